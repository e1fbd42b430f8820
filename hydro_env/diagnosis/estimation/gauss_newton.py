"""Joint estimation of parameters by damped Gauss-Newton steps, many estimates side by side.

Every finite-difference column and every trial step of every estimate is one request to the model, so that one batch of
simulations serves all of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .box import minimum_in_box
from .estimate import Estimate, Vector
from .fit import Fit
from .unknowns import scaled

__all__ = ["SETTLE_ITERATIONS", "differentiate", "solve", "step_all"]

#: Most iterations of a refit that is to go as far as it goes.
SETTLE_ITERATIONS = 12

#: Steps of q for finite differences, in turn: stiction makes the data a rough function of its parameters.
DIFFERENCE_STEPS = (0.15, 0.04, 0.4)
#: Parts and multiples of a step that are tried: weights that follow the residual make single steps too short.
STEP_FACTORS = (4.0, 2.0, 1.0, 0.4, 0.1)
#: Longest step in any coordinate of q.
LONGEST_STEP = 3.0
#: Starts of an estimate that are nearer than this in every q have met.
MET = 0.05
#: An iteration is idle if it takes away less than this share of what the cost is above that of the noise alone. Where something
#: is missing, the other parameters creep for long, and to no use: they move again once it is there.
IDLE_SHARE = 0.0005


def solve(
    fit: Fit, estimates: Sequence[Estimate], iterations: int = 4, tolerance: float = 2.0,
    races: Sequence[Sequence[Estimate]] = (),
) -> None:  # fmt: skip
    """Improves all estimates, in place.

    `races` are starts of the same estimate, or competing candidates, improved in the same way, of which only the best one will
    be used: one that cannot become the best any more ends early (`_out_of_race`).

    An estimate ends early once no step size of the differences lowers its cost by `tolerance` (or `IDLE_SHARE`), or one does not
    and it is at the noise already. One that brings `columns` along (from a smaller one) uses them in its first step.
    """
    fit.evaluate([p for p in estimates if not p.simulated])
    live = [p for p in estimates if p.unknowns and np.isfinite(p.cost)]
    stalled = dict.fromkeys(map(id, live), 0)
    falls: dict[int, list[float]] = {id(p): [] for p in live}
    floors = {id(p): fit.cost_of_noise(p) for p in live}
    for iteration in range(iterations):
        if not live:
            break
        before = {id(p): p.cost for p in live}
        old = [p for p in live if not p.columns or iteration > 0]
        points = differentiate(fit, old, size=DIFFERENCE_STEPS[iteration % len(DIFFERENCE_STEPS)])
        step_all(fit, live)
        for estimate, (cost, q, result) in zip(old, points, strict=True):
            # A point that was simulated for a derivative may be better than every step along it.
            if cost < estimate.cost:
                estimate.cost, estimate.q, estimate.simulated = cost, q, result
        for p in live:
            idle = before[id(p)] - p.cost < max(tolerance, IDLE_SHARE * (p.cost - floors[id(p)]))
            quiet = idle and fit.at_noise(p)
            stalled[id(p)] = len(DIFFERENCE_STEPS) if quiet else stalled[id(p)] + 1 if idle else 0
            falls[id(p)].append(before[id(p)] - p.cost)
        out = {n for race in races for n in _out_of_race(race, falls, iterations - iteration - 1, tolerance)}
        live = [p for p in live if stalled[id(p)] < len(DIFFERENCE_STEPS) and id(p) not in out]


def step_all(fit: Fit, live: Sequence[Estimate], factors: Sequence[float] = STEP_FACTORS) -> None:
    """One Gauss-Newton step of every estimate, the best of its multiples."""
    trials = []
    for p in live:
        step, (low, high) = _bounded_step(p, *fit.normal_equations(p)), p.bounds
        trials += [(p, np.clip(p.q + factor * step, low, high)) for factor in factors]
    results = fit.rig.predict([p.request(q) for p, q in trials])
    for (estimate, q), result in zip(trials, results, strict=True):
        cost = fit.cost(estimate, result, q)
        if cost < estimate.cost:
            estimate.cost, estimate.q, estimate.simulated = cost, q, result


def _bounded_step(estimate: Estimate, matrix: Vector, side: Vector) -> Vector:
    """The Gauss-Newton step inside the bounds and not longer than `LONGEST_STEP` in any coordinate."""
    scale, vectors = np.linalg.eigh(matrix)
    scale = np.maximum(scale, 1e-9 * scale[-1] + 1e-9)
    low, high = estimate.bounds
    low, high = np.maximum(low - estimate.q, -LONGEST_STEP), np.minimum(high - estimate.q, LONGEST_STEP)
    low, high = np.minimum(low, 0.0) - 1e-9, np.maximum(high, 0.0) + 1e-9
    return minimum_in_box((vectors * scale) @ vectors.T, side, low, high)


def _out_of_race(
    race: Sequence[Estimate], falls: dict[int, list[float]], left: int, tolerance: float
) -> set[int]:
    """The ids of the starts that have met the best one, or do not reach it in the iterations that are left if every one of
    these is as good as the best of the last ones, one of each size of step."""
    best = min(race, key=lambda p: p.cost)
    out = set()
    for p in race:
        recent = falls.get(id(p), [])[-len(DIFFERENCE_STEPS) :]
        if p is best or len(recent) < len(DIFFERENCE_STEPS):
            continue
        behind = p.cost - best.cost
        same = [u.name for u in p.unknowns] == [u.name for u in best.unknowns]  # forms may race, too
        met = same and behind < tolerance and float(np.max(np.abs(p.q - best.q), initial=0.0)) < MET
        if met or behind > left * max(recent):
            out.add(id(p))
    return out


# --- derivatives ----------------------------------------------------------------------------------------------------------
def differentiate(
    fit: Fit, estimates: Sequence[Estimate], only: Sequence[Sequence[int]] | None = None, size: float = DIFFERENCE_STEPS[0]
) -> list[tuple[float, Vector, dict[int, Vector]]]:  # fmt: skip
    """Sets `columns` of every estimate, or only the columns `only` (one list of numbers for each estimate).

    Returns for every estimate the best of the points that were simulated for it: (cost, q, samples).
    """
    moves: list[list[tuple[int, Vector]]] = []
    for n, estimate in enumerate(estimates):
        wanted = range(len(estimate.unknowns)) if only is None else only[n]
        moves.append([(j, _move(estimate, j, size)) for j in wanted])
    requests = [r for p, own in zip(estimates, moves, strict=True) for r in p.beside(m for _, m in own)]
    results = iter(fit.rig.predict(requests))
    found = []
    for estimate, own in zip(estimates, moves, strict=True):
        fit.take(estimate, next(results))
        best = (np.inf, estimate.q, estimate.simulated)
        low, high = estimate.bounds
        for channel in fit.channels_of(estimate):
            shape = (estimate.simulated[channel].size, len(estimate.unknowns))
            kept = estimate.columns.get(channel)
            # New ones: an estimate that another was made from may still hold the old ones. They lie in memory column by column,
            # as they come.
            fresh = (
                np.zeros(shape, order="F")
                if kept is None or kept.shape != shape or only is None
                else kept.copy(order="K")
            )
            estimate.columns = {**estimate.columns, channel: fresh}
        for j, move in own:
            result, moved = next(results), estimate.q + move
            for channel in fit.channels_of(estimate):
                estimate.columns[channel][:, j] = (result[channel] - estimate.simulated[channel]) / move[j]
            inside = bool(np.all((low <= moved) & (moved <= high)))
            cost = fit.cost(estimate, result, moved) if inside else np.inf
            if cost < best[0]:
                best = (cost, moved, result)
        _by_single_unknowns(estimate, own)
        found.append(best)
    return found


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
    # The forces not with every size of step: which derivative leads into a local minimum and which out of it is a matter of luck.
    if name in estimate.together and (name != "k" or size != DIFFERENCE_STEPS[1]):
        return scaled(estimate.unknowns, estimate.q, j, step)
    move = np.zeros(len(estimate.unknowns))
    move[j] = step
    return move
