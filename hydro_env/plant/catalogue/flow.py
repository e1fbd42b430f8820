"""Effects on the flow through the opened valve."""

from math import inf

from ..parameters import assumed
from ..vector_math import sign
from .effect import Effect


def _pressure_dependent_flow(drive, opening, pressure, supply_pressure):
    return drive - sign(opening) * pressure / supply_pressure


# Both edges take the same pressure drop, so the lines stand at the same distance from supply and tank.
def _half_the_supply(mean_line_pressure, supply_pressure):
    return 0.5 * supply_pressure if supply_pressure < 1e12 else mean_line_pressure


PRESSURE_DEPENDENT_FLOW = Effect(
    name="pressure_dependent_flow",
    port="flow",
    title="flow that falls with load pressure",
    summary="orifice law: flow falls as the load takes its share of the supply pressure",
    signature="flow falls as load pressure rises",
    source="paper, (7), which it replaces by (8); Merritt 1967: sqrt((ps - sign(x) dp) / ps)",
    parameters=(
        assumed("supply_pressure", "Pa", inf, low=5e5, high=350e5, typical=100e5, log=True,
            note="supply pressure at which no flow is left"),
    ),
    laws={"drive": _pressure_dependent_flow, "mean_line_pressure": _half_the_supply},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (PRESSURE_DEPENDENT_FLOW,)
