"""The PID law of the paper's eq. (12) and the controllers that run one on each motor.

Sampled as usual in practice: the integral by backward differences, the derivative through a first-order
filter (`FILTER_RATE`), and no further integration into a limit (conditional integration, which needs no
parameter of its own), be it of the command or of its rate.
"""

from math import inf
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.controllers.base import FRACTION_PER_V, OUTPUT_SHAPING, Controller, Floats, Gain, Measurements
from hydro_env.units import RPM

#: The paper's gains of valves V1 and V2: V/rpm, s, s.
TABLE_III = {"Kp": (0.016, 0.023), "Ti": (0.156, 0.150), "Td": (0.005, 0.0)}

#: Rate N of the derivative's filter, 1/s, assumed since the paper gives none.
FILTER_RATE = 100.0

KP = Gain("Kp", "V/rpm", 0.01, 0.4, summary="proportional gain")
TI = Gain("Ti", "s", 0.01, 1.0, summary="integral time")
TD = Gain("Td", "s", 1e-4, 0.06, summary="derivative time")
RAMP = Gain("ramp", "rpm/s", 1000.0, 30000.0, summary="how fast the set-point is followed", default=inf)


def per_rpm(gain: ArrayLike) -> Floats:
    """A gain in V/rpm on the paper's rig as a fraction of the rated command per rad/s."""
    return np.asarray(gain, dtype=float) * FRACTION_PER_V / RPM


class Pid:
    """u = kp (e + 1/ti int e dt + td de/dt) + feedforward, limited; vectorised by broadcasting."""

    def __init__(
        self, period: float, output: ArrayLike, kp: ArrayLike, ti: ArrayLike, td: ArrayLike = 0.0
    ) -> None:
        """Starts with the output that is in force, at a sample time of `period` s, without a derivative kick."""
        self.kp, self.ti, self.td = (np.asarray(value, dtype=float) for value in (kp, ti, td))
        self.period = period
        self.integral: Floats = np.array(output, dtype=float)
        self.derivative: Floats = np.zeros_like(self.integral)
        self._last_error: Floats | None = None

    def step(
        self, error: Floats, feedforward: Floats | float = 0.0, limits: tuple[Any, Any] = (-1.0, 1.0)
    ) -> Floats:
        """The output for this sample's error, both of the shape of the output at the start, within this sample's `limits`."""
        low, high = limits
        change = error - (error if self._last_error is None else self._last_error)
        self._last_error = error
        rate = FILTER_RATE * self.period
        self.derivative = (self.derivative + self.kp * self.td * FILTER_RATE * change) / (1.0 + rate)
        grown = self.integral + self.kp * (self.period / self.ti) * error
        rest = self.kp * error + self.derivative + feedforward
        output = rest + grown
        into_high = (output > high) & (grown > self.integral)
        into_low = (output < low) & (grown < self.integral)
        self.integral = np.where(into_high | into_low, self.integral, grown)
        # Named, since local names become those of the exported Structured Text.
        limited: Floats = np.minimum(np.maximum(rest + self.integral, low), high)
        return limited


class PidController(Controller):
    """A PID on each motor's speed, which knows nothing of the other motor: the paper's own control concept."""

    GAINS: ClassVar[tuple[Gain, ...]] = (KP, TI, TD, *OUTPUT_SHAPING)
    similar = True

    def start(self, measured: Measurements) -> None:
        kp, ti, td = per_rpm(self.gains["Kp"]), self.gains["Ti"], self.gains["Td"]
        self._pid = Pid(self.period, measured.command, kp, ti, td)

    def command(self, measured: Measurements) -> Floats:
        return self._pid.step(measured.setpoint[:, None] - measured.speed, limits=self.limits)


class RampedPid(PidController):
    """The same on a set-point that changes no faster than `ramp`, as drives are usually set: neither motor is asked for
    more than its valve gives, and a step of the set-point does not have to be paid for with gains too low for loads.
    """

    GAINS = (*PidController.GAINS, RAMP)

    def start(self, measured: Measurements) -> None:
        super().start(measured)
        self._reference = np.mean(measured.speed, axis=1)

    def command(self, measured: Measurements) -> Floats:
        most = np.ravel(self.gains["ramp"]) * RPM * self.period
        self._reference = self._reference + np.clip(measured.setpoint - self._reference, -most, most)
        return self._pid.step(self._reference[:, None] - measured.speed, limits=self.limits)
