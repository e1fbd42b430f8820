"""References that lag behind the set-point, exact for a set-point that is held between samples."""

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.arrays import Floats


class FirstOrder:
    """The set-point through a first-order lag."""

    def __init__(self, value: Floats, time_constant: ArrayLike, period: float) -> None:
        self.value = value
        self.share = -np.expm1(-period / np.broadcast_to(np.ravel(time_constant), value.shape))

    def step(self, setpoint: Floats) -> Floats:
        self.value = self.value + self.share * (setpoint - self.value)
        return self.value


class DoublePole:
    """The set-point through a critically damped lag of second order, with a double pole at `rate` 1/s: 2 / rate is its mean
    delay. `speed` (num_rigs,) and its derivative `acceleration`."""

    def __init__(self, speed: Floats, rate: ArrayLike, period: float) -> None:
        self.speed, self.acceleration = speed, np.zeros_like(speed)
        self._rate, self._period = np.ravel(rate), period

    def ahead(self, setpoint: Floats) -> tuple[Floats, Floats]:
        """Speed and acceleration a period later."""
        gap, decay = setpoint - self.speed, np.exp(-self._rate * self._period)
        slope = self._rate * gap - self.acceleration
        later = gap + slope * self._period
        return setpoint - later * decay, (self._rate * later - slope) * decay

    def step(self, setpoint: Floats) -> None:
        """Goes on by one period."""
        self.speed, self.acceleration = self.ahead(setpoint)
