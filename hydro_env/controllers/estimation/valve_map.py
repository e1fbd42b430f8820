"""The steady flow curve of a valve, as a controller knows it; units as in `estimation.nominal`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.nominal import RATED_FLOW
from hydro_env.plant import Plant

__all__ = ["ValveMap", "true_map"]


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
