"""What is reported goes all the way to its minimum (`estimation.final_refinement`), before it is proved and given intervals."""

from __future__ import annotations

from ..estimation import refine
from ..state import State

__all__ = ["run"]


def run(state: State) -> State:
    """Refines the estimates that are reported."""
    coarse, fine = (state.fit.on(rig.for_long_refits()) for rig in (state.rig, state.fine))
    refine(coarse, fine, state.shown.values())
    return state
