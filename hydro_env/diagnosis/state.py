"""The state of a diagnosis: the results of its stages, for those that look at everything, and for the report."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..measured import Finding
from ..plant import PlantModel
from .logs import Logs
from .models.base import RigModel
from .stages.candidates import Selection
from .stages.localisation import Location
from .stages.naming import NamedEffect
from .stages.screening import Screening
from .stages.values import estimated_model
from .stages.verdict import Confirmed


@dataclass(frozen=True)
class State(Confirmed):
    """What the stages found, with the verdict that is confirmed.

    `verdict` is `none`: the model as given explains the logs; `calibration`: adjusting known parameters does; `effects`: the
    named `effects` do; `unknown`: something is missing that the catalogue does not explain.

    `undetermined` says why the fit logs do not determine the known parameters.
    """

    logs: Logs
    findings: list[Finding]
    screening: list[Screening]
    selection: Selection
    locations: list[Location]
    effects: list[NamedEffect]
    undetermined: list[str]

    @property
    def rig(self) -> RigModel:
        return self.logs.rig

    @cached_property
    def model(self) -> PlantModel:
        """The model with what was found; the one given where nothing is missing."""
        if self.verdict == "none":
            return self.rig.model
        return estimated_model(self.rig, self.models.final, f"{self.rig.model.name} diagnosed")

    @property
    def best_guess(self) -> bool:
        """Whether the named effects are only the best guess: they leave more of a speed of the held-out logs than its noise
        (`Settings.unexplained`). A reduced model is not held against the noise, which is not all that it leaves out."""
        unexplained = self.proofs.left(self.rig.channels, ["speed"]) > self.logs.fit.settings.unexplained
        return self.verdict == "effects" and unexplained
