"""Dead-zone compensation and input shaping: from the flow asked for to the command that is sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.nominal import SPOOL_RATE
from hydro_env.controllers.estimation.valve_estimator import ValveState
from hydro_env.controllers.input_shaping import three_taps
from hydro_env.controllers.mpc.reference import capacity
from hydro_env.controllers.settings import setting
from hydro_env.jit import compiled

__all__ = ["CompensationSettings", "DeadZoneCompensation", "Shaper"]

Rows = NDArray[Any] | slice


@dataclass(frozen=True)
class CompensationSettings:
    """How the jump over the dead zone is smoothed."""

    blend: float = setting(0.01, "1", "flow below which the jump is a ramp", "just above what counts as flow")


class DeadZoneCompensation:
    """The inverse of the estimated flow curves."""

    def __init__(self, settings: CompensationSettings) -> None:
        self._blend = settings.blend

    def command(self, flow: Floats, valves: ValveState) -> Floats:
        """Commands (num_rigs, 2) for flows (num_rigs, 2), which are lowered in place where a valve is at its limit: both give
        way, so that the motors stay together."""
        command = np.empty_like(flow)
        _invert(self._blend, flow, valves, command)
        return command


class Shaper:
    """The filter of three taps; `unshaped` (samples, num_rigs, 2) are the commands before it, oldest first."""

    def __init__(self, num_rigs: int, period: float) -> None:
        self.spacing, self.outer = three_taps(SPOOL_RATE, period)
        self.unshaped = np.zeros((2 * self.spacing, num_rigs, 2))

    def reset(self, rows: Rows, command: Floats) -> None:
        """The command was in force for long."""
        self.unshaped[:, rows] = command

    def step(self, command: Floats, at_once: Floats) -> Floats:
        """Commands to send, (num_rigs, 2); a share `at_once` (num_rigs,) of each is not filtered."""
        sent = np.empty_like(command)
        _shape(self.spacing, self.outer, command, at_once, self.unshaped, sent)
        return sent


@compiled
def _invert(blend, flow, valves, command):
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
            command[i, c] = middle + min(abs(flow[i, c]) / blend, 1.0) * (beyond - middle)


@compiled
def _shape(spacing, outer, command, at_once, unshaped, sent):
    last = unshaped.shape[0] - 1
    for i in range(command.shape[0]):
        for c in range(2):
            newest = min(max(command[i, c], -1.0), 1.0)
            ends, middle = newest + unshaped[0, i, c], unshaped[spacing, i, c]
            smooth = outer * ends + (1.0 - 2.0 * outer) * middle
            for k in range(last):
                unshaped[k, i, c] = unshaped[k + 1, i, c] + at_once[i] * (newest - unshaped[k + 1, i, c])
            unshaped[last, i, c] = newest
            sent[i, c] = min(max(smooth + at_once[i] * (newest - smooth), -1.0), 1.0)
