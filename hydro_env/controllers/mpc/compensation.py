"""Dead-zone compensation: from the flow asked for to the command that is sent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.valve_estimator import ValveState
from hydro_env.controllers.mpc.reference import capacity
from hydro_env.controllers.settings import setting
from hydro_env.jit import compiled

__all__ = ["CompensationSettings", "DeadZoneCompensation"]


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
