"""The flow controller: recursive estimation, one reference for both motors, dead-zone compensation, receding horizon.

It knows nothing of the drawn valves. Its parts, in the order of a control period:

* `Estimator`: where the spools stand, edges and gain of each valve, speeds and loads of the motors, sensors and delay.
* `Probing`: looks for the edges while the set-point is zero.
* `Reference`: one speed for both motors.
* `Crossing`: looks for an edge that is unknown when the flow has to change its direction.
* `Feedback`: the flow each motor is to get.
* `compensate` and `InputShaper`: the estimated curves turn flow into commands; three successive commands are averaged
  so that the spool's lightly damped mode stays at rest. A sudden load on one motor alone is answered without that delay.
* `Planner`, if there is one: plans the next commands of both valves together instead. Two spools with different ways to their
  edges begin to flow at different times when commands are averaged, which parts the motors at every start and every crossing.

Where a speed sensor is poor, while a rig probes or crosses, and at control periods other than 10 ms, averaged commands are sent.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.controllers.estimation.estimator import Estimator, EstimatorSettings
from hydro_env.controllers.estimation.nominal import FLOWING, TUNED_PERIOD, Motor
from hydro_env.controllers.input_shaping import InputShaper
from hydro_env.controllers.mpc.edge_search import Crossing, CrossingSettings, Probing, ProbingSettings
from hydro_env.controllers.mpc.feedback import Feedback, FeedbackSettings
from hydro_env.controllers.mpc.planner import HORIZON, Planner, PlannerSettings, Scene, predict_delayed
from hydro_env.controllers.mpc.reference import Reference, ReferenceSettings, capacity
from hydro_env.envs.observation import Measurements
from hydro_env.jit import compiled

#: Flow below which the jump over the dead zone is a ramp: just above what counts as flow.
BLEND = 0.01


class FlowSettings(NamedTuple):
    """Settings of the parts; without a planner, commands are averaged throughout."""

    motor: Motor = Motor()
    estimator: EstimatorSettings = EstimatorSettings()
    reference: ReferenceSettings = ReferenceSettings()
    probing: ProbingSettings = ProbingSettings()
    crossing: CrossingSettings = CrossingSettings()
    feedback: FeedbackSettings = FeedbackSettings()
    planner: PlannerSettings | None = PlannerSettings()
    shaped: Annotated[bool, "", "whether commands are averaged: a well-damped spool does not ring"] = True


class FlowController:
    """`start`, then `command` and `update` in turn, once a control period. The parts are attributes of the same names."""

    def __init__(self, settings: FlowSettings | None = None) -> None:
        self.settings = settings or FlowSettings()

    def start(self, seen: Measurements, period: float) -> None:
        """Begins with the first measurements of all rigs; forgets everything before. `period` in s."""
        s, n = self.settings, len(seen.speed)
        self.period = period
        self.estimator = Estimator(s.estimator, s.motor, seen, period, HORIZON)
        channel = self.estimator.channel
        self.probing = Probing(s.probing, n, period)
        self.crossing = Crossing(s.crossing, n, period)
        self.feedback = Feedback(s.feedback, s.motor, channel, seen.speed)
        remembered = self.feedback.remembered
        self.reference = Reference(s.reference, channel, seen.setpoint, seen.speed, remembered)
        self.shaper = InputShaper(s.estimator.spool.rate, period, seen.command)
        planned = s.planner if abs(period - TUNED_PERIOD) < 1e-6 else None
        self.planner = Planner(planned, seen.command, channel) if planned else None
        # periods by which speeds follow the reference
        self._response = s.planner.behind if s.planner else s.feedback.delay / period
        self.setpoint, self.sent, self.wanted = seen.setpoint, np.array(seen.command, float), np.zeros((n, 2))

    def update(self, seen: Measurements) -> None:
        """Takes in the next measurements of all rigs and decides what flow they are to get."""
        e, reference, crossing = self.estimator, self.reference.state, self.crossing.state
        steady = ~(crossing.active | self.probing.active) & (np.abs(reference.acceleration) < 1.0)
        seen = e.update(seen, self.sent, steady, self.probing.flowing, self.probing.settings.sweep)
        valves, motors = e.valves.state, e.motors.state
        self.setpoint = self.reference.foresee(seen.setpoint, self._response)
        self.probing.update(seen.setpoint, self.reference.smooth, e.flow, e.flow_noise, valves.unknown)
        probing = self.probing.active
        self.reference.update(self.setpoint, seen.speed, motors.torque, valves, crossing.active, probing)
        self.crossing.update(reference.flow, valves, probing)
        noise = e.sensors.state.noise
        self.feedback.update(seen.speed, motors, noise, e.delay.periods, self.wanted, reference, probing)

    def command(self) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1]."""
        e, probing = self.estimator, self.probing.active
        valves = e.valves.state
        asked_for, pressure = self.feedback.state.flow, e.motors.state.pressure
        flow = asked_for / self.settings.motor.strength(asked_for, pressure)
        asked = np.empty_like(flow)
        compensate(flow, valves, asked)
        self.crossing.steer(asked, e.flow, FLOWING * e.flow_noise, valves)
        self.probing.steer(asked, e.valves.middle)
        idle = (self.crossing.state.active | probing)[:, None]
        self.wanted = np.where(idle, 0.0, flow)
        last = self.sent
        # A share of each command is not filtered where a load is sudden.
        sudden, newest = self.feedback.state.sudden[:, None], np.clip(asked, -1.0, 1.0)
        smooth = self.shaper.step(newest) if self.settings.shaped else newest
        self.shaper.past = [each + sudden * (newest - each) for each in self.shaper.past]
        sent = np.clip(smooth + sudden * (newest - smooth), -1.0, 1.0)
        self.shaper.replace(self.probing.lead(sent, e.spool, e.valves, e.channel), sent)
        if self.planner:
            sent = self._plan(sent, last)
        self.sent = sent
        return sent.copy()

    def _plan(self, averaged: Floats, last: Floats) -> Floats:
        """Planned commands where they can be planned, the `averaged` ones elsewhere."""
        assert self.planner is not None
        e, shaper = self.estimator, self.shaper
        sensors, valves = e.sensors, e.valves.state
        poor = np.any(sensors.unsound | (sensors.state.noise > self.planner.settings.noisiest), axis=1)
        planned = ~(self.crossing.state.active | self.probing.active | poor)
        # the plain way to the aim: what the shaper would send if the flow stayed as it is asked for
        plain, final = np.empty_like(self.planner.plan), shaper.past[-1]
        plain[..., 0] = averaged
        plain[..., 1] = averaged + (1.0 - 2.0 * shaper.outer) * (final - last)
        plain[..., 2:] = final[..., None]
        np.clip(plain, -1.0, 1.0, out=plain)
        load, edge = e.motors.state.torque.copy(), valves.edge.copy()
        place, motor = np.stack([e.spool.position, e.spool.speed, e.spool.coil]), e.motors.state.speed.copy()
        if e.delay.periods.any():
            predict_delayed(e.delay.periods, e.sent, place, motor, load, edge, valves.gain, e.channel)
        reference = self.reference.state
        aim = self.planner.aim(reference, motor, self.period)
        heavier = self.planner.move_weights(valves.innovation / e.flow_noise, reference.acceleration)
        scene = Scene(place, motor, load, edge, valves.gain, last, aim, heavier)
        sent = self.planner.step(planned, plain, scene)
        # what the average goes on from
        shaper.replace(planned[:, None], sent)
        return sent


@compiled
def compensate(flow, valves, command):
    """Fills in commands (N, 2) for flows (N, 2), which are lowered in place where a valve is at its limit: both give way, so that
    the motors stay together. valves: `ValveState`."""
    for i in range(flow.shape[0]):
        excess = 0.0
        for c in range(2):
            d = 1 if flow[i, c] < 0.0 else 0
            excess = max(excess, abs(flow[i, c]) - capacity(valves.gain[i, c], valves.edge[i, c, d]))
        for c in range(2):
            flow[i, c] -= np.sign(flow[i, c]) * excess
            positive, negative = valves.edge[i, c, 0], valves.edge[i, c, 1]
            middle, opening = 0.5 * (positive - negative), abs(flow[i, c]) / valves.gain[i, c]
            beyond = -(negative + opening) if flow[i, c] < 0.0 else positive + opening
            command[i, c] = middle + min(abs(flow[i, c]) / BLEND, 1.0) * (beyond - middle)
