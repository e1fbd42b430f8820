"""Multistart: an estimate that leaves a little more than noise begins again, as friction makes a cost with many local minima.

A spool that sticks a moment longer or shorter changes the logs by a jump, so Gauss-Newton steps end in the local minimum in
which they began. So the friction of the spool is drawn again several times, about the values as given and about those of the
estimate in turn; all starts are improved side by side, the better half for longer (successive halving).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .estimate import Estimate
from .fit import Fit
from .gauss_newton import solve

__all__ = ["restart_friction"]

#: Base parameters that are drawn again, and the standard deviations of the factors, less than their priors': a start has to be
#: near enough to what is found from it.
DRAWN = {"Fc": 0.15, "Fs": 0.15, "vs": 0.3}
#: New starts, iterations of each round, after which the better half goes on, and how often all this is done at most, as long as
#: it helps. Three times free all four of the spools that are stuck in the rigs of tests/diagnosis/test_diagnosis_local_minima.py.
STARTS, ROUNDS, MAX_TIMES = 8, (2, 3), 3


def restart_friction(fit: Fit, estimates: Sequence[Estimate], iterations: int) -> None:
    """Improves in place those of `estimates` that leave more than noise, but not so much that an effect is missing; what becomes
    better is improved for `iterations` more."""
    rng = np.random.default_rng(0)
    live = [p for p in estimates if any(u.name in DRAWN for u in p.unknowns)]
    for _ in range(MAX_TIMES if fit.settings.uses("restart_friction") else 0):
        live = [p for p in live if not fit.at_noise(p) and not fit.far_from_noise(p)]
        fields = [[_with_other_friction(p, n % 2 == 1, rng) for n in range(STARTS)] for p in live]
        for each in ROUNDS:
            solve(fit, [p for starts in fields for p in starts], each)
            fields = [sorted(starts, key=lambda p: p.cost)[: len(starts) // 2] for starts in fields]
        live = [p for p, starts in zip(live, fields, strict=True) if p.adopt(starts[0])]
        solve(fit, live, iterations)


def _with_other_friction(estimate: Estimate, here: bool, rng: np.random.Generator) -> Estimate:
    """The same with the friction of the spool drawn again, about its own or (not `here`) the given values."""
    q = estimate.q.copy()
    for j, u in enumerate(estimate.unknowns):
        if u.name in DRAWN:
            q[j] = (q[j] if here else 0.0) + DRAWN[u.name] / u.scale * rng.standard_normal()
    twin = estimate.at(np.clip(q, *estimate.bounds))
    twin.columns = dict(estimate.columns)  # derivatives of before are good enough for the first step
    return twin
