"""What a controller believes of a valve and its motor: the steady flow curve, and the flow a speed takes.

Flows are fractions of the nominal rated flow (Kq x at the spool travel of the rated command), commands
fractions of the rated command, so that a nominal valve without a dead zone has edge 0 and gain 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.plant import PARAMETERS, Plant

__all__ = ["MOTOR_RATE", "RATED_FLOW", "ValveMap", "flow_for", "measured_flow", "true_map"]

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
RATED_TRAVEL = NOMINAL["alpha"] * NOMINAL["u_rated"] / (NOMINAL["R"] * NOMINAL["k"])
"""Spool travel at the rated command, m."""

RATED_FLOW = NOMINAL["Kq"] * RATED_TRAVEL
"""Flow of the nominal valve at the rated command, m3/s."""

LEAK_PER_TORQUE = NOMINAL["Km"] / NOMINAL["D"] / RATED_FLOW
"""Leakage that a torque costs: the pressure for it drives the leak (rated flow per N m)."""

FLOW_PER_ACCELERATION = NOMINAL["J"] * LEAK_PER_TORQUE
FLOW_PER_SPEED = NOMINAL["D"] / RATED_FLOW + NOMINAL["B"] * LEAK_PER_TORQUE
MOTOR_RATE = FLOW_PER_SPEED / FLOW_PER_ACCELERATION
"""Rate at which a motor without flow coasts down, 1/s: (B + D^2/Km) / J."""


def flow_for(speed: Floats, acceleration: Floats | float, load: Floats | float) -> Floats:
    """The share of the rated flow that a speed (rad/s), an acceleration (rad/s2) and a load (N m) take."""
    return FLOW_PER_SPEED * speed + FLOW_PER_ACCELERATION * acceleration + LEAK_PER_TORQUE * load


def measured_flow(speed: Floats, pressure: Floats) -> Floats:
    """Flow into the motor, seen through its displacement and leakage: eq. (1), as a share of the rated
    flow.
    """
    return (NOMINAL["D"] * speed + NOMINAL["Km"] * pressure) / RATED_FLOW


@dataclass
class ValveMap:
    """Steady flow curve: in direction s, flow = s gain_s max(0, s command - edge_s).

    `edge` and `gain` have the shape (num_rigs, 2 channels, 2 directions), the positive direction first.
    """

    edge: Floats
    gain: Floats

    def command(self, flow: Floats, blend: float | Floats = 1e-3) -> Floats:
        """The command for a flow, both (num_rigs, 2). Below `blend` (a flow) the jump over the dead zone is
        a ramp.
        """
        negative = (flow < 0.0).astype(int)[..., None]
        edge = np.take_along_axis(self.edge, negative, axis=2)[..., 0]
        gain = np.take_along_axis(self.gain, negative, axis=2)[..., 0]
        sign = np.where(flow < 0.0, -1.0, 1.0)
        beyond = sign * (edge + np.abs(flow) / gain)
        middle = 0.5 * (self.edge[..., 0] - self.edge[..., 1])
        return middle + np.clip(np.abs(flow) / blend, 0.0, 1.0) * (beyond - middle)


def true_map(plant: Plant) -> ValveMap:
    """The curve that follows from the true parameters of every rig of a plant (friction left out)."""

    def own(name: str) -> Floats | float:
        return plant.get(name) if name.partition(".")[0] in plant.effects else 0.0

    offset = own("null_offset.offset")
    overlap = [own("dead_zone.overlap_positive") - offset, own("dead_zone.overlap_negative") + offset]
    travel = plant.get("alpha") * plant.get("u_rated") / (plant.get("R") * plant.get("k"))
    edge = np.stack([value / travel for value in overlap], axis=-1)
    gain = plant.get("Kq") * travel / RATED_FLOW
    return ValveMap(edge, np.stack([gain, gain], axis=-1))
