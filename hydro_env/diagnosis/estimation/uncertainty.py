"""Uncertainty: block bootstrap on the derivatives at the estimate, without a new simulation.

The logs are cut into stretches of `STRETCH_S`; each holds all signals of that time. A replica draws as many stretches with
replacement, draws from the priors, solves the linearised normal equations and counts the deviance that an effect saves. What the
logs say nothing of, such as the common scale of torques where no load acts, differs between replicas as much as the priors allow
(randomised maximum likelihood; Oliver, He and Reynolds 1996).

Stretches are longer than the rig's memory, so what is correlated inside one stays together: the shaft with its leakage forgets
its speed with J / (B + D^2 / Km), 0.18 s on the preset rigs, and what two stretches hold is independent from twice that on. With
n of them there are C(2n - 1, n) different replicas (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.2); a
95 % interval needs at least forty, one beyond each end. With fewer nothing can be told from chance, and the verdict would be
`none` whatever the rig lacks.
"""

from math import comb

import numpy as np

from .estimate import Estimate, Intervals, Vector
from .fit import Fit
from .gauss_newton import minimum_in_box
from .unknowns import PRIOR_SPREAD, scaled

#: Length of a stretch, s.
STRETCH_S = 0.5
#: Chance that a value lies beyond one end of a 95 % interval.
_TAIL = 0.025
#: The fit logs, and the held-out ones, last at least so long in all, s.
SHORTEST_S = STRETCH_S * next(n for n in range(1, 100) if comb(2 * n - 1, n) >= 1.0 / _TAIL)
#: Replicas of the bootstrap: five lie beyond each end of a 95 % interval. More than 200 are seldom needed for a standard error
#: (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.4).
REPLICAS = 200
#: Half the width of a 95 % interval of the normal distribution, in standard deviations.
TWO_SIDED_95 = 1.96
#: Directions (`unknowns.SCALED_TOGETHER`) whose scale only the damping and the bristles of the spool fix: they are held at the
#: given values, of which no more is known than of others, and no friction keeps to the law of the bristles. The step of q.
OPEN_SCALES, SCALE_STEP = ("k", "Kq"), 0.1
#: Replicas that are simulated on the held-out logs: the largest of eight differences is above their median but in one of 256
#: cases.
DRAWS = 8
#: Times the noise by which the replicas' simulations differ where the held-out logs cannot be predicted: at five times, noise is
#: a 25th of the power of what a proof would compare.
CANNOT_BE_PREDICTED = 5.0


def intervals_of(fit: Fit, estimate: Estimate) -> Intervals:
    """Intervals of all unknowns of an estimate whose `columns` are at its q, never narrower than the inverse of the normal matrix
    says, and with the scales open that only held parameters fix (`OPEN_SCALES`). The draws keep to these scales: what is
    simulated has the held parameters."""
    size, bounds, seed = len(estimate.unknowns), estimate.bounds, fit.settings.seed
    prior = np.array([1.0 if u.prior else 0.0 for u in estimate.unknowns]) + 1e-9
    matrices, sides = fit.normal_equations_by_stretch(estimate, STRETCH_S)
    whole = matrices.sum(axis=0) + np.diag(prior)
    moves = bootstrap(matrices, sides, np.diag(prior), estimate.q, np.random.default_rng(seed))
    draws = np.array([nearest_inside(whole, move, estimate.q, bounds) for move in moves[:DRAWS]])
    if fit.rig.has_hidden_states and (scales := open_scales(estimate)).size:
        wide, q = np.hstack([np.eye(size), scales]), np.pad(estimate.q, (0, scales.shape[1]))
        prior = np.append(prior, np.full(scales.shape[1], PRIOR_SPREAD**-2))
        matrices, sides = wide.T @ matrices @ wide, sides @ wide
        whole = matrices.sum(axis=0) + np.diag(prior)
        moves = bootstrap(matrices, sides, np.diag(prior), q, np.random.default_rng(seed))
    low, high = np.quantile(moves[:, :size], [_TAIL, 1.0 - _TAIL], axis=0)
    variances = np.diag(np.linalg.pinv(whole, hermitian=True))[:size]
    spread = TWO_SIDED_95 * np.sqrt(np.maximum(variances, 0.0))
    low = np.clip(estimate.q + np.minimum(low, -spread), *bounds)
    high = np.clip(estimate.q + np.maximum(high, spread), *bounds)
    return Intervals(low, high, draws.reshape(DRAWS, size))


