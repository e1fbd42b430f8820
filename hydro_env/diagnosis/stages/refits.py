"""Short refits of candidates."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimation import Estimate, Fit, bases_of, differentiate, solve

__all__ = ["short_refit"]

#: Iterations of a short refit; where simulating costs next to nothing there are more.
SHORT_ITERATIONS, CHEAP_ITERATIONS = 2, 10


def short_refit(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Two steps along the derivatives of the base parameters as they are and fresh ones of the new effect.

    Where simulating costs next to nothing all derivatives are fresh and there are more steps.
    """
    fit.evaluate(estimates)
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
        solve(fit, estimates, 1)
