"""What all stages work on: a model of the rig with its logs."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from .estimation.fit import Fit
from .models.base import RigModel


@dataclass(frozen=True)
class Logs:
    """The model of the rig with all logs: `fit` with those to fit and their noise, `fine` the same with the accuracy of the
    proof, `held_out` with those that take no part in the fit."""

    fit: Fit
    fine: RigModel
    held_out: RigModel

    @property
    def rig(self) -> RigModel:
        return self.fit.rig

    @property
    def seconds(self) -> float:
        """Length of the longest log to fit, s."""
        return max(len(p.log) * p.log.period for p in self.rig.parts)

    def following(self, channels: Collection[int]) -> Logs:
        """The same with the simulated speed of these channels drawn to the measured one."""
        fine, held_out = (rig.following(channels) for rig in (self.fine, self.held_out))
        return Logs(self.fit.on(self.rig.following(channels)), fine, held_out)


def place_of(channel: int | None) -> str:
    """ "1" or "2" for a channel, "rig" for None."""
    return "rig" if channel is None else str(channel + 1)
