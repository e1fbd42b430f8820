"""Refits of the selection: short ones of candidates, and the last one of what was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..estimation import Estimate, Fit, bases_of, differentiate, solve, step_all
from ..settings import rule

__all__ = ["refit_found", "short_refit"]

REFIT_FOUND = rule("refit_found", "refit what was found by the noise that is seen then")

#: Iterations of the refit of what was found.
FOUND_ITERATIONS = 6
#: Iterations of a short refit; where simulating costs next to nothing there are more.
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


def refit_found(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Refits what was found, in place: by the noise that is seen now, since what was missing made it look larger."""
    if not (fit.rig.has_hidden_states and fit.settings.uses(REFIT_FOUND)):
        return
    every = [p for p in {id(p): p for p in estimates}.values() if p.unknowns]
    finer = [p.in_all_directions() for p in every]
    solve(fit.on(fit.rig.for_long_refits()), finer, FOUND_ITERATIONS)
    for estimate, other in zip(every, finer, strict=True):
        estimate.adopt(other)
