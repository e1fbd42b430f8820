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
from hydro_env.plant import PARAMETERS
from hydro_env.units import RPM

__all__ = ["MOST_DELAY", "DelayEstimate", "SensorCheck"]

Floats = NDArray[np.floating[Any]]
Bools = NDArray[np.bool_]
Rows = NDArray[Any] | slice

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
SPEED_NOISE, PRESSURE_NOISE = SENSOR_NOISE["speed_rpm"] * RPM, SENSOR_NOISE["pressure_bar"] * 1e5
USUAL, USUAL_PRESSURE = 1.7, 1.4
"""Multiples of the usual noise up to which nothing is changed; estimates from three samples scatter so far, that of the
pressures less as all four sensors tell of it."""
MODEL_ERROR = 1.4 * RPM
"""Standard deviation of what the integrated torque misses in a period."""
LAGGING = 0.014
"""Lag of a speed sensor from which on its readings are corrected, s; a load's step looks like up to 0.01."""
MOST_DELAY = 2
"""Delays up to so many periods are told apart."""


class SensorCheck:
    """Speeds (num_rigs, 2) to go by, `noise` of speeds and `pressure_noise` in multiples of the usual, (num_rigs, 2)."""

    def __init__(self, num_rigs: int, period: float, leakage: float = 1.0) -> None:
        pair = (num_rigs, 2)
        self.period, self._leak = period, leakage * NOMINAL["Km"]
        self.speed, self.noise, self.pressure_noise = np.zeros(pair), np.ones(pair), np.ones(pair)
        self.stuck, self.lagging, self.lag = np.zeros(pair, bool), np.zeros(pair, bool), np.zeros(pair)
        self._read, self._pressure = np.zeros((3, *pair)), np.zeros((3, *pair))
        self._speed_square, self._pressure_square = np.ones(pair), np.ones(pair)
        self._sums = np.zeros((2, *pair))
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
        self._sums[:, rows] = 0.0
        self._early(rows, seen.speed, seen.pressure)
        self._rate()

    def step(self, seen: Measurements, torque: Floats, valve_flow: Floats, steady: Bools) -> Floats:
        """Takes in the next readings.

        `torque` (num_rigs, 2): the loads as estimated, N m. `valve_flow` (num_rigs, 2): what the valves pass by the
        estimate, m3/s. `steady` (num_rigs,): the reference neither moves nor waits.
        """
        self._read = np.concatenate([seen.speed[None], self._read[:-1]])
        self._pressure = np.concatenate([seen.pressure[None], self._pressure[:-1]])
        self._watch_noise(steady)
        new, old = self._read[0], self._read[1]
        self.stuck = (new == old) & (self._pressure[0] != self._pressure[1])
        between = 0.5 * (self._pressure[0] + self._pressure[1])
        # the torque's gain of speed in this period; with a sound sensor that reads with usual noise it is not used
        push = self.period / NOMINAL["J"] * (NOMINAL["D"] * between - NOMINAL["B"] * self.speed - torque)
        # (a lag looks like a load to the estimate of loads, which is left out for that)
        self._watch_lag(push + self.period / NOMINAL["J"] * torque)
        ahead = self.speed + push
        spread, noise = MODEL_ERROR**2, SPEED_NOISE**2 * np.where(self.noise > 1.0, self.noise**2 - 1.0, 0.0)
        known = 0.5 * (spread + np.sqrt(spread * spread + 4.0 * spread * noise))
        trusted = known / (known + noise)
        sound = ahead + trusted * (new - ahead)
        mended = new + self.lag * (new - old) / self.period
        by_flow = (valve_flow - self._leak * seen.pressure) / NOMINAL["D"]
        share = min(1.0, 3.0 * self.period)
        unsound = ahead + np.where(self.stuck, share * (by_flow - ahead), share * (mended - ahead))
        self.speed = np.where(self.unsound, unsound, np.where(self.noise > 1.0, sound, new))
        return self.speed

    def _early(self, rows: Rows, speed: Floats, pressure: Floats) -> None:
        """Takes in readings at rest, the first three. Squares are believed beforehand: the usual ones of pressures, the
        pressures' of speeds. What makes pressures noisy makes speeds noisy, so that both tell of it; but one speed sensor
        may be worse alone, and a valve open at rest moves what its own sensors read. So of each kind the quieter one
        counts, half as much again as it is the smaller of two."""
        squares = np.stack([speed / SPEED_NOISE, pressure / PRESSURE_NOISE]) ** 2
        self._sums[:, rows] += np.minimum(squares, 900.0)
        count = self._age[rows][:, None]
        quieter = np.sum(np.min(self._sums[:, rows], axis=-1, keepdims=True), axis=0)
        pressures = (2.0 + 1.5 * quieter) / (2.0 + 2.0 * count)
        self._pressure_square[rows] = pressures
        self._speed_square[rows] = (2.0 * pressures + self._sums[0, rows]) / (2.0 + count)

    def _watch_noise(self, steady: Bools) -> None:
        """Three readings at rest, then second differences wherever the reference has been steady for a while."""
        early = self._age < 3
        self._age = np.minimum(self._age + 1, 1000)
        if early.any():
            rows = np.flatnonzero(early)
            self._early(rows, self._read[0, rows], self._pressure[0, rows])
        self._calm = np.where(steady & ~early, self._calm + 1, 0)
        bend = (self._read[0] - 2.0 * self._read[1] + self._read[2]) / SPEED_NOISE
        taken = np.minimum(bend**2 / 6.0, 4.0 * self._speed_square)  # a load's step is not noise
        weight = np.where((self._calm > 15)[:, None] & ~self.stuck, 0.02, 0.0)
        self._speed_square = self._speed_square + weight * (taken - self._speed_square)
        self._rate()

    def _rate(self) -> None:
        noise, pressure = np.sqrt(self._speed_square), np.sqrt(self._pressure_square)
        self.noise = np.where(noise > USUAL, noise, 1.0)
        self.pressure_noise = np.where(pressure > USUAL_PRESSURE, pressure, 1.0)

    def _watch_lag(self, push: Floats) -> None:
        """What the torque gives more than the reading shows goes, for a lag, as the change of the reading's slope."""
        before = self._read[1]
        slope = self._read[0] - before
        bend = slope - (before - self._read[2])
        counts = (np.abs(bend) > 8.0 * SPEED_NOISE * self.noise) & ~self.stuck
        self._along = self._along + np.where(counts, (push - slope) * bend, 0.0)
        self._size = self._size + np.where(counts, bend * bend, 0.0)
        self.lag = np.clip(self.period * self._along / self._size, 0.0, 0.2)
        was = self.lagging
        self.lagging = (was | (self.lag > LAGGING)) & (self.lag > 0.5 * LAGGING)
        # what the reading had fallen behind by the time that this is seen
        begun = self.lagging & ~was
        self.speed = np.where(begun, before + self.lag * slope / self.period, self.speed)


