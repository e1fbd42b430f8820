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
    summary="the command reaches the coil late: u(t - delay)",
    signature="pure shift of the onset of every reaction",
    source="fieldbus and driver electronics; dead time, e.g. Merritt 1967",
    # The delay line itself lives in the kernel, which hands `rates` the delayed command.
    parameters=(
        Parameter("delay", "s", 0.0, 0.0, 0.03, "one to three control periods of 10 ms", "dead time", 0.005),
    ),
    indistinguishable_from=("sensor_lag",),
)


def _driver_saturation(voltage, voltage_limit):
    return clip(voltage, -voltage_limit, voltage_limit)


DRIVER_SATURATION = Effect(
    name="driver_saturation",
    port="driver",
    summary="the driver cannot give more than a limited voltage",
    signature="clipped current at large commands",
    source="supply voltage of valve amplifiers (24 V less their own drop)",
    parameters=(Parameter("voltage_limit", "V", inf, 20.0, 73.0, "assumed", "limit of the output", 45.0),),
    laws={"voltage": _driver_saturation},
)


#: In the order in which they act.
EFFECTS = (
    COMMAND_DELAY,
    DRIVER_SATURATION,
)
