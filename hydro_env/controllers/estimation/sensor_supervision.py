"""Supervision of speed and pressure sensors while the rig is driven: their noise, a sensor that stands still or lags.

It gives the speeds that the law goes by: the readings as they are while noise is usual and nothing is wrong; otherwise the
pressure's torque integrated over the motor's inertia (eq. 2), corrected by the reading as far as that can be trusted, or by
the valve's flow where it cannot be trusted at all (eq. 1). One row per rig, one column per channel.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import HAND, Bools, Floats, Rows
from hydro_env.controllers.estimation.nominal import FLOW_NOISE, NOMINAL, PRESSURE_NOISE, SPEED_NOISE, Motor
from hydro_env.envs.observation import Measurements
from hydro_env.jit import compiled
from hydro_env.units import RPM

#: How many of the first 4, 8 and 12 readings at rest count, the quietest, and the mean of their squares for noise of variance 1
#: (order statistics of the chi-square distribution with one degree of freedom).
KEPT, SHARE = np.array([3, 6, 8]), np.array([0.51, 0.446, 0.326])
INERTIA, DISPLACEMENT, FRICTION, LEAKAGE = (NOMINAL[name] for name in ("J", "D", "B", "Km"))


class SensorSettings(NamedTuple):
    """From when on a sensor is held for noisy, lagging or stuck."""

    active: Annotated[bool, "", "whether readings are supervised at all"] = True
    noisy: Annotated[float, "1", "noise of a speed that counts as unusual, of usual", HAND] = 1.7
    noisy_pressure: Annotated[float, "1", "and of the pressures: all four sensors tell of it", HAND] = 1.4
    forgetting: Annotated[float, "1", "share of a new square in the noise's mean", HAND] = 0.02
    settled: Annotated[float, "1", "samples of a steady reference before noise is measured", HAND] = 15.0
    bend: Annotated[float, "1", "bend of a reading that tells of a lag, standard deviations", HAND] = 8.0
    lagging: Annotated[float, "s", "lag that is corrected; a load's step looks like 0.01", HAND] = 0.014
    model: Annotated[float, "rad/s", "standard deviation of a period's integrated torque", HAND] = 1.4 * RPM
    rate: Annotated[float, "1/s", "pace from integrated torque to a doubtful reading or flow", HAND] = 3.0


class SensorState(NamedTuple):
    """Speeds to go by (rad/s), noise as multiples of the usual and their squares, flags, lags (s), and the sums that give
    them, each (N, 2)."""

    speed: Floats
    noise: Floats
    pressure_noise: Floats
    speed_square: Floats
    pressure_square: Floats
    stuck: Bools
    lagging: Bools
    lag: Floats
    along: Floats
    size: Floats


class SensorSupervision:
    """Holds a `SensorState` in `state`, whose arrays keep their place."""

    def __init__(self, settings: SensorSettings, period: float, motor: Motor, seen: Measurements) -> None:
        """`seen`: the first readings, taken at rest."""
        num_rigs, pair = len(seen.speed), seen.speed.shape
        self.settings, self._period, self._leak = settings, period, motor.leakage * LEAKAGE
        self._motor, self._pressure_noise = motor, motor.noise * PRESSURE_NOISE
        self._drag = motor.friction * FRICTION
        noises, flags, sums = np.ones((4, *pair)), np.zeros((2, *pair), bool), np.zeros((3, *pair))
        sums[2] = (15.0 * RPM) ** 2  # the first `size`
        self.state = SensorState(np.array(seen.speed, float), *noises, *flags, *sums)
        self._read, self._pressure = np.stack([seen.speed] * 3), np.stack([seen.pressure] * 3)
        # squares of the first three readings at rest: of both speeds, then both pressures
        self._firsts = np.full((num_rigs, 3, 4), np.inf)
        self._age, self._steady = np.ones(num_rigs, int), np.zeros(num_rigs, int)
        self._first_readings(slice(None), seen.speed, seen.pressure)
        noise, pressure_noise = np.sqrt(self.state.speed_square), np.sqrt(self.state.pressure_square)
        self.state.noise[:] = np.where(noise > settings.noisy, noise, 1.0)
        self.state.pressure_noise[:] = np.where(pressure_noise > settings.noisy_pressure, pressure_noise, 1.0)

    @property
    def unsound(self) -> Bools:
        """Sensors whose readings cannot be taken for the speed, (num_rigs, 2)."""
        return self.state.stuck | self.state.lagging

    @property
    def flow_noise(self) -> Floats:
        """Noise of the measured flow as a multiple of the usual, (num_rigs, 2)."""
        s = self.state
        heard = self._motor.flow_noise(np.minimum(s.noise, 5.0), s.pressure_noise)
        return np.where((s.noise > 1.0) | (s.pressure_noise > 1.0), heard / FLOW_NOISE, 1.0)

    def update(self, seen: Measurements, torque: Floats, valve_flow: Floats, steady: Bools) -> Floats:
        """Takes in the next readings; returns the speeds to go by.

        `torque` (num_rigs, 2): the loads as estimated, N m. `valve_flow` (num_rigs, 2): what the valves pass by the
        estimate, m3/s. `steady` (num_rigs,): the reference neither moves nor waits.
        """
        self._read = np.concatenate([seen.speed[None], self._read[:-1]])
        self._pressure = np.concatenate([seen.pressure[None], self._pressure[:-1]])
        early = self._age < 3
        if early.any():
            rows = np.flatnonzero(early)
            self._age[rows] += 1
            self._first_readings(rows, self._read[0, rows], self._pressure[0, rows])
        self._steady = np.where(steady & ~early, self._steady + 1, 0)
        _supervise(
            self.settings, self._period, self._leak, self._drag, self._read, self._pressure, torque, valve_flow, self._steady,
            self.state,
        )  # fmt: skip
        return self.state.speed.copy()

    def _first_readings(self, rows: Rows, speed: Floats, pressure: Floats) -> None:
        """Takes in readings at rest, the first three. Prior squares: the usual ones for pressures, the pressures'
        for speeds. What makes pressures noisy makes speeds noisy, so that both tell of it; but one speed sensor
        may be worse alone, and valves open at rest or very soon move what their own sensors read. So of all readings only the
        quieter ones count."""
        deviations = np.stack([speed / SPEED_NOISE, pressure / self._pressure_noise], axis=1)
        squares = np.minimum(deviations**2, 900.0)
        index, age = np.arange(len(self._age))[rows], self._age[rows]
        self._firsts[index, age - 1] = squares.reshape(len(index), 4)
        kept = KEPT[age - 1]
        ordered = np.sort(self._firsts[index].reshape(len(index), 12), axis=1)
        quiet = np.sum(np.where(np.arange(12) < kept[:, None], ordered, 0.0), axis=1)
        pressures = ((2.0 + quiet) / (2.0 + SHARE[age - 1] * kept))[:, None]
        own = np.sum(np.where(np.isfinite(self._firsts[index]), self._firsts[index], 0.0)[..., :2], axis=1)
        self.state.pressure_square[rows] = pressures
        self.state.speed_square[rows] = (2.0 * pressures + own) / (2.0 + age[:, None])


@compiled
def _supervise(s, period, leak, drag, read, pressures, torque, valve_flow, steady, v):
    per_torque = period / INERTIA
    for i in range(steady.size):
        for c in range(2):
            new, old, older = read[0, i, c], read[1, i, c], read[2, i, c]
            _noise(s, i, c, new - 2.0 * old + older, steady[i] > s.settled, v)
            v.stuck[i, c] = new == old and pressures[0, i, c] != pressures[1, i, c]
            between = 0.5 * (pressures[0, i, c] + pressures[1, i, c])
            # the torque's gain of speed in this period; with a sound sensor that reads with usual noise it is not used
            push = per_torque * (DISPLACEMENT * between - drag * v.speed[i, c] - torque[i, c])
            was = v.lagging[i, c]
            _lag(s, i, c, period, new - old, old - older, push + per_torque * torque[i, c], v)
            if v.lagging[i, c] and not was:  # what the reading has fallen behind by now
                v.speed[i, c] = old + v.lag[i, c] * (new - old) / period
            by_flow = (valve_flow[i, c] - leak * pressures[0, i, c]) / DISPLACEMENT
            _speed(s, i, c, period, new, new - old, v.speed[i, c] + push, by_flow, v)


@compiled
def _noise(s, i, c, bend, measure, v):
    """Noise from second differences wherever the reference has been steady for a while; a load's step is not noise."""
    if measure and not v.stuck[i, c]:
        taken = min((bend / SPEED_NOISE) ** 2 / 6.0, 4.0 * v.speed_square[i, c])
        v.speed_square[i, c] += s.forgetting * (taken - v.speed_square[i, c])
    v.noise[i, c], v.pressure_noise[i, c] = np.sqrt(v.speed_square[i, c]), np.sqrt(v.pressure_square[i, c])
    if not v.noise[i, c] > s.noisy:
        v.noise[i, c] = 1.0
    if not v.pressure_noise[i, c] > s.noisy_pressure:
        v.pressure_noise[i, c] = 1.0


