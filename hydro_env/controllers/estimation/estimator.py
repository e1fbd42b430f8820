"""What is known of a pair of channels while they are driven: spools, valves, motors, sensors, delay."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.delay_estimator import MAX_DELAY, DelayEstimator, DelaySettings
from hydro_env.controllers.estimation.motor_filter import MotorFilter, MotorFilterSettings
from hydro_env.controllers.estimation.nominal import FLOW_NOISE, FLOWING, NOMINAL, RATED_FLOW, Motor
from hydro_env.controllers.estimation.sensor_supervision import SensorSettings, SensorSupervision
from hydro_env.controllers.estimation.spool import Channel, SpoolModel, SpoolSettings, channel_of
from hydro_env.controllers.estimation.valve_estimator import ValveEstimator, ValveSettings
from hydro_env.envs.observation import Measurements

LEAKAGE_TORQUE = RATED_FLOW / NOMINAL["Km"] * NOMINAL["D"]
"""Torque of the rated flow through the nominal leakage, N m."""


class EstimatorSettings(NamedTuple):
    """Settings of the parts."""

    spool: SpoolSettings = SpoolSettings()
    valves: ValveSettings = ValveSettings()
    motors: MotorFilterSettings = MotorFilterSettings()
    sensors: SensorSettings = SensorSettings()
    delay: DelaySettings = DelaySettings()


class Estimator:
    """The parts in the order in which a sample passes them.

    `spool` moves with the commands as they take effect, `prompt` with every command at once. `sent` are the last commands,
    newest first; `flow` is the measured flow, `flow_noise` its noise as a multiple of the usual.
    """

    def __init__(
        self, settings: EstimatorSettings, motor: Motor, seen: Measurements, period: float, horizon: int
    ) -> None:
        """`seen`: the first measurements, at rest."""
        self.settings, self.motor, self.period = settings, motor, period
        self.channel: Channel = channel_of(settings.spool, motor, period, horizon)
        lag = settings.spool.pressure_lag
        self.spool, self.prompt = (SpoolModel(seen.command, self.channel, lag) for _ in range(2))
        self.sent, self._pressure = np.stack([seen.command] * (MAX_DELAY + 1)), seen.pressure
        self._places = np.stack([self.sent, np.zeros_like(self.sent)], axis=1)
        self.flow: Floats = motor.flow(seen.speed, seen.pressure)
        self.flow_noise: Floats = np.ones(self.flow.shape)
        self.valves = ValveEstimator(settings.valves, len(self.flow), period)
        self.motors = MotorFilter(settings.motors, period, motor, seen.speed, seen.pressure)
        self.sensors = SensorSupervision(settings.sensors, period, motor, seen)
        self.delay = DelayEstimator(settings.delay, seen.command, self.flow)

    def update(
        self, seen: Measurements, sent: Floats, steady: NDArray[np.bool_], flowing: Floats, sweep: float
    ) -> Measurements:
        """Takes in a sample; returns it with the speeds to go by.

        Args:
            seen: the measurements.
            sent: the commands of the period before, (num_rigs, 2).
            steady: whether the reference neither moves nor waits, (num_rigs,).
            flowing: what counts as flow where its noise is usual, (num_rigs, 2).
            sweep: how fast spools sweep while edges are looked for, 1/s.
        """
        self.sent = np.concatenate([sent[None], self.sent[:-1]])
        valves = self.valves.state
        self.spool.move(self.sent[self.delay.periods, np.arange(len(sent))], valves.edge, valves.gain)
        if self.settings.sensors.active:
            seen = self._supervise(seen, steady)
            self._watch_delay(seen, sweep)
        self.flow, self._pressure = self._measured_flow(seen), seen.pressure
        strength = self.motor.strength(self.flow, seen.pressure)
        self.valves.update(self.spool, self.flow / strength, self.flow_noise, flowing * self.flow_noise)
        unsampled = LEAKAGE_TORQUE * self.spool.unsampled
        self.motors.update(
            seen.speed, seen.pressure, unsampled, self.sensors.state.noise, self.sensors.unsound
        )
        return seen

    def _measured_flow(self, seen: Measurements) -> Floats:
        return self.motor.flow(seen.speed, seen.pressure, (seen.pressure - self._pressure) / self.period)

    def _supervise(self, seen: Measurements, steady: NDArray[np.bool_]) -> Measurements:
        """The measurements with speeds to go by."""
        passed = RATED_FLOW * self.valves.expected_flow(self.spool.position)
        speed = self.sensors.update(seen, self.motors.state.torque, passed, steady)
        self.motors.state.torque[self.sensors.state.lagging] = 0.0
        self.flow_noise = self.sensors.flow_noise
        return replace(seen, speed=speed)

    def _watch_delay(self, seen: Measurements, sweep: float) -> None:
        """A delay of the commands, once it is seen, is taken into account."""
        valves = self.valves.state
        self.prompt.move(self.sent[0], valves.edge, valves.gain)
        now = np.stack([self.prompt.position, self.prompt.speed])
        self._places = np.concatenate([now[None], self._places[:-1]])
        noise = self.flow_noise
        changed = self.delay.update(
            self.prompt.shown, self._measured_flow(seen), valves.gain, FLOWING * noise, FLOW_NOISE * noise
        )
        if changed.any():
            rows = np.flatnonzero(changed)
            late = self.delay.periods[rows]
            place = self._places[late, :, rows]
            self.spool.position[rows], self.spool.speed[rows] = place[:, 0], place[:, 1]
            # edges found by a sweep lie nearer by what the sweep went on before the spool followed
            self.valves.shift_edges(rows, sweep * self.period * late[:, None, None])
