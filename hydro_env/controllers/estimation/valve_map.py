"""The steady flow curve of a valve, as a controller knows it; units as in `estimation.nominal`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydro_env.controllers.base import Floats

__all__ = ["ValveMap"]


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
