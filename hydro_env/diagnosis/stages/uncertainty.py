"""Uncertainty: intervals of all estimates, by a block bootstrap on their derivatives (`estimation.uncertainty`)."""

from __future__ import annotations

from ..estimation import intervals_of
from ..state import State

__all__ = ["run"]


def run(state: State) -> State:
    """Sets the intervals of every estimate that has derivatives."""
    every = (*state.final.values(), *state.selection.estimates.values(), *state.calibrated.values())
    for one in {id(p): p for p in every}.values():
        if one.unknowns and one.columns:
            one.intervals = intervals_of(state.fit, one)
    return state
