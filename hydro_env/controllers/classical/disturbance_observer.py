"""Disturbance observer: a linear model of the rated motor, and whatever it does not explain is taken off again.

The model knows the rated valve without dead zone, its spool and the motor's own pole, nothing of the drawn
valves. What is missing between it and the measured speed - dead zone, wrong gain, load, leakage - is
estimated as one disturbance at the valve's input, a share of the rated command, and subtracted from the
command (Ohnishi's scheme, here in state space). The estimate takes the place of an integrator; since it is fed
with the command that was in force, limits included, it does not wind up.
"""

from __future__ import annotations

import numpy as np

from hydro_env.controllers.base import OUTLET, Controller, Floats, Gain, Measurements
from hydro_env.controllers.estimation.valve_map import MOTOR_RATE, flow_for
from hydro_env.controllers.spool import Spool

__all__ = ["DisturbanceObserver"]

MOST = 1.0
"""No disturbance is taken to be larger than the rated command."""


class DisturbanceObserver(Controller):
    """A second-order reference, fed forward through the rated motor, with gains on the errors and the estimate.

    Both motors follow one reference; `Ks` pulls each to the mean of both speeds.
    """

    GAINS = (
        Gain("rate", "1/s", 8.0, 60.0, summary="double pole of the reference: 2 / rate is its mean delay"),
        Gain("Kp", "1/s", 1.0, 60.0, summary="acceleration per error to the reference speed"),
        Gain("Ks", "1/s", 1.0, 200.0, summary="acceleration per half of the speed difference"),
        Gain("observer", "1/s", 2.0, 200.0, summary="double pole of the disturbance observer"),
        *OUTLET,
    )

    def start(self, measured: Measurements) -> None:
        self._spool = Spool(measured.command, self.period)
        self._model = measured.speed.astype(float)
        self._reference = np.mean(measured.speed, axis=1)
        self._acceleration = np.zeros(len(measured.speed))
        decay, pole = np.exp(-MOTOR_RATE * self.period), np.exp(-self.gains["observer"] * self.period)
        self._decay = decay
        self._per_flow = (1.0 - decay) / flow_for(np.ones(()), np.zeros(()), np.zeros(()))
        # Gains that put both poles of the estimation error at `pole`, from the trace and determinant of its matrix.
        self._to_speed = 1.0 - pole**2 / decay
        self._to_disturbance = (1.0 - pole) ** 2 / self._per_flow
        # The command in force is right as it is: what the rated motor would not need of it is the disturbance.
        wanted = self._wanted(measured)
        self.disturbance: Floats = np.clip(wanted - measured.command, -MOST, MOST)
        self._fresh = True

    def command(self, measured: Measurements) -> Floats:
        if not self._fresh:  # nothing has passed before the first sample
            self._observe(measured)
        self._fresh = False
        self._move_reference(measured.setpoint)
        return self._wanted(measured) - self.disturbance

    def _observe(self, measured: Measurements) -> None:
        """One period under the command that was in force."""
        before = self._spool.position
        self._spool.step(measured.command)
        opening = 0.5 * (before + self._spool.position)
        expected = self._decay * self._model + self._per_flow * (opening + self.disturbance)
        miss = measured.speed - expected
        self._model = expected + self._to_speed * miss
        self.disturbance = np.clip(self.disturbance + self._to_disturbance * miss, -MOST, MOST)

    def _move_reference(self, setpoint: Floats) -> None:
        """One period of a critically damped second-order lag, exact for a set-point that is held."""
        rate, step = np.ravel(self.gains["rate"]), self.period
        gap, decay = setpoint - self._reference, np.exp(-rate * step)
        slope = rate * gap - self._acceleration
        self._reference = setpoint - (gap + slope * step) * decay
        self._acceleration = (rate * (gap + slope * step) - slope) * decay

    def _wanted(self, measured: Measurements) -> Floats:
        """What the rated motor would need, a share of the rated command, (num_rigs, 2)."""
        apart = np.mean(measured.speed, axis=1, keepdims=True) - measured.speed
        reference = self._reference[:, None]
        asked = (
            self._acceleration[:, None]
            + self.gains["Kp"] * (reference - measured.speed)
            + self.gains["Ks"] * apart
        )
        return flow_for(np.broadcast_to(reference, asked.shape), asked, np.zeros_like(asked))
