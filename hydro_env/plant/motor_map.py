"""Steady flow, torque and efficiencies of a model's motor over pressure and speed: what a catalogue of motors shows."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Floats
from .catalogue import CATALOGUE
from .catalogue.effect import arguments
from .catalogue.losses import FAMILY
from .model import PlantModel


@dataclass(frozen=True)
class MotorMap:
    """A motor at steady points, arrays of one shape: `pressure` Pa, `speed` rad/s, `flow` m3/s, `torque` N m, `loss` W.

    `flow` enters at the first port, `torque` acts on the load; `loss` is what goes in less what comes out. Efficiencies
    are those of motoring, in [0, 1] where the motor drives its load and NaN elsewhere.
    """

    pressure: Floats
    speed: Floats
    flow: Floats
    torque: Floats
    loss: Floats
    volumetric: Floats
    hydromechanical: Floats

    @property
    def total(self) -> Floats:
        """Volumetric times hydromechanical efficiency."""
        return self.volumetric * self.hydromechanical


def motor_map(model: PlantModel, pressure: ArrayLike, speed: ArrayLike, channel: int = 0) -> MotorMap:
    """The motor of channel 0 or 1 with Km, B and the loss models of `model`, without any other effect.

    `pressure` (Pa) and `speed` (rad/s) broadcast against each other.
    """
    p, w = np.broadcast_arrays(np.asarray(pressure, dtype=float), np.asarray(speed, dtype=float))
    base = model.channels[channel]
    known: dict[str, Any] = {**base, "pressure": p, "motor_pressure": p, "speed": w}
    known |= {"leakage": base["Km"] * p, "torque": -base["B"] * w}
    for name, pair in model.effects.items():
        if CATALOGUE[name].family == FAMILY:
            for quantity, law in CATALOGUE[name].laws.items():
                given = known | pair[channel]
                known[quantity] = np.vectorize(law, [float])(*(given[asked] for asked in arguments(law)))
    flow, torque = base["D"] * w + known["leakage"], base["D"] * p + known["torque"]
    loss = p * flow - torque * w
    with np.errstate(divide="ignore", invalid="ignore"):
        drives = (p * w > 0.0) & (torque * w > 0.0)
        volumetric = np.where(drives, base["D"] * w / flow, np.nan)
        hydromechanical = np.where(drives, torque / (base["D"] * p), np.nan)
    return MotorMap(p, w, flow, torque, loss, volumetric, hydromechanical)
