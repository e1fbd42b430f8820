"""Joint estimation of parameters by damped Gauss-Newton steps, many estimates side by side.

Every finite-difference column and every trial step of every estimate is one request to the model, so that one batch of
simulations serves all of them.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

from ..models.base import Samples
from .estimate import Estimate, Vector
from .fit import Fit
from .unknowns import scaled

#: Steps of q for finite differences, in turn, since stiction makes the data a rough function of its parameters. Where a prior is
#: 30 % wide these are 4.5 %, 1.2 % for an estimate that is near its minimum, and 12 % to step over local minima.
DIFFERENCE_STEPS = (0.15, 0.04, 0.4)
#: Iterations of a refit that is to go as far as it goes, at most: each step of differences four times.
SETTLE_ITERATIONS = 4 * len(DIFFERENCE_STEPS)
#: Parts and multiples of a step that are tried: weights that follow the residual make single steps too short. A part is between a
#: tenth and a half of the one before (Dennis and Schnabel, Numerical Methods for Unconstrained Optimization, 1983, section 6.3).
STEP_FACTORS = (4.0, 2.0, 1.0, 0.4, 0.1)
#: Longest step in any coordinate of q: three standard deviations of its prior.
MAX_STEP = 3.0
#: An iteration is idle if it takes away less than this share of what the cost is above that of the noise alone. Where something
#: is missing, the other parameters creep for long, and to no use: they move again once it is there.
#: Twenty idle iterations would take away a hundredth.
IDLE_SHARE = 0.0005


def solve(fit: Fit, estimates: Sequence[Estimate], iterations: int = 4, tolerance: float = 2.0) -> None:
    """Improves all estimates, in place.

    An estimate ends early once no step size of the differences lowers its cost by `tolerance` (two: what a parameter must gain
    at least, Akaike 1974) or `IDLE_SHARE`, or one does not and it is at the noise already. One that brings `columns` along (from
    a smaller one) uses them in its first step.
    """
    fit.evaluate([p for p in estimates if not p.simulated])
    live = [p for p in estimates if p.unknowns and np.isfinite(p.cost)]
    stalled = dict.fromkeys(live, 0)
    floors = {p: fit.cost_of_noise(p) for p in live}
    for iteration in range(iterations):
        if not live:
            break
        before = {p: p.cost for p in live}
        old = [p for p in live if not p.columns or iteration > 0]
        points = differentiate(fit, old, size=DIFFERENCE_STEPS[iteration % len(DIFFERENCE_STEPS)])
        step_all(fit, live)
        for p, point in zip(old, points, strict=True):
            # A point that was simulated for a derivative may be better than every step along it.
            p.improve(*point)
        for p in live:
            idle = before[p] - p.cost < max(tolerance, IDLE_SHARE * (p.cost - floors[p]))
            quiet = idle and fit.at_noise(p)
            stalled[p] = len(DIFFERENCE_STEPS) if quiet else stalled[p] + 1 if idle else 0
        live = [p for p in live if stalled[p] < len(DIFFERENCE_STEPS)]


def step_all(fit: Fit, live: Sequence[Estimate], factors: Sequence[float] = STEP_FACTORS) -> None:
    """One Gauss-Newton step of every estimate, the best of its multiples."""
    trials = []
    for p in live:
        step, (low, high) = _bounded_step(p, *fit.normal_equations(p)), p.bounds
        trials += [(p, np.clip(p.q + factor * step, low, high)) for factor in factors]
    results = fit.rig.predict([p.request(q) for p, q in trials])
    for (p, q), result in zip(trials, results, strict=True):
        p.improve(fit.cost(p, result, q), q, result)


def _bounded_step(estimate: Estimate, matrix: Vector, side: Vector) -> Vector:
    """The Gauss-Newton step inside the bounds and not longer than `MAX_STEP` in any coordinate."""
    scale, vectors = np.linalg.eigh(matrix)
    scale = np.maximum(scale, 1e-9 * scale[-1] + 1e-9)
    low, high = estimate.bounds
    low, high = np.maximum(low - estimate.q, -MAX_STEP), np.minimum(high - estimate.q, MAX_STEP)
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    return minimum_in_box((vectors * scale) @ vectors.T, side, low, high)


def minimum_in_box(matrix: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The x (k,) with low <= x <= high at which x' matrix x / 2 - side' x is least.

    `matrix` (k, k) is symmetric and positive definite, `side`, `low` and `high` are (k,). As bounded least squares: with the
    Cholesky factor, matrix = U' U, it is the least |U x - U'^-1 side|.
    """
    size = 1.0 / np.sqrt(np.diag(matrix))  # unknowns in units of their own, so that one tolerance serves all
    upper = cholesky(matrix * np.outer(size, size))
    right = solve_triangular(upper, side * size, trans="T")
    bounds = low / size, high / size
    found = lsq_linear(upper, right, bounds, method="bvls", tol=1e-12, max_iter=10 * len(side))
    return np.asarray(found.x * size)


