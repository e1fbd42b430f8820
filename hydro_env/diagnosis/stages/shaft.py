"""The shaft alone in the logs: how measured pressure and load would turn it, a filter, and how it turned."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ..input.parts import Part, filled
from ..models.base import RigModel

#: Base parameters of the shaft.
SHAFT = ("D", "J", "B")
#: Least viscous friction, N m s/rad, so that the filter has a time constant.
MIN_FRICTION = 1e-6


@dataclass(frozen=True)
class Shaft:
    """A shaft in one log, every `period`: pressure, load and measured speed (n,), SI, without holes; `used` are the rows that
    count and have both signals."""

    pressure: np.ndarray
    load: np.ndarray
    speed: np.ndarray
    used: np.ndarray
    period: float

    def driven(self, values: Mapping[str, float]) -> np.ndarray:
        """The speed (n,) of J dw/dt = D p - B w - load from rest, with these values of `SHAFT`. The load is held for a period;
        between two samples of the pressure stands their mean, as held it would come half a period late."""
        friction = max(values["B"], MIN_FRICTION)
        keep = float(np.exp(-self.period * friction / values["J"]))
        between = 0.5 * (self.pressure[1:] + self.pressure[:-1])
        torque = np.concatenate([[0.0], values["D"] * between - self.load[:-1]])
        return np.asarray(lfilter([(1.0 - keep) / friction], [1.0, -keep], torque))


def shaft_of(
    part: Part, turning: int, pressing: int | None = None, loaded: int | None = None, step: int = 1
) -> Shaft | None:
    """The shaft of channel `turning`, every `step` rows, with the pressure of `pressing` and the load of `loaded` (of the same
    channel if None); None where a tenth of its pressure or more is missing: what drives it there is not known."""
    log, pressing, loaded = part.log, *(turning if c is None else c for c in (pressing, loaded))
    if log.pressure is None or not (log.has("pressure", pressing) and log.has("speed", turning)):
        return None
    pressure, speed = log.pressure[::step, pressing], log.speed[::step, turning]
    if np.isfinite(pressure).mean() < 0.9:
        return None
    load = np.zeros(len(log))
    if log.load is not None and log.has("load", loaded):
        load = np.nan_to_num(log.load[:, loaded])
    used = part.inside[::step] & np.isfinite(speed) & np.isfinite(pressure)
    return Shaft(filled(pressure), load[::step], filled(speed), used, log.period * step)


def given_shaft(rig: RigModel, channel: int) -> dict[str, float]:
    """The values of `SHAFT` in the model as given."""
    return {name: rig.model.value(name, channel) for name in SHAFT}
