"""What a policy's network sees of the rig, and how its outputs become valve commands.

The same code runs in training (`agents`) and in the shipped controllers, so that what was trained is what runs. Two
views:

`FramesView`: the last observations as they are; the outputs are the commands. Nothing is built in.

`ValveView`: one network drives each valve in turn and sees its own channel first, so that both channels share all
weights. Besides the measurements it is given memory that a network without recurrence lacks: leaky integrals, the
modelled position of the spools and, for each valve and direction, a running estimate of dead-zone edge and flow gain.
The outputs ask for flow beyond what holds the present speed, which the estimated valve curve turns into a command, and
for a shift of that command. Three successive commands are averaged with weights that leave the spool's lightly damped
mode at rest, because every step would set it ringing.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from math import cos, exp, sin, sqrt
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hydro_env.envs.observation import Measurements, decode
from hydro_env.errors import InputError
from hydro_env.plant import PARAMETERS

__all__ = ["FramesView", "ValveView", "View", "make_view"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any]


class View(Protocol):
    """Stands between the observations of a batch of rigs and a network.

    `rows_per_rig`: how many inputs the network gets for each rig; `num_features`, `num_actions`: their and the outputs'
    number. Inputs have the shape (num_rigs * rows_per_rig, num_features).
    """

    rows_per_rig: int
    num_features: int
    num_actions: int

    def start(self, observation: Floats, period: float) -> Floats:
        """Inputs at the first observation of all rigs; forgets everything before."""

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        """Inputs at the first observation of some rigs (indices), whose episodes begin anew."""

    def see(self, observation: Floats) -> Floats:
        """Inputs at the next observation of all rigs, a control period later."""

    def command(self, outputs: Floats) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for the network's outputs at the inputs seen last."""

    def settings(self) -> dict[str, Any]:
        """What `make_view` needs to build the same view."""


def _settings(view: type[Any]) -> list[str]:
    """The settings of a view, with those that it hands on to the view it is built on."""
    given = inspect.signature(view).parameters.values()
    own = [each.name for each in given if each.kind is not each.VAR_KEYWORD]
    on = _settings(view.__base__) if len(own) < len(given) and view.__base__ is not None else []
    return list(dict.fromkeys([*own, *on]))


