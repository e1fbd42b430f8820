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
from math import cos, pi
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.estimation.sensor_supervision import MOST_DELAY, DelayEstimate, SensorCheck
from hydro_env.controllers.estimation.valve_estimate import (
    FLOWING,
    NOISE,
    LoadEstimate,
    SpoolModel,
    ValveEstimate,
)
from hydro_env.controllers.mpc.flow_law import (
    BOTH,
    FRAME,
    NOMINAL,
    OWN,
    SPEED,
    SPOOL_RATE,
    Tuning,
    describe,
    steer,
    think,
)
from hydro_env.envs.observation import Measurements, decode
from hydro_env.plant.sensors import NOISE as SENSORS
from hydro_env.units import RPM

__all__ = ["FlowView"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

RATED_TRAVEL = NOMINAL["alpha"] * NOMINAL["u_rated"] / (NOMINAL["R"] * NOMINAL["k"])
RATED_FLOW = NOMINAL["Kq"] * RATED_TRAVEL
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


TUNED_PERIOD = 0.01
"""The control period that rates and gains were tuned at, s."""
AT_REST = 5.0 * RPM
SWEEP_FROM = -0.02
PAUSE = 0.15  # s between two answers to sudden loads
LEAK_NOISE = NOMINAL["Km"] * SENSORS["pressure_bar"] * 1e5 / RATED_FLOW
TURN_NOISE = NOMINAL["D"] * SENSORS["speed_rpm"] * RPM / RATED_FLOW
"""Usual noise of the measured flow that comes from the pressure and from the speed."""


class Loads(Protocol):
    """Torque on each shaft, N m, (num_rigs, 2), and by how much the last reading was off."""

    torque: Floats
    miss: Floats


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
    moved, cautious, idle, unused = 0.0, False, 0.0, 0.0
    """Of `ValveEstimate` and `DelayEstimate`."""

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
        self.sensors, self.delays = (
            SensorCheck(n, period, self.motor.leakage),
            DelayEstimate(n, self.cautious),
        )
        self.noisier = np.ones(pair)
        # where a spool was that hears every command at once; the commands sent and flows asked for, newest first
        self._places = np.zeros((MOST_DELAY + 1, 2, *pair))
        self._sent, self._wanted = np.zeros((MOST_DELAY + 1, *pair)), np.zeros((MOST_DELAY + 1, *pair))
        self.valves = ValveEstimate(
            n, period, drift=self.drift, gain_drift=self.gain_drift,
            doubt=(self.still, self.moving), first=self.first, moved=self.moved, idle=self.idle, unused=self.unused,
        )  # fmt: skip
        # a difference of speeds over half the time is twice as noisy; slower sampling allows less feedback
        self._jump = self.jump * max(1.0, TUNED_PERIOD / period)
        self._feedback = min(1.0, TUNED_PERIOD / period)
        # what goes wrong in one longer period before it is seen: spools creep as far as usual, flow rises by less
        self._creep_pace = self.search * self._feedback
        self._growth = self.slew * self._feedback**1.5 * period
        self._make_models(n)
        # weights a, 1 - 2 a, a have no response at the mode's angle per sample if 2 a cos(angle) + 1 - 2 a = 0
        self._spacing = max(1, round(2.0 * pi / 3.0 / SPOOL_RATE / period))
        self._outer = min(0.5 / (1.0 - cos(min(SPOOL_RATE * period * self._spacing, pi))), 0.4)
        self._tuning = self._numbers()
        self.sent: Floats = np.zeros(pair)
        self.asked = np.zeros((2 * self._spacing, *pair))
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
        # of the inputs seen last: flow that the law asks for, effect of the outputs, set-point
        self._law, self._effect, self._setpoint = np.zeros(pair), np.zeros(n), np.zeros(n)
        self._apart, self._behind = np.zeros(pair), np.zeros(n)
        return self.restart(np.arange(n), observation)

    def _numbers(self) -> Tuning:
        motor, period = self.motor, self.period
        spans = np.array([period, self.lead * TUNED_PERIOD])
        shares = (
            1.0 - np.exp(-motor.mode * spans)
            if motor.mode
            else spans * (1.0 - 0.5 * motor.rate * TUNED_PERIOD)
        )
        whole = int(self.delay / period)
        return Tuning(
            period=period, per_speed=motor.per_speed, per_torque=motor.per_torque,
            per_acceleration=motor.per_acceleration, coasting=motor.rate, rate=self.rate, growth=self._growth,
            fall=self.fall, doubt=self.doubt, most=self.most, known=self.known, jump=self._jump, bolt=self.bolt,
            pause=round(PAUSE / period), mode=bool(motor.mode), share_period=float(shares[0]), share_lead=float(shares[1]),
            whole=whole, part=self.delay / period - whole, track=self.track, couple=self.couple,
            feedback=self._feedback, late=self.late, calm=self.calm, reach=self.reach, shift=self.shift,
            blend=self.blend, creep=self._creep_pace * period, pulse=self.pulse, pulse_samples=self._pulse_samples,
            spacing=self._spacing, outer=self._outer,
        )  # fmt: skip

    def _make_models(self, n: int) -> None:
        # with the commands as they take effect, and one that hears every command at once
        self.spool, self.prompt = (
            SpoolModel(n, self.period, SPOOL_RATE, self.damping, self.friction * FRICTION) for _ in range(2)
        )
        self._estimate = LoadEstimate(n, self.period, NOMINAL["J"], self.share, self._jump)
        self.loads: Loads = self._estimate

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
        self._unload(rows, seen)
        self.sent[rows], self.asked[:, rows] = seen.command, seen.command
        self.flow[rows], self.wanted[rows] = self.motor.flow(seen), 0.0
        self._pressure[rows] = seen.pressure
        self.speed[rows], self.acceleration[rows] = np.mean(seen.speed, axis=1), 0.0
        self.before[:, rows], self.quick[rows] = self.speed[rows], 1.0
        self.direction[rows], self.crossing[rows], self.crept[rows] = 0.0, False, 0.0
        self.probing[rows], self.sides[rows], self.swept[rows] = self.probe > 0.0, 0, SWEEP_FROM
        self.pulsed[rows], self.bolting[rows], self.pausing[rows] = 0, 0.0, 0
        self._setpoint[rows] = seen.setpoint
        self._law[rows], self._effect[rows] = self.motor.per_speed * seen.speed, self.calm
        self._apart[rows], self._behind[rows] = 0.0, 0.0
        self.past[:, rows] = self._frame(seen)
        return self._inputs(seen, rows).reshape(-1, self.num_features)

    def see(self, observation: Floats) -> Floats:
        seen = self.take_in(observation)
        inputs = self._inputs(seen, slice(None))
        if self.frames:
            self.past = np.concatenate([self._frame(seen)[None], self.past[:-1]])
        return inputs.reshape(-1, self.num_features)

    def take_in(self, observation: Floats) -> Measurements:
        """What `see` does without a network's inputs; the measurements with speeds to go by."""
        seen = decode(np.asarray(observation))
        self._sent = np.concatenate([self.sent[None], self._sent[:-1]])
        self._wanted = np.concatenate([self.wanted[None], self._wanted[:-1]])
        self.spool.move(self._delayed(self._sent))
        if self.watch:
            seen = self._watch(seen)
        self.flow = self._flow(seen)
        self._pressure = seen.pressure
        self.valves.learn(self.spool, self.flow, self.noisier, self._least())
        self._weigh(seen)
        self._think(seen)
        return seen

    def _least(self) -> Floats:
        """What counts as flow, (num_rigs, 2)."""
        return FLOWING * self.noisier

    def _unload(self, rows: Rows, seen: Measurements) -> None:
        self._estimate.forget(rows, seen.speed, _shaft_torque(seen))

    def _weigh(self, seen: Measurements) -> None:
        """Takes in what the shafts bear."""
        self._estimate.step(seen.speed, _shaft_torque(seen), self.sensors.noise, self.sensors.unsound)

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
            self.prompt.shown, self._flow(seen), valves.gain, FLOWING * self.noisier, NOISE * self.noisier
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
        self._setpoint = seen.setpoint
        self._probe()
        valves, loads = self.valves, self.loads
        think(
            self._tuning, np.ascontiguousarray(seen.setpoint), np.ascontiguousarray(seen.speed), loads.torque, loads.miss,
            self.sensors.noise, self.delays.periods, self._wanted, valves.gain, valves.edge, valves.unknown,
            valves.nearest, valves.gain_variance, valves.edge_variance, self.probing, self.quick, self.speed,
            self.acceleration, self.before, self.direction, self.crossing, self.crept, self.bolting, self.pausing,
            self._law, self._apart, self._behind, self._effect,
        )  # fmt: skip

    def _probe(self) -> None:
        """Sweeps go on; a spool at whose motor flow shows turns to the other side; pulses when both are done."""
        self.probing = self.probing & (np.abs(self._setpoint) < AT_REST)
        if not self.probing.any():
            return
        sign = np.where(self.sides == 0, 1.0, -1.0)
        found = self._found(sign * self.flow) | (self.swept > 0.5)
        turns = found & (self.sides < 2) & self.probing[:, None]
        self.sides = self.sides + turns
        self.swept = np.where(turns, SWEEP_FROM, self.swept + self.sweep * self.period)
        ready = self.probing & np.all(self.sides == 2, axis=1)
        self.pulsed = np.where(ready, self.pulsed + 1, self.pulsed)
        # after the pulses two samples for the spools to come home
        self.probing = self.probing & ~(ready & (self.pulsed > 2 * self._pulse_samples + 2))

    def _found(self, flow: Floats) -> NDArray[np.bool_]:
        """Whether a flow away from rest ends a sweep, (num_rigs, 2)."""
        found: NDArray[np.bool_] = flow > self.detect * self.noisier
        return found

    @property
    def _pulse_samples(self) -> int:
        return round(self.pulse_time / self.period) if self.pulse > 0.0 else 0

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
        valves, loads = self.valves, self.loads
        index = np.arange(len(self.sent))[rows]
        inputs = np.empty((len(index), 2, self.num_features), np.float32)
        describe(
            inputs, index, *(np.ascontiguousarray(each) for each in (seen.setpoint, seen.speed, seen.pressure)),
            self.motor.flow(seen), self.sent, self.spool.position, self.spool.speed, self.asked, self._law, self.wanted,
            loads.torque, loads.miss, valves.edge, valves.gain, valves.edge_variance, valves.gain_variance,
            valves.unknown, valves.surprise, self.crept, self.speed, self.acceleration, self._behind, self.direction,
            self.crossing, self.probing, self._effect, self._apart, self.past,
        )  # fmt: skip
        return inputs

    def command(self, outputs: Floats) -> Floats:
        given = self._effect[:, None, None] * np.asarray(outputs, dtype=float).reshape(
            -1, 2, self.num_actions
        )
        self.quick = np.exp(self.pace * np.mean(given[..., 2], axis=1))
        valves = self.valves
        steer(
            self._tuning, given, self._law, self.flow, self.noisier, valves.gain, valves.edge, valves.edge_variance,
            self.direction, self.crossing, self.crept, self.probing, self.sides, self.swept, self.pulsed, self.bolting,
            self.asked, self.wanted, self.sent,
        )  # fmt: skip
        return self.sent.copy()


def _shaft_torque(seen: Measurements) -> Floats:
    """What each motor's shaft gives after friction (eq. 2), N m, (num_rigs, 2)."""
    return NOMINAL["D"] * seen.pressure - NOMINAL["B"] * seen.speed
