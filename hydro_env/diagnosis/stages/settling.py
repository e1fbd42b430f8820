"""Settling: what is reported goes all the way to its minimum (`estimation.settling`), before it is proved and given intervals."""

from __future__ import annotations

from ..estimation import far_from_noise, restart_friction, settle, settle_finally
from ..settings import rule
from ..state import State

__all__ = ["run"]

RESTART_FOUND = rule(
    "restart_found",
    "restart what is reported with other spool friction where it leaves more than white noise",
)

#: Most rounds of restarts.
RESTARTS = 4


def run(state: State) -> State:
    """Settles the estimates that are reported: by the fit's substeps, which cost a third, then from there by the proof's.

    An estimate that stops a little early is far from the truth in what the logs know by ratios only, measured by its interval.
    What is far from the noise is left as it is: something is missing there, and its minimum is not where the truth is.

    What leaves more than white noise by the fit's substeps begins anew with other friction of the spool, as long as that helps:
    an effect was found, and its form corrected, from where calibration had ended without it, which may be a local minimum.
    """
    coarse, fine = (state.fit.on(rig.for_long_refits()) for rig in (state.rig, state.fine))
    every = {id(p): p for p in state.shown.values()}.values()
    near = [p for p in every if p.simulated and not far_from_noise(fine, p)]
    settle(coarse, near)
    left = near
    for seed in range(RESTARTS if state.settings.uses(RESTART_FOUND) and state.rig.has_hidden_states else 0):
        left = restart_friction(coarse, left, seed)
        settle(coarse, left)
    settle_finally(fine, near)
    return state
