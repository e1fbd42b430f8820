"""Joint estimation of parameters by damped Gauss-Newton steps, many estimation problems side by side.

Every finite-difference column and every trial step of every problem is one request to the machine, so that one batch of
simulations serves all of them. Weights follow the residual: every block of a tenth of a second of every signal has a variance
of its own, at least the noise's, which is maximum likelihood for variances that are unknown. What the model explains
well thereby counts, and a few events that it misses (a spool that sticks a moment longer) do not drown the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import lsq_linear

from ...plant import CATALOGUE, parameter_of
from ..models.base import BLOCK_S, Machine, Request, Segment
from .noise import effective_samples, noise_floor
from .unknowns import Unknown, effect_unknowns, less_taken, scaled

if TYPE_CHECKING:
    from .uncertainty import Certainty

__all__ = [
    "Floors",
    "Problem",
    "at_noise",
    "beside",
    "channels_of",
    "differentiate",
    "evaluate",
    "floors_from",
    "gain",
    "levels",
    "lower",
    "normal_parts",
    "rescored",
    "rms",
    "saved_by_stretch",
    "solve",
    "stretch_costs",
]

Vector = np.ndarray
#: Standard deviations of the noise by (channel, signal), in SI.
Floors = dict[tuple[int, str], float]
#: Steps of q for finite differences, in turn: stiction makes the data a rough function of its parameters.
_STEPS = (0.15, 0.04, 0.4)
#: Parts and multiples of a step that are tried: weights that follow the residual make single steps too short.
_TRIALS = (4.0, 2.0, 1.0, 0.4, 0.1)
#: Starts of a problem that are nearer than this in every q have met.
_MET = 0.05


@dataclass
class Problem:
    """Unknowns of a channel (or of the whole rig: None) and the estimate so far.

    `simulated` holds, by channel, the samples at `q`; `columns` their derivatives (n, number of unknowns) where they were
    last computed; `spread` the standard deviations of q. `follow` holds parameters that are not estimated but repeat
    another one of the problem, by name (with a minus: its opposite), or a number. `together` names the
    directions of all that is told by ratios only (`unknowns.TOGETHER`) along which derivatives are taken.
    """

    channel: int | None
    unknowns: list[Unknown]
    q: Vector
    label: str = ""
    simulated: dict[int, Vector] = field(default_factory=dict)
    columns: dict[int, Vector] = field(default_factory=dict)
    spread: Vector | None = None
    cost: float = np.inf
    certainty: Certainty | None = None
    follow: dict[str, str | float] = field(default_factory=dict)
    together: tuple[str, ...] = ("k",)

    def request(self, q: Vector | None = None) -> Request:
        """The simulation at q (default: at the estimate)."""
        q = self.q if q is None else q
        if self.channel is not None:
            values = {u.name: u.value(v) for u, v in zip(self.unknowns, q, strict=True)}
            return Request(self.channel, self._with_followers(values))
        pairs: dict[str, list[float]] = {}
        for u, v in zip(self.unknowns, q, strict=True):
            value = u.value(v)
            # What is estimated for one channel alone is an effect that the other one does not have.
            other = value if "." not in u.name else parameter_of(u.name).nominal
            pair = pairs.setdefault(u.name, [other, other])
            for c in (0, 1) if u.channel is None else (u.channel,):
                pair[c] = value
        sides = [self._with_followers({name: pair[c] for name, pair in pairs.items()}) for c in (0, 1)]
        return Request(None, {name: (sides[0][name], sides[1][name]) for name in sides[0]})

    def _with_followers(self, values: dict[str, float]) -> dict[str, float]:
        for name, source in self.follow.items():
            if not isinstance(source, str):
                values[name] = source
            elif source.removeprefix("-") in values:
                value = values[source.removeprefix("-")]
                values[name] = -value if source.startswith("-") else value
        return values

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        pairs = np.array([u.bounds for u in self.unknowns]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def values(self, channel: int) -> dict[str, float]:
        """The estimated values that act on a channel, by name."""
        own = zip(self.unknowns, self.q, strict=True)
        return self._with_followers({u.name: u.value(v) for u, v in own if u.channel in (None, channel)})

    def effects(self) -> list[str]:
        return list(dict.fromkeys(u.name.split(".", 1)[0] for u in self.unknowns if "." in u.name))


def beside(problem: Problem, effect: str, start: dict[str, float]) -> Problem:
    """The problem with an effect more at the values `start` {own name: value}."""
    added = effect_unknowns(CATALOGUE[effect], start)
    q = np.concatenate([problem.q, np.zeros(len(added))])
    if problem.channel is not None:
        taken = less_taken(problem.values(problem.channel), effect, start)
        for j, u in enumerate(problem.unknowns):
            if u.name in taken:
                q[j] = np.clip(u.q(taken[u.name]), *u.bounds)
    return Problem(problem.channel, [*problem.unknowns, *added], q, effect, follow=problem.follow)


def channels_of(problem: Problem, machine: Machine) -> tuple[int, ...]:
    return machine.channels if problem.channel is None else (problem.channel,)


def floors_from(machine: Machine, problems: dict[int, Problem]) -> Floors:
    """Noise floors by (channel, signal): the smallest that the residual of a model or the bare signal shows, SI."""
    floors: Floors = {}
    for channel, problem in problems.items():
        found: dict[str, list[float]] = {}
        for s in machine.segments[channel]:
            # Of the residual: a model, even a poor one, takes the fast movements out.
            error = s.measured - problem.simulated[channel][s.place]
            both = [noise_floor(x, s.used, s.period) for x in (error, s.measured)]
            found.setdefault(s.signal, []).append(float(np.nanmin(both)))
        for signal, values in found.items():
            floors[channel, signal] = max(float(np.nanmedian(values)), 1e-12)
    return floors


def lower(old: Floors, new: Floors) -> Floors:
    """The lower of two floors, for all that `old` has."""
    return {key: min(value, new.get(key, value)) for key, value in old.items()}


def rms(machine: Machine, simulated: Vector, channel: int) -> dict[tuple[int, str], float]:
    """RMS error by (log, signal) over the rows that count, SI."""
    found = {}
    for s in machine.segments[channel]:
        error = (s.measured - simulated[s.place])[s.used]
        found[s.log, s.signal] = float(np.sqrt(np.mean(error * error))) if error.size else float("nan")
    return found


def _powers(
    machine: Machine, simulated: Vector, channel: int, floors: Floors
) -> Iterator[tuple[Segment, Vector, Vector, Vector]]:
    """By segment: the first row of every block (b,), the rows of it that count, and the power of noise and error (b,).

    The power is the mean square of the error plus the noise's.
    """
    for s in machine.segments[channel]:
        first, count = s.blocks
        error = s.error(simulated)
        power = (
            np.add.reduceat(error * error, first) / np.maximum(count, 1.0) + floors[channel, s.signal] ** 2
        )
        yield s, first, count, power


def levels(machine: Machine, simulated: Vector, channel: int, floors: Floors) -> dict[str, float]:
    """By signal: how far the errors are above the noise, as the mean over blocks of log(power), 0 at the noise.

    Unlike an RMS it is not a matter of a few events, such as a spool that meets its end stop a millisecond late.
    """
    sums: dict[str, list[float]] = {}
    for s, _, count, power in _powers(machine, simulated, channel, floors):
        entry = sums.setdefault(s.signal, [0.0, 0.0])
        entry[0] += float(count @ np.log(power / floors[channel, s.signal] ** 2))
        entry[1] += float(count.sum())
    return {name: max(total / max(n, 1.0) - float(np.log(2.0)), 0.0) for name, (total, n) in sums.items()}


def _cost(
    machine: Machine, problem: Problem, simulated: dict[int, Vector], q: Vector, floors: Floors
) -> float:
    """Twice the negative log-likelihood with an unknown variance in every block, plus priors; inf for a failed simulation."""
    total = float(sum(v * v for u, v in zip(problem.unknowns, q, strict=True) if u.prior))
    for channel in channels_of(problem, machine):
        if not np.isfinite(simulated[channel]).all():
            return np.inf
        for _, _, count, power in _powers(machine, simulated[channel], channel, floors):
            total += float(count @ np.log(power))
    return total


def _weights(machine: Machine, simulated: Vector, channel: int, floors: Floors) -> Vector:
    """One over the standard deviation of every sample (n,), 0 for rows that do not count."""
    weights = np.zeros(simulated.size)
    for s, first, _, power in _powers(machine, simulated, channel, floors):
        sizes = np.diff(first, append=s.rows.size)
        weights[s.place] = s.used / np.sqrt(np.repeat(power, sizes))
    return weights


def _measured(machine: Machine, channel: int) -> Vector:
    return np.concatenate([s.filled for s in machine.segments[channel]])


def evaluate(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Simulates every problem at its estimate and sets `simulated` and `cost`."""
    for problem, result in zip(problems, machine.predict([p.request() for p in problems]), strict=True):
        problem.simulated = result
        problem.cost = _cost(machine, problem, result, problem.q, floors)


