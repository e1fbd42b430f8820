"""Joint estimation of parameters by damped Gauss-Newton steps, many estimation problems side by side.

Every finite-difference column and every trial step of every problem is one request to the machine, so that one batch of
simulations serves all of them. Weights follow the residual: each signal of each channel has the variance that the
model leaves in it, at least the noise floor, which is maximum likelihood for unknown variances. A signal that the
model explains badly thereby does not drown the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear

from .machine import Machine, Request
from .noise import effective_samples
from .unknowns import Unknown

__all__ = ["Floors", "Problem", "channels_of", "differentiate", "evaluate", "gain", "rms", "solve"]

Vector = np.ndarray
#: Standard deviations of the noise by (channel, signal), in SI.
Floors = dict[tuple[int, str], float]
_STEP = 0.04  # of q, for finite differences
_TRIALS = (1.0, 0.5, 0.2, 0.05)


@dataclass
class Problem:
    """Unknowns of a channel (or of the whole rig: None) and the estimate so far.

    `simulated` holds, by channel, the samples at `q`; `columns` their derivatives (n, number of unknowns) where they were
    last computed; `spread` the standard deviations of q.
    """

    channel: int | None
    unknowns: list[Unknown]
    q: Vector
    label: str = ""
    simulated: dict[int, Vector] = field(default_factory=dict)
    columns: dict[int, Vector] = field(default_factory=dict)
    spread: Vector | None = None
    cost: float = np.inf

    def request(self, q: Vector | None = None) -> Request:
        """The simulation at q (default: at the estimate)."""
        q = self.q if q is None else q
        if self.channel is not None:
            return Request(self.channel, {u.name: u.value(v) for u, v in zip(self.unknowns, q, strict=True)})
        pairs: dict[str, list[float]] = {}
        for u, v in zip(self.unknowns, q, strict=True):
            value = u.value(v)
            pair = pairs.setdefault(u.name, [value, value])
            for c in (0, 1) if u.channel is None else (u.channel,):
                pair[c] = value
        return Request(None, {name: (pair[0], pair[1]) for name, pair in pairs.items()})

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        pairs = np.array([u.bounds for u in self.unknowns]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def values(self, channel: int) -> dict[str, float]:
        """The estimated values that act on a channel, by name."""
        return {u.name: u.value(v) for u, v in zip(self.unknowns, self.q, strict=True) if u.channel in (None, channel)}

    def effects(self) -> list[str]:
        return list(dict.fromkeys(u.name.split(".", 1)[0] for u in self.unknowns if "." in u.name))


def channels_of(problem: Problem, machine: Machine) -> tuple[int, ...]:
    return machine.channels if problem.channel is None else (problem.channel,)


def rms(machine: Machine, simulated: Vector, channel: int) -> dict[tuple[int, str], float]:
    """RMS error by (log, signal) over the rows that count, SI."""
    found = {}
    for s in machine.segments[channel]:
        error = (s.measured - simulated[s.place])[s.used]
        found[s.log, s.signal] = float(np.sqrt(np.mean(error * error))) if error.size else float("nan")
    return found


def variances(machine: Machine, simulated: Vector, channel: int, floors: Floors) -> dict[str, float]:
    """Variance that a model leaves in each signal of a channel, at least the noise's."""
    totals: dict[str, list[float]] = {}
    for s in machine.segments[channel]:
        error = (s.measured - simulated[s.place])[s.used]
        entry = totals.setdefault(s.signal, [0.0, 0.0])
        entry[0] += float(error @ error)
        entry[1] += error.size
    return {n: max(t / max(k, 1.0), floors[channel, n] ** 2) for n, (t, k) in totals.items()}


def _cost(machine: Machine, problem: Problem, simulated: dict[int, Vector], q: Vector, floors: Floors) -> float:
    """Twice the negative log-likelihood with unknown variances, plus priors; infinite where a simulation failed."""
    total = float(sum(v * v for u, v in zip(problem.unknowns, q, strict=True) if u.prior))
    for channel in channels_of(problem, machine):
        if not np.isfinite(simulated[channel]).all():
            return np.inf
        left = variances(machine, simulated[channel], channel, floors)
        count: dict[str, int] = {}
        for s in machine.segments[channel]:
            count[s.signal] = count.get(s.signal, 0) + int(s.used.sum())
        total += sum(count[n] * np.log(v) for n, v in left.items())
    return total


