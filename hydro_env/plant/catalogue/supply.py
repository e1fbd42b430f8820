"""Effects of the supply, which both valves share."""

from __future__ import annotations

from ..parameters import Parameter
from .effect import Effect, State

__all__ = ["EFFECTS"]


def _supply_droop(drive, droop):
    return drive - droop


def _droop_rate(droop, own_flow, other_flow, relative_drop, time_constant):
    # 8.1778e-4 m3/s (49 l/min): two nominal valves at the rated command. It is the supply's own, the same for both channels.
    return (relative_drop * (abs(own_flow) + abs(other_flow)) / 8.1778e-4 - droop) / time_constant


def _droop_corner(relative_drop):
    # The other channel's flow is that of the substep before, which a supply as weak as this does not forgive.
    return relative_drop > 0.5


SUPPLY_DROOP = Effect(
    name="supply_droop",
    port="supply",
    scope="rig",
    summary="the supply pressure falls with the total flow of both valves, with memory",
    signature="both motors slow down together; needs the other channel's flow",
    source="pump and accumulator characteristics, Backe 1992",
    parameters=(
        Parameter(
            "relative_drop",
            "1",
            0.0,
            0.0,
            0.9,
            "assumed",
            "share of the supply pressure lost at 49 l/min, the rated flow of two nominal valves",
            0.5,
        ),
        Parameter("time_constant", "s", 0.1, 0.01, 5.0, "assumed", "memory of the supply", 0.1, log=True),
    ),
    laws={"drive": _supply_droop},
    states=(State("droop", _droop_rate),),
    corner=_droop_corner,
)


#: In the order in which they act.
EFFECTS = (SUPPLY_DROOP,)