class DelayEstimate:
    """Whole control periods by which the commands come late, `periods` (num_rigs,)."""

    def __init__(self, num_rigs: int) -> None:
        self.periods = np.zeros(num_rigs, int)
        self._where = np.zeros((MOST_DELAY + 2, num_rigs, 2))
        self._misses = np.zeros((MOST_DELAY + 1, num_rigs, 2))
        self._flow = np.zeros((num_rigs, 2))

    def forget(self, rows: Rows, position: Floats, flow: Floats) -> None:
        self.periods[rows], self._misses[:, rows] = 0, 0.0
        self._where[:, rows], self._flow[rows] = position, flow

    def step(self, position: Floats, flow: Floats, gain: Floats, flowing: Floats, noise: Floats) -> Bools:
        """Takes in where a modelled spool is without any delay, and the flow; returns the rigs whose delay is now seen
        to be another one. `flowing`: what counts as flow, `noise`: standard deviation of the flow, both (num_rigs, 2).
        """
        self._where = np.concatenate([position[None], self._where[:-1]])
        both = (np.minimum(np.abs(flow), np.abs(self._flow)) > flowing) & (flow * self._flow > 0.0)
        moved = self._where[:-1] - self._where[1:]
        miss = (flow - self._flow - gain * moved) ** 2 / (2.0 * noise**2 + DOUBT**2)
        self._misses = self._misses + np.where(both, np.minimum(miss, 100.0), 0.0)
        self._flow = np.array(flow)
        together = np.sum(self._misses, axis=-1)
        best = np.argmin(together, axis=0)
        rows = np.arange(len(best))
        now, then = together[self.periods, rows], together[best, rows]
        each = np.min(self._misses[self.periods, rows] - self._misses[best, rows], axis=-1)
        surely = (now - then > CERTAIN) & (then < 0.5 * now) & (each > EACH)
        change: Bools = (best != self.periods) & surely
        self.periods = np.where(change, best, self.periods)
        return change


DOUBT = 0.02
"""Standard deviation of what the spool model gets wrong in a period, share of the rated command."""
CERTAIN, EACH = 12.0, 3.0
"""By how much the squares of the misses have to differ, of both valves together and of each."""
