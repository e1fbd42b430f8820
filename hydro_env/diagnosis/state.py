"""The state of a diagnosis: what every stage reads, and what it adds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..measured import Finding
from ..plant import PlantModel
from .estimation import Estimate, Fit
from .input.parts import Part
from .models.base import RigModel
from .settings import Settings

if TYPE_CHECKING:
    from .stages.candidates import Selection
    from .stages.form_correction import Correction
    from .stages.localisation import Location
    from .stages.naming import NamedEffect
    from .stages.next_experiment import NextExperiment
    from .stages.screening import Screening
    from .stages.validation import Proof

__all__ = ["Estimates", "State"]

#: Named effects that leave a speed of the held-out logs above so many times its noise are not proven.
PROVEN = 1.5

#: Estimates by channel; the same one for both where the whole rig was estimated together.
Estimates = dict[int, Estimate]


@dataclass(frozen=True)
class State:
    """What is known so far; a stage returns a copy with more in it.

    `fit` is the model of the rig with the logs to fit and their noise, `fine` the same with the accuracy of the proof, `held_out`
    the model with the logs that take no part in the fit. Estimates: `given` the model as given, `calibrated` with known
    parameters adjusted, `final` what was found, with corrections of form, `placebo` the best wrong effect instead.
    `on_fit` and `on_held_out` are the errors of free simulations, which are reported, `judged_fit` and `judged` those by which
    names are judged: their simulations follow the measured speed where a coupling rattles.
    `undetermined` says why the fit logs do not determine the known parameters, `elsewhere` why the held-out logs seem to be of
    another rig or state.
    """

    model: PlantModel
    fit: Fit
    fine: RigModel
    held_out: RigModel
    held_out_parts: list[Part]
    accept: frozenset[str] = frozenset()
    progress: Callable[[str], None] = lambda text: None

    findings: list[Finding] = field(default_factory=list)
    given: Estimates = field(default_factory=dict)
    calibrated: Estimates = field(default_factory=dict)
    screening: list[Screening] = field(default_factory=list)
    selection: Selection = None  # type: ignore[assignment]  # set by the stage of that name, like all that follows
    verdict: str = ""
    locations: list[Location] = field(default_factory=list)
    final: Estimates = field(default_factory=dict)
    placebo: Estimates = field(default_factory=dict)
    corrections: list[Correction] = field(default_factory=list)
    on_fit: Proof = None  # type: ignore[assignment]
    on_held_out: Proof = None  # type: ignore[assignment]
    judged_fit: Proof = None  # type: ignore[assignment]
    judged: Proof = None  # type: ignore[assignment]
    doubts: list[str] = field(default_factory=list)
    undetermined: list[str] = field(default_factory=list)
    elsewhere: list[str] = field(default_factory=list)
    effects: list[NamedEffect] = field(default_factory=list)
    next_experiment: NextExperiment | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def rig(self) -> RigModel:
        return self.fit.rig

    @property
    def settings(self) -> Settings:
        return self.fit.settings

    @property
    def seconds(self) -> float:
        """Length of the longest log to fit, s."""
        return max(len(p.log) * p.log.period for p in self.rig.parts)

    @property
    def best_guess(self) -> bool:
        """Whether the named effects are only the best guess: they leave more of a speed of the held-out logs than its noise
        (`PROVEN`). A reduced model is not held against the noise, which is not all that it leaves out."""
        if self.verdict != "effects" or not self.rig.has_hidden_states:
            return False
        errors = self.judged.errors
        return any(e["after"] > PROVEN * e["noise"] for (_, signal), e in errors.items() if signal == "speed")

    @property
    def shown(self) -> Estimates:
        """The estimates whose known parameters are reported."""
        return self.calibrated if self.verdict == "none" else self.final
