"""How sure: block bootstrap and leave-one-manoeuvre-out, on the derivatives at the estimate, without a new simulation.

The logs are cut into stretches of `STRETCH_S`; each holds all signals of that time. A replica draws as many stretches with
replacement, solves the linearised normal equations and counts the deviance that an effect saves. Stretches are much longer
than the residual's memory, so what is correlated inside one stays together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..models.base import Machine
from .least_squares import Floors, Problem, channels_of, normal_parts, saved_by_stretch

__all__ = ["Certainty", "certainty", "chance", "spread_of", "undetermined"]

#: Length of a stretch that is drawn or left out as a whole, s.
STRETCH_S = 0.5
#: Length of a manoeuvre that is left out as a whole, s.
MANOEUVRE_S = 2.0
REPLICAS = 200
#: Replicas that are simulated on the sealed logs, and times the noise by which their courses differ where these cannot be
#: foretold.
DRAWS, APART = 8, 5.0


@dataclass(frozen=True)
class Certainty:
    """`low` and `high` (k,) hold 95 % of the replicas' estimates of q; `without` (k,) is the largest move of q when one
    manoeuvre is left out. `draws` (DRAWS, k) are some of the replicas' estimates."""

    low: np.ndarray
    high: np.ndarray
    without: np.ndarray
    draws: np.ndarray


def certainty(machine: Machine, problem: Problem, floors: Floors, seed: int = 0) -> Certainty:
    """Intervals of all unknowns of a problem whose `columns` are at the estimate, never narrower than its `spread` says."""
    prior = np.diag([1.0 if u.prior else 0.0 for u in problem.unknowns]) + 1e-9 * np.eye(
        len(problem.unknowns)
    )
    matrices, sides = normal_parts(machine, problem, floors, STRETCH_S)
    moves = _bootstrap(matrices, sides, prior, problem.q, np.random.default_rng(seed))
    low, high = np.quantile(moves, [0.025, 0.975], axis=0)
    spread = np.zeros(len(low)) if problem.spread is None else 1.96 * problem.spread
    bounds = problem.bounds
    low = np.clip(problem.q + np.minimum(low, -spread), *bounds)
    high = np.clip(problem.q + np.maximum(high, spread), *bounds)
    whole, right = matrices.sum(axis=0) + prior, sides.sum(axis=0) - prior @ problem.q
    start = np.linalg.lstsq(whole, right, rcond=None)[0]
    width = round(MANOEUVRE_S / STRETCH_S)
    without = np.zeros(len(low))
    for first in range(0, len(matrices), width):
        gone = slice(first, first + width)
        less = np.linalg.lstsq(
            whole - matrices[gone].sum(axis=0), right - sides[gone].sum(axis=0), rcond=None
        )[0]
        without = np.maximum(without, np.abs(less - start))
    return Certainty(low, high, without, np.clip(problem.q + moves[:DRAWS], *bounds))


def _bootstrap(
    matrices: np.ndarray, sides: np.ndarray, prior: np.ndarray, q: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Moves of q (REPLICAS, k) about their middle."""
    count = len(matrices)
    moves = np.empty((REPLICAS, len(q)))
    for n in range(REPLICAS):
        times = np.bincount(rng.integers(count, size=count), minlength=count).astype(float)
        whole = np.tensordot(times, matrices, 1) + prior
        moves[n] = np.linalg.lstsq(whole, times @ sides - prior @ q, rcond=None)[0]
    return moves - np.median(moves, axis=0)


def chance(
    machine: Machine, smaller: Problem, larger: Problem, needed: float, floors: Floors, seed: int = 0
) -> float:
    """Share of the replicas in which `larger` saves more deviance than the `needed` one, as (n + 1/2) / (N + 1)."""
    saved = np.concatenate(
        [
            saved_by_stretch(machine, smaller, larger, c, floors, STRETCH_S)
            for c in channels_of(larger, machine)
        ]
    )
    rng = np.random.default_rng(seed)
    drawn = saved[rng.integers(len(saved), size=(REPLICAS, len(saved)))].sum(axis=1)
    return float((np.sum(drawn > needed) + 0.5) / (REPLICAS + 1.0))


def spread_of(machine: Machine, problem: Problem, channel: int, floors: Floors) -> dict[str, float]:
    """By signal of a channel how far the courses of the replicas' estimates are apart from that of the estimate on the logs of
    `machine`, which may be others than those of the fit: RMS of the farthest, in times the noise.

    A spool that sticks now here, now there, or a shaft that comes nearly to rest and turns on this way or that, does so by
    parts in a thousand of a parameter, which no fit knows.
    """
    if problem.certainty is None:
        return {}
    requests = [problem.request(), *(problem.request(q) for q in problem.certainty.draws)]
    first, *others = (result[channel] for result in machine.predict(requests))
    apart: dict[str, float] = {}
    for s in machine.segments[channel]:
        far = max(float(np.sqrt(np.mean((o - first)[s.place][s.used] ** 2))) for o in others)
        apart[s.signal] = max(apart.get(s.signal, 0.0), far / floors[channel, s.signal])
    return apart


def undetermined(sealed: Machine, problem: Problem, channel: int, floors: Floors) -> dict[str, float]:
    """By signal of a channel how far the replicas' courses are apart on the logs of `sealed` (`spread_of`), where that is
    so far that the logs cannot be foretold."""
    found = spread_of(sealed, problem, channel, floors)
    return {name: value for name, value in found.items() if value > APART}