def rescored(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Sets `cost` anew, for other floors."""
    for problem in problems:
        problem.cost = _cost(machine, problem, problem.simulated, problem.q, floors)


def at_noise(machine: Machine, problem: Problem, floors: Floors, within: float = 1.02) -> bool:
    """Whether no signal of any log is left with more than its noise, or so many times it."""
    return all(
        value < within * floors[channel, signal]
        for channel in channels_of(problem, machine)
        for (_, signal), value in rms(machine, problem.simulated[channel], channel).items()
    )


def differentiate(
    machine: Machine,
    problems: Sequence[Problem],
    floors: Floors,
    only: Sequence[Sequence[int]] | None = None,
    size: float = _STEPS[0],
) -> list[tuple[float, Vector, dict[int, Vector]]]:
    """Sets `columns` of every problem, or only the columns `only` (one list of numbers for each problem).

    Returns for every problem the best of the points that were simulated for it: (cost, q, samples).
    """
    wanted = [list(range(len(p.unknowns))) if only is None else list(only[n]) for n, p in enumerate(problems)]
    moves: list[list[tuple[int, Vector]]] = []
    for problem, numbers in zip(problems, wanted, strict=True):
        moves.append([(j, _move(problem, j, size)) for j in numbers])
    requests = [p.request(p.q + move) for p, own in zip(problems, moves, strict=True) for _, move in own]
    results = iter(machine.predict(requests))
    found = []
    for problem, own in zip(problems, moves, strict=True):
        best = (np.inf, problem.q, problem.simulated)
        low, high = problem.bounds
        for channel in channels_of(problem, machine):
            shape = (problem.simulated[channel].size, len(problem.unknowns))
            kept = problem.columns.get(channel)
            # New ones: a problem that another was made from may still hold the old ones.
            fresh = np.zeros(shape) if kept is None or kept.shape != shape or only is None else kept.copy()
            problem.columns = {**problem.columns, channel: fresh}
        for j, move in own:
            result, moved = next(results), problem.q + move
            for channel in channels_of(problem, machine):
                problem.columns[channel][:, j] = (result[channel] - problem.simulated[channel]) / move[j]
            inside = bool(np.all((low <= moved) & (moved <= high)))
            cost = _cost(machine, problem, result, moved, floors) if inside else np.inf
            if cost < best[0]:
                best = (cost, moved, result)
        _part(problem, own)
        found.append(best)
    return found


def _part(problem: Problem, moves: Sequence[tuple[int, Vector]]) -> None:
    """Puts derivatives by single unknowns in the place of those along `moves`, by unknown, in the columns just computed."""
    if all(np.count_nonzero(move) == 1 for _, move in moves):
        return
    new = [j for j, _ in moves]
    along = np.array([move / move[j] for j, move in moves]).T
    apart = np.linalg.inv(along[new])
    along[new] = 0.0
    for columns in problem.columns.values():
        columns[:, new] = (columns[:, new] - columns @ along) @ apart


def _move(problem: Problem, j: int, size: float) -> Vector:
    """The change of q for the derivative by unknown j: of it alone, or of all that it is told together with (`TOGETHER`)."""
    step = -size if problem.q[j] + size > problem.bounds[1][j] else size
    name = problem.unknowns[j].name
    # The forces not with every size of step: which derivative leads into a valley and which out of it is a matter of luck.
    if name in problem.together and (name != "k" or size != _STEPS[1]):
        return scaled(problem.unknowns, problem.q, j, step)
    move = np.zeros(len(problem.unknowns))
    move[j] = step
    return move


def _normal(machine: Machine, problem: Problem, floors: Floors) -> tuple[Vector, Vector]:
    """Normal matrix and right-hand side of the linearised problem, priors included."""
    size = len(problem.unknowns)
    prior = np.array([1.0 if u.prior else 0.0 for u in problem.unknowns])
    matrix, side = np.diag(prior), -prior * problem.q
    for channel in channels_of(problem, machine):
        weights = _weights(machine, problem.simulated[channel], channel, floors)
        columns = problem.columns[channel] * weights[:, None]
        error = (_measured(machine, channel) - problem.simulated[channel]) * weights
        matrix += columns.T @ columns
        side += columns.T @ error
    return matrix.reshape(size, size), side


def _bounded_step(problem: Problem, matrix: Vector, side: Vector) -> Vector:
    """The Gauss-Newton step inside the bounds and not longer than 3 in any coordinate."""
    scale, vectors = np.linalg.eigh(matrix)
    scale = np.maximum(scale, 1e-9 * scale[-1] + 1e-9)
    root = np.sqrt(scale)
    low, high = problem.bounds
    low, high = np.maximum(low - problem.q, -3.0), np.minimum(high - problem.q, 3.0)
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    return lsq_linear(
        root[:, None] * vectors.T, (vectors.T @ side) / root, bounds=(low, high), method="bvls"
    ).x


def solve(
    machine: Machine,
    problems: Sequence[Problem],
    floors: Floors,
    iterations: int = 4,
    tolerance: float = 2.0,
    races: Sequence[Sequence[Problem]] = (),
    sizes: Sequence[float] = _STEPS,
) -> None:
    """Improves the estimates of all problems.

    `races` are starts of the same problem, or rivals, improved in the same way, of which only the best one will be used: one
    that cannot become the best any more ends early (`_out_of_race`).

    `sizes` are the steps of q for finite differences, in turn.

    A problem ends early once no step size of the differences lowers its cost by `tolerance`, or one does not and the
    problem is at the noise already. One that brings `columns`
    along (from a smaller problem) uses them in its first step.
    """
    fresh = [p for p in problems if not p.simulated]
    evaluate(machine, fresh, floors)
    live = [p for p in problems if p.unknowns and np.isfinite(p.cost)]
    stalled = dict.fromkeys(map(id, live), 0)
    falls: dict[int, list[float]] = {id(p): [] for p in live}
    for iteration in range(iterations):
        if not live:
            break
        old = [p for p in live if not p.columns or iteration > 0]
        points = differentiate(machine, old, floors, size=sizes[iteration % len(sizes)])
        steps = [_bounded_step(p, *_normal(machine, p, floors)) for p in live]
        low_high = [p.bounds for p in live]
        trials = [
            np.clip(p.q + factor * step, low, high)
            for p, step, (low, high) in zip(live, steps, low_high, strict=True)
            for factor in _TRIALS
        ]
        owners = [p for p in live for _ in _TRIALS]
        results = machine.predict([p.request(q) for p, q in zip(owners, trials, strict=True)])
        before = {id(p): p.cost for p in live}
        for problem, q, result in zip(owners, trials, results, strict=True):
            cost = _cost(machine, problem, result, q, floors)
            if cost < problem.cost:
                problem.cost, problem.q, problem.simulated = cost, q, result
        for problem, (cost, q, result) in zip(old, points, strict=True):
            # A point that was simulated for a derivative may be better than every step along it.
            if cost < problem.cost:
                problem.cost, problem.q, problem.simulated = cost, q, result
        for p in live:
            idle = before[id(p)] - p.cost < tolerance
            quiet = idle and at_noise(machine, p, floors)
            stalled[id(p)] = len(sizes) if quiet else stalled[id(p)] + 1 if idle else 0
            falls[id(p)].append(before[id(p)] - p.cost)
        out = {n for race in races for n in _out_of_race(race, falls, iterations - iteration - 1, tolerance)}
        live = [p for p in live if stalled[id(p)] < len(sizes) and id(p) not in out]
    for problem in problems:
        if problem.unknowns and problem.columns:
            problem.spread = _spread(machine, problem, floors)


def _out_of_race(
    race: Sequence[Problem], falls: dict[int, list[float]], left: int, tolerance: float
) -> set[int]:
    """The ids of the starts that have met the best one, or do not reach it in the iterations that are left if every one of
    these is as good as the best of the last ones, one of each size of step."""
    best = min(race, key=lambda p: p.cost)
    out = set()
    for p in race:
        recent = falls.get(id(p), [])[-len(_STEPS) :]
        if p is best or len(recent) < len(_STEPS):
            continue
        behind = p.cost - best.cost
        same = [u.name for u in p.unknowns] == [u.name for u in best.unknowns]  # forms may race, too
        met = same and behind < tolerance and float(np.max(np.abs(p.q - best.q), initial=0.0)) < _MET
        if met or behind > left * max(recent):
            out.add(id(p))
    return out


def _spread(machine: Machine, problem: Problem, floors: Floors) -> Vector:
    """Standard deviations of q, widened for the correlation of the residual."""
    prior = np.diag([1.0 if u.prior else 0.0 for u in problem.unknowns])
    matrix = prior + 1e-12 * np.eye(len(problem.unknowns))
    for channel in channels_of(problem, machine):
        weights = _weights(machine, problem.simulated[channel], channel, floors)
        for s in machine.segments[channel]:
            if s.used.sum() < 8:
                continue
            error = (s.measured - problem.simulated[channel][s.place])[s.used]
            share = effective_samples(error) / error.size
            columns = problem.columns[channel][s.place] * weights[s.place, None]
            matrix = matrix + share * (columns.T @ columns)
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(matrix, hermitian=True)), 0.0))


def _stretches(segment: Segment, stretch_s: float) -> Vector:
    """Number of the stretch of each row of a segment."""
    return (np.arange(segment.rows.size) * segment.period / stretch_s).astype(int)


def normal_parts(
    machine: Machine, problem: Problem, floors: Floors, stretch_s: float
) -> tuple[Vector, Vector]:
    """Normal matrices (m, k, k) and right-hand sides (m, k), without priors, of m stretches of time of all logs.

    Samples count by the share of them that is independent.
    """
    size = len(problem.unknowns)
    found: dict[tuple[int, int], tuple[Vector, Vector]] = {}
    for channel in channels_of(problem, machine):
        weights = _weights(machine, problem.simulated[channel], channel, floors)
        for s in machine.segments[channel]:
            if s.used.sum() < 8:
                continue
            error = s.error(problem.simulated[channel])
            share = effective_samples(error[s.used]) / float(s.used.sum())
            columns = problem.columns[channel][s.place] * weights[s.place, None]
            number = _stretches(s, stretch_s)
            for n in range(number[-1] + 1):
                rows = number == n
                matrix, side = found.setdefault((s.log, n), (np.zeros((size, size)), np.zeros(size)))
                part = columns[rows]
                matrix += share * (part.T @ part)
                side += share * (part.T @ (error[rows] * weights[s.place][rows]))
    ordered = [found[key] for key in sorted(found)]
    return np.array([m for m, _ in ordered]), np.array([v for _, v in ordered])


def saved_by_stretch(
    machine: Machine, smaller: Problem, larger: Problem, channel: int, floors: Floors, stretch_s: float
) -> Vector:
    """Fall of the deviance from `smaller` to `larger` (m,) in every stretch of a channel's logs, in independent samples.

    The share of samples that is independent is that of the signal with the longest memory: were every signal counted by
    its own, a current at its white noise would outweigh a pressure that is far off for seconds.
    """
    found: dict[tuple[int, int], float] = {}
    shares = []
    for s in machine.segments[channel]:
        if s.used.sum() < 8:
            continue
        floor = floors[channel, s.signal] ** 2
        number = _stretches(s, stretch_s)
        errors = [s.error(p.simulated[channel]) for p in (smaller, larger)]
        weights = _weights(machine, larger.simulated[channel], channel, floors)[s.place]
        shares.append(effective_samples((errors[1] * weights)[s.used]) / float(s.used.sum()))
        counts = np.bincount(number, s.used.astype(float))
        powers = [np.bincount(number, e * e) / np.maximum(counts, 1.0) + floor for e in errors]
        for n, value in enumerate(counts * np.log(powers[0] / powers[1])):
            found[s.log, n] = found.get((s.log, n), 0.0) + float(value)
    return min(shares, default=1.0) * np.array([found[key] for key in sorted(found)])


def stretch_costs(
    machine: Machine, problem: Problem, channel: int, floors: Floors, stretch_s: float
) -> Vector:
    """The cost, without priors, of a channel's logs in stretches of time (m,)."""
    found: dict[tuple[int, int], float] = {}
    for s, first, count, power in _powers(machine, problem.simulated[channel], channel, floors):
        for n, value in zip(_stretches(s, stretch_s)[first], count * np.log(power), strict=True):
            found[s.log, n] = found.get((s.log, n), 0.0) + float(value)
    return np.array([found[key] for key in sorted(found)])


def gain(
    machine: Machine, smaller: Problem, larger: Problem, floors: Floors, channels: Sequence[int] | None = None
) -> float:
    """How much better `larger` explains the data: the fall of the deviance, counted in independent samples.

    As in the cost that is minimised, every block has a variance of its own: one effect of two is a gain although the events
    that only the other one explains spoil any RMS.
    """
    return float(
        sum(
            saved_by_stretch(machine, smaller, larger, channel, floors, BLOCK_S).sum()
            for channel in (channels_of(larger, machine) if channels is None else channels)
        )
    )
