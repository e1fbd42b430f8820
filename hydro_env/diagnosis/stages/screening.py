"""What every effect of the catalogue would look like in these logs: its signature beside the calibrated model.

One simulation per effect and size. A signature is the change of all signals; what calibration could absorb of it is
projected off. From it follow, at once, whether the effect could be seen at all here (`detectable`), which effects look
alike (`alike`), and how much of the present gap each could explain (`first_look`). Finite sizes are used because a dead
zone, play or stiction has no useful derivative at zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...plant import CATALOGUE
from ..estimation.least_squares import Floors, Problem
from ..estimation.unknowns import less_taken, starts
from ..models.base import Machine, Request

__all__ = ["Look", "absorb", "alike", "detectable", "first_look", "hidden_by_calibration"]

#: Squared length of a projected signature, in noise units, from which an effect counts as visible.
VISIBLE = 60.0
#: Share of the squared length of what an effect changes that calibration may leave of an effect that it takes up: where it moves
#: along derivatives of one place only, it never gets all of it. Others keep more than five times that.
TAKEN = 1e-4
#: Steps of calibration towards an effect of medium size at most and at least, and what a later step must make of what is left
#: to be followed by another.
ABSORB, LEAST, GOING = 8, 2, 0.8
#: Cosine from which two projected signatures count as the same.
SAME = 0.96


@dataclass
class Look:
    """An effect on a channel (None: the rig) at the size that explains most of the gap.

    `gain` is the expected fall of the deviance, `visible` the squared length of the signature of medium size in noise
    units after projection, by channel; `signature` that projected signature, normalised, all channels one after the other.
    `plain` is the squared length before projection, `change` (n,) the unweighted signature of medium size (one channel only).
    """

    effect: str
    channel: int | None
    start: dict[str, float]
    gain: float
    visible: float
    signature: np.ndarray
    plain: float = 0.0
    change: np.ndarray | None = None

    @property
    def hidden(self) -> bool:
        """Whether it would show if nothing were calibrated, and calibration takes it all."""
        return self.plain > VISIBLE and self.visible <= max(VISIBLE, TAKEN * self.plain)

    @property
    def shows(self) -> bool:
        """Whether logs like these would show it."""
        return self.visible > VISIBLE and not self.hidden


class _Projector:
    """Takes out of a weighted vector what small changes of the base parameters can make."""

    def __init__(
        self, machine: Machine, problem: Problem, channel: int, deviations: dict[str, float]
    ) -> None:
        self.weights = np.zeros(problem.simulated[channel].size)
        for s in machine.segments[channel]:
            self.weights[s.place] = s.used / deviations[s.signal]
        columns = problem.columns[channel] * self.weights[:, None]
        prior = np.diag([1.0 if u.prior else 1e-6 for u in problem.unknowns])
        # Rows of the prior below the columns make the projection a ridge: parameters move inside their priors only.
        self.basis, _ = np.linalg.qr(np.vstack([columns, np.sqrt(prior)]))
        self.rows = columns.shape[0]

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        full = np.concatenate([vector * self.weights, np.zeros(self.basis.shape[0] - self.rows)])
        full -= self.basis @ (self.basis.T @ full)
        return full[: self.rows]


def first_look(
    machine: Machine, problems: dict[int, Problem], floors: Floors, effects: Sequence[str], seconds: float,
    earlier: Sequence[Look] = (),
) -> list[Look]:  # fmt: skip
    """One look at every effect on every channel, beside the present `problems`, best first.

    Effects of the whole rig are looked at on both channels together. Effects that are slow to simulate are looked at only
    in the size that did best in an `earlier` look, if there is one.
    """
    wanted: list[tuple[str, int | None, dict[str, float]]] = []
    for name in effects:
        effect = CATALOGUE[name]
        for channel in problems if effect.scope == "channel" else (None,):
            known = [k.start for k in earlier if (k.effect, k.channel) == (name, channel)]
            slow = effect.corner is not None and known
            wanted += [(name, channel, start) for start in (known if slow else starts(effect, seconds))]
    requests = [_beside(problems, name, channel, start) for name, channel, start in wanted]
    results = machine.predict(requests)
    left = {c: _Projector(machine, p, c, _deviations(machine, p, c, floors)) for c, p in problems.items()}
    noise = {
        c: _Projector(machine, p, c, {s: floors[c, s] for s in {g.signal for g in machine.segments[c]}})
        for c, p in problems.items()
    }
    errors = {c: left[c](_error(machine, p, c)) for c, p in problems.items()}
    looks: dict[tuple[str, int | None], Look] = {}
    for (name, channel, start), result in zip(wanted, results, strict=True):
        channels = machine.channels if channel is None else (channel,)
        if not all(np.isfinite(result[c]).all() for c in channels):
            continue
        changes = {c: result[c] - problems[c].simulated[c] for c in channels}
        gained = _gain(machine, channels, {c: left[c](changes[c]) for c in channels}, errors, left, floors)
        parts = [noise[c](changes[c]) for c in channels]
        signature = np.concatenate(parts)
        size = float(signature @ signature)
        look = looks.get((name, channel))
        medium = _is_medium(name, start)
        if look is None:
            look = looks[name, channel] = Look(
                name, channel, start, gained, size, signature / max(np.sqrt(size), 1e-30)
            )
        if medium:
            look.visible, look.signature = size, signature / max(np.sqrt(size), 1e-30)
            look.plain = sum(float(np.sum((changes[c] * noise[c].weights) ** 2)) for c in channels)
            look.change = changes[channel] if channel is not None else None
        if gained > look.gain:
            look.gain, look.start = gained, start
    return sorted(looks.values(), key=lambda look: -look.gain)


def absorb(machine: Machine, problems: dict[int, Problem], floors: Floors, looks: Sequence[Look]) -> None:
    """Lowers `visible` to what calibration leaves of an effect if it really moves, and not only along its derivatives.

    The logs of a rig with the effect of medium size are what is fitted here, by steps along the derivatives at `problems`.
    """
    places = {}
    for c, p in problems.items():
        weights = np.zeros(p.simulated[c].size)
        for s in machine.segments[c]:
            weights[s.place] = s.used / floors[c, s.signal]
        columns = p.columns[c] * weights[:, None]
        prior = np.diag([1.0 if u.prior else 1e-6 for u in p.unknowns])
        places[c] = weights, columns, np.linalg.pinv(columns.T @ columns + prior)
    live = [k for k in looks if k.channel is not None and k.change is not None and k.visible > VISIBLE]
    moved = {id(k): problems[k.channel].q for k in live}  # type: ignore[index]
    left = {id(k): k.change for k in live if k.change is not None}
    going: dict[int, bool] = {}
    for number in range(ABSORB):
        requests = []
        for k in live:
            assert k.channel is not None
            problem, (weights, columns, inverse) = problems[k.channel], places[k.channel]
            q, rest = moved[id(k)], left[id(k)]
            step = inverse @ (columns.T @ (rest * weights) - (q - problem.q))
            moved[id(k)] = np.clip(q + step, *problem.bounds)
            requests.append(problem.request(moved[id(k)]))
        for k, result in zip(live, machine.predict(requests), strict=True):
            assert k.channel is not None and k.change is not None
            problem, (weights, columns, inverse) = problems[k.channel], places[k.channel]
            rest = left[id(k)] = k.change + problem.simulated[k.channel] - result[k.channel]
            if not np.isfinite(rest).all():
                going[id(k)] = False
                continue
            along = rest * weights - columns @ (inverse @ (columns.T @ (rest * weights)))
            now = float(along @ along)
            going[id(k)] = now > VISIBLE and (number < LEAST or now < GOING * k.visible)
            k.visible = min(k.visible, now)
        live = [k for k in live if going[id(k)]]


def _beside(
    problems: dict[int, Problem], effect: str, channel: int | None, start: dict[str, float]
) -> Request:
    extra = {f"{effect}.{name}": value for name, value in start.items()}
    if channel is not None:
        values = problems[channel].values(channel)
        return Request(channel, {**values, **less_taken(values, effect, start), **extra})
    pairs: dict[str, tuple[float, float]] = {}
    sides = [problems[c].values(c) if c in problems else {} for c in (0, 1)]
    for name in {*sides[0], *sides[1]}:
        pair = [side.get(name) for side in sides]
        pairs[name] = tuple(v if v is not None else next(w for w in pair if w is not None) for v in pair)  # type: ignore[assignment]
    return Request(None, {**pairs, **{name: (value, value) for name, value in extra.items()}})


def _is_medium(effect: str, start: dict[str, float]) -> bool:
    return all(
        start[p.name] == p.typical
        for p in CATALOGUE[effect].parameters
        if p.typical is not None and p.typical != p.nominal
    )


def _deviations(machine: Machine, problem: Problem, channel: int, floors: Floors) -> dict[str, float]:
    sums: dict[str, list[float]] = {}
    for s in machine.segments[channel]:
        error = (s.measured - problem.simulated[channel][s.place])[s.used]
        entry = sums.setdefault(s.signal, [0.0, 1e-9])
        entry[0] += float(error @ error)
        entry[1] += error.size
    return {n: float(np.sqrt(max(t / k, floors[channel, n] ** 2))) for n, (t, k) in sums.items()}


def _error(machine: Machine, problem: Problem, channel: int) -> np.ndarray:
    return np.concatenate(
        [np.nan_to_num(s.measured - problem.simulated[channel][s.place]) for s in machine.segments[channel]]
    )


def _gain(
    machine: Machine, channels: Sequence[int], changes: dict[int, np.ndarray], errors: dict[int, np.ndarray],
    projectors: dict[int, _Projector], floors: Floors,
) -> float:  # fmt: skip
    """Fall of the deviance if the change came with the best factor from 0 to 1.5."""
    square = sum(float(changes[c] @ changes[c]) for c in channels)
    if square <= 1e-12:
        return 0.0
    factor = float(np.clip(sum(float(changes[c] @ errors[c]) for c in channels) / square, 0.0, 1.5))
    total = 0.0
    for c in channels:
        for s in machine.segments[c]:
            used = s.used
            before = errors[c][s.place][used]
            after = before - factor * changes[c][s.place][used]
            # In the units of the weights the noise floor is the floor over the deviation that was left.
            scale = projectors[c].weights[s.place][used]
            floor = floors[c, s.signal] * (scale[0] if scale.size else 1.0)
            total += before.size * np.log(
                max(np.mean(before**2), floor**2) / max(np.mean(after**2), floor**2)
            )
    return float(total)


def detectable(looks: Sequence[Look], machine: Machine) -> dict[str, dict[str, bool]]:
    """By effect and channel ("1", "2", "rig"): whether an effect of medium size would show in these logs."""
    found: dict[str, dict[str, bool]] = {}
    for look in looks:
        key = "rig" if look.channel is None else str(look.channel + 1)
        found.setdefault(look.effect, {})[key] = look.shows
    return {name: dict(sorted(found[name].items())) for name in CATALOGUE if name in found}


def hidden_by_calibration(looks: Sequence[Look]) -> dict[str, list[str]]:
    """By effect the channels on which calibration takes all of an effect of medium size that would show otherwise."""
    found: dict[str, list[str]] = {}
    for look in looks:
        if look.hidden:
            found.setdefault(look.effect, []).append("rig" if look.channel is None else str(look.channel + 1))
    return {name: sorted(found[name]) for name in CATALOGUE if name in found}


def alike(looks: Sequence[Look]) -> dict[tuple[str, int | None], list[str]]:
    """For every effect on a channel the visible ones whose signature has the same direction, whatever the sign."""
    found: dict[tuple[str, int | None], list[str]] = {}
    for a in looks:
        same = [
            b.effect for b in looks
            if b is not a and b.channel == a.channel and min(a.visible, b.visible) > VISIBLE
            and abs(float(a.signature @ b.signature)) > SAME
        ]  # fmt: skip
        found[a.effect, a.channel] = same
    return found
