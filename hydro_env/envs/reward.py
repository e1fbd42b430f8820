"""The reward: what a step costs, in terms an engineer can read."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from ..arrays import Floats
from ..errors import InputError, check_known, shown
from ..limits import Limits

WEIGHT = Limits(0.0, 1e6)


@dataclass(frozen=True)
class Reward:
    """Weights of the cost of a control period; the reward is the negative sum of

    tracking * |speed - set-point| / 100 rpm, mean of both motors
    difference * |speed 1 - speed 2| / 100 rpm (both on the paper's rig, on another one in proportion to its speed)
    variation * |command - command before|, mean of both valves, as a fraction of the rated command
    divergence, once, if the simulation diverges numerically (which ends the episode)

    Speeds are the true ones at the end of the period, the set-point is the one in force during it. With the defaults a
    motor 100 rpm off costs 0.25 and 100 rpm between the motors cost 1.5; a good controller loses about 0.2 a step.
    """

    tracking: float = 0.5
    difference: float = 1.5
    variation: float = 0.1
    divergence: float = 10.0

    def weights(self, speed: float = 1.0) -> Floats:
        """The four weights per rpm, rpm, fraction and event on a rig of this scale of speed, and the speed difference, rpm,
        beyond which `cost_difference` counts; what good controllers stay below once the motors run."""
        unit = 100.0 * speed
        per_rpm = self.tracking / unit, self.difference / unit
        return np.array([*per_rpm, self.variation, self.divergence, 20.0 * speed])


def load_reward(source: Mapping[str, float] | Reward | None) -> Reward:
    """Weights from a mapping of those to be changed; None for the defaults. InputError for anything unknown."""
    if source is None or isinstance(source, Reward):
        return source or Reward()
    if not isinstance(source, Mapping):
        raise InputError(f"reward: expected a mapping of weights or a function, found {shown(source)}")
    check_known("reward: unknown weight", source, asdict(Reward()))
    return Reward(**{key: WEIGHT.check(value, f"reward: {key}") for key, value in source.items()})
