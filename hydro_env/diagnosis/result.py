"""The result of a diagnosis: verdict, effects, improved model, and diagnosis.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..files import write_text
from ..plant import CATALOGUE
from .logs import place_of
from .stages.candidates import Correction
from .stages.next_experiment import NextExperiment
from .stages.screening import detectable, hidden_by_calibration
from .stages.values import effect_values, known_parameters
from .state import State

SCHEMA = "hydro_env/diagnosis/1"


@dataclass(frozen=True)
class Diagnosis(State):
    """What was found, with the estimates, simulated signals and proofs behind it; `seconds` is the time it took."""

    next_experiment: NextExperiment | None = None
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def report(self, path: str | Path) -> None:
        """Writes the report, an HTML page that needs no network. Needs the extra `report`."""
        from .report.page import report_page

        write_text(Path(path), report_page(self))

    def summary(self) -> str:
        """The report in about twenty lines of text."""
        from .report.summary import summary

        return summary(self)

    def as_dict(self) -> dict[str, Any]:
        """The content of diagnosis.json, of schema `SCHEMA`.

        `best_guess`, `candidates`, `warnings`, `hidden_by_calibration` and `form_corrections` go beyond the contract. Where there
        are form corrections, "after" is the model with them, "named" in `gap` the one with the effects alone.
        """
        logs = (*self.rig.parts, *self.logs.held_out.parts)
        known = known_parameters(self.rig, self.models.shown)
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "best_guess": self.best_guess,
            "effects": [n.as_dict() for n in self.effects],
            "where": [p.as_dict() for p in self.locations],
            "calibrated": {p.name: {"nominal": p.nominal, **vars(p.estimate)} for p in known},
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
        first = self.rig.channels[0] if kept.channel is None else kept.channel
        values = effect_values(self.models.final[first], kept.correction, first)
        return {
            "effect": kept.effect, "correction": kept.correction, "what": CATALOGUE[kept.correction].summary,
            "channel": place_of(kept.channel), "note": "form correction, not physics",
            "parameters": {name: vars(p) for name, p in values.items()}, "fall": round(float(kept.fall), 1),
        }  # fmt: skip
