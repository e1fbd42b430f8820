"""The diagnosis as a list of stages over one state: from logs to a verdict, its reasons and an improved model.

    found = diagnose(["fit_1.csv", "fit_2.csv"], ["held_out.csv"], model="paper")
    print(found.verdict, found.effects)
    found.report("report.html")

`LOG@FROM:TO` names a part of a log in seconds, `LOG@0:13,23:34` two windows of it; so one long run can serve for both
fit and proof. Axes whose mapping says `actuator: cylinder`, or any with `steady`, are diagnosed with the reduced
steady-valve model (`models.steady_valve`), everything else with the dynamic plant (`models.dynamic_rig`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from ..measured import Mapping, RigLog
from ..plant import PlantModel, load_model
from .estimation import Fit
from .input.checks import read_logs
from .models.choice import rig_model
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
    row_times,
    screening,
    selection,
    settling,
    uncertainty,
    validation,
    verdict,
    warnings,
)
from .state import State

__all__ = ["STAGES", "diagnose"]

#: The settings unless others are given.
DEFAULT = Settings()
#: The stages in their order, each with what a progress bar says.
STAGES: tuple[tuple[str, Callable[[State], State]], ...] = (
    ("model as given", consistency.run),
    ("calibrating known parameters", calibration.run),
    ("does a coupling rattle?", rattling.run),
    ("screening every effect", screening.run),
    ("selecting effects", selection.run),
    ("verdict of the fit logs", verdict.decide),
    ("locating the residual", localisation.run),
    ("correcting the form of what is named", form_correction.run),
    ("settling on the minimum", settling.run),
    ("validation on held-out logs", validation.run),
    ("uncertainty", uncertainty.run),
    ("verdict of the held-out logs", verdict.confirm),
    ("naming", naming.run),
    ("next experiment", next_experiment.run),
    ("warnings", warnings.run),
)


def diagnose(
    fit: Sequence[str | Path | RigLog], sealed: Sequence[str | Path | RigLog], model: str | Path | PlantModel = "paper",
    mapping: Mapping | str | Path | None = None, *, jobs: int = 1, steady: bool = False, without: Collection[str] = (),
    accept: Collection[str] = (), settings: Settings = DEFAULT,
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
        settings: thresholds, the seed of the bootstrap, and rules to switch off for an ablation.
        progress: called with what is being done and the number of simulations done since the last call.

    Raises:
        InputError: for anything that cannot be used.
    """
    begin = time.perf_counter()
    given = load_model(model)
    doing = "reading logs"

    def say(text: str) -> None:
        nonlocal doing
        doing = text
        progress(doing, 0)

    # Threads of the linear algebra would wait for each other and for those that simulate: its matrices are narrow.
    with threadpool_limits(1, "blas"):
        say(doing)
        parts, held_out = read_logs(fit, sealed, mapping, accept)
        rig = rig_model(given, parts, steady, jobs, lambda done: progress(doing, done), frozenset(without))
        parts, held_out = row_times.settled(rig, parts), row_times.settled(rig, held_out)
        rig.close()
        rig = rig_model(given, parts, steady, jobs, lambda done: progress(doing, done), frozenset(without))
        # Where the dynamics are simulated, the proof has a tighter tolerance than the fit.
        fine = rig.with_parts(parts, False) if rig.has_hidden_states else rig
        others = rig.with_parts(held_out, True)
        state = State(given, Fit(rig, {}, settings), fine, others, held_out, frozenset(accept), say)
        try:
            for text, stage in STAGES:
                say(text)
                state = stage(state)
        finally:
            for one in (rig, fine, others):
                one.close()
    return Diagnosis(state, time.perf_counter() - begin)