@compiled
def _lag(s, i, c, period, slope, last_slope, gained, v):
    """What the torque gives more than the reading shows goes, for a lag, as the change of the reading's slope (a lag looks like
    a load to the estimate of loads, which is left out for that)."""
    bend = slope - last_slope
    if abs(bend) > s.bend * SPEED_NOISE * v.noise[i, c] and not v.stuck[i, c]:
        v.along[i, c] += (gained - slope) * bend
        v.size[i, c] += bend * bend
    v.lag[i, c] = min(max(period * v.along[i, c] / v.size[i, c], 0.0), 0.2)
    v.lagging[i, c] = (v.lagging[i, c] or v.lag[i, c] > s.lagging) and v.lag[i, c] > 0.5 * s.lagging


@compiled
def _speed(s, i, c, period, new, slope, ahead, by_flow, v):
    """The speed to go by: `ahead` is what the torque makes of the last one."""
    share, variance = min(1.0, s.rate * period), s.model**2
    if v.stuck[i, c]:
        v.speed[i, c] = ahead + share * (by_flow - ahead)
    elif v.lagging[i, c]:
        v.speed[i, c] = ahead + share * (new + v.lag[i, c] * slope / period - ahead)
    elif v.noise[i, c] > 1.0:
        excess = SPEED_NOISE**2 * (v.noise[i, c] ** 2 - 1.0)
        known = 0.5 * (variance + np.sqrt(variance * variance + 4.0 * variance * excess))
        v.speed[i, c] = ahead + known / (known + excess) * (new - ahead)
    else:
        v.speed[i, c] = new
