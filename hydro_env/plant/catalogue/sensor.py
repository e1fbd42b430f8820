"""Effects of the speed sensor: they change what is measured and nothing else."""

from functools import partial

from ..parameters import assumed
from .effect import Effect, State

_effect = partial(Effect, port="sensor")


def _sensor_lag(measured_speed, lagged_speed, time_constant):
    return lagged_speed if time_constant > 0.0 else measured_speed


def _lag_rate(lagged_speed, speed, time_constant):
    return (speed - lagged_speed) / (time_constant if time_constant > 1e-5 else 1e-5)


SENSOR_LAG = _effect(
    name="sensor_lag",
    title="a lag of the speed sensor",
    summary="the measured speed lags the true one (filter of first order)",
    signature="measured speed late against physics, torque balance broken",
    source="counter gates and filters of speed sensors",
    parameters=(
        assumed("time_constant", "s", 0.0, low=0.0, high=0.1, typical=0.02, note="time constant of the sensor"),
    ),
    laws={"measured_speed": _sensor_lag},
    states=(State("lagged_speed", _lag_rate, scale=10.0),),
    indistinguishable_from=("command_delay",),
)  # fmt: skip


def _sensor_gain(measured_speed, gain):
    return measured_speed * gain


SENSOR_GAIN = _effect(
    name="sensor_gain",
    title="a scale error of the speed sensor",
    summary="the speed sensor's scale is wrong",
    signature="speed contradicts pressure and flow by one factor; the rig behaves as modelled",
    source="pulses per turn, calibration",
    parameters=(
        assumed("gain", "1", 1.0, low=0.7, high=1.4, typical=1.05, log=True, note="measured over true speed"),
    ),
    laws={"measured_speed": _sensor_gain},
    separated_by={"directional_gain": "count revolutions over a minute at constant speed, both directions"},
)  # fmt: skip


def _sensor_offset(measured_speed, offset):
    return measured_speed + offset


SENSOR_OFFSET = _effect(
    name="sensor_offset",
    title="a zero error of the speed sensor",
    summary="the speed sensor's zero is wrong",
    signature="speed contradicts pressure and flow by a constant; the rig behaves as modelled",
    source="drift of analogue speed signals",
    parameters=(
        assumed("offset", "rad/s", 0.0, low=-10.0, high=10.0, typical=1.0, note="measured speed at standstill"),
    ),
    laws={"measured_speed": _sensor_offset},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (SENSOR_LAG, SENSOR_GAIN, SENSOR_OFFSET)
