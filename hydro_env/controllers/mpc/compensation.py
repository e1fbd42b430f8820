"""Dead-zone compensation: from the flow asked for to the command that is sent, by the inverse of the estimated flow curves."""

from __future__ import annotations

import numpy as np

from hydro_env.controllers.mpc.reference import capacity
from hydro_env.jit import compiled

BLEND = 0.01
"""Flow below which the jump over the dead zone is a ramp: just above what counts as flow."""


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
