"""A control law for a pair of unknown valves, and a network's place in it: inputs, and what its outputs do.

The law alone (outputs zero) drives the rig; a trained network refines it. Its parts, in the order of a control period:

* Estimation (`valve_estimate`): where the spools stand, edge and gain of each valve, load on each shaft.
* Probing. While the set-point is zero and edges are unknown, both spools sweep slowly through their dead zones, first to
  the positive side, then to the negative one, and turn back at the first sign of flow. Then both motors get the same
  short pulse of flow to and fro, which shows the gains. The shafts move by a few rpm for it; all ends at once when the
  set-point moves.
* A reference speed, common to both motors, runs to the set-point. It asks for no more flow than the weaker valve can
  give, and for a slower rise of flow while the gains are in doubt.
* Crossing. When the flow has to change direction and an edge there is unknown, both spools creep up to their edges; the
  first to flow waits for the other while the reference coasts as a motor without flow does.
* Flow that the reference takes by the motor's equations, corrected by the error to the reference as it was when the
  present speed was asked for, and by the speed difference one period ahead; if one valve is at its limit, both give way.
* The estimated valve curves turn flow into commands. Three successive commands are averaged so that the spool's lightly
  damped mode stays at rest; a sudden load on one motor alone is answered without that delay.

One network drives each valve in turn and sees its own channel first, so that both channels share all weights. Its
outputs add flow, shift the command, and (their mean over both valves) quicken or slow the reference.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from math import cos, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.sensor_check import MOST_DELAY, DelayEstimate, SensorCheck
from hydro_env.controllers.valve_estimate import FLOWING, NOISE, LoadEstimate, SpoolModel, ValveEstimate
from hydro_env.envs.observation import Measurements, decode
from hydro_env.plant import PARAMETERS
from hydro_env.units import RPM

__all__ = ["FlowView"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
RATED_TRAVEL = NOMINAL["alpha"] * NOMINAL["u_rated"] / (NOMINAL["R"] * NOMINAL["k"])
RATED_FLOW = NOMINAL["Kq"] * RATED_TRAVEL
SPOOL_RATE = sqrt(NOMINAL["k"] / NOMINAL["m"])
FRICTION = NOMINAL["Fs"] / (NOMINAL["k"] * RATED_TRAVEL)
"""Friction of the nominal spool as a share of the rated command."""


@dataclass(frozen=True)
class Motor:
    """Flow, as a share of the rated one, that torque, speed and acceleration of a motor take (eq. 1 and 2).

    leakage: relative to the paper's motor. compliance: flow into the lines per rate of the pressure, m3/Pa. mode: rate at
    which the motor follows a flow where that is not the leakage's, 1/s; 0 for the leakage's.
    """

    leakage: float = 1.0
    compliance: float = 0.0
    mode: float = 0.0

    @property
    def per_torque(self) -> float:
        return self.leakage * NOMINAL["Km"] / NOMINAL["D"] / RATED_FLOW

    @property
    def per_speed(self) -> float:
        return NOMINAL["D"] / RATED_FLOW + NOMINAL["B"] * self.per_torque

    @property
    def per_acceleration(self) -> float:
        return NOMINAL["J"] * self.per_torque

    @property
    def rate(self) -> float:
        """Rate at which a motor without flow coasts down, 1/s."""
        return self.per_speed / self.per_acceleration

    def flow(self, seen: Measurements, rise: Floats | float = 0.0) -> Floats:
        """Flow of each valve from its motor's speed and leakage (eq. 1) and the lines' swelling, (num_rigs, 2); `rise` is
        the pressure's, Pa/s."""
        leak = self.leakage * NOMINAL["Km"] * seen.pressure
        return (NOMINAL["D"] * seen.speed + leak + self.compliance * rise) / RATED_FLOW

    def ahead(self, speed: Floats, flow: Floats, torque: Floats, span: Floats) -> Floats:
        """Speed after a span (num_rigs,) in s with that flow."""
        if self.mode:
            final = (flow - self.per_torque * torque) / self.per_speed
            return speed + (1.0 - np.exp(-self.mode * span))[:, None] * (final - speed)
        rate = (flow - self.per_speed * speed - self.per_torque * torque) / self.per_acceleration
        return speed + (span * (1.0 - 0.5 * self.rate * TUNED_PERIOD))[:, None] * rate


