"""What the sensors of a pair of motors are worth, and by how many periods commands come late; found while driving.

`SensorCheck`    noise of each speed and pressure sensor; a speed sensor that stands still or lags behind. It gives the speeds
                 that the law goes by: the readings as they are while noise is usual and nothing is wrong; otherwise the
                 pressure's torque integrated over the motor's inertia (eq. 2), corrected by the reading as far as that can
                 be trusted, or by the valve's flow where it cannot be trusted at all (eq. 1).
`DelayEstimate`  compares how the flow changed with how the modelled spool moved now, one and two periods ago. A spool
                 that sticks looks late too, but not both spools at once.

One row per rig, one column per channel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.envs.observation import NOISE as SENSOR_NOISE
from hydro_env.envs.observation import Measurements
from hydro_env.jit import compiled
from hydro_env.plant import PARAMETERS
from hydro_env.units import BAR, RPM

__all__ = ["MOST_DELAY", "DelayEstimate", "SensorCheck"]

Floats = NDArray[np.floating[Any]]
Bools = NDArray[np.bool_]
Rows = NDArray[Any] | slice

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
SPEED_NOISE, PRESSURE_NOISE = SENSOR_NOISE["speed_rpm"] * RPM, SENSOR_NOISE["pressure_bar"] * BAR
USUAL, USUAL_PRESSURE = 1.7, 1.4
"""Multiples of the usual noise up to which nothing is changed; estimates from three samples scatter so far, that of the
pressures less as all four sensors tell of it."""
MODEL_ERROR = 1.4 * RPM
"""Standard deviation of what the integrated torque misses in a period."""
LAGGING = 0.014
"""Lag of a speed sensor from which on its readings are corrected, s; a load's step looks like up to 0.01."""
KEPT, SHARE = np.array([3, 6, 8]), np.array([0.51, 0.446, 0.326])
"""Of the first 4, 8 and 12 readings at rest so many count, the quietest, and what the mean of their squares is for noise of
variance 1."""
MOST_DELAY = 2
"""Delays up to so many periods are told apart."""
DOUBT = 0.02
"""Standard deviation of what the spool model gets wrong in a period, share of the rated command."""
LOOSE = 0.15
"""And what share of the way, to the cautious."""
EACH = 3.0
BOLD, CAUTIOUS = (12.0, 100.0), (20.0, 9.0)
"""By how much the squares of the misses have to differ, of both valves together (and `EACH`), and the most that one sample
counts: to the cautious, a spool that sticks once is no delay."""
INERTIA, DISPLACEMENT, FRICTION = NOMINAL["J"], NOMINAL["D"], NOMINAL["B"]


