"""Controllers that couple the two motors: cross and relative coupling, virtual leader, master and slave.

All build on PI laws on the speeds and need nothing but the speed signals.
"""

from typing import ClassVar

import numpy as np

from hydro_env.controllers.base import OUTPUT_SHAPING, RPM, Controller, Floats, Gain, Measurements
from hydro_env.controllers.classical.pid import KP, TI, Pid, per_rpm
from hydro_env.controllers.classical.reference import FirstOrder

#: How channels 1 and 2 enter the speed difference.
SIDES = np.array([1.0, -1.0])

FILTER = Gain("filter", "s", 0.01, 0.2, summary="time constant of the set-point filter")
COUPLING = (
    Gain("Kc", "V/rpm", 0.01, 0.4, summary="proportional gain on the speed difference"),
    Gain("Tic", "s", 0.004, 1.0, summary="integral time on the speed difference"),
)
SLAVE = (
    Gain("Kp_slave", "V/rpm", 0.01, 0.8, summary="proportional gain of the slave"),
    Gain("Ti_slave", "s", 0.01, 1.0, summary="integral time of the slave"),
)
WEIGHT = Gain("coupling", "1", 0.1, 20.0, summary="weight of the lag behind the other motor in the error")
LEAD = Gain("lead", "rpm", 30.0, 600.0, summary="how far the leader may run ahead")


class Following(Controller):
    """A PI on each motor's error, `_track`, to a set-point that is smoothed by a filter, `_reference`."""

    similar = True

    def start(self, measured: Measurements) -> None:
        self._reference = FirstOrder(np.mean(measured.speed, axis=1), self.gains["filter"], self.period)
        self._track = self.pi(measured.command, "Kp", "Ti")

    def pi(self, output: Floats, gain: str, time: str) -> Pid:
        """A PI with gains of these names, which starts with this output."""
        return Pid(self.period, output, per_rpm(self.gains[gain]), self.gains[time])


class CrossCoupled(Following):
    """PI on each motor's error to the smoothed set-point, and a PI on the speed difference that acts on both.

    The motor that is ahead is held back as much as the other is pushed, so that they meet in the middle.
    """

    FOLLOWING = (KP, TI, *COUPLING, FILTER)
    GAINS: ClassVar[tuple[Gain, ...]] = (*FOLLOWING, *OUTPUT_SHAPING)

    def start(self, measured: Measurements) -> None:
        super().start(measured)
        self._couple = self.pi(np.zeros((len(measured.speed), 1)), "Kc", "Tic")

    def command(self, measured: Measurements) -> Floats:
        return self._follow(self._reference.step(measured.setpoint), measured)

    def _follow(self, reference: Floats, measured: Measurements) -> Floats:
        correction = self._correction(measured)
        return self._track.step(reference[:, None] - measured.speed, correction, self.limits)

    def _correction(self, measured: Measurements) -> Floats:
        """What the coupling adds, (num_rigs, 2)."""
        behind = measured.speed[:, 1:] - measured.speed[:, :1]  # how far motor 1 is behind motor 2
        return SIDES * self._couple.step(behind)


class RelativeCoupled(Following):
    """PI on each motor's error to the smoothed set-point plus its weighted lag behind the other motor.

    With many motors, relative coupling feeds every motor its differences to all others, where cross coupling
    knows but one difference (or that to the next motor). With two motors there is only one difference left, and
    what still sets the two apart is where it enters: here it is part of the error that the motor's own PI works
    on, there it has a PI of its own. In the linear range this is cross coupling with Tic = Ti and
    Kc = coupling * Kp: one gain less to tune, and the speed difference cannot be integrated faster than the error
    to the set-point. At a limit of the command it behaves differently, because one integrator holds both parts.
    (The weights are usually set by the ratio of the inertias; those of the two motors are equal.)
    """

    GAINS = (KP, TI, WEIGHT, FILTER, *OUTPUT_SHAPING)

    def command(self, measured: Measurements) -> Floats:
        lag = measured.speed[:, ::-1] - measured.speed
        error = self._reference.step(measured.setpoint)[:, None] - measured.speed
        return self._track.step(error + self.gains["coupling"] * lag, limits=self.limits)


class VirtualLeader(CrossCoupled):
    """Cross coupling behind a leader that waits: it runs to the set-point, but never further than `lead`
    ahead of the slower motor, so that a valve still crossing its dead zone holds both motors up."""

    GAINS = (*CrossCoupled.GAINS, LEAD)

    def command(self, measured: Measurements) -> Floats:
        leader = self._reference.value
        direction = np.where(measured.setpoint >= leader, 1.0, -1.0)
        ahead = direction * self._reference.step(measured.setpoint)
        slower = np.min(direction[:, None] * measured.speed, axis=1)
        # It falls back no faster than it runs: a step back is a bump.
        retreat = self._reference.share * (np.abs(leader) + 600.0 * RPM)
        limit = np.maximum(slower + np.ravel(self.gains["lead"]) * RPM, direction * leader - retreat)
        self._reference.value = direction * np.minimum(ahead, limit)
        return self._follow(self._reference.value, measured)


class MasterSlave(Following):
    """Motor 1 follows the smoothed set-point, motor 2 follows the measured speed of motor 1."""

    GAINS = (KP, TI, *SLAVE, FILTER, *OUTPUT_SHAPING)

    def pi(self, output: Floats, gain: str, time: str) -> Pid:
        return Pid(self.period, output, per_rpm(self._both(gain)), self._both(time))

    def _both(self, name: str) -> Floats:
        """A gain of the master beside that of the slave, (..., 2)."""
        both = (np.ravel(self.gains[key]) for key in (name, f"{name}_slave"))
        return np.stack(np.broadcast_arrays(*both), axis=-1)

    def command(self, measured: Measurements) -> Floats:
        aim = np.stack([self._reference.step(measured.setpoint), measured.speed[:, 0]], axis=1)
        return self._track.step(aim - measured.speed, limits=self.limits)
