"""The result of a diagnosis: verdict, effects, improved model, and diagnosis.json."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..files import write_text
from ..measured import Finding
from ..plant import CATALOGUE, PlantModel
from .logs import Logs, place_of
from .models.base import RigModel
from .stages.candidates import Correction, Selection
from .stages.localisation import Location
from .stages.naming import NamedEffect
from .stages.screening import Screening, detectable, hidden_by_calibration
from .stages.values import KnownParameter, effect_values, estimated_model, known_parameters
from .stages.verdict import Confirmed

if TYPE_CHECKING:
    from .stages.next_experiment import NextExperiment

SCHEMA = "hydro_env/diagnosis/1"


@dataclass(frozen=True)
class Diagnosis(Confirmed):
    """What was found, with the estimates, simulated signals and proofs behind it; `seconds` is the time it took.

    `verdict` is `none`: the model as given explains the logs; `calibration`: adjusting known parameters does; `effects`: the
    named `effects` do; `unknown`: something is missing that the catalogue does not explain.

    `undetermined` says why the fit logs do not determine the known parameters. The last two stages look at everything else and
    add the `next_experiment` and the `warnings`.
    """

    logs: Logs
    findings: list[Finding]
    screening: list[Screening]
    selection: Selection
    locations: list[Location]
    effects: list[NamedEffect]
    undetermined: list[str]
    next_experiment: "NextExperiment | None" = None
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0

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
    def known(self) -> list[KnownParameter]:
        """The known parameters as they are reported."""
        return [*known_parameters(self.rig, self.models.shown)]

    @property
    def best_guess(self) -> bool:
        """Whether the named effects are only the best guess: they leave more of a speed of the held-out logs than its noise
        (`Settings.unexplained`). A reduced model is not held against the noise, which is not all that it leaves out."""
        unexplained = self.proofs.left(self.rig.channels, ["speed"]) > self.logs.fit.settings.unexplained
        return self.verdict == "effects" and unexplained

    def report(self, path: str | Path) -> None:
        """Writes the report, an HTML page that needs no network. Needs the extra `report`."""
        from .report.page import report_page

        write_text(Path(path), report_page(self))

    def summary(self) -> str:
        """The report in about twenty lines of text."""
        from .report.statements import summary

        return summary(self)

    def as_dict(self) -> dict[str, Any]:
        """The content of diagnosis.json, of schema `SCHEMA`.

        `best_guess`, `candidates`, `warnings`, `hidden_by_calibration` and `form_corrections` go beyond the contract. Where there
        are form corrections, "after" is the model with them, "named" in `gap` the one with the effects alone.
        """
        logs = (*self.rig.parts, *self.logs.held_out.parts)
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "best_guess": self.best_guess,
            "effects": [n.as_dict() for n in self.effects],
            "where": [p.as_dict() for p in self.locations],
            "calibrated": {p.name: {"nominal": p.nominal, **vars(p.estimate)} for p in self.known},
            "gap": {"sealed": self.proofs.held_out.as_dict(), "fit": self.proofs.fit.as_dict()},
            "form_corrections": [self._correction(k) for k in self.models.corrections],
            "next_experiment": self.next_experiment.as_dict() if self.next_experiment else None,
            "detectable": detectable(self.screening),
            "hidden_by_calibration": hidden_by_calibration(self.screening),
            "seconds": round(self.seconds, 1),
            "log_sha256": {p.log.name: p.log.sha256 for p in logs},
            "candidates": [t.as_dict() for t in self.selection.candidates],
            "warnings": self.warnings,
        }

    def _correction(self, kept: Correction) -> dict[str, Any]:
        """What a form correction corrects, and its numbers."""
        values = effect_values(self.models.final, kept.correction, kept.channel)
        return {
            "effect": kept.effect, "correction": kept.correction, "what": CATALOGUE[kept.correction].summary,
            "channel": place_of(kept.channel), "note": "form correction, not physics",
            "parameters": {name: vars(p) for name, p in values.items()}, "fall": round(float(kept.fall), 1),
        }  # fmt: skip
