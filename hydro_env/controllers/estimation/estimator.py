"""What is known of a pair of channels while they are driven: spools, valves, motors, sensors, delay."""

from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Bools, Floats
from hydro_env.controllers.base import HAND
from hydro_env.controllers.estimation.motor_filter import MotorFilter, MotorFilterSettings
from hydro_env.controllers.estimation.nominal import FLOW_NOISE, FLOWING, NOMINAL, RATED_FLOW, Motor
from hydro_env.controllers.estimation.sensor_supervision import SensorSettings, SensorSupervision
from hydro_env.controllers.estimation.spool import Channel, SpoolModel, SpoolSettings, channel_of
from hydro_env.controllers.estimation.valve_estimator import ValveEstimator, ValveSettings
from hydro_env.envs.observation import Measurements
from hydro_env.jit import compiled

#: Torque of the rated flow through the nominal leakage, N m.
LEAKAGE_TORQUE = RATED_FLOW / NOMINAL["Km"] * NOMINAL["D"]
#: Longest delay of the commands that is recognised, periods.
MAX_DELAY = 2


class DelaySettings(NamedTuple):
    """When a delay is accepted. A planner needs more certainty than a filter does."""

    certain: Annotated[float, "1", "by how much the squares of both valves' misses have to differ", HAND] = 20.0  # fmt: skip
    each: Annotated[float, "1", "and those of each valve", HAND] = 3.0
    most: Annotated[float, "1", "most that one sample counts: a spool that sticks once is no delay", HAND] = 9.0  # fmt: skip
    model: Annotated[float, "1", "error of the modelled spool in a period, standard deviation", HAND] = 0.02
    loose: Annotated[float, "1", "and what share of its way it may have wrong", HAND] = 0.15


class DelayEstimator:
    """Whole control periods by which the commands come late, `periods` (num_rigs,). How the flow changed is compared with how
    the modelled spool moved now, one and two periods ago. A spool that sticks looks late too, but not both spools at once."""

    def __init__(self, settings: DelaySettings, position: Floats, flow: Floats) -> None:
        """Spools and flows (num_rigs, 2) as they are now."""
        self._settings = settings
        self.periods = np.zeros(len(position), int)
        self._position, self._flow = np.stack([position] * (MAX_DELAY + 2)), flow
        self._misses = np.zeros((MAX_DELAY + 1, *position.shape))

    def update(self, position: Floats, flow: Floats, gain: Floats, flowing: Floats, noise: Floats) -> Bools:
        """Takes in where a modelled spool is without any delay, and the flow; returns the rigs whose delay is now seen
        to be another one. `flowing`: what counts as flow, `noise`: standard deviation of the flow, both (num_rigs, 2).
        """
        self._position = np.concatenate([position[None], self._position[:-1]])
        change = np.empty(len(self.periods), bool)
        _compare(
            self._settings, self._position, self._flow, flow, gain, flowing, noise, self._misses, self.periods, change,
        )  # fmt: skip
        self._flow = flow
        return change


@compiled
def _compare(s, position, before, flow, gain, flowing, noise, misses, periods, change):
    together = np.empty(misses.shape[0])
    for i in range(periods.size):
        together[:] = 0.0
        for c in range(2):
            least = min(abs(flow[i, c]), abs(before[i, c]))
            both = least > flowing[i, c] and flow[i, c] * before[i, c] > 0.0
            for late in range(together.size):
                if both:
                    moved = position[late, i, c] - position[late + 1, i, c]
                    miss = flow[i, c] - before[i, c] - gain[i, c] * moved
                    model = s.model**2 + (s.loose * moved) ** 2
                    misses[late, i, c] += min(miss**2 / (2.0 * noise[i, c] ** 2 + model), s.most)
                together[late] += misses[late, i, c]
        now, best = periods[i], np.argmin(together)
        if now < best - 1 and together[best - 1] - together[best] < s.certain:
            best -= 1  # one period is accepted before two
        each = min(misses[now, i, 0] - misses[best, i, 0], misses[now, i, 1] - misses[best, i, 1])
        gap = together[now] - together[best]
        change[i] = best != now and gap > s.certain and together[best] < 0.5 * together[now] and each > s.each
        if change[i]:
            periods[i] = best


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
        self, seen: Measurements, sent: Floats, steady: Bools, flowing: Floats, sweep: float
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
        unsampled, sensors = LEAKAGE_TORQUE * self.spool.unsampled, self.sensors
        self.motors.update(seen.speed, seen.pressure, unsampled, sensors.state.noise, sensors.unsound)
        return seen

    def _measured_flow(self, seen: Measurements) -> Floats:
        return self.motor.flow(seen.speed, seen.pressure, (seen.pressure - self._pressure) / self.period)

    def _supervise(self, seen: Measurements, steady: Bools) -> Measurements:
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
        noise = FLOWING * self.flow_noise, FLOW_NOISE * self.flow_noise
        changed = self.delay.update(self.prompt.shown, self._measured_flow(seen), valves.gain, *noise)
        if changed.any():
            rows = np.flatnonzero(changed)
            late = self.delay.periods[rows]
            place = self._places[late, :, rows]
            self.spool.position[rows], self.spool.speed[rows] = place[:, 0], place[:, 1]
            # edges found by a sweep lie nearer by what the sweep went on before the spool followed
            self.valves.shift_edges(rows, sweep * self.period * late[:, None, None])
