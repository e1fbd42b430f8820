"""Speeds and loads of a pair of motors: a Kalman filter that goes by the torque and is corrected by the speed sensors.

The pressure tells what turns a shaft far better than a speed sensor tells how fast it turns, so between two readings the
speed is integrated (eq. 2), and a reading corrects it and the load by as much as it is worth. Both loads change together more
easily than against each other. A load that jumps shows in a reading far off what was expected, or in two in a row; then it
is held for unknown, of both motors together or against each other, and found anew from this reading and the next ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.envs.observation import NOISE
from hydro_env.jit import compiled
from hydro_env.plant import PARAMETERS
from hydro_env.units import BAR, RPM

__all__ = ["MotorFilter"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

INERTIA, DISPLACEMENT, FRICTION = (PARAMETERS[name].nominal for name in ("J", "D", "B"))
READING = NOISE["speed_rpm"] * RPM
"""Standard deviation of a speed sensor, rad/s."""
PUSH = DISPLACEMENT * NOISE["pressure_bar"] * BAR
"""Standard deviation of the torque read from a pressure sensor, N m."""
SUDDEN = 4.0
"""Standard deviations from which on a miss counts as a load that has jumped."""


class MotorFilter:
    """Speeds in rad/s and loads in N m, each (num_rigs, 2).

    Args:
        wander: standard deviations of the random walks in one period of the loads' mean and of half their difference, N m.
        turned: what the torque's integral may have wrong of a change of torque, as a share of it.
        twice: product of two misses in a row, in variances of a miss, from which on they count as a load that has jumped.
        bent: of what the samples miss of the mean torque, the share that the model may have wrong.
    """

    def __init__(
        self,
        num_rigs: int,
        period: float,
        wander: tuple[float, float],
        turned: float,
        twice: float,
        bent: float = 0.5,
    ) -> None:
        pair = (num_rigs, 2)
        self._settings = (period / INERTIA, *wander, turned, twice, bent)
        self.speed, self._pressure = np.zeros(pair), np.zeros(pair)
        self.torque: Floats = np.zeros(pair)
        self.miss: Floats = np.zeros(pair)
        # of both speeds, then both loads
        self._spread = np.zeros((num_rigs, 4, 4))

    def forget(self, rows: Rows, speed: Floats, pressure: Floats) -> None:
        """No load; speeds and pressures as they are now."""
        self.speed[rows], self._pressure[rows] = speed, pressure
        self.torque[rows], self.miss[rows] = 0.0, 0.0
        self._spread[rows] = READING**2 * np.diag([1.0, 1.0, 0.0, 0.0])

    def step(
        self, speed: Floats, pressure: Floats, bend: Floats, noisier: Floats, blind: NDArray[np.bool_]
    ) -> None:
        """Takes in the next readings.

        `bend`: what the mean torque of the period is beyond the mean of its two readings, by the model, N m. `noisier`:
        the speeds' noise as a multiple of the usual. Where `blind`, `speed` is taken for the speed and the load stays.
        """
        _step(
            self.speed, self.torque, self.miss, self._spread, self._pressure, np.ascontiguousarray(speed),
            np.ascontiguousarray(pressure), bend, noisier, blind, *self._settings,
        )  # fmt: skip


@compiled
def _step(
    speed, torque, miss, spread, before, reading, pressure, bend, noisier, blind,
    gained, wander, apart, turned, twice, bent,
):  # fmt: skip
    off, sensor = np.empty(2), np.empty(2)
    for i in range(speed.shape[0]):
        p = spread[i]
        # a period later: speeds have taken in the torques less the loads
        for c in range(2):
            mean = 0.5 * DISPLACEMENT * (pressure[i, c] + before[i, c]) + bend[i, c]
            speed[i, c] += gained * (mean - FRICTION * speed[i, c] - torque[i, c])
            off[c] = reading[i, c] - speed[i, c]
            sensor[c] = (READING * noisier[i, c]) ** 2
            for k in range(4):
                p[c, k] -= gained * p[2 + c, k]
            for k in range(4):
                p[k, c] -= gained * p[k, 2 + c]
            wrong = (bent * bend[i, c]) ** 2 + (turned * DISPLACEMENT * (pressure[i, c] - before[i, c])) ** 2
            p[c, c] += gained**2 * (0.5 * PUSH**2 + wrong)
            before[i, c] = pressure[i, c]
        # loads together (sign 1) and against each other (-1)
        for sign, walk in ((1.0, wander), (-1.0, apart)):
            expected = 0.25 * (p[0, 0] + p[1, 1] + sensor[0] + sensor[1]) + 0.5 * sign * p[0, 1]
            now = 0.5 * (off[0] + sign * off[1])
            last = -0.5 * gained * (miss[i, 0] + sign * miss[i, 1])
            unknown = max(now * now - SUDDEN**2 * expected, now * last - twice * expected, 0.0) / gained**2
            if blind[i, 0] or blind[i, 1]:
                unknown = 0.0
            unknown += walk**2
            for c in range(2):
                for d in range(2):
                    more = unknown if c == d else sign * unknown
                    p[2 + c, 2 + d] += more
                    p[c, 2 + d] -= gained * more
                    p[2 + d, c] -= gained * more
                    p[c, d] += gained**2 * more
        for c in range(2):
            miss[i, c] = -off[c] / gained
        for c in range(2):
            if blind[i, c]:
                speed[i, c], miss[i, c] = reading[i, c], 0.0
                for k in range(4):
                    p[c, k] = p[k, c] = p[2 + c, k] = p[k, 2 + c] = 0.0
                p[c, c] = sensor[c]
                continue
            weight = (reading[i, c] - speed[i, c]) / (p[c, c] + sensor[c])
            speed[i, 0] += p[0, c] * weight
            speed[i, 1] += p[1, c] * weight
            torque[i, 0] += p[2, c] * weight
            torque[i, 1] += p[3, c] * weight
            share = 1.0 / (p[c, c] + sensor[c])
            for k in range(4):
                off[0] = p[k, c] * share
                for m in range(4):
                    if m != c and k != c:
                        p[k, m] -= off[0] * p[c, m]
            rest = 1.0 - p[c, c] * share
            for k in range(4):
                if k != c:
                    p[k, c] *= rest
                    p[c, k] = p[k, c]
            p[c, c] *= rest