def make_view(settings: Any) -> View:
    """A view from its settings, `{"kind": "plan" | "flow" | "valves" | "frames", ...}`; the plain observation without any.

    InputError for anything that is not right.
    """
    if settings is not None and not isinstance(settings, Mapping):
        raise InputError(f"should be a table with a key 'kind', found {type(settings).__name__}")
    given = dict(settings or {"kind": "frames"})
    from hydro_env.controllers.mpc.flow_controller import FlowView
    from hydro_env.controllers.mpc.planning_controller import PlanningView

    kinds: dict[str, type[Any]] = {
        "frames": FramesView, "valves": ValveView, "flow": FlowView, "plan": PlanningView,
    }  # fmt: skip
    kind = given.pop("kind", None)
    if kind not in kinds:
        raise InputError(f"kind {kind!r} is unknown; there are {', '.join(kinds)}")
    known = _settings(kinds[str(kind)])
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{key!r} is unknown; known for kind {kind!r} are {', '.join(known)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e5:
            raise InputError(f"{key} {value!r} should be a number from 0 to 100000")
    made: View = kinds[str(kind)](**given)
    return made


class FramesView:
    """The last `frames` observations of `width` numbers each, newest last; the outputs are the commands."""

    rows_per_rig = 1
    num_actions = 2

    def __init__(self, frames: int = 1, width: int = 9) -> None:
        self.frames, self.width = int(frames), int(width)
        self.num_features = self.frames * self.width

    def settings(self) -> dict[str, Any]:
        return {"kind": "frames", "frames": self.frames, "width": self.width}

    def start(self, observation: Floats, period: float) -> Floats:
        self._seen = np.tile(self._newest(observation), (1, self.frames))
        return self._seen.copy()

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        self._seen[rows] = np.tile(self._newest(observation), (1, self.frames))
        return self._seen[rows]

    def see(self, observation: Floats) -> Floats:
        self._seen = np.concatenate([self._seen[:, self.width :], self._newest(observation)], axis=1)
        return self._seen.copy()

    def _newest(self, observation: Floats) -> NDArray[np.float32]:
        """The newest frame, whatever history the environment adds."""
        return np.asarray(observation, dtype=np.float32)[:, -self.width :]

    def command(self, outputs: Floats) -> Floats:
        return np.clip(outputs, -1.0, 1.0)


NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
RATED_FLOW = NOMINAL["Kq"] * NOMINAL["alpha"] * NOMINAL["u_rated"] / (NOMINAL["R"] * NOMINAL["k"])
"""Flow of the nominal valve at the rated command, m3/s: flows below are fractions of it."""
FLOW_PER_SPEED = (NOMINAL["D"] + NOMINAL["B"] * NOMINAL["Km"] / NOMINAL["D"]) / RATED_FLOW
"""Flow that holds a speed without load (s/rad): displacement, and the leakage that viscous friction costs."""
FLOW_PER_TORQUE = NOMINAL["Km"] / NOMINAL["D"] / RATED_FLOW
"""Leakage that a load costs (1/(N m))."""

RPM = 2.0 * np.pi / 60.0
SPEED = 600.0 * RPM  # scales of the inputs
PRESSURE = 10e5
INTEGRAL_TIME = 0.3
TRIM_TIME, TRIM_ERROR, TRIM_MOST = 0.35, 50.0 * RPM, 0.15
LOAD_TIME = 0.03
LAG = 0.1
SPOOL_RATE = sqrt(NOMINAL["k"] / NOMINAL["m"])
SPOOL_DAMPING = 0.05  # assumed: back-EMF and friction
FLOWING = 0.008  # share of the rated flow: four standard deviations of the measured flow's noise
SIGNS = np.array([1.0, -1.0])


class ValveView:
    """See the module's text.

    Args:
        frames: how many past measurements of speed difference, error and flow are among the inputs.
        reach: the share of the rated flow that an output of 1 asks for beyond what holds the speed.
        pull, limit, couple: a proportional law beneath the network: what is added to the output per 600 rpm of error to
            the set-point (no more than `limit`), and taken off per 600 rpm that the motor is ahead of the other.
        shift: what a second output of 1 adds to the command itself, as a fraction of the rated one.
        calm: what is left of both outputs at the set-point; they have their full effect from 100 rpm of error on.
        blend: flow (share of rated) below which the jump over the dead zone is a ramp.
        drift: random walk of the estimated edge, command per root second.
    """

    rows_per_rig = 2
    num_actions = 2

    def __init__(
        self,
        frames: int = 3,
        reach: float = 0.6,
        blend: float = 0.01,
        drift: float = 0.03,
        pull: float = 0.0,
        limit: float = 1.0,
        couple: float = 0.0,
        shift: float = 0.1,
        calm: float = 1.0,
    ) -> None:
        self.frames = int(frames)
        self.reach, self.blend, self.drift = float(reach), float(blend), float(drift)
        self.pull, self.limit, self.couple = float(pull), float(limit), float(couple)
        self.shift_reach, self.calm = float(shift), float(calm)
        self.num_features = 44 + 5 * self.frames

    def settings(self) -> dict[str, Any]:
        return {
            "kind": "valves", "frames": self.frames, "reach": self.reach, "blend": self.blend, "drift": self.drift,
            "pull": self.pull, "limit": self.limit, "couple": self.couple, "shift": self.shift_reach, "calm": self.calm,
        }  # fmt: skip

    # ---- memory: (num_rigs, 2 channels) or (num_rigs, 2 channels, 2 directions) ------------------------------------
    def start(self, observation: Floats, period: float) -> Floats:
        num_rigs = len(observation)
        self.period = period
        self._turn = _held_oscillator(SPOOL_RATE, SPOOL_DAMPING, period)
        pair, each = (num_rigs, 2), (num_rigs, 2, 2)
        self.spool, self.spool_speed = np.zeros(pair), np.zeros(pair)
        self.integral, self.apart = np.zeros(pair), np.zeros(num_rigs)
        self.trim, self.slow_speed, self.slow_torque = np.zeros(pair), np.zeros(pair), np.zeros(pair)
        self.lagged, self.before = np.zeros(num_rigs), np.zeros(pair)
        self.past = np.zeros((self.frames, num_rigs, 5))
        # weights a, 1 - 2 a, a have no response at the mode's angle per sample if 2 a cos(angle) + 1 - 2 a = 0
        away = 1.0 - cos(min(SPOOL_RATE * period, np.pi))
        self._outer = min(0.5 / away, 0.4)
        self.asked = np.zeros((2, *pair))
        self.gain, self.shift = np.zeros(each), np.zeros(each)
        self.gain_variance, self.shift_variance = np.zeros(each), np.zeros(each)
        self.covariance = np.zeros(each)
        # of the inputs seen last: flow that holds the speed, what the law asks for, effect of the outputs
        self._hold, self._law, self._effect = np.zeros(pair), np.zeros(pair), np.zeros(num_rigs)
        return self.restart(np.arange(num_rigs), observation).reshape(-1, self.num_features)

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        seen = decode(np.asarray(observation))
        self.spool[rows], self.spool_speed[rows] = seen.command, 0.0
        self.integral[rows], self.apart[rows] = 0.0, 0.0
        self.lagged[rows] = np.mean(seen.speed, axis=1)
        self.trim[rows], self.slow_speed[rows], self.slow_torque[rows] = 0.0, seen.speed, 0.0
        self.before[rows] = seen.command
        self.asked[:, rows] = seen.command
        # the scatter of valves of one type: flow = gain * spool - shift beyond the edge shift / gain
        self.gain[rows], self.shift[rows] = 0.82, 0.095
        self.gain_variance[rows], self.shift_variance[rows], self.covariance[rows] = 0.15**2, 0.07**2, 0.0
        self.past[:, rows] = self._frame(seen)
        return self._inputs(seen, rows).reshape(-1, self.num_features)

    def see(self, observation: Floats) -> Floats:
        seen = decode(np.asarray(observation))
        self._move_spool(seen.command)
        self._learn(seen.command, _flow(seen))
        decay = exp(-self.period / INTEGRAL_TIME)
        self.integral = self.integral * decay + (1.0 - decay) * (seen.setpoint[:, None] - seen.speed) / SPEED
        self.apart = self.apart * decay + (1.0 - decay) * (seen.speed[:, 0] - seen.speed[:, 1]) / SPEED
        self.lagged = self.lagged + (1.0 - exp(-self.period / LAG)) * (seen.setpoint - self.lagged)
        error = seen.setpoint[:, None] - seen.speed
        near = np.abs(error) < TRIM_ERROR  # not on the way there: that would wind it up
        self.trim = (
            self.trim + self.period / TRIM_TIME * self.reach * self.pull * np.where(near, error, 0.0) / SPEED
        )
        self.trim = np.clip(self.trim, -TRIM_MOST, TRIM_MOST)
        share = 1.0 - exp(-self.period / LOAD_TIME)
        self.slow_torque = self.slow_torque + share * (_shaft_torque(seen) - self.slow_torque)
        self.slow_speed = self.slow_speed + share * (seen.speed - self.slow_speed)
        inputs = self._inputs(seen, slice(None))
        if self.frames:
            self.past = np.concatenate([self._frame(seen)[None], self.past[:-1]])
        self.before = np.array(seen.command, dtype=float)
        return inputs.reshape(-1, self.num_features)

    def _move_spool(self, command: Floats) -> None:
        """Where the nominal spool went under the command that was held, as a fraction of its rated travel."""
        (a, b), (c, d) = self._turn
        gap = self.spool - command
        self.spool = command + a * gap + b * self.spool_speed
        self.spool_speed = c * gap + d * self.spool_speed

    def _learn(self, command: Floats, flow: Floats) -> None:
        """Kalman update of flow = gain * spool - shift for the direction in which each spool stands beyond its edge."""
        ringing = (self.spool - command) ** 2 + (self.spool_speed / SPOOL_RATE) ** 2
        x, y = self.spool[..., None] * SIGNS, flow[..., None] * SIGNS
        edge = self.edge
        active = ((x > edge) | (y > FLOWING)) & (x > 0.5 * (edge - edge[..., ::-1]))
        noise = 0.01**2 + 0.5**2 * ringing[..., None]  # a moving spool is not quite where the model has it
        walk = np.where(active, self.drift**2 * self.period, 0.0)
        vs, vg, c = np.minimum(self.shift_variance + walk, 0.1**2), self.gain_variance, self.covariance
        along_shift, along_gain = c * x - vs, vg * x - c
        total = x * along_gain - along_shift + noise
        surprise = np.where(active, y - np.maximum(self.gain * x - self.shift, 0.0), 0.0)
        to_shift = np.where(active, along_shift / total, 0.0)
        to_gain = np.where(active, along_gain / total, 0.0)
        self.shift = np.clip(self.shift + to_shift * surprise, -0.15, 0.5)
        self.gain = np.clip(self.gain + to_gain * surprise, 0.35, 1.5)
        self.shift_variance = np.maximum(vs - to_shift * along_shift, 1e-8)
        self.gain_variance = np.maximum(vg - to_gain * along_gain, 1e-8)
        self.covariance = c - to_shift * along_gain

    @property
    def edge(self) -> Floats:
        """The estimated edges of the dead zones, (num_rigs, 2 channels, 2 directions), as a fraction of the command."""
        return self.shift / self.gain

    # ---- inputs and outputs ---------------------------------------------------------------------------------------
    def _frame(self, seen: Measurements) -> Floats:
        """What is remembered of every step, (num_rigs, 5): both speeds, both flows, the set-point."""
        return np.concatenate([seen.speed / SPEED, 2.0 * _flow(seen), seen.setpoint[:, None] / SPEED], axis=1)

    def _inputs(self, seen: Measurements, rows: Rows | slice) -> NDArray[np.float32]:
        """The network's inputs for some rigs and what they measure, (rigs, 2, num_features)."""
        speed, flow = seen.speed, _flow(seen)
        setpoint = np.broadcast_to(seen.setpoint[:, None], speed.shape)
        error, apart = setpoint - speed, speed - speed[:, ::-1]
        # J dw/dt = torque - load, both sides through the same lag
        load = self.slow_torque[rows] - NOMINAL["J"] * (speed - self.slow_speed[rows]) / LOAD_TIME
        self._hold[rows] = FLOW_PER_SPEED * speed + FLOW_PER_TORQUE * load + self.trim[rows]
        pull = np.clip(self.pull * error / SPEED, -self.limit, self.limit)
        self._law[rows] = pull - self.couple * apart / SPEED
        worst = np.max(np.abs(error), axis=1) / (100.0 * RPM)
        self._effect[rows] = self.calm + (1.0 - self.calm) * np.minimum(worst, 1.0)

        edge, unsure = np.clip(self.edge[rows], -0.3, 0.7), np.sqrt(self.shift_variance[rows])
        gain, asked = self.gain[rows], self.asked[:, rows]
        own = np.stack(
            [
                speed / SPEED, error / SPEED,
                np.clip(error / (60.0 * RPM), -1.0, 1.0), 2.0 * flow, seen.pressure / PRESSURE, seen.command,
                self.before[rows], self.spool[rows], self.spool_speed[rows] / SPOOL_RATE, self.integral[rows],
                asked[1], asked[0], load, 10.0 * self.trim[rows],
                4.0 * edge[..., 0], 4.0 * edge[..., 1], gain[..., 0], gain[..., 1],
                10.0 * unsure[..., 0], 10.0 * unsure[..., 1],
            ],
            axis=-1,
        )  # fmt: skip
        other = own[:, ::-1, 2:]
        lag = np.broadcast_to((seen.setpoint - self.lagged[rows])[:, None], speed.shape)
        both = np.stack(
            [
                setpoint / SPEED, lag / SPEED, apart / SPEED, np.clip(apart / (60.0 * RPM), -1.0, 1.0),
                np.clip(apart / (10.0 * RPM), -1.0, 1.0), self.apart[rows, None] * SIGNS,
            ],
            axis=-1,
        )  # fmt: skip
        inputs = [own, other, both]
        for frame in self.past[:, rows]:
            mine = np.stack([frame[:, 0:2], frame[:, 2:4]], axis=-1)
            shared = np.broadcast_to(frame[:, None, 4:], (len(frame), 2, 1))
            inputs += [mine, mine[:, ::-1], shared]
        return np.clip(np.concatenate(inputs, axis=-1), -10.0, 10.0).astype(np.float32)

    def command(self, outputs: Floats) -> Floats:
        given = self._effect[:, None, None] * np.asarray(outputs, dtype=float).reshape(-1, 2, 2)
        asked = np.clip(self._law + given[..., 0], -1.0, 1.0)
        flow = self._hold + self.reach * asked
        edges = self.edge
        facing = flow[..., None] * SIGNS > 0.0
        edge = np.sum(np.where(facing, edges, 0.0), axis=-1)
        gain = np.where(flow < 0.0, self.gain[..., 1], self.gain[..., 0])
        beyond = np.sign(flow) * (edge + np.abs(flow) / gain)
        middle = 0.5 * (edges[..., 0] - edges[..., 1])
        share = np.minimum(np.abs(flow) / self.blend, 1.0)
        asked = np.clip(middle + share * (beyond - middle) + self.shift_reach * given[..., 1], -1.0, 1.0)
        smooth = self._outer * (asked + self.asked[0]) + (1.0 - 2.0 * self._outer) * self.asked[1]
        self.asked = np.stack([self.asked[1], asked])
        return np.clip(smooth, -1.0, 1.0)


def _flow(seen: Measurements) -> Floats:
    """Flow into each motor from its speed and leakage (eq. 1), as a share of the rated flow, (num_rigs, 2)."""
    return (NOMINAL["D"] * seen.speed + NOMINAL["Km"] * seen.pressure) / RATED_FLOW


def _shaft_torque(seen: Measurements) -> Floats:
    """What each motor's shaft gives after friction (eq. 2), N m, (num_rigs, 2)."""
    return NOMINAL["D"] * seen.pressure - NOMINAL["B"] * seen.speed


def _held_oscillator(rate: float, damping: float, period: float) -> tuple[tuple[float, float], ...]:
    """Exact transition of position (from its rest point) and speed over a period, for damping below 1."""
    damped = rate * sqrt(1.0 - damping * damping)
    decay, c, s = exp(-damping * rate * period), cos(damped * period), sin(damped * period) / damped
    slope = damping * rate
    return (decay * (c + slope * s), decay * s), (-decay * rate * rate * s, decay * (c - slope * s))
