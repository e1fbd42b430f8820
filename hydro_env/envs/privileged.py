"""What the simulation knows and no sensor shows, for the critic of an asymmetric actor-critic (L. Pinto et al.: Asymmetric actor
critic for image-based robot learning, Robotics: Science and Systems, 2018)."""

from typing import Any

import numpy as np

from ..arrays import Floats, Singles
from ..plant import Plant, PlantModel, Scales
from ..tasks.mismatch import Mismatch, own_values
from ..tasks.rigs import DERIVED, PACE, power_of_pace
from ..tasks.scenarios import NOMINAL_TORQUE
from .observation import LIMIT, scales_on
from .randomisation import Randomisation
from .rollout import Rollout

#: Drawn values are clipped here: a sensor that is never stuck is so from an infinite time on.
BEYOND = 2.0
NOISE_NAMES = ("noise_speed", "noise_current", "noise_pressure")


def privileged_names(env: Any) -> tuple[str, ...]:
    """What the numbers of `info["privileged"]` are, of an environment made with `privileged=True`, single or many.

    What is drawn lies in [-1, 1] over its range, in the logarithm where it is drawn so: levels of the noise ("noise_speed", ...),
    then parameters that have ranges in the mismatch that the environment was made with, of both valves ("Kq_1", "Kq_2", ...).
    Then true speeds, currents and pressure differences, scaled like the observation, spool positions ("spool_1", 1.0 for 1 mm)
    and loads ("load_1", 1.0 for the nominal torque; both on the paper's rig, on another one in proportion to its size). An FMU
    shows no spools. ValueError for an environment made without.
    """
    batch = getattr(getattr(env, "unwrapped", env), "batch", getattr(env, "unwrapped", env))
    if batch.privileged is None:
        raise ValueError("the environment was made without privileged=True")
    return tuple(batch.privileged.names)


class Privileged:
    """`names` (k,) says what the k numbers of a row are, see `privileged_names`."""

    def __init__(
        self, rollout: Rollout, drawn: Randomisation, mismatch: Mismatch | None, noise: Floats, rig: Scales
    ) -> None:
        """`noise` (2, 6): the levels between which it is drawn."""
        self._rollout, self._drawn = rollout, drawn
        self._random_noise = np.flatnonzero(noise[0] < noise[1])[::2]
        self._noise = noise[:, self._random_noise]
        spans = {} if mismatch is None else {n: _span(n, mismatch, drawn.model) for n in mismatch.parameters}
        self._spans = {name: span for name, span in spans.items() if (span[0] < span[1]).any()}
        speed, current, pressure = scales_on(rig)[[1, 3, 5]]
        states = {"speed": speed, "current": current, "pressure": pressure, "spool": 1e-3 * rig.travel}
        self._states = {name: scale for name, scale in states.items() if _shows(rollout.plant, name)}
        self._torque = NOMINAL_TORQUE * rig.torque
        channels = [f"{name}_{c}" for name in (*self._spans, *self._states, "load") for c in (1, 2)]
        self.names = (*(NOISE_NAMES[j // 2] for j in self._random_noise), *channels)
        self.draw()

    def draw(self) -> None:
        """Takes over what is drawn for the present episodes."""
        parts = [_share(self._rollout.deviation[:, self._random_noise], *self._noise)]
        parts += [_share(self._drawn.value(n, self._rollout.plant), *span) for n, span in self._spans.items()]
        self._values = np.clip(np.concatenate(parts, axis=1), -BEYOND, BEYOND)

    def now(self) -> Singles:
        """The numbers (N, k) of all rows as they are now."""
        states = [self._rollout.plant.get(name) / scale for name, scale in self._states.items()]
        states.append(self._rollout.state["load"] / self._torque)
        found = np.concatenate([self._values, np.clip(np.concatenate(states, axis=1), -LIMIT, LIMIT)], axis=1)
        return found.astype(np.float32)


def _span(name: str, mismatch: Mismatch, model: PlantModel) -> tuple[Floats, Floats, bool]:
    """Least and largest value (2,) that a parameter is given, faults included; whether it is drawn in its logarithm."""
    ranges = [each[name] for each in (mismatch.ranges, *mismatch.faults.values()) if name in each]
    if not ranges or (name in DERIVED and mismatch.rig):  # follows from others
        return np.zeros(2), np.zeros(2), False
    ends = [each.scaled(name, np.array([end]), model)[0] for each in ranges for end in (each.low, each.high)]
    if name not in mismatch.ranges and np.isfinite(own := own_values(name, model)).all():
        ends.append(np.array(own))
    if PACE in mismatch.rig and (power := power_of_pace(name)):
        ends = [end * pace**power for end in ends for pace in mismatch.rig[PACE].ends]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    return low, high, bool(all(each.loguniform for each in ranges) and (low > 0.0).all())


def _share(value: Floats, low: Floats, high: Floats, logarithmic: bool = False) -> Floats:
    """Values (N, n), -1 at the low and 1 at the high end (n,); 0 where there is nothing between them."""
    if logarithmic:
        least = 1e-9 * low  # before the first reset values are 0
        value, low, high = (np.log(np.maximum(each, least)) for each in (value, low, high))
    return np.asarray((2.0 * value - low - high) / np.where(low < high, high - low, np.inf))


def _shows(plant: Plant, name: str) -> bool:
    """Whether the plant has this signal."""
    try:
        return plant.row_of(name) >= 0
    except KeyError:
        return False
