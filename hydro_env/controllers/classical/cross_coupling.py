"""Controllers that couple the two motors: cross and relative coupling, virtual leader, master and slave.

All build on PI laws on the speeds and need nothing but the speed signals.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hydro_env.controllers.base import OUTPUT_SHAPING, RPM, Controller, Floats, Gain, Measurements
from hydro_env.controllers.classical.pid import KP, TI, Pid, per_rpm
from hydro_env.controllers.classical.reference import FirstOrder

__all__ = ["CrossCoupled", "MasterSlave", "RelativeCoupled", "VirtualLeader"]

SIDES = np.array([1.0, -1.0])
"""How channels 1 and 2 enter the speed difference."""

FILTER = Gain("filter", "s", 0.01, 0.2, summary="time constant of the set-point filter")
COUPLING = (
    Gain("Kc", "V/rpm", 0.01, 0.4, summary="proportional gain on the speed difference"),
    Gain("Tic", "s", 0.004, 1.0, summary="integral time on the speed difference"),
)


class CrossCoupled(Controller):
    """PI on each motor's error to the smoothed set-point, and a PI on the speed difference that acts on both.

    The motor that is ahead is held back as much as the other is pushed, so that they meet in the middle.
    """

    FOLLOWING = (KP, TI, *COUPLING, FILTER)
    similar = True
    GAINS: ClassVar[tuple[Gain, ...]] = (*FOLLOWING, *OUTPUT_SHAPING)

    def start(self, measured: Measurements) -> None:
        self._reference = FirstOrder(np.mean(measured.speed, axis=1), self.gains["filter"], self.period)
        self._track = Pid(self.period, self._in_force(measured), per_rpm(self.gains["Kp"]), self.gains["Ti"])
        apart = np.zeros((len(measured.speed), 1))
        self._couple = Pid(self.period, apart, per_rpm(self.gains["Kc"]), self.gains["Tic"])

    def _in_force(self, measured: Measurements) -> Floats:
        """What the PI of each motor starts with, (num_rigs, 2)."""
        return measured.command

    def command(self, measured: Measurements) -> Floats:
        return self._follow(self._reference.step(measured.setpoint), measured)

    def _follow(self, reference: Floats, measured: Measurements) -> Floats:
        correction = self._correction(measured)
        return self._track.step(reference[:, None] - measured.speed, correction, self.limits)

    def _correction(self, measured: Measurements) -> Floats:
        """What the coupling adds, (num_rigs, 2)."""
        behind = measured.speed[:, 1:] - measured.speed[:, :1]  # how far motor 1 is behind motor 2
        return SIDES * self._couple.step(behind)


class RelativeCoupled(Controller):
    """PI on each motor's error to the smoothed set-point plus its weighted lag behind the other motor.

    With many motors, relative coupling feeds every motor its differences to all others, where cross coupling
    knows but one difference (or that to the next motor). With two motors there is only one difference left, and
    what still sets the two apart is where it enters: here it is part of the error that the motor's own PI works
    on, there it has a PI of its own. In the linear range this is cross coupling with Tic = Ti and
    Kc = coupling * Kp: one gain less to tune, and the speed difference cannot be integrated faster than the error
    to the set-point. At a limit of the command it behaves differently, because one integrator holds both parts.
    (The weights are usually set by the ratio of the inertias; those of the two motors are equal.)
    """

    similar = True
    GAINS = (
        KP,
        TI,
        Gain("coupling", "1", 0.1, 20.0, summary="weight of the lag behind the other motor in the error"),
        FILTER,
        *OUTPUT_SHAPING,
    )

    def start(self, measured: Measurements) -> None:
        self._reference = FirstOrder(np.mean(measured.speed, axis=1), self.gains["filter"], self.period)
        self._pid = Pid(self.period, measured.command, per_rpm(self.gains["Kp"]), self.gains["Ti"])

    def command(self, measured: Measurements) -> Floats:
        lag = measured.speed[:, ::-1] - measured.speed
        error = self._reference.step(measured.setpoint)[:, None] - measured.speed
        return self._pid.step(error + self.gains["coupling"] * lag, limits=self.limits)


class VirtualLeader(CrossCoupled):
    """Cross coupling behind a leader that waits: it runs to the set-point, but never further than `lead`
    ahead of the slower motor, so that a valve still crossing its dead zone holds both motors up."""

    GAINS = (
        *CrossCoupled.GAINS,
        Gain("lead", "rpm", 30.0, 600.0, summary="how far the leader may run ahead"),
    )

    def command(self, measured: Measurements) -> Floats:
        leader = self._reference.value
        direction = np.where(measured.setpoint >= leader, 1.0, -1.0)
        ahead = direction * self._reference.step(measured.setpoint)
        slower = np.min(direction[:, None] * measured.speed, axis=1)
        limit = np.maximum(
            slower + np.ravel(self.gains["lead"]) * RPM, direction * leader - self._retreat(leader)
        )
        self._reference.value = direction * np.minimum(ahead, limit)
        return self._follow(self._reference.value, measured)

    def _retreat(self, leader: Floats) -> Floats:
        """How far the leader may fall back in one sample: no faster than it runs (a step back is a bump)."""
        return self._reference.share * (np.abs(leader) + 600.0 * RPM)


class MasterSlave(Controller):
    """Motor 1 follows the smoothed set-point, motor 2 follows the measured speed of motor 1."""

    similar = True
    GAINS = (
        KP,
        TI,
        Gain("Kp_slave", "V/rpm", 0.01, 0.8, summary="proportional gain of the slave"),
        Gain("Ti_slave", "s", 0.01, 1.0, summary="integral time of the slave"),
        FILTER,
        *OUTPUT_SHAPING,
    )

    def start(self, measured: Measurements) -> None:
        self._reference = FirstOrder(np.mean(measured.speed, axis=1), self.gains["filter"], self.period)
        kp, ti = (
            np.stack(
                np.broadcast_arrays(*(np.ravel(self.gains[key]) for key in (name, f"{name}_slave"))), axis=-1
            )
            for name in ("Kp", "Ti")
        )
        self._pid = Pid(self.period, measured.command, per_rpm(kp), ti)

    def command(self, measured: Measurements) -> Floats:
        aim = np.stack([self._reference.step(measured.setpoint), measured.speed[:, 0]], axis=1)
        return self._pid.step(aim - measured.speed, limits=self.limits)
