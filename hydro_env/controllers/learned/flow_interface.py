"""A network on top of the flow controller: features from its estimates, output shaping into its parts.

One network drives each valve in turn and sees its own channel first, so that both channels share all weights. Its outputs
add flow, shift the command, and (their mean over both valves) quicken or slow the reference. Outputs of zero leave the
controller alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.estimation.nominal import SPOOL_RATE
from hydro_env.controllers.mpc.flow_controller import FlowController, FlowSettings, Refinement
from hydro_env.controllers.settings import TUNED, as_table, from_table, setting
from hydro_env.envs.observation import Measurements
from hydro_env.errors import InputError, shown
from hydro_env.jit import compiled
from hydro_env.units import RPM

__all__ = ["FlowInterface", "OutputSettings"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

SPEED, PRESSURE = 600.0 * RPM, 10e5
"""Scales of the features: rad/s, Pa."""
OWN, BOTH, FRAME, FRAMES = 24, 12, 3, 2
"""Numbers of features: of each channel, of the rig, of each remembered sample; samples that are remembered."""
FULL = 100.0 * RPM
"""Error from which on outputs have their full effect, rad/s."""


@dataclass(frozen=True)
class OutputSettings:
    """What outputs of 1 do."""

    flow: float = setting(0.25, "1", "flow that is added, rated flows", TUNED)
    command: float = setting(0.1, "1", "shift of the command", TUNED)
    pace: float = setting(0.5, "1", "logarithm of the reference's pace", TUNED)
    floor: float = setting(
        0.1, "1", "what is left of that at the set-point; all of it beyond 100 rpm of error", TUNED
    )


class Sample(NamedTuple):
    """Measurements of the rigs described, (n,) and (n, 2)."""

    setpoint: Floats
    speed: Floats
    pressure: Floats
    flow: Floats


class Law(NamedTuple):
    """What the controller has in mind, (N,), (N, 2) or (samples, N, 2)."""

    sent: Floats
    position: Floats
    spool_speed: Floats
    unshaped: Floats
    wanted: Floats
    probing: NDArray[np.bool_]
    effect: Floats


class FlowInterface:
    """See the module's text; `hydro_env.controllers.learned.policy_interface.PolicyInterface`."""

    rows_per_rig = 2
    num_actions = 3
    num_features = 2 * OWN + BOTH + FRAME * FRAMES

    def __init__(self, settings: FlowSettings | None = None, outputs: OutputSettings | None = None) -> None:
        self.controller, self.outputs = FlowController(settings), outputs or OutputSettings()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> FlowInterface:
        """From `{"law": {...}, "outputs": {...}}`, both of which may be left out. InputError for anything else."""
        for key in table:
            if key not in ("law", "outputs"):
                raise InputError(f"{shown(key)} is unknown; known for kind 'flow' are law, outputs")
        law = from_table(FlowSettings, table.get("law", {}), "law: ")
        return cls(law, from_table(OutputSettings, table.get("outputs", {}), "outputs: "))

    def table(self) -> dict[str, Any]:
        return {"kind": "flow", "law": as_table(self.controller.settings), "outputs": as_table(self.outputs)}

    def start(self, observation: Floats, period: float) -> Floats:
        n = len(observation)
        self._effect, self._past = np.zeros(n), np.zeros((FRAMES, n, 2, FRAME))
        seen = self.controller.start(observation, period)
        return self._begun(np.arange(n), seen)

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        return self._begun(rows, self.controller.restart(rows, observation))

    def _begun(self, rows: Rows, seen: Measurements) -> Floats:
        self._effect[rows] = self.outputs.floor
        self._past[:, rows] = self._frame(seen)
        return self._features(seen, rows)

    def see(self, observation: Floats) -> Floats:
        law = self.controller
        seen = law.update(observation)
        worst = np.max(np.abs(law.setpoint[:, None] - seen.speed), axis=1)
        floor = self.outputs.floor
        self._effect = np.where(
            law.probing.active, 1.0, floor + (1.0 - floor) * np.minimum(worst / FULL, 1.0)
        )
        features = self._features(seen, slice(None))
        self._past = np.concatenate([self._frame(seen)[None], self._past[:-1]])
        return features

    def command(self, outputs: Floats) -> Floats:
        law, reach = self.controller, self.outputs
        given = self._effect[:, None, None] * np.asarray(outputs, dtype=float).reshape(
            -1, 2, self.num_actions
        )
        law.reference.state.pace[:] = np.exp(reach.pace * np.mean(given[..., 2], axis=1))
        load = reach.flow / law.settings.motor.per_torque * given[..., 0]
        return law.command(Refinement(reach.flow * given[..., 0], load, reach.command * given[..., 1]))

    def _frame(self, seen: Measurements) -> Floats:
        """What is remembered of every sample, (rigs, 2, FRAME): error, being ahead of the other, flow."""
        error, apart = seen.setpoint[:, None] - seen.speed, seen.speed - seen.speed[:, ::-1]
        flow = self.controller.settings.motor.flow(seen.speed, seen.pressure)
        return np.stack([error / SPEED, np.clip(apart / (20.0 * RPM), -2.0, 2.0), 2.0 * flow], axis=-1)

    def _features(self, seen: Measurements, rows: Rows) -> NDArray[np.float32]:
        """The network's inputs for some rigs and what they measure, (rigs * 2, num_features)."""
        law, e = self.controller, self.controller.estimator
        index = np.arange(len(law.sent))[rows]
        inputs = np.empty((len(index), 2, self.num_features), np.float32)
        setpoint, speed, pressure = map(np.ascontiguousarray, (seen.setpoint, seen.speed, seen.pressure))
        sample = Sample(setpoint, speed, pressure, law.settings.motor.flow(seen.speed, seen.pressure))
        mind = Law(
            law.sent,
            e.spool.position,
            e.spool.speed,
            law.shaper.unshaped,
            law.wanted,
            law.probing.active,
            self._effect,
        )
        _describe(
            inputs, index, sample, mind, law.feedback.state, e.motors.state, e.valves.state, law.reference.state,
            law.crossing.state, self._past,
        )  # fmt: skip
        return inputs.reshape(-1, self.num_features)


