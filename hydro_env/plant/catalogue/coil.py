"""Effects of the coil."""

from ..parameters import Parameter, assumed
from .effect import Effect, State


def _heating_resistance(resistance, rise, heat):
    return resistance * (1.0 + rise * heat)


def _heating_rate(heat, R, current, u_rated, time_constant):
    # Power over its value at the rated command of the cold coil.
    rated_current = u_rated / R
    return (current * current / (rated_current * rated_current) - heat) / time_constant


COIL_HEATING = Effect(
    name="coil_heating",
    port="coil",
    title="heating of the coil",
    summary="the coil's resistance rises as the coil warms up",
    signature="slow loss of force at constant voltage, seen in the current",
    source="copper, 0.39 %/K; 60-100 K of coil temperature rise are usual for wet-pin solenoids",
    parameters=(
        Parameter("rise", "1", 0.0, low=0.0, high=0.5, typical=0.25,
            note="relative rise of R at rated power", source="0.39 %/K over up to 130 K"),
        assumed("time_constant", "s", 300.0, low=2.0, high=1200.0, log=True, role="time_constant", note="thermal time constant"),
    ),
    laws={"resistance": _heating_resistance},
    states=(State("heat", _heating_rate, scale=0.1),),
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (COIL_HEATING,)
