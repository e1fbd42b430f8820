"""Dead-zone inverse and flow feed-forward from a valve bench, with cross-coupled PI for the rest."""

import numpy as np

from hydro_env.controllers.base import OUTPUT_SHAPING, Floats, Gain, Measurements
from hydro_env.controllers.classical.cross_coupling import CrossCoupled
from hydro_env.controllers.estimation.bench_map import FromTheBench
from hydro_env.controllers.estimation.nominal import Motor

MOTOR = Motor()
BLEND = Gain("blend", "1", 1e-3, 0.1, summary="share of the rated flow below which the inverse is a ramp")


class Compensated(FromTheBench, CrossCoupled):
    """Asks for flow, and turns flow into a command by the inverse of each valve's measured curve.

    The flow that the smoothed set-point takes is fed forward; a cross-coupled PI corrects it. It does not notice when valves
    change afterwards.
    """

    GAINS = (*CrossCoupled.FOLLOWING, BLEND, *OUTPUT_SHAPING)

    def start(self, measured: Measurements) -> None:
        super().start(measured)
        self._track.integral = np.zeros_like(measured.speed)

    def command(self, measured: Measurements) -> Floats:
        before = self._reference.value
        reference = self._reference.step(measured.setpoint)
        ahead = MOTOR.demand(reference, (reference - before) / self.period, 0.0)[:, None]
        correction = self._correction(measured)
        integral = self._track.integral
        flow = self._track.step(reference[:, None] - measured.speed, ahead + correction)
        asked = self.valves.command(flow, self.gains["blend"])
        # What would be integrated further into a limit of the command is not.
        low, high = self.limits
        grown = self._track.integral - integral
        self._track.integral = np.where(
            ((asked > high) & (grown > 0.0)) | ((asked < low) & (grown < 0.0)), integral, integral + grown
        )
        return asked