class SensorCheck:
    """Speeds (num_rigs, 2) to go by, `noise` of speeds and `pressure_noise` in multiples of the usual, (num_rigs, 2)."""

    def __init__(self, num_rigs: int, period: float, leakage: float = 1.0) -> None:
        pair = (num_rigs, 2)
        self.period, self._leak = period, leakage * NOMINAL["Km"]
        self.speed, self.noise, self.pressure_noise = np.zeros(pair), np.ones(pair), np.ones(pair)
        self.stuck, self.lagging, self.lag = np.zeros(pair, bool), np.zeros(pair, bool), np.zeros(pair)
        self._read, self._pressure = np.zeros((3, *pair)), np.zeros((3, *pair))
        self._speed_square, self._pressure_square = np.ones(pair), np.ones(pair)
        # squares of the first three readings at rest: of both speeds, then both pressures
        self._firsts = np.full((num_rigs, 3, 4), np.inf)
        self._along, self._size = np.zeros(pair), np.zeros(pair)
        self._age, self._calm = np.zeros(num_rigs, int), np.zeros(num_rigs, int)

    @property
    def unsound(self) -> Bools:
        """Sensors whose readings cannot be taken for the speed, (num_rigs, 2)."""
        return self.stuck | self.lagging

    def forget(self, rows: Rows, seen: Measurements) -> None:
        """Begins anew with the first readings, taken at rest."""
        self.speed[rows] = seen.speed
        self._read[:, rows], self._pressure[:, rows] = seen.speed, seen.pressure
        self.stuck[rows], self.lagging[rows], self.lag[rows] = False, False, 0.0
        self._along[rows], self._size[rows] = 0.0, (15.0 * RPM) ** 2
        self._age[rows], self._calm[rows] = 1, 0
        self._firsts[rows] = np.inf
        self._early(rows, seen.speed, seen.pressure)
        self._rate()

    def step(self, seen: Measurements, torque: Floats, valve_flow: Floats, steady: Bools) -> Floats:
        """Takes in the next readings.

        `torque` (num_rigs, 2): the loads as estimated, N m. `valve_flow` (num_rigs, 2): what the valves pass by the
        estimate, m3/s. `steady` (num_rigs,): the reference neither moves nor waits.
        """
        self._read = np.concatenate([seen.speed[None], self._read[:-1]])
        self._pressure = np.concatenate([seen.pressure[None], self._pressure[:-1]])
        early = self._age < 3
        if early.any():
            rows = np.flatnonzero(early)
            self._age[rows] += 1
            self._early(rows, self._read[0, rows], self._pressure[0, rows])
        _check(
            self._read, self._pressure, torque, valve_flow, steady & ~early, self.period, self._leak, self._calm,
            self._speed_square, self._pressure_square, self.noise, self.pressure_noise, self.stuck, self.lagging, self.lag,
            self._along, self._size, self.speed,
        )  # fmt: skip
        return self.speed.copy()

    def _early(self, rows: Rows, speed: Floats, pressure: Floats) -> None:
        """Takes in readings at rest, the first three. Squares are believed beforehand: the usual ones of pressures, the
        pressures' of speeds. What makes pressures noisy makes speeds noisy, so that both tell of it; but one speed sensor
        may be worse alone, and valves open at rest or very soon move what their own sensors read. So of all readings only the
        quieter ones count."""
        squares = np.minimum(np.stack([speed / SPEED_NOISE, pressure / PRESSURE_NOISE], axis=1) ** 2, 900.0)
        index, age = np.arange(len(self._age))[rows], self._age[rows]
        self._firsts[index, age - 1] = squares.reshape(len(index), 4)
        kept = KEPT[age - 1]
        ordered = np.sort(self._firsts[index].reshape(len(index), 12), axis=1)
        quiet = np.sum(np.where(np.arange(12) < kept[:, None], ordered, 0.0), axis=1)
        pressures = ((2.0 + quiet) / (2.0 + SHARE[age - 1] * kept))[:, None]
        own = np.sum(np.where(np.isfinite(self._firsts[index]), self._firsts[index], 0.0)[..., :2], axis=1)
        count = age[:, None]
        self._pressure_square[rows] = pressures
        self._speed_square[rows] = (2.0 * pressures + own) / (2.0 + count)

    def _rate(self) -> None:
        noise, pressure = np.sqrt(self._speed_square), np.sqrt(self._pressure_square)
        self.noise = np.where(noise > USUAL, noise, 1.0)
        self.pressure_noise = np.where(pressure > USUAL_PRESSURE, pressure, 1.0)