@compiled
def _describe(inputs, rows, z, law, f, m, v, r, x, past):
    """Inputs (n, 2, features) of the rigs `rows` (n,). A channel's own come first, then the other's, the rig's, the past."""
    row = np.empty(inputs.shape[2])
    for k in range(rows.size):
        i = rows[k]
        for own in range(2):
            _channel(row[:OWN], k, i, own, z, law, f, m, v, x)
            _channel(row[OWN : 2 * OWN], k, i, 1 - own, z, law, f, m, v, x)
            at = 2 * OWN
            row[at], row[at + 1] = z.setpoint[k] / SPEED, r.speed[i] / SPEED
            row[at + 2] = r.acceleration[i] / (20.0 * SPEED)
            row[at + 3], row[at + 4] = (z.setpoint[k] - r.speed[i]) / SPEED, f.behind[i] / (60.0 * RPM)
            row[at + 5], row[at + 6], row[at + 7] = x.direction[i], x.active[i], law.probing[i]
            row[at + 8] = law.effect[i]
            ahead = z.speed[k, own] - z.speed[k, 1 - own]
            row[at + 9] = min(max(ahead / (60.0 * RPM), -1.0), 1.0)
            row[at + 10] = min(max(ahead / (10.0 * RPM), -1.0), 1.0)
            row[at + 11] = min(max(f.apart[i, own] / (10.0 * RPM), -1.0), 1.0)
            at += BOTH
            for frame in range(past.shape[0]):
                for n in range(FRAME):
                    row[at + n] = past[frame, i, own, n]
                at += FRAME
            for n in range(at):
                inputs[k, own, n] = min(max(row[n], -5.0), 5.0)


@compiled
def _channel(row, k, i, c, z, law, f, m, v, x):
    """Features of channel c of rig i, the k-th that is described."""
    error = z.setpoint[k] - z.speed[k, c]
    row[0], row[1] = error / SPEED, min(max(error / (60.0 * RPM), -1.0), 1.0)
    row[2], row[3] = 2.0 * z.flow[k, c], z.pressure[k, c] / PRESSURE
    row[4], row[5], row[6] = law.sent[i, c], law.position[i, c], law.spool_speed[i, c] / SPOOL_RATE
    row[7], row[8] = law.unshaped[-1, i, c], law.unshaped[0, i, c]
    row[9], row[10] = 2.0 * f.flow[i, c], 2.0 * law.wanted[i, c]
    row[11], row[12] = m.torque[i, c], m.miss[i, c]
    row[13], row[14], row[15] = 4.0 * v.edge[i, c, 0], 4.0 * v.edge[i, c, 1], v.gain[i, c]
    row[16] = 10.0 * min(np.sqrt(v.edge_variance[i, c, 0]), 0.1)
    row[17] = 10.0 * min(np.sqrt(v.edge_variance[i, c, 1]), 0.1)
    row[18] = 8.0 * np.sqrt(v.gain_variance[i, c])
    row[19], row[20] = v.unknown[i, c, 0], v.unknown[i, c, 1]
    row[21], row[22], row[23] = 20.0 * v.innovation[i, c], 4.0 * x.position[i, c], z.speed[k, c] / SPEED
