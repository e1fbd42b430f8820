"""Short refits of candidates, which the selection ranks them by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..estimation import Estimate, Fit, bases_of, differentiate, solve, step_all

__all__ = ["short_refit"]

#: Iterations of a short refit: one to come near, one from there. Where simulating costs next to nothing there are more.
SHORT_ITERATIONS, CHEAP_ITERATIONS = 2, 10
#: Multiples of a step of a short refit: parts of it are the best of all in one of forty.
SHORT_FACTORS = (4.0, 2.0, 1.0)


def short_refit(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Two steps along the derivatives of the base parameters as they are and fresh ones of the new effect.

    Where simulating costs next to nothing all derivatives are fresh and there are more steps.
    """
    fit.evaluate([p for p in estimates if not p.simulated])
    if fit.rig.simulation_is_cheap:
        differentiate(fit, estimates)
        solve(fit, estimates, CHEAP_ITERATIONS)
        return
    fresh = []
    for p in estimates:
        bases = bases_of(p.label)
        fresh.append([j for j, u in enumerate(p.unknowns) if u.effect == p.label or u.name in bases])
    for _ in range(SHORT_ITERATIONS):
        differentiate(fit, estimates, fresh)
        step_all(fit, [p for p in estimates if np.isfinite(p.cost)], SHORT_FACTORS)
