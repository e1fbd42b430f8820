"""Refits that several stages share: short ones of candidates, of the present model, and the last one of what was found."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..estimation import Estimate, Fit, bases_of, differentiate, solve
from ..settings import rule
from ..state import Estimates

__all__ = ["LAST_STEPS", "refit_found", "restart_present", "short_refit"]

RESTART_PRESENT = rule(
    "restart_present", "refit the present model from the known parameters of its best extension"
)
REFIT_FOUND = rule("refit_found", "refit what was found by the noise that is seen then")

#: Steps of q for the differences in the iterations of the refit of what was found, and of the last one, by the proof's substeps.
FOUND_STEPS, LAST_STEPS = (0.15, 0.04, 0.4, 0.15, 0.04, 0.4), (0.15, 0.04, 0.01, 0.04, 0.01)
#: Iterations of a short refit; where simulating costs next to nothing there are more.
SHORT_ITERATIONS, CHEAP_ITERATIONS = 2, 10
#: Iterations of the present model's restart, before and after the question whether it gets anywhere.
RESTART_ITERATIONS = 2, 6


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


def restart_present(fit: Fit, present: Estimates, best: Sequence[tuple[int, Estimate]]) -> None:
    """Restarts the present estimates of channels, in place, from the base parameters that their best extensions found.

    A candidate must not win because its refit led the known parameters out of a local minimum.
    """
    if not fit.settings.uses(RESTART_PRESENT):
        return
    restarts = {}
    for c in dict.fromkeys(c for c, _ in best):
        own = min((p for k, p in best if k == c), key=lambda p: p.cost)
        restarts[c] = present[c].at(own.q[: len(present[c].unknowns)].copy())
    solve(fit, list(restarts.values()), RESTART_ITERATIONS[0])
    # Where the base parameters alone get nowhere from there, the effect did not carry them out of one.
    going = {c: p for c, p in restarts.items() if p.cost < present[c].cost}
    solve(fit, list(going.values()), RESTART_ITERATIONS[1])
    for c, estimate in going.items():
        present[c].adopt(estimate)


def refit_found(fit: Fit, estimates: Sequence[Estimate], steps: Sequence[float] = FOUND_STEPS) -> None:
    """Refits what was found, in place: by the noise that is seen now, since what was missing made it look larger, and by the
    substeps of the model of `fit`."""
    if not (fit.rig.has_hidden_states and fit.settings.uses(REFIT_FOUND)):
        return
    every = [p for p in {id(p): p for p in estimates}.values() if p.unknowns]
    finer = [p.in_all_directions() for p in every]
    solve(fit.on(fit.rig.for_long_refits()), finer, len(steps), sizes=steps)
    for estimate, other in zip(every, finer, strict=True):
        estimate.cost = math.inf  # was counted by another noise, or with other substeps
        estimate.adopt(other)
