"""What an estimate of the valves is compared with."""

from __future__ import annotations

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.bench_map import ValveMap
from hydro_env.controllers.estimation.nominal import RATED_FLOW
from hydro_env.plant import Plant


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
