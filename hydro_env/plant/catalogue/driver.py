"""Effects of the driver, between the command and the coil."""

from functools import partial
from math import inf

from ..parameters import Parameter, assumed
from ..vector_math import clip
from .effect import Effect, State

_effect = partial(Effect, port="driver")

COMMAND_DELAY = _effect(
    name="command_delay",
    title="a dead time of the command",
    summary="the command reaches the coil late: u(t - delay)",
    signature="pure shift of the onset of every reaction",
    source="fieldbus and driver electronics; dead time, e.g. Merritt 1967",
    parameters=(
        Parameter("delay", "s", 0.0, low=0.0, high=0.03, typical=0.005, possible=(0.0, 10.0),
            note="dead time", source="one to three control periods of 10 ms"),
    ),
    delays_command="delay",
    indistinguishable_from=("sensor_lag",),
    separated_by={
        "sensor_lag": "sine sweep of 1 to 20 Hz about a bias with the pressure recorded: the pressure shows a delay of the "
        "command, not the lag of the speed sensor",
    },
)  # fmt: skip


# The element with play follows within 0.1 ms, so much faster than a command changes that nobody sees it.
def _played(voltage, follower, width):
    return voltage - clip(voltage - follower, -0.5 * width, 0.5 * width)


def _follower_rate(follower, command, width):
    gap = command - follower
    return (gap - clip(gap, -0.5 * width, 0.5 * width)) / 1e-4


INPUT_HYSTERESIS = _effect(
    name="input_hysteresis",
    title="hysteresis at the valve's input",
    summary="play between command and valve: after a reversal the command first has to cross its width",
    signature="loop in flow over command whose width depends neither on rate nor on amplitude",
    source="play operator (Prandtl); ISO 10770-1, hysteresis, whatever its mechanism",
    parameters=(
        Parameter("width", "V", 0.0, low=0.0, high=15.0, typical=3.0,
            note="width of the loop; the whole one, as ISO 10770-1 gives it",
            source="3 to 6 % of the rated command are usual for valves without spool feedback"),
    ),
    laws={"voltage": _played},
    states=(State("follower", _follower_rate),),
    indistinguishable_from=("magnetic_hysteresis", "spool_stiction"),
    separated_by={
        "magnetic_hysteresis": "record the current: with play before the coil it does not move either",
        "spool_stiction": "record the current: with play before the coil it does not move either",
    },
)  # fmt: skip


def _driver_saturation(voltage, voltage_limit):
    return clip(voltage, -voltage_limit, voltage_limit)


DRIVER_SATURATION = _effect(
    name="driver_saturation",
    title="saturation of the driver",
    summary="the driver cannot give more than a limited voltage",
    signature="clipped current at large commands",
    source="supply voltage of valve amplifiers (24 V less their own drop)",
    parameters=(
        assumed("voltage_limit", "V", inf, low=2.0, high=73.0, typical=45.0, possible=(0.1, 1000.0),
            note="limit of the driver's voltage"),
    ),
    laws={"voltage": _driver_saturation},
    indistinguishable_from=("spool_stop", "flow_saturation"),
    separated_by={"flow_saturation": "record the current: a driver at its limit clips it, a saturated edge does not"},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (COMMAND_DELAY, INPUT_HYSTERESIS, DRIVER_SATURATION)
