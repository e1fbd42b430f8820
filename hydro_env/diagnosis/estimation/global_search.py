"""Global search: every effect of the catalogue from many starts, for a channel that nothing explains.

A candidate is first judged after a few steps from the calibrated model, one start of each. That is enough for most. But
calibration without the effect that is missing has moved the known parameters to make up for it, often so far that a few steps
lead nowhere (the right effect then seems to explain nothing), and where an effect decides the way a shaft turns, only one start
of a dozen leads to it. So where the effects that were accepted leave most of a channel's residual, every effect begins at several
sizes and shapes, from the calibrated model and from the model as given; all starts are improved side by side, and each round
goes on with the better ones. What is found must explain the residual nearly to the noise, or it is not used: among so many
starts one is always better than the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...plant import CATALOGUE
from .estimate import Estimate
from .fit import Fit
from .gauss_newton import solve
from .unknowns import effect_starts

__all__ = ["search_all"]

#: Starts of an effect from the calibrated model and from the model as given.
FROM_CALIBRATED, FROM_GIVEN = 2, 1
#: Iterations of each round, and how many starts go on after it.
ITERATIONS_AND_KEPT = ((1, 30), (2, 10), (3, 4), (4, 3))
#: Of these at most so many are of one effect.
OF_ONE_EFFECT = 2


def search_all(
    fit: Fit, calibrated: Estimate, effects: Sequence[str], seconds: float
) -> list[tuple[str, Estimate]]:
    """The effects that explain a channel best of `effects`, best first, each with its estimate, refitted beside the known
    parameters from many starts."""
    refits = _starts(fit, calibrated, effects, seconds)
    for iterations, keep in ITERATIONS_AND_KEPT:
        solve(fit, refits, iterations)
        refits = _best(refits, keep, OF_ONE_EFFECT)
    return [(p.label, p) for p in _best(refits, len(refits), 1)]


def _starts(fit: Fit, calibrated: Estimate, effects: Sequence[str], seconds: float) -> list[Estimate]:
    """The most promising starts of every effect, by one simulation of each."""
    found: list[Estimate] = []
    for place, of_one in ((calibrated, FROM_CALIBRATED), (calibrated.from_given(), FROM_GIVEN)):
        every = [
            place.with_effect(name, start)
            for name in effects
            for start in effect_starts(CATALOGUE[name], seconds, whole=True)
        ]
        fit.evaluate(every)
        found += _best([p for p in every if np.isfinite(p.cost)], len(every), of_one)
    return found


def _best(estimates: Sequence[Estimate], most: int, of_one: int) -> list[Estimate]:
    """The best estimates by cost, at most so many and at most so many of one effect."""
    kept: list[Estimate] = []
    for p in sorted(estimates, key=lambda p: p.cost):
        if len(kept) < most and sum(k.label == p.label for k in kept) < of_one:
            kept.append(p)
    return kept