# --- derivatives ----------------------------------------------------------------------------------------------------------
def simulate_moves(
    fit: Fit, estimates: Sequence[Estimate], moves: Sequence[Sequence[Vector]]
) -> Iterator[tuple[list[Samples], list[float]]]:
    """Simulates every estimate again and, in the steps of that simulation, the points at its `moves` of q: yields by estimate the
    samples at these points and their costs."""
    requests = [r for p, own in zip(estimates, moves, strict=True) for r in p.beside(own)]
    results = iter(fit.rig.predict(requests))
    for p, own in zip(estimates, moves, strict=True):
        fit.take(p, next(results))
        found = [next(results) for _ in own]
        yield found, [fit.cost(p, r, p.q + move) for r, move in zip(found, own, strict=True)]


def differentiate(
    fit: Fit, estimates: Sequence[Estimate], only: Sequence[Sequence[int]] | None = None, size: float = DIFFERENCE_STEPS[0]
) -> list[tuple[float, Vector, Samples]]:  # fmt: skip
    """Sets `columns` of every estimate, or only the columns `only` (one list of numbers for each estimate).

    Returns for every estimate the best of the points inside its bounds that were simulated for it: (cost, q, samples).
    """
    wanted = [range(len(p.unknowns)) for p in estimates] if only is None else only
    moves = [[_move(p, j, size) for j in own] for p, own in zip(estimates, wanted, strict=True)]
    points = []
    every = zip(estimates, wanted, moves, simulate_moves(fit, estimates, moves), strict=True)
    for p, numbers, own, (found, costs) in every:
        # New ones: an estimate that another was made from may still hold the old ones.
        p.columns = {c: _columns_of(p, c, keep=only is not None) for c in fit.channels_of(p)}
        best = (np.inf, p.q, p.simulated)
        low, high = p.bounds
        for j, move, result, cost in zip(numbers, own, found, costs, strict=True):
            for c, columns in p.columns.items():
                columns[:, j] = (result[c] - p.simulated[c]) / move[j]
            moved = p.q + move
            if cost < best[0] and np.all((low <= moved) & (moved <= high)):
                best = (cost, moved, result)
        _by_single_unknowns(p, list(zip(numbers, own, strict=True)))
        points.append(best)
    return points


def _columns_of(estimate: Estimate, channel: int, keep: bool) -> Vector:
    """Room for the derivatives of a channel, with those that are known if these are to be kept. They lie in memory column by
    column, as they come."""
    if keep and channel in estimate.columns:
        return estimate.columns[channel].copy(order="K")
    return np.zeros((estimate.simulated[channel].size, len(estimate.unknowns)), order="F")


def _by_single_unknowns(estimate: Estimate, moves: Sequence[tuple[int, Vector]]) -> None:
    """Puts derivatives by single unknowns in the place of those along `moves`, by unknown, in the columns just computed."""
    if all(np.count_nonzero(move) == 1 for _, move in moves):
        return
    new = [j for j, _ in moves]
    along = np.array([move / move[j] for j, move in moves]).T
    whole = np.linalg.inv(along[new])
    along[new] = 0.0
    # What one derivative takes from the others, of those in which several unknowns moved; the rest stays as it is.
    combined = np.zeros(along.shape)
    combined[new] = whole
    combined -= along @ whole
    changed = [n for n in range(len(new)) if np.count_nonzero(combined[:, n]) > 1]
    for columns in estimate.columns.values():
        columns[:, [new[n] for n in changed]] = columns @ combined[:, changed]


def _move(estimate: Estimate, j: int, size: float) -> Vector:
    """The change of q for the derivative by unknown j: of it alone, or of a direction of `SCALED_TOGETHER`."""
    step = -size if estimate.q[j] + size > estimate.bounds[1][j] else size
    name = estimate.unknowns[j].name
    # The forces not with the smallest step: logs know their common scale least, so that it shows the roughness of stiction alone,
    # and fits end in local minima of the spool's friction.
    if name in estimate.together and (name != "k" or size != DIFFERENCE_STEPS[1]):
        return scaled(estimate.unknowns, estimate.q, j, step)
    move = np.zeros(len(estimate.unknowns))
    move[j] = step
    return move
