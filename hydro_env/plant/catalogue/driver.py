"""Effects of the driver, between the command and the coil."""

from __future__ import annotations

from math import inf

from ..parameters import Parameter
from ..vector_math import clip
from .effect import Effect

__all__ = ["EFFECTS"]


COMMAND_DELAY = Effect(
    name="command_delay",
    port="driver",
    title="a dead time of the command",
    summary="the command reaches the coil late: u(t - delay)",
    signature="pure shift of the onset of every reaction",
    source="fieldbus and driver electronics; dead time, e.g. Merritt 1967",
    parameters=(
        Parameter(
            "delay",
            "s",
            0.0,
            low=0.0,
            high=0.03,
            typical=0.005,
            note="dead time",
            source="one to three control periods of 10 ms",
            possible=(0.0, 10.0),
        ),
    ),
    delays_command="delay",
    indistinguishable_from=("sensor_lag",),
    separated_by={
        "sensor_lag": (
            "sine sweep of 1 to 20 Hz about a bias with the pressure recorded: the pressure shows a delay of "
            "the command, not the lag of the speed sensor"
        )
    },
)


def _driver_saturation(voltage, voltage_limit):
    return clip(voltage, -voltage_limit, voltage_limit)


DRIVER_SATURATION = Effect(
    name="driver_saturation",
    port="driver",
    title="saturation of the driver",
    summary="the driver cannot give more than a limited voltage",
    signature="clipped current at large commands",
    source="supply voltage of valve amplifiers (24 V less their own drop)",
    parameters=(
        Parameter(
            "voltage_limit",
            "V",
            inf,
            low=20.0,
            high=73.0,
            typical=45.0,
            note="limit of the driver's voltage",
            source="assumed",
        ),
    ),
    laws={"voltage": _driver_saturation},
)


#: In the order in which they act.
EFFECTS = (
    COMMAND_DELAY,
    DRIVER_SATURATION,
)
