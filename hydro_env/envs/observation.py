"""What a controller sees: names, scales, sensors.

An observation is a frame of `OBSERVATION` signals, or with `history=k` the last k frames, newest last. Every signal
is divided by its fixed physical scale inside the environment and clipped to +-`LIMIT`, so that nothing has
to be normalised, and no statistics saved, outside. On the paper's rig the scales are `SCALES`, on another `scales_on` it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Floats, Reals, Singles
from ..errors import InputError, check_known, shown
from ..limits import Limits
from ..plant import PAPER, Scales
from ..plant.sensors import NOISE as SENSORS
from ..units import BAR, RPM

Level = float | Sequence[float]
#: The argument `noise`: a factor or levels, each a number or [lowest, highest].
Noise = Level | Mapping[str, Level]

#: Signals of a frame, in order.
OBSERVATION = (
    "setpoint", "speed_1", "speed_2", "current_1", "current_2", "pressure_1", "pressure_2", "command_1", "command_2",
)  # fmt: skip
#: Factor on the sensors' noise, or one level of it.
LEVEL = Limits(0.0, 1e6)
FRAME = len(OBSERVATION)
#: What `with_errors` adds to a frame.
ERRORS = 3

#: What 1.0 stands for on the paper's rig: 600 rpm, in rad/s; the rated current, A; 10 bar, in Pa; the rated command.
SCALES: Floats = np.array([600 * RPM] * 3 + [0.73] * 2 + [10 * BAR] * 2 + [1.0] * 2)
SCALES.setflags(write=False)

#: Scaled signals are clipped to +-LIMIT: on the paper's rig 6000 rpm, 7.3 A, 100 bar, far beyond what it does.
LIMIT = 10.0

#: Standard deviations of the sensors' noise on the paper's rig, by key of the `noise` argument, in the units these keys name.
NOISE = {key: SENSORS[key] for key in ("speed_rpm", "current_A", "pressure_bar")}


@dataclass(frozen=True)
class Measurements:
    """What the sensors show, SI.

    setpoint: (N,) in rad/s
    speed: (N, 2) in rad/s
    current: (N, 2) in A
    pressure: (N, 2), pressure differences over the motors in Pa
    command: (N, 2), the last one, as a fraction of the rated command
    """

    setpoint: Floats
    speed: Floats
    current: Floats
    pressure: Floats
    command: Floats

    def over(self, rig: Scales) -> "Measurements":
        """The measurements of the same motion on a rig that is smaller by these scales."""
        if rig == PAPER:
            return self
        current, pressure = self.current / rig.current, self.pressure / rig.pressure
        return Measurements(
            self.setpoint / rig.speed, self.speed / rig.speed, current, pressure, self.command
        )


def scales_on(rig: Scales) -> Floats:
    """What 1.0 stands for on a rig of another size, (FRAME,) in SI."""
    factors = [rig.speed] * 3 + [rig.current] * 2 + [rig.pressure] * 2 + [1.0] * 2
    return SCALES * factors


def decode(observation: Reals, rig: Scales = PAPER) -> Measurements:
    """The newest frame of observations (N, n) in SI, with errors in front or without, on a rig of this size (`scales_of(model)`).

    ValueError if n is no multiple of the length of a frame."""
    array = np.asarray(observation)
    width = array.shape[1] if array.ndim == 2 else 0
    if not width or (width % FRAME and width % (FRAME + ERRORS)):
        raise ValueError(f"observations have the shape {array.shape}, expected (N, k * {FRAME})")
    frame = array[:, -FRAME:] * scales_on(rig)
    return Measurements(frame[:, 0], frame[:, 1:3], frame[:, 3:5], frame[:, 5:7], frame[:, 7:9])


def encode(measured: Measurements, rig: Scales = PAPER) -> Singles:
    """The frames (N, FRAME) of measurements on a rig of this size: the opposite of `decode`."""
    m = measured
    frame = np.column_stack([m.setpoint, m.speed, m.current, m.pressure, m.command]) / scales_on(rig)
    return np.clip(frame, -LIMIT, LIMIT).astype(np.float32)


def with_errors(observation: Reals) -> Singles:
    """Observations (..., 9 k) with three numbers for each frame in front of them: (..., 12 k).

    Both motors' errors to the set-point and the speed difference, 1.0 for a tenth of that of the speeds, clipped to +-5. They
    hold nothing new, but a network finds the same numbers a tenth as large, and differences of large ones, hard to learn from.
    """
    array = np.asarray(observation, dtype=np.float32)
    frames = array.reshape(*array.shape[:-1], -1, FRAME)
    setpoint, one, two = frames[..., 0], frames[..., 1], frames[..., 2]
    errors = np.stack([setpoint - one, setpoint - two, one - two], axis=-1) * np.float32(10.0)
    errors = np.clip(errors, -5.0, 5.0).reshape(*array.shape[:-1], -1)
    return np.concatenate([errors, array], axis=-1)


def noise_levels(noise: Noise, rig: Scales = PAPER, end: int = 0) -> Floats:
    """Standard deviations (6,) of speeds, currents and pressures, scaled like the observation on a rig of this size.

    `noise` is a factor on what sensors of such a rig have (0 for none), `NOISE` on the paper's, or gives single levels in its
    units; of a range [lowest, highest] that `end` counts. InputError for anything else.
    """
    sizes = {"speed_rpm": rig.speed, "current_A": rig.current, "pressure_bar": rig.pressure}
    levels = {key: sizes[key] * value for key, value in NOISE.items()}
    if isinstance(noise, Mapping):
        check_known("noise: unknown key", noise, levels)
        levels |= {key: _level(value, f"noise: {key}", end) for key, value in noise.items()}
    else:
        factor = _level(noise, "noise", end)
        levels = {key: factor * value for key, value in levels.items()}
    speed, current, pressure = levels["speed_rpm"] * RPM, levels["current_A"], levels["pressure_bar"] * BAR
    return np.array([speed, speed, current, current, pressure, pressure]) / scales_on(rig)[1:7]


def _level(value: Any, name: str, end: int) -> float:
    """A level, or an end of a range of them."""
    if not (isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim)):
        return float(LEVEL.check(value, name))
    ends = [LEVEL.check(each, name) for each in value]
    if len(ends) != 2 or ends[0] > ends[1]:
        raise InputError(f"{name} is {shown(value)}, expected a number or [lowest, highest]")
    return float(ends[end])
