"""The diagnosis as stages, each a function of what it needs of those before: from logs to a verdict, its reasons and a model.

    found = diagnose(["fit_1.csv", "fit_2.csv"], ["held_out.csv"], model="paper")
    print(found.verdict, found.effects)
    found.report("report.html")

`LOG@FROM:TO` names a part of a log in seconds, `LOG@0:13,23:34` two windows of it; so one long run can serve for both
fit and proof. Axes whose mapping says `actuator: cylinder`, or any with `steady`, are diagnosed with the reduced
steady-valve model (`models.steady_valve`), everything else with the dynamic plant (`models.dynamic_rig`).
"""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from ..measured import Mapping, RigLog
from ..plant import PlantModel, load_model
from .logs import Logs, opened
from .result import Diagnosis
from .settings import Settings
from .stages import (
    calibration,
    consistency,
    form_correction,
    localisation,
    naming,
    next_experiment,
    rattling,
    screening,
    selection,
    uncertainty,
    validation,
    verdict,
    warnings,
)
from .stages.candidates import Selection
from .stages.verdict import Confirmed

#: The settings unless others are given.
DEFAULT = Settings()
#: The stages in their order, each with what a progress bar says.
STAGES: dict[Callable[..., Any], str] = {
    consistency.run: "model as given",
    calibration.run: "calibrating known parameters",
    form_correction.of_given: "correcting the form of given effects",
    rattling.run: "does a coupling rattle?",
    screening.run: "screening every effect",
    selection.run: "selecting effects",
    verdict.decide: "verdict of the fit logs",
    form_correction.run: "correcting the form of what is named",
    uncertainty.settle: "settling on the minimum",
    uncertainty.run: "uncertainty",
    validation.run: "validation on held-out logs",
    verdict.confirm: "verdict of the held-out logs",
    selection.without_weakest: "leaving out what may be absent",
    localisation.locate: "locating the residual",
    naming.run: "naming",
    next_experiment.run: "next experiment",
    warnings.run: "warnings",
}

Given = ParamSpec("Given")
Result = TypeVar("Result")


def diagnose(
    fit: Sequence[str | Path | RigLog], sealed: Sequence[str | Path | RigLog], model: str | Path | PlantModel = "paper",
    mapping: Mapping | str | Path | None = None, *, jobs: int = 1, steady: bool = False, without: Collection[str] = (),
    accept: Collection[str] = (), former: str | Path | PlantModel | None = None, settings: Settings = DEFAULT,
    progress: Callable[[str, int], None] = lambda text, simulations: None,
) -> Diagnosis:  # fmt: skip
    """Finds out from logs what a model of the rig lacks.

    Args:
        fit: logs to fit, as paths, parts of them (`LOG@FROM:TO`) or logs that are loaded.
        sealed: logs that take no part in the fit and confirm what was found.
        model: preset, YAML file or model that is to be improved.
        mapping: what the columns of the logs mean, where their header does not say it.
        jobs: threads that simulate; the result does not depend on it.
        steady: whether to use the reduced steady-valve model.
        without: effects that are not to be candidates.
        accept: codes of findings (`sign`, `swapped`, `unit`, ...) that would otherwise stop a diagnosis.
        former: model that a diagnosis of some of the logs with the same `model` has found: its effects compete with those that
            are found anew, and stay where they explain more.
        settings: thresholds, the seed of the bootstrap, and rules to switch off for an ablation.
        progress: called with what is being done and the number of simulations done since the last call.

    Raises:
        InputError: for anything that cannot be used.
    """
    begin, doing = time.perf_counter(), "reading logs"

    def say(text: str) -> None:
        nonlocal doing
        doing = text
        progress(doing, 0)

    say(doing)
    with opened(
        fit, sealed, model, mapping, accept, steady=steady, jobs=jobs, settings=settings, without=without,
        count=lambda done: progress(doing, done),
    ) as logs:  # fmt: skip
        found = _find(logs, accept, None if former is None else load_model(former), say)
    return replace(found, seconds=time.perf_counter() - begin)


def _find(
    logs: Logs, accept: Collection[str], former: PlantModel | None, say: Callable[[str], None]
) -> Diagnosis:
    """All stages in their order, each with what it needs of those before; without the time that they took."""

    def do(stage: Callable[Given, Result], *needs: Given.args, **more: Given.kwargs) -> Result:
        say(STAGES[stage])
        return stage(*needs, **more)

    calibrated = do(calibration.run, *do(consistency.run, logs, accept))
    calibrated, forms = do(form_correction.of_given, calibrated)
    calibrated = do(rattling.run, calibrated, calibrated.estimates)
    while True:
        screened = do(screening.run, calibrated.logs, calibrated.estimates, calibrated.backlashes)
        selected = do(selection.run, calibrated, screened, former)
        # An effect that explains more may have hidden a coupling that rattles: then all is selected beside that.
        following = do(rattling.run, calibrated, selected.in_best_form())
        if following is calibrated:
            break
        calibrated = following
    logs = selected.logs

    def judged(chosen: Selection) -> Confirmed:
        first = do(verdict.decide, calibrated, chosen)
        models = do(form_correction.run, calibrated.given, chosen, first, forms)
        shown = do(uncertainty.run, logs, do(uncertainty.settle, logs, models.shown))
        models = models.with_shown(shown)
        return do(verdict.confirm, chosen, first, models, do(validation.run, logs, models))

    fewer, found = selected, judged(selected)
    again = found
    while again.absent and len(fewer.accepted) > 1:
        fewer = do(selection.without_weakest, fewer, again.absent)
        again = judged(fewer)
    if again.verdict == "effects":
        selected, found = fewer, again
    missing = found.verdict not in ("none", "calibration")
    locations = do(localisation.locate, logs.rig, selected.calibrated) if missing else []
    effects = do(naming.run, selected, found)
    state = Diagnosis(
        **vars(found), logs=logs, findings=calibrated.findings, screening=screened, selection=selected, locations=locations,
        effects=effects, undetermined=list(uncertainty.undetermined(logs.rig)),
    )  # fmt: skip
    return replace(state, next_experiment=do(next_experiment.run, state), warnings=do(warnings.run, state))