@compiled
def _check(
    read, pressures, torque, valve_flow, steady, period, leak, calm,
    speed_square, pressure_square, noise, pressure_noise, stuck, lagging, lag, along, size, speed,
):  # fmt: skip
    per_torque, spread = period / INERTIA, MODEL_ERROR**2
    share = min(1.0, 3.0 * period)
    for i in range(speed.shape[0]):
        calm[i] = calm[i] + 1 if steady[i] else 0
        for c in range(2):
            new, old, older = read[0, i, c], read[1, i, c], read[2, i, c]
            # noise: second differences wherever the reference has been steady for a while; a load's step is not noise
            if calm[i] > 15 and not stuck[i, c]:
                bend = (new - 2.0 * old + older) / SPEED_NOISE
                taken = min(bend**2 / 6.0, 4.0 * speed_square[i, c])
                speed_square[i, c] += 0.02 * (taken - speed_square[i, c])
            noise[i, c], pressure_noise[i, c] = np.sqrt(speed_square[i, c]), np.sqrt(pressure_square[i, c])
            if not noise[i, c] > USUAL:
                noise[i, c] = 1.0
            if not pressure_noise[i, c] > USUAL_PRESSURE:
                pressure_noise[i, c] = 1.0

            stuck[i, c] = new == old and pressures[0, i, c] != pressures[1, i, c]
            between = 0.5 * (pressures[0, i, c] + pressures[1, i, c])
            # the torque's gain of speed in this period; with a sound sensor that reads with usual noise it is not used
            push = per_torque * (DISPLACEMENT * between - FRICTION * speed[i, c] - torque[i, c])

            # What the torque gives more than the reading shows goes, for a lag, as the change of the reading's slope (a
            # lag looks like a load to the estimate of loads, which is left out for that).
            slope = new - old
            bend = slope - (old - older)
            if abs(bend) > 8.0 * SPEED_NOISE * noise[i, c] and not stuck[i, c]:
                along[i, c] += (push + per_torque * torque[i, c] - slope) * bend
                size[i, c] += bend * bend
            lag[i, c] = min(max(period * along[i, c] / size[i, c], 0.0), 0.2)
            was = lagging[i, c]
            lagging[i, c] = (was or lag[i, c] > LAGGING) and lag[i, c] > 0.5 * LAGGING
            if lagging[i, c] and not was:  # what the reading had fallen behind by the time that this is seen
                speed[i, c] = old + lag[i, c] * slope / period

            ahead = speed[i, c] + push
            if stuck[i, c]:
                by_flow = (valve_flow[i, c] - leak * pressures[0, i, c]) / DISPLACEMENT
                speed[i, c] = ahead + share * (by_flow - ahead)
            elif lagging[i, c]:
                mended = new + lag[i, c] * (new - old) / period
                speed[i, c] = ahead + share * (mended - ahead)
            elif noise[i, c] > 1.0:
                excess = SPEED_NOISE**2 * (noise[i, c] ** 2 - 1.0)
                known = 0.5 * (spread + np.sqrt(spread * spread + 4.0 * spread * excess))
                speed[i, c] = ahead + known / (known + excess) * (new - ahead)
            else:
                speed[i, c] = new


class DelayEstimate:
    """Whole control periods by which the commands come late, `periods` (num_rigs,).

    The `cautious` believe a delay when it was seen more than once, and one period before two: for who plans on it.
    """

    def __init__(self, num_rigs: int, cautious: bool = False) -> None:
        self._cautious = cautious
        self.periods = np.zeros(num_rigs, int)
        self._where = np.zeros((MOST_DELAY + 2, num_rigs, 2))
        self._misses = np.zeros((MOST_DELAY + 1, num_rigs, 2))
        self._flow: Floats = np.zeros((num_rigs, 2))

    def forget(self, rows: Rows, position: Floats, flow: Floats) -> None:
        self.periods[rows], self._misses[:, rows] = 0, 0.0
        self._where[:, rows], self._flow[rows] = position, flow

    def step(self, position: Floats, flow: Floats, gain: Floats, flowing: Floats, noise: Floats) -> Bools:
        """Takes in where a modelled spool is without any delay, and the flow; returns the rigs whose delay is now seen
        to be another one. `flowing`: what counts as flow, `noise`: standard deviation of the flow, both (num_rigs, 2).
        """
        self._where = np.concatenate([position[None], self._where[:-1]])
        change = np.empty(len(self.periods), bool)
        _compare(
            self._where,
            self._flow,
            flow,
            gain,
            flowing,
            noise,
            self._misses,
            self.periods,
            change,
            self._cautious,
        )
        self._flow = flow
        return change


@compiled
def _compare(where, before, flow, gain, flowing, noise, misses, periods, change, cautious):
    certain, most = CAUTIOUS if cautious else BOLD
    together = np.empty(misses.shape[0])
    for i in range(periods.size):
        together[:] = 0.0
        for c in range(2):
            least = min(abs(flow[i, c]), abs(before[i, c]))
            both = least > flowing[i, c] and flow[i, c] * before[i, c] > 0.0
            for late in range(together.size):
                if both:
                    moved = where[late, i, c] - where[late + 1, i, c]
                    miss = flow[i, c] - before[i, c] - gain[i, c] * moved
                    loose = DOUBT**2 + (LOOSE * moved) ** 2 if cautious else DOUBT**2
                    misses[late, i, c] += min(miss**2 / (2.0 * noise[i, c] ** 2 + loose), most)
                together[late] += misses[late, i, c]
        now, best = periods[i], np.argmin(together)
        if cautious and now < best - 1 and together[best - 1] - together[best] < certain:
            best -= 1
        each = min(misses[now, i, 0] - misses[best, i, 0], misses[now, i, 1] - misses[best, i, 1])
        gap = together[now] - together[best]
        change[i] = best != now and gap > certain and together[best] < 0.5 * together[now] and each > EACH
        if change[i]:
            periods[i] = best
