"""Settling: what is reported goes all the way to its minimum (`estimation.settling`), before it is proved and given intervals."""

from __future__ import annotations

from ..estimation import far_from_noise, settle, settle_finally
from ..state import State

__all__ = ["run"]


def run(state: State) -> State:
    """Settles the estimates that are reported: with the fit's tolerance, which costs less, then from there with the proof's.

    An estimate that stops a little early is far from the truth in what the logs know by ratios only, measured by its interval.
    What is far from the noise is left as it is: something is missing there, and its minimum is not where the truth is.
    """
    coarse, fine = (state.fit.on(rig.for_long_refits()) for rig in (state.rig, state.fine))
    every = {id(p): p for p in state.shown.values()}.values()
    near = [p for p in every if p.simulated and not far_from_noise(fine, p)]
    settle(coarse, near)
    settle_finally(fine, near)
    return state
