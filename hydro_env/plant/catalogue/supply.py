"""Effects of the supply, which both valves share."""

from ..parameters import assumed
from .effect import Effect, State


def _supply_droop(drive, droop):
    return drive - droop


def _lower_lines(mean_line_pressure, droop):
    return mean_line_pressure * (1.0 - droop)


def steady_droop(own_flow, other_flow, relative_drop):
    """The droop that flows which last lead to."""
    # 8.1778e-4 m3/s (49 l/min) is the flow of two nominal valves at the rated command; a fixed one, whatever the valves.
    return relative_drop * (abs(own_flow) + abs(other_flow)) / 8.1778e-4


def _droop_rate(droop, own_flow, other_flow, relative_drop, time_constant):
    return (steady_droop(own_flow, other_flow, relative_drop) - droop) / time_constant


SUPPLY_DROOP = Effect(
    name="supply_droop",
    port="supply",
    title="a drooping supply pressure",
    scope="rig",
    summary="the supply pressure falls with the total flow of both valves, with memory",
    signature="both motors slow down together; needs the other channel's flow",
    source="pump and accumulator characteristics, Backe 1992",
    parameters=(
        assumed("relative_drop", "1", 0.0, low=0.0, high=0.9, typical=0.5, per="m3/s",
            note="relative drop at 49 l/min of both valves together; in proportion at other flows"),
        assumed("time_constant", "s", 0.1, low=0.002, high=5.0, log=True, role="time_constant", note="memory of the supply"),
    ),
    laws={"drive": _supply_droop, "mean_line_pressure": _lower_lines},
    states=(State("droop", _droop_rate, scale=0.1),),
    separated_by={
        "pressure_dependent_flow": "record the supply pressure; drive the other channel alone while this one holds its command",
    },
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (SUPPLY_DROOP,)
