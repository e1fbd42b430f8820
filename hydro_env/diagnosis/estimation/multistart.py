"""Multistart: estimates that begin again from other values, because friction makes a cost with many local minima.

A spool that sticks a moment longer or shorter changes the logs by a jump, so Gauss-Newton steps end in the local minimum in
which they began. So the friction of the spool is drawn anew several times, about the values as given and about
those of the estimate in turn; all starts are improved side by side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..settings import rule
from .estimate import Estimate, Vector
from .fit import Fit
from .gauss_newton import solve

__all__ = ["far_from_noise", "restart_friction"]

RESTART_FRICTION = rule(
    "restart_friction", "restart with other spool friction where little but more than white noise is left"
)

#: Base parameters that are drawn anew, and the standard deviations of the factors: less than their priors', for a start has to be
#: near enough to what is found from it.
DRAWN = {"Fc": 0.15, "Fs": 0.15, "vs": 0.3}
#: New starts, and iterations of each round, after which the better half goes on.
STARTS, ROUND_ITERATIONS = 8, (2, 3, 4)
#: A residual (`Fit.level`) up to which a local minimum may be the cause; what a missing effect leaves is larger.
SMALL_LEVEL = 1.0


def far_from_noise(fit: Fit, estimate: Estimate) -> bool:
    """Whether more is left than a local minimum leaves."""
    return fit.level(estimate) > SMALL_LEVEL


def restart_friction(fit: Fit, estimates: Sequence[Estimate]) -> list[Estimate]:
    """Improves those of `estimates` that leave little but more than white noise, in place; returns those that became better."""
    if not fit.settings.uses(RESTART_FRICTION):
        return []
    rng = np.random.default_rng(0)
    fields: list[tuple[Estimate, list[Estimate]]] = []
    for estimate in estimates:
        drawn = [j for j, u in enumerate(estimate.unknowns) if u.name in DRAWN]
        if not drawn or fit.is_white(estimate) or far_from_noise(fit, estimate):
            continue
        centres = (np.zeros(len(estimate.q)), estimate.q)
        starts = [_with_other_friction(estimate, drawn, centres[n % 2], rng) for n in range(STARTS)]
        fields.append((estimate, starts))
    for iterations in ROUND_ITERATIONS:
        solve(fit, [p for _, starts in fields for p in starts], iterations)
        for _, starts in fields:
            starts.sort(key=lambda p: p.cost)
            # Nothing better than white noise can be found.
            keep = 1 if fit.is_white(starts[0]) else max(2, len(starts) // 2)
            del starts[keep:]
    return [p for p, starts in fields if p.adopt(starts[0])]


def _with_other_friction(
    estimate: Estimate, drawn: Sequence[int], centre: Vector, rng: np.random.Generator
) -> Estimate:
    """The same with the friction of the spool drawn anew about `centre`."""
    q = estimate.q.copy()
    spread = np.array([DRAWN[estimate.unknowns[j].name] / estimate.unknowns[j].scale for j in drawn])
    q[drawn] = centre[drawn] + spread * rng.standard_normal(len(drawn))
    twin = estimate.at(np.clip(q, *estimate.bounds))
    twin.columns = dict(estimate.columns)  # derivatives of before are good enough for the first step
    return twin
