"""Speeds and loads of a pair of motors: a Kalman filter that goes by the torque and is corrected by the speed sensors.

The pressure tells what turns a shaft far better than a speed sensor tells how fast it turns, so between two readings the
speed is integrated (eq. 2), and a reading corrects it and the load by as much as it is worth. Both loads change together more
easily than against each other. A load that jumps shows in a reading far off what was expected, or in two in a row; then it
is held for unknown, of both motors together or against each other, and found again from this reading and the next ones.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Bools, Floats
from hydro_env.controllers.base import HAND, TUNED
from hydro_env.controllers.estimation.nominal import NOMINAL, PRESSURE_NOISE, SPEED_NOISE, Motor
from hydro_env.jit import compiled

INERTIA, DISPLACEMENT, FRICTION = (NOMINAL[name] for name in ("J", "D", "B"))
#: Standard deviation of the torque read from a pressure sensor, N m.
TORQUE_NOISE = DISPLACEMENT * PRESSURE_NOISE


class MotorFilterSettings(NamedTuple):
    """What the filter expects of loads and of its own model."""

    together: Annotated[float, "N m", "random walk of the loads' mean in a period", TUNED] = 0.006
    apart: Annotated[float, "N m", "and of half their difference", TUNED] = 0.0005
    changed: Annotated[float, "1", "share of a change of torque that its integral may have wrong", TUNED] = 0.06  # fmt: skip
    unsampled: Annotated[float, "1", "share of the torque between samples that may be wrong", TUNED] = 0.5
    sudden: Annotated[float, "1", "a miss that shows a load's jump, standard deviations", HAND] = 4.0
    twice: Annotated[float, "1", "product of two misses in a row that does, variances", TUNED] = 8.0


class MotorState(NamedTuple):
    """Speeds (rad/s), loads (N m), and by how much the last reading of the load was off, each (N, 2); covariance (N, 4, 4) of
    both speeds, then both loads; the last pressures (Pa)."""

    speed: Floats
    torque: Floats
    miss: Floats
    covariance: Floats
    pressure: Floats


class MotorFilter:
    """Holds a `MotorState` in `state`, whose arrays keep their place."""

    def __init__(
        self, settings: MotorFilterSettings, period: float, motor: Motor, speed: Floats, pressure: Floats
    ) -> None:
        """No load; `speed` and `pressure` (num_rigs, 2) as they are now."""
        self._settings, self._gained = settings, period / INERTIA
        self._motor = motor.noise * TORQUE_NOISE, motor.friction * FRICTION
        torque, miss = np.zeros((2, *speed.shape))
        covariance = np.zeros((len(speed), 4, 4))
        covariance[:] = SPEED_NOISE**2 * np.diag([1.0, 1.0, 0.0, 0.0])
        self.state = MotorState(np.array(speed, float), torque, miss, covariance, np.array(pressure, float))

    def update(self, speed: Floats, pressure: Floats, unsampled: Floats, noise: Floats, blind: Bools) -> None:
        """Takes in the next readings (num_rigs, 2), rad/s and Pa.

        `unsampled`: what the mean torque of the period is beyond the mean of its two readings, by the model, N m. `noise`:
        the speeds' noise as a multiple of the usual. Where `blind`, `speed` is taken for the speed and the load stays.
        """
        readings = np.ascontiguousarray(speed), np.ascontiguousarray(pressure)
        _update(self._settings, self._gained, *self._motor, self.state, *readings, unsampled, noise, blind)


@compiled
def _update(s, gained, hiss, drag, m, speed, pressure, unsampled, noise, blind):
    off, sensor = np.empty(2), np.empty(2)
    for i in range(speed.shape[0]):
        for c in range(2):
            _predict(s, gained, hiss, drag, i, c, m, pressure[i, c], unsampled[i, c])
            off[c] = speed[i, c] - m.speed[i, c]
            sensor[c] = (SPEED_NOISE * noise[i, c]) ** 2
        known = not (blind[i, 0] or blind[i, 1])
        _widen(s, gained, m.covariance[i], off, sensor, m.miss[i], known)
        for c in range(2):
            m.miss[i, c] = -off[c] / gained
        for c in range(2):
            if blind[i, c]:
                _replace(i, c, m, speed[i, c], sensor[c])
            else:
                _correct(i, c, m, speed[i, c], sensor[c])


@compiled
def _predict(s, gained, hiss, drag, i, c, m, pressure, unsampled):
    """A period later: the speed has taken in the torque less the load."""
    p = m.covariance[i]
    mean = 0.5 * DISPLACEMENT * (pressure + m.pressure[i, c]) + unsampled
    m.speed[i, c] += gained * (mean - drag * m.speed[i, c] - m.torque[i, c])
    for k in range(4):
        p[c, k] -= gained * p[2 + c, k]
    for k in range(4):
        p[k, c] -= gained * p[k, 2 + c]
    change = s.changed * DISPLACEMENT * (pressure - m.pressure[i, c])
    wrong = (s.unsampled * unsampled) ** 2 + change**2
    p[c, c] += gained**2 * (0.5 * hiss**2 + wrong)
    m.pressure[i, c] = pressure


@compiled
def _widen(s, gained, p, off, sensor, miss, known):
    """Random walks of the loads together (sign 1) and against each other (-1), as wide as a jump that shows in what the
    readings are `off`."""
    for sign, walk in ((1.0, s.together), (-1.0, s.apart)):
        expected = 0.25 * (p[0, 0] + p[1, 1] + sensor[0] + sensor[1]) + 0.5 * sign * p[0, 1]
        now = 0.5 * (off[0] + sign * off[1])
        last = -0.5 * gained * (miss[0] + sign * miss[1])
        unknown = max(now * now - s.sudden**2 * expected, now * last - s.twice * expected, 0.0) / gained**2
        if not known:
            unknown = 0.0
        unknown += walk**2
        for c in range(2):
            for d in range(2):
                more = unknown if c == d else sign * unknown
                p[2 + c, 2 + d] += more
                p[c, 2 + d] -= gained * more
                p[2 + d, c] -= gained * more
                p[c, d] += gained**2 * more


@compiled
def _replace(i, c, m, speed, sensor):
    """A sensor that is not to be trusted: its substitute is the speed."""
    p = m.covariance[i]
    m.speed[i, c], m.miss[i, c] = speed, 0.0
    for k in range(4):
        p[c, k] = p[k, c] = p[2 + c, k] = p[k, 2 + c] = 0.0
    p[c, c] = sensor


@compiled
def _correct(i, c, m, speed, sensor):
    """Kalman update by the reading of one speed."""
    p = m.covariance[i]
    weight = (speed - m.speed[i, c]) / (p[c, c] + sensor)
    m.speed[i, 0] += p[0, c] * weight
    m.speed[i, 1] += p[1, c] * weight
    m.torque[i, 0] += p[2, c] * weight
    m.torque[i, 1] += p[3, c] * weight
    share = 1.0 / (p[c, c] + sensor)
    for k in range(4):
        to = p[k, c] * share
        for j in range(4):
            if j != c and k != c:
                p[k, j] -= to * p[c, j]
    rest = 1.0 - p[c, c] * share
    for k in range(4):
        if k != c:
            p[k, c] *= rest
            p[c, k] = p[k, c]
    p[c, c] *= rest
