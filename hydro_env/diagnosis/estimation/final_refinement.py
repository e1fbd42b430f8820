"""Final refinement: an estimate that is near its minimum goes all the way, with derivatives as wide as its own uncertainty.

Friction makes a cost rough, and forces on the spool are known by their ratios far better than one by one. Differences of one
unknown at a time then see the roughness or step over the minimum. So differences are taken along the principal axes of the
normal matrix, as secants over several standard deviations either way: wide ones step over local minima, narrow ones give the
covariance on the scale on which it is used. This is Gauss-Newton in whitened coordinates with the secants of unscented
transforms (Julier and Uhlmann 2004, doi:10.1109/JPROC.2003.823141).
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from .estimate import Estimate, Vector
from .fit import Fit
from .gauss_newton import simulate_moves, step_all

#: Reach of the secants in standard deviations, in turn, a third each; the last one is that of the covariance.
REACHES = (10.0, 3.0, 1.0)
#: Turns at most, and the fall of the cost in one below which an estimate has settled: that of one parameter that moves by its
#: standard deviation.
MAX_TURNS, SETTLED = 5, 1.0
#: Longest reach in any coordinate of q: the standard deviation of its prior.
MAX_REACH = 1.0


def refine(fit: Fit, fine: Fit, estimates: Iterable[Estimate]) -> None:
    """Improves estimates as far as they go, in place: with the tolerance of `fit`, which costs less, then with that of `fine`.
    Sets their `columns` on the scale of their standard deviations.

    An estimate that stops a little early is far from the truth in what the logs know by ratios only, measured by its interval.
    What is far from the noise is left as it is: something is missing there, and its minimum is not where the truth is.
    """
    near = [p for p in dict.fromkeys(estimates) if p.simulated and not fine.far_from_noise(p)]
    settle(fit, near)
    near = _ready(fine, near)
    # The way is mostly short, and the derivatives that they bring along show it.
    _while_it_pays(lambda live: step_all(fine, live), near)
    _while_it_pays(lambda live: _secant_steps(fine, live, REACHES[-1:]), near)


def settle(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Improves estimates that have `columns`, in place."""
    _while_it_pays(lambda live: _secant_steps(fit, live, REACHES), _ready(fit, estimates))


def _while_it_pays(turn: Callable[[Sequence[Estimate]], None], live: Sequence[Estimate]) -> None:
    """Turns, as long as they lower the cost of an estimate."""
    for _ in range(MAX_TURNS):
        if not live:
            return
        before = [p.cost for p in live]
        turn(live)
        live = [p for p, cost in zip(live, before, strict=True) if cost - p.cost > SETTLED]


def _ready(fit: Fit, estimates: Sequence[Estimate]) -> list[Estimate]:
    """Those of the estimates that have `columns`, simulated."""
    every = [p for p in estimates if p.unknowns and p.columns]
    fit.evaluate(every)
    return [p for p in every if np.isfinite(p.cost)]


def _secant_steps(fit: Fit, estimates: Sequence[Estimate], reaches: Sequence[float]) -> None:
    """A step of every estimate with each reach."""
    for reach in reaches:
        _secants(fit, estimates, reach)
        step_all(fit, estimates)


def _secants(fit: Fit, estimates: Sequence[Estimate], reach: float) -> None:
    """Sets the derivatives of every estimate by secants along its principal axes, and moves it to the best point on them."""
    ways = [moves_along_axes(p, fit.normal_equations(p)[0], reach) for p in estimates]
    every = zip(estimates, ways, simulate_moves(fit, estimates, [list(own) for _, own in ways]), strict=True)
    for p, (axes, own), (found, costs) in every:
        good = np.flatnonzero(np.isfinite(costs))
        # By axis the straight line through the estimate that fits its points best; the axes are at right angles.
        along = own[good] @ axes
        weights = along / np.maximum((along**2).sum(axis=0), 1e-30) @ axes.T
        for c in fit.channels_of(p):
            changes = np.array([found[n][c] - p.simulated[c] for n in good]).reshape(good.size, -1)
            p.columns = {**p.columns, c: (weights.T @ changes).T}
        here = p.q
        for move, cost, result in zip(own, costs, found, strict=True):
            p.improve(cost, here + move, result)


def moves_along_axes(estimate: Estimate, matrix: Vector, reach: float) -> tuple[Vector, Vector]:
    """Axes at right angles (k, k), as columns, and moves (up to 2 k, k) either way along each of them: the principal axes of
    the normal matrix, and by itself each unknown that has a bound within `reach` of its own standard deviations.

    At a bound a move ends, without leaving its axis: clipped in one coordinate it would go along stiff axes as well, by many
    standard deviations, and what these do would be taken for what it does. Two unknowns at their bounds would bar an axis either
    way.
    """
    low, high = estimate.bounds
    below, above = np.maximum(estimate.q - low, 0.0), np.maximum(high - estimate.q, 0.0)
    diagonal = np.diag(matrix)
    length = reach / np.sqrt(np.maximum(diagonal, 1e-9 * diagonal.max()))
    free = np.flatnonzero(np.minimum(below, above) >= length)
    axes = np.eye(length.size)
    if free.size:
        inner = np.ix_(free, free)
        scale, axes[inner] = np.linalg.eigh(matrix[inner])
        length[free] = reach / np.sqrt(np.maximum(scale, 1e-9 * scale[-1]))
    moves = axes * length
    moves = moves * np.minimum(1.0, MAX_REACH / np.maximum(np.abs(moves).max(axis=0), 1e-30))
    both = np.concatenate([moves.T, -moves.T])
    room = np.where(both > 0.0, above, np.where(both < 0.0, below, np.inf))
    share = np.min(room / np.maximum(np.abs(both), 1e-30), axis=1)
    inside = both * np.minimum(share, 1.0)[:, None]
    return axes, inside[share > 0.0]