def open_scales(estimate: Estimate) -> Vector:
    """The changes of q (k, n) by a logarithm of each of the `OPEN_SCALES` that an estimate has."""
    unknowns, changes = estimate.unknowns, []
    for j, u in enumerate(unknowns):
        if u.name in OPEN_SCALES and u.log:
            changes.append(scaled(unknowns, estimate.q, j, SCALE_STEP) / (u.scale * SCALE_STEP))
    return np.array(changes).reshape(-1, len(unknowns)).T


def nearest_inside(matrix: Vector, move: Vector, q: Vector, bounds: tuple[Vector, Vector]) -> Vector:
    """The q inside the bounds that the logs distinguish least from `q + move`.

    Clipping every parameter for itself would break combinations of parameters that make up for each other.
    """
    low, high = bounds
    if np.all((q + move >= low) & (q + move <= high)):
        return q + move
    room = np.maximum(high - low, 1e-9)
    matrix = matrix + 1e-12 * np.trace(matrix) * np.eye(len(q))
    inside = np.clip(q, low, high)
    found = minimum_in_box(matrix, matrix @ move, low - inside, low - inside + room)
    return np.clip(inside + found, low, high)


def bootstrap(matrices: Vector, sides: Vector, prior: Vector, q: Vector, rng: np.random.Generator) -> Vector:
    """Moves of q (REPLICAS, k) about their middle."""
    count = len(matrices)
    moves = np.empty((REPLICAS, len(q)))
    for n in range(REPLICAS):
        times = np.bincount(rng.integers(count, size=count), minlength=count).astype(float)
        whole = np.tensordot(times, matrices, 1) + prior
        middle = rng.standard_normal(len(q))
        moves[n] = np.linalg.lstsq(whole, times @ sides + prior @ (middle - q), rcond=None)[0]
    return moves - np.median(moves, axis=0)


def probability_of_gain(fit: Fit, smaller: Estimate, larger: Estimate, needed: float) -> float:
    """Share of the replicas in which `larger` gains more deviance than the `needed` one, as (n + 1/2) / (N + 1)."""
    channels = fit.channels_of(larger)
    gains = np.concatenate([fit.gain_by_stretch(smaller, larger, c, STRETCH_S) for c in channels])
    rng = np.random.default_rng(fit.settings.seed)
    drawn = gains[rng.integers(len(gains), size=(REPLICAS, len(gains)))].sum(axis=1)
    return float((np.sum(drawn > needed) + 0.5) / (REPLICAS + 1.0))


def replica_differences(fit: Fit, estimate: Estimate, channel: int) -> list[tuple[str, Vector]]:
    """By segment of a channel its signal, and how far the simulations of the replicas' estimates are from that of the estimate
    (replicas, rows that count), in times the noise; on the logs of `fit`, which may be others than those fitted.

    A spool that sticks now here, now there, or a shaft that comes nearly to rest and turns on this way or that, does so by
    parts in a thousand of a parameter, which no fit knows.
    """
    if estimate.intervals is None:
        return []
    requests = [estimate.request(), *(estimate.request(q) for q in estimate.intervals.draws)]
    first, *others = (result[channel] for result in fit.rig.predict(requests))
    return [
        (s.signal, np.array([(o - first)[s.place][s.used] for o in others]) / fit.noise[channel, s.signal])
        for s in fit.rig.segments[channel]
    ]


def predictions_apart(fit: Fit, estimate: Estimate, channel: int) -> dict[str, float]:
    """By signal of a channel the RMS of the farthest of the `replica_differences`, in times the noise."""
    apart: dict[str, float] = {}
    for signal, rows in replica_differences(fit, estimate, channel):
        far = float(np.sqrt(np.mean(rows**2, axis=1)).max())
        apart[signal] = max(apart.get(signal, 0.0), far)
    return apart


def unpredictable(held_out: Fit, estimate: Estimate, channel: int) -> dict[str, float]:
    """By signal of a channel how far the replicas' simulations are apart, where the held-out logs cannot be predicted."""
    found = predictions_apart(held_out, estimate, channel)
    return {name: value for name, value in found.items() if value > CANNOT_BE_PREDICTED}
