"""Disturbance observer: a linear model of the rated motor, and whatever it does not explain is taken off again.

The model knows the rated valve without dead zone, its spool and the motor's own pole, nothing of the drawn
valves. What is missing between it and the measured speed - dead zone, wrong gain, load, leakage - is
estimated as one disturbance at the valve's input, a share of the rated command, and subtracted from the
command (Ohnishi's scheme, here in state space). The estimate takes the place of an integrator; since it is fed
with the command that was in force, limits included, it does not wind up.
"""

import numpy as np

from hydro_env.controllers.base import OUTPUT_SHAPING, Controller, Floats, Gain, Measurements
from hydro_env.controllers.classical.reference import DoublePole
from hydro_env.controllers.estimation.nominal import Motor
from hydro_env.controllers.estimation.spool import SpoolModel, SpoolSettings, channel_of

MOTOR = Motor()
#: The rated spool, linear: more damping takes the place of friction and coil.
SPOOL = SpoolSettings(damping=0.15, friction=0.0, coil=1e-6)
#: No disturbance is taken to be larger than the rated command.
MAX_DISTURBANCE = 1.0


class DisturbanceObserver(Controller):
    """A second-order reference, fed forward through the rated motor, with gains on the errors and the estimate.

    Both motors follow one reference; `Ks` pulls each to the mean of both speeds.
    """

    similar = True
    GAINS = (
        Gain("rate", "1/s", 8.0, 60.0, summary="double pole of the reference: 2 / rate is its mean delay"),
        Gain("Kp", "1/s", 1.0, 60.0, summary="acceleration per error to the reference speed"),
        Gain("Ks", "1/s", 1.0, 200.0, summary="acceleration per half of the speed difference"),
        Gain("observer", "1/s", 2.0, 200.0, summary="double pole of the disturbance observer"),
        *OUTPUT_SHAPING,
    )

    def start(self, measured: Measurements) -> None:
        n = len(measured.speed)
        channel = channel_of(SPOOL, MOTOR, self.period, 1)
        self._spool = SpoolModel(measured.command, channel, SPOOL.pressure_lag)
        self._valve = np.zeros((n, 2, 2)), np.ones((n, 2))
        self._model = measured.speed.astype(float)
        self._reference = DoublePole(np.mean(measured.speed, axis=1), self.gains["rate"], self.period)
        self._decay, pole = np.exp(-MOTOR.rate * self.period), np.exp(-self.gains["observer"] * self.period)
        self._per_flow = (1.0 - self._decay) / MOTOR.per_speed
        # Gains that put both poles of the estimation error at `pole`, from the trace and determinant of its matrix.
        self._to_speed = 1.0 - pole**2 / self._decay
        self._to_disturbance = (1.0 - pole) ** 2 / self._per_flow
        # The command in force is right as it is: what the rated motor would not need of it is the disturbance.
        wanted = self._wanted(measured)
        self.disturbance: Floats = np.clip(wanted - measured.command, -MAX_DISTURBANCE, MAX_DISTURBANCE)

    def command(self, measured: Measurements) -> Floats:
        self._reference.step(measured.setpoint)
        return self._wanted(measured) - self.disturbance

    def take_in(self, measured: Measurements) -> None:
        """One period under the command that was in force."""
        before = self._spool.position.copy()
        self._spool.move(measured.command, *self._valve)
        opening = 0.5 * (before + self._spool.position)
        expected = self._decay * self._model + self._per_flow * (opening + self.disturbance)
        miss = measured.speed - expected
        self._model = expected + self._to_speed * miss
        self.disturbance = np.clip(
            self.disturbance + self._to_disturbance * miss, -MAX_DISTURBANCE, MAX_DISTURBANCE
        )

    def _wanted(self, measured: Measurements) -> Floats:
        """What the rated motor would need, a share of the rated command, (num_rigs, 2)."""
        apart = np.mean(measured.speed, axis=1, keepdims=True) - measured.speed
        speed = self._reference.speed[:, None]
        correction = self.gains["Kp"] * (speed - measured.speed) + self.gains["Ks"] * apart
        return MOTOR.demand(speed, self._reference.acceleration[:, None] + correction, 0.0)