def _weights(machine: Machine, simulated: Vector, channel: int, floors: Floors) -> Vector:
    """One over the standard deviation of every sample (n,), 0 for rows that do not count."""
    left = variances(machine, simulated, channel, floors)
    weights = np.zeros(simulated.size)
    for s in machine.segments[channel]:
        weights[s.place] = s.used / np.sqrt(left[s.signal])
    return weights


def _measured(machine: Machine, channel: int) -> Vector:
    return np.concatenate([np.nan_to_num(s.measured) for s in machine.segments[channel]])


def evaluate(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Simulates every problem at its estimate and sets `simulated` and `cost`."""
    for problem, result in zip(problems, machine.predict([p.request() for p in problems]), strict=True):
        problem.simulated = result
        problem.cost = _cost(machine, problem, result, problem.q, floors)


def differentiate(machine: Machine, problems: Sequence[Problem], only: Sequence[Sequence[int]] | None = None) -> None:
    """Sets `columns` of every problem, or only the columns `only` (one list of numbers for each problem)."""
    wanted = [list(range(len(p.unknowns))) if only is None else list(only[n]) for n, p in enumerate(problems)]
    requests, steps = [], []
    for problem, numbers in zip(problems, wanted, strict=True):
        high = problem.bounds[1]
        for j in numbers:
            step = -_STEP if problem.q[j] + _STEP > high[j] else _STEP
            moved = problem.q.copy()
            moved[j] += step
            requests.append(problem.request(moved))
            steps.append(step)
    results = iter(zip(machine.predict(requests), steps, strict=True))
    for problem, numbers in zip(problems, wanted, strict=True):
        for channel in channels_of(problem, machine):
            size = (problem.simulated[channel].size, len(problem.unknowns))
            if problem.columns.get(channel, np.empty((0, 0))).shape != size:
                problem.columns[channel] = np.zeros(size)
        for j in numbers:
            result, step = next(results)
            for channel in channels_of(problem, machine):
                problem.columns[channel][:, j] = (result[channel] - problem.simulated[channel]) / step


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
    return lsq_linear(root[:, None] * vectors.T, (vectors.T @ side) / root, bounds=(low, high), method="bvls").x


def solve(machine: Machine, problems: Sequence[Problem], floors: Floors, iterations: int = 4, tolerance: float = 2.0) -> None:
    """Improves the estimates of all problems; ends early for a problem whose cost falls by less than `tolerance`.

    A problem that brings `columns` along (from a smaller problem) uses them in its first step.
    """
    fresh = [p for p in problems if not p.simulated]
    evaluate(machine, fresh, floors)
    live = [p for p in problems if p.unknowns and np.isfinite(p.cost)]
    for iteration in range(iterations):
        if not live:
            break
        old = [p for p in live if not p.columns or iteration > 0]
        differentiate(machine, old)
        steps = [_bounded_step(p, *_normal(machine, p, floors)) for p in live]
        low_high = [p.bounds for p in live]
        trials = [
            np.clip(p.q + factor * step, low, high)
            for p, step, (low, high) in zip(live, steps, low_high, strict=True)
            for factor in _TRIALS
        ]
        owners = [p for p in live for _ in _TRIALS]
        results = machine.predict([p.request(q) for p, q in zip(owners, trials, strict=True)])
        going = []
        for number, problem in enumerate(live):
            before = problem.cost
            for k in range(number * len(_TRIALS), (number + 1) * len(_TRIALS)):
                cost = _cost(machine, problem, results[k], trials[k], floors)
                if cost < problem.cost:
                    problem.cost, problem.q, problem.simulated = cost, trials[k], results[k]
            if before - problem.cost > tolerance:
                going.append(problem)
        live = going
    for problem in problems:
        if problem.unknowns and problem.columns:
            problem.spread = _spread(machine, problem, floors)


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


def gain(machine: Machine, smaller: Problem, larger: Problem, floors: Floors, channels: Sequence[int] | None = None) -> float:
    """How much better `larger` explains the data: the fall of the deviance, counted in independent samples.

    Per log and signal, n_eff log(variance before / variance after), with n_eff from the residual of the better model.
    """
    total = 0.0
    for channel in channels_of(larger, machine) if channels is None else channels:
        for s in machine.segments[channel]:
            before = (s.measured - smaller.simulated[channel][s.place])[s.used]
            after = (s.measured - larger.simulated[channel][s.place])[s.used]
            if after.size < 8:
                continue
            floor = 0.9 * floors[channel, s.signal] ** 2
            count = effective_samples(after)
            total += count * np.log(max(np.mean(before**2), floor) / max(np.mean(after**2), floor))
    return float(total)