SPEED, PRESSURE = 600.0 * RPM, 10e5  # scales of the inputs
TUNED_PERIOD = 0.01
"""The control period that rates and gains were tuned at, s."""
AT_REST = 5.0 * RPM
SWEEP_FROM = -0.02
PAUSE = 0.15  # s between two answers to sudden loads
LEAK_NOISE = NOMINAL["Km"] * 0.05e5 / RATED_FLOW
TURN_NOISE = NOMINAL["D"] * 1.0 * RPM / RATED_FLOW
"""Usual noise of the measured flow that comes from the pressure and from the speed."""
SIGNS = np.array([1.0, -1.0])
OWN, BOTH, FRAME = 24, 12, 3
"""Numbers of inputs: of each channel, of the rig, and of each remembered sample."""


class FlowView:
    """See the module's text. Rates and gains were tuned on pairs of `train`.

    Args:
        rate: rate at which the reference runs to the set-point, 1/s.
        slew: how fast the flow may rise, rated flows per second; `fall` times as fast it may fall.
        doubt: by how much an unknown gain slows that rise: divided by 1 + doubt.
        most: share of the weaker valve's capacity that the reference may use.
        track, couple: acceleration per error to the reference, and per half of the speed difference, 1/s.
        delay: from a flow asked for to the speed it gives, s.
        lead: how far ahead the speed difference is predicted, in periods of 10 ms.
        friction: of the modelled spool, relative to the nominal one.
        drift, gain_drift, still, moving, first: of the `ValveEstimate`.
        share, jump: of the `LoadEstimate`.
        bolt: share of a sudden difference of loads that is answered without averaging commands.
        probe: 1 for probing at rest, 0 for none.
        sweep, search: pace of the spools when probing and when crossing, command per second.
        detect: flow that ends a sweep.
        pulse: flow of the pulses after the sweep; they last `pulse_time` s each.
        known: standard deviation of an edge below which it needs no search.
        blend: flow below which the jump over the dead zone is a ramp.
        reach, shift, pace: what outputs of 1 do: flow added, command shifted, logarithm of the reference's quickness.
        calm: what is left of the outputs at the set-point; they have their full effect from 100 rpm of error on and while
            the view probes.
        watch: 1 for watching sensors and delay, 0 for taking both as they should be.
        late: by how much a delay of one period lowers the feedback: divided by 1 + late.
        leakage, compliance, mode: of the `Motor`; compliance here in 1e-12 m3/Pa.
        damping: damping ratio of the modelled spool.
        frames: how many past samples are among the inputs.
    """

    rows_per_rig = 2
    num_actions = 3

    def __init__(
        self,
        rate: float = 40.0,
        slew: float = 27.0,
        fall: float = 4.0,
        doubt: float = 4.0,
        most: float = 1.0,
        track: float = 11.0,
        couple: float = 47.0,
        delay: float = 0.016,
        lead: float = 0.66,
        friction: float = 1.07,
        drift: float = 0.03,
        gain_drift: float = 0.0073,
        still: float = 0.008,
        moving: float = 0.19,
        first: float = 0.0065,
        share: float = 0.084,
        jump: float = 0.15,
        bolt: float = 1.0,
        probe: float = 1.0,
        sweep: float = 3.0,
        search: float = 9.3,
        detect: float = 0.0085,
        pulse: float = 0.08,
        pulse_time: float = 0.03,
        known: float = 0.0235,
        blend: float = 0.01,
        reach: float = 0.25,
        shift: float = 0.1,
        pace: float = 0.5,
        calm: float = 0.1,
        watch: float = 1.0,
        late: float = 0.8,
        leakage: float = 1.0,
        compliance: float = 0.0,
        mode: float = 0.0,
        damping: float = 0.03,
        frames: float = 2,
    ) -> None:
        self._given = {
            name: float(value)
            for name, value in locals().items()
            if name in inspect.signature(FlowView).parameters
        }
        self.rate, self.slew, self.fall, self.doubt, self.most = rate, slew, fall, doubt, most
        self.track, self.couple, self.delay, self.lead = track, couple, delay, lead
        self.friction, self.drift, self.gain_drift = friction, drift, gain_drift
        self.still, self.moving, self.first = still, moving, first
        self.share, self.jump, self.bolt = share, jump, bolt
        self.probe, self.sweep, self.search, self.detect = probe, sweep, search, detect
        self.pulse, self.pulse_time, self.known, self.blend = pulse, pulse_time, known, blend
        self.reach, self.shift, self.pace, self.calm = reach, shift, pace, calm
        self.motor, self.damping = Motor(leakage, 1e-12 * compliance, mode), damping
        self.watch, self.late, self.frames = watch, late, int(frames)
        self.num_features = 2 * OWN + BOTH + FRAME * self.frames

    def settings(self) -> dict[str, Any]:
        return {"kind": "flow", **self._given}

    # ---- memory ---------------------------------------------------------------------------------------------------
    def start(self, observation: Floats, period: float) -> Floats:
        n = len(observation)
        self.period = period
        pair = (n, 2)
        self.spool = SpoolModel(n, period, SPOOL_RATE, self.damping, self.friction * FRICTION)
        self.sensors, self.delays = SensorCheck(n, period, self.motor.leakage), DelayEstimate(n)
        self.noisier = np.ones(pair)
        # a spool that hears every command at once, and where it was; the commands sent and flows asked for, newest first
        self.prompt = SpoolModel(n, period, SPOOL_RATE, self.damping, self.friction * FRICTION)
        self._places = np.zeros((MOST_DELAY + 1, 2, *pair))
        self._sent, self._wanted = np.zeros((MOST_DELAY + 1, *pair)), np.zeros((MOST_DELAY + 1, *pair))
        self.valves = ValveEstimate(
            n, period, drift=self.drift, gain_drift=self.gain_drift,
            doubt=(self.still, self.moving), first=self.first,
        )  # fmt: skip
        # a difference of speeds over half the time is twice as noisy; slower sampling allows less feedback
        self._jump = self.jump * max(1.0, TUNED_PERIOD / period)
        self._feedback = min(1.0, TUNED_PERIOD / period)
        # what goes wrong in one longer period before it is seen: spools creep as far as usual, flow rises by less
        self._creep_pace = self.search * self._feedback
        self._growth = self.slew * self._feedback**1.5 * period
        self.loads = LoadEstimate(n, period, NOMINAL["J"], self.share, self._jump)
        # weights a, 1 - 2 a, a have no response at the mode's angle per sample if 2 a cos(angle) + 1 - 2 a = 0
        self._spacing = max(1, round(2.0 * pi / 3.0 / SPOOL_RATE / period))
        self._outer = min(0.5 / (1.0 - cos(min(SPOOL_RATE * period * self._spacing, pi))), 0.4)
        self.sent, self.asked = np.zeros(pair), np.zeros((2 * self._spacing, *pair))
        self.flow: Floats = np.zeros(pair)
        self.wanted = np.zeros(pair)
        # the reference: speed, acceleration, and the speeds it had, newest first
        self.speed, self.acceleration = np.zeros(n), np.zeros(n)
        self.before = np.zeros((int(self.delay / period) + 2 + MOST_DELAY, n))
        self.quick = np.ones(n)
        # crossing: direction of the flow, where the spools have crept to
        self.direction, self.crossing, self.crept = np.zeros(n), np.zeros(n, bool), np.zeros(pair)
        # probing: sides done by each spool, where it has swept to, samples of pulses
        self.probing, self.sides = np.zeros(n, bool), np.zeros(pair, int)
        self.swept, self.pulsed = np.zeros(pair), np.zeros(n, int)
        self.bolting, self.pausing = np.zeros(n), np.zeros(n, int)
        self._pressure = np.zeros(pair)
        self.past = np.zeros((self.frames, n, 2, FRAME))
        # of the inputs seen last: flow that the law asks for, effect of the outputs, set-point, mean load
        self._law, self._effect, self._setpoint, self._load = (
            np.zeros(pair),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
        )
        self._apart, self._behind = np.zeros(pair), np.zeros(n)
        return self.restart(np.arange(n), observation)

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        seen = decode(np.asarray(observation))
        self.spool.place(rows, seen.command)
        self.prompt.place(rows, seen.command)
        self._places[:, 0, rows], self._places[:, 1, rows] = seen.command, 0.0
        self._sent[:, rows], self._wanted[:, rows] = seen.command, 0.0
        self.sensors.forget(rows, seen)
        self.delays.forget(rows, seen.command, self.motor.flow(seen))
        self.noisier[rows] = 1.0
        self.valves.forget(rows)
        self.loads.forget(rows, seen.speed, _shaft_torque(seen))
        self.sent[rows], self.asked[:, rows] = seen.command, seen.command
        self.flow[rows], self.wanted[rows] = self.motor.flow(seen), 0.0
        self._pressure[rows] = seen.pressure
        self.speed[rows], self.acceleration[rows] = np.mean(seen.speed, axis=1), 0.0
        self.before[:, rows], self.quick[rows] = self.speed[rows], 1.0
        self.direction[rows], self.crossing[rows], self.crept[rows] = 0.0, False, 0.0
        self.probing[rows], self.sides[rows], self.swept[rows] = self.probe > 0.0, 0, SWEEP_FROM
        self.pulsed[rows], self.bolting[rows], self.pausing[rows] = 0, 0.0, 0
        self._load[rows], self._setpoint[rows] = 0.0, seen.setpoint
        self._law[rows], self._effect[rows] = self.motor.per_speed * seen.speed, self.calm
        self._apart[rows], self._behind[rows] = 0.0, 0.0
        self.past[:, rows] = self._frame(seen)
        return self._inputs(seen, rows).reshape(-1, self.num_features)

    def see(self, observation: Floats) -> Floats:
        seen = decode(np.asarray(observation))
        self._sent = np.concatenate([self.sent[None], self._sent[:-1]])
        self._wanted = np.concatenate([self.wanted[None], self._wanted[:-1]])
        self.spool.move(self._delayed(self._sent))
        if self.watch:
            seen = self._watch(seen)
        self.flow = self._flow(seen)
        self._pressure = seen.pressure
        self.valves.learn(self.spool, self.flow, self.noisier)
        self.loads.step(seen.speed, _shaft_torque(seen), self.sensors.noise, self.sensors.unsound)
        self._think(seen)
        inputs = self._inputs(seen, slice(None))
        if self.frames:
            self.past = np.concatenate([self._frame(seen)[None], self.past[:-1]])
        return inputs.reshape(-1, self.num_features)

    def _flow(self, seen: Measurements) -> Floats:
        return self.motor.flow(seen, (seen.pressure - self._pressure) / self.period)

    def _delayed(self, history: Floats, more: int = 0) -> Floats:
        """From a history (periods, num_rigs, 2), what now comes into effect in each rig."""
        at: Floats = history[np.maximum(self.delays.periods - more, 0), np.arange(len(self.sent))]
        return at

    def _watch(self, seen: Measurements) -> Measurements:
        """The measurements with speeds to go by; a delay of the commands, once it is seen, is taken into account."""
        sensors, valves = self.sensors, self.valves
        signed = np.sign(self.spool.position - valves.middle)
        edge = np.where(signed < 0.0, valves.edge[..., 1], valves.edge[..., 0])
        passed = signed * valves.gain * np.maximum(signed * self.spool.position - edge, 0.0)
        steady = ~(self.crossing | self.probing) & (np.abs(self.acceleration) < 1.0)
        speed = sensors.step(seen, self.loads.torque, RATED_FLOW * passed, steady)
        self.loads.torque = np.where(sensors.lagging, 0.0, self.loads.torque)
        seen = replace(seen, speed=np.asarray(speed, dtype=np.float64))
        heard = np.hypot(LEAK_NOISE * sensors.pressure_noise, TURN_NOISE * np.minimum(sensors.noise, 5.0))
        self.noisier = np.where((sensors.noise > 1.0) | (sensors.pressure_noise > 1.0), heard / NOISE, 1.0)

        self.prompt.move(self.sent)
        now = np.stack([self.prompt.position, self.prompt.speed])
        self._places = np.concatenate([now[None], self._places[:-1]])
        changed = self.delays.step(
            self.prompt.position, self._flow(seen), valves.gain, FLOWING * self.noisier, NOISE * self.noisier
        )
        if changed.any():
            rows = np.flatnonzero(changed)
            late = self.delays.periods[rows]
            place = self._places[late, :, rows]
            self.spool.position[rows], self.spool.speed[rows] = place[:, 0], place[:, 1]
            # edges found by a sweep lie nearer by what the sweep went on before the spool followed
            shift = self.sweep * self.period * late[:, None, None]
            valves.edge[rows] -= shift
            valves.nearest[rows] -= shift
            valves.edge_variance[rows] += (0.5 * shift) ** 2
        return seen

    # ---- the law --------------------------------------------------------------------------------------------------
    def _think(self, seen: Measurements) -> None:
        """Everything that is decided before the network's outputs are known."""
        self._setpoint, self._load = seen.setpoint, np.mean(self.loads.torque, axis=1)
        self._probe()
        motors = np.mean(seen.speed, axis=1)
        asked = self._move_reference(motors)
        self._watch_direction(asked)
        unequal = np.abs(self.loads.miss[:, 0] - self.loads.miss[:, 1])
        jump = self._jump * np.max(self.sensors.noise, axis=1)
        sudden = np.clip((unequal - 2.0 * jump) / jump, 0.0, 1.0)
        self.bolting = self.bolt * np.where((self.pausing <= 0) & ~self.probing, sudden, 0.0)
        self.pausing = np.where(self.bolting > 0.0, round(PAUSE / self.period), self.pausing - 1)

        # speed difference one period ahead, under the flows asked for last
        torque = self.loads.torque
        ahead: Floats = seen.speed
        late = self.delays.periods
        for more in range(int(np.max(late)) + 1):
            flow = self._delayed(self._wanted, more)
            # whole periods until the last command comes into effect, then what the spool takes
            span = np.where(more < late, self.period, np.where(more == late, self.lead * TUNED_PERIOD, 0.0))
            ahead = self.motor.ahead(ahead, flow, torque, span)
        apart = 0.5 * (ahead - ahead[:, ::-1])
        behind = self._reference_then() - motors
        correction = self.track * behind[:, None] - self.couple * apart
        feedback = self._feedback / (1.0 + self.late * late)
        acceleration = self.acceleration[:, None] + feedback[:, None] * correction
        self._law = (
            self.motor.per_speed * self.speed[:, None]
            + self.motor.per_acceleration * acceleration
            + self.motor.per_torque * torque
        )
        self._apart, self._behind = apart, behind
        worst = np.max(np.abs(seen.setpoint[:, None] - seen.speed), axis=1) / (100.0 * RPM)
        self._effect = np.where(self.probing, 1.0, self.calm + (1.0 - self.calm) * np.minimum(worst, 1.0))

    def _probe(self) -> None:
        """Sweeps go on; a spool at whose motor flow shows turns to the other side; pulses when both are done."""
        self.probing = self.probing & (np.abs(self._setpoint) < AT_REST)
        if not self.probing.any():
            return
        sign = np.where(self.sides == 0, 1.0, -1.0)
        found = (sign * self.flow > self.detect * self.noisier) | (self.swept > 0.5)
        turns = found & (self.sides < 2) & self.probing[:, None]
        self.sides = self.sides + turns
        self.swept = np.where(turns, SWEEP_FROM, self.swept + self.sweep * self.period)
        ready = self.probing & np.all(self.sides == 2, axis=1)
        self.pulsed = np.where(ready, self.pulsed + 1, self.pulsed)
        # after the pulses two samples for the spools to come home
        self.probing = self.probing & ~(ready & (self.pulsed > 2 * self._pulse_samples + 2))

    @property
    def _pulse_samples(self) -> int:
        return round(self.pulse_time / self.period) if self.pulse > 0.0 else 0

    def _move_reference(self, motors: Floats) -> Floats:
        """One period of the reference; returns the flow it asks for, (num_rigs,)."""
        valves, load = self.valves, self.motor.per_torque * self._load
        held = self.motor.per_speed * self.speed + load
        now = held + self.motor.per_acceleration * self.acceleration
        most = self.most * np.min(valves.capacity(), axis=1)
        unsure = np.sqrt(np.max(valves.gain_variance, axis=1)) / 0.12
        growth = self._growth * self.quick / (1.0 + self.doubt * unsure)
        target = held + self.motor.per_acceleration * self.rate * self.quick * (self._setpoint - self.speed)
        upward = np.where(now >= 0.0, growth, self.fall * growth)
        downward = np.where(now <= 0.0, growth, self.fall * growth)
        flow = np.clip(np.clip(target, now - downward, now + upward), -most[:, 1], most[:, 0])
        acceleration = (flow - held) / self.motor.per_acceleration
        waits = self.crossing | self.probing
        coasting = np.where(self.probing, 0.0, -self.motor.rate * motors - self._load / NOMINAL["J"])
        self.acceleration = np.where(waits, coasting, acceleration)
        self.speed = np.where(waits, motors, self.speed + self.period * acceleration)
        self.before = np.concatenate([self.speed[None], self.before[:-1]])
        self.before = np.where(waits, motors, self.before)
        asked: Floats = self.motor.per_speed * self.speed + load + self.motor.per_acceleration * acceleration
        return asked

    def _reference_then(self) -> Floats:
        """The reference `delay` ago."""
        whole = int(self.delay / self.period)
        share = self.delay / self.period - whole
        rows, at = np.arange(len(self.speed)), whole + self.delays.periods
        then: Floats = (1.0 - share) * self.before[at, rows] + share * self.before[at + 1, rows]
        return then

    def _watch_direction(self, asked: Floats) -> None:
        """Begins a crossing where the flow asked for changes its direction and an edge there is unknown."""
        sign = np.sign(asked)
        turns = (np.abs(asked) > 2.0 * FLOWING) & (sign != self.direction) & ~self.probing
        self.direction = np.where(turns, sign, self.direction)
        edge, deviation = self._facing(self.valves.edge), self._facing(self.valves.edge_deviation)
        begin = np.where(
            self._facing(self.valves.unknown), self._facing(self.valves.nearest), edge - 2.0 * deviation
        )
        self.crept = np.where(turns[:, None], begin, self.crept)
        self.crossing = np.where(turns, np.any(deviation > self.known, axis=1), self.crossing)

    def _facing(self, values: NDArray[Any]) -> NDArray[Any]:
        """The values (num_rigs, 2, 2) of the direction each rig is to flow in, (num_rigs, 2)."""
        return np.where(self.direction[:, None] < 0.0, values[..., 1], values[..., 0])

    # ---- inputs and outputs ---------------------------------------------------------------------------------------
    def _frame(self, seen: Measurements) -> Floats:
        """What is remembered of every sample, (rigs, 2, FRAME): error, being ahead of the other, flow."""
        error, apart = seen.setpoint[:, None] - seen.speed, seen.speed - seen.speed[:, ::-1]
        frame: Floats = np.stack(
            [error / SPEED, np.clip(apart / (20.0 * RPM), -2.0, 2.0), 2.0 * self.motor.flow(seen)], axis=-1
        )
        return frame

    def _inputs(self, seen: Measurements, rows: Rows) -> NDArray[np.float32]:
        """The network's inputs for some rigs and what they measure, (rigs, 2, num_features)."""
        valves = self.valves
        error = seen.setpoint[:, None] - seen.speed
        apart = seen.speed - seen.speed[:, ::-1]
        sent, position = self.sent[rows], self.spool.position[rows]
        deviation = np.minimum(valves.edge_deviation[rows], 0.1)
        own = np.stack(
            [
                error / SPEED, np.clip(error / (60.0 * RPM), -1.0, 1.0), 2.0 * self.motor.flow(seen), seen.pressure / PRESSURE,
                sent, position, self.spool.speed[rows] / SPOOL_RATE, self.asked[-1, rows], self.asked[0, rows],
                2.0 * self._law[rows], 2.0 * self.wanted[rows], self.loads.torque[rows], self.loads.miss[rows],
                4.0 * valves.edge[rows, :, 0], 4.0 * valves.edge[rows, :, 1], valves.gain[rows],
                10.0 * deviation[..., 0], 10.0 * deviation[..., 1], 8.0 * np.sqrt(valves.gain_variance[rows]),
                valves.unknown[rows, :, 0], valves.unknown[rows, :, 1], 20.0 * valves.surprise[rows],
                4.0 * self.crept[rows], seen.speed / SPEED,
            ],
            axis=-1,
        )  # fmt: skip
        rig = np.stack(
            [
                seen.setpoint / SPEED, self.speed[rows] / SPEED, self.acceleration[rows] / (20.0 * SPEED),
                (seen.setpoint - self.speed[rows]) / SPEED, self._behind[rows] / (60.0 * RPM), self.direction[rows],
                self.crossing[rows], self.probing[rows], self._effect[rows],
            ],
            axis=-1,
        )  # fmt: skip
        pair = np.stack(
            [
                np.clip(apart / (60.0 * RPM), -1.0, 1.0), np.clip(apart / (10.0 * RPM), -1.0, 1.0),
                np.clip(self._apart[rows] / (10.0 * RPM), -1.0, 1.0),
            ],
            axis=-1,
        )  # fmt: skip
        shared = np.broadcast_to(rig[:, None], (len(rig), 2, rig.shape[-1]))
        inputs = [own, own[:, ::-1], shared, pair, *self.past[:, rows]]
        return np.clip(np.concatenate(inputs, axis=-1), -5.0, 5.0).astype(np.float32)

    def command(self, outputs: Floats) -> Floats:
        given = self._effect[:, None, None] * np.asarray(outputs, dtype=float).reshape(
            -1, 2, self.num_actions
        )
        self.quick = np.exp(self.pace * np.mean(given[..., 2], axis=1))
        flow = self._law + self.reach * given[..., 0]
        # one valve at its limit: both give way, so that they stay together
        capacity = np.where(flow < 0.0, self.valves.capacity()[..., 1], self.valves.capacity()[..., 0])
        excess = np.max(np.maximum(np.abs(flow) - capacity, 0.0), axis=1, keepdims=True)
        flow = flow - np.sign(flow) * excess
        asked = self.valves.command(flow, self.blend)
        asked, free = self._creep(asked)
        asked, open_loop = self._probing_command(asked)
        self.wanted = np.where((free & ~open_loop)[:, None], flow, 0.0)
        asked = np.clip(asked + self.shift * given[..., 1], -1.0, 1.0)
        middle = self.asked[self._spacing]
        smooth = self._outer * (asked + self.asked[0]) + (1.0 - 2.0 * self._outer) * middle
        bolting = self.bolting[:, None]
        kept = self.asked[1:]
        self.asked = np.concatenate([kept + bolting * (asked - kept), asked[None]])
        self.sent = np.clip(smooth + bolting * (asked - smooth), -1.0, 1.0)
        return self.sent.copy()

    def _creep(self, asked: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Commands of the rigs that look for an edge on the way; and which rigs do not, (num_rigs,)."""
        sign = self.direction[:, None]
        edge, deviation = self._facing(self.valves.edge), self._facing(self.valves.edge_deviation)
        # an edge too far away: no flow is seen, a sick sensor
        there = (sign * self.flow > FLOWING * self.noisier) | (deviation < self.known) | (self.crept > 0.6)
        self.crept = np.where(there, self.crept, self.crept + self._creep_pace * self.period)
        self.crossing = self.crossing & ~np.all(there, axis=1)
        creeping = sign * np.where(there, edge + FLOWING / self.valves.gain, self.crept)
        return np.where(self.crossing[:, None], creeping, asked), ~self.crossing

    def _probing_command(self, asked: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Commands of the rigs that probe; and which rigs do."""
        if not self.probing.any():
            return asked, self.probing
        samples = self._pulse_samples
        level = np.where(self.pulsed <= samples, 1.0, np.where(self.pulsed <= 2 * samples, -1.0, 0.0))
        level = self.pulse * np.where(self.pulsed > 0, level, 0.0)
        pulses = self.valves.command(np.broadcast_to(level[:, None], asked.shape), self.blend)
        sweeps = np.where(self.sides == 0, 1.0, -1.0) * self.swept
        probing = np.where(self.sides < 2, sweeps, pulses)
        return np.where(self.probing[:, None], probing, asked), self.probing


def _shaft_torque(seen: Measurements) -> Floats:
    """What each motor's shaft gives after friction (eq. 2), N m, (num_rigs, 2)."""
    return NOMINAL["D"] * seen.pressure - NOMINAL["B"] * seen.speed
