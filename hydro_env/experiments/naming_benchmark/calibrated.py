"""The calibrated model of a rig, from which a method may begin: whether it is enough, and an answer beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...diagnosis.estimation.estimate import Estimate
from ...diagnosis.estimation.fit import Fit
from ...diagnosis.input.checks import read_logs
from ...diagnosis.logs import Logs
from ...diagnosis.models.dynamic_rig import DynamicRig
from ...diagnosis.settings import Settings
from ...diagnosis.stages import calibration, consistency
from ...diagnosis.stages.validation import prove
from ...diagnosis.stages.values import estimated_model
from ...plant import BUILT_IN, PlantModel, load_model
from ...reading import read_json
from .answers import answer

Named = list[dict[str, Any]]

#: A speed of the validation log within this multiple of its noise counts as explained.
EXPLAINED = 1.3


@dataclass(frozen=True)
class Start:
    """A rig with its calibrated model: `verdict` is none, calibration, or unknown where the calibrated model leaves a speed of
    the validation log above its noise, on the channels `open`."""

    rig: DynamicRig
    estimates: Mapping[int, Estimate]
    model: PlantModel
    verdict: str
    open: tuple[int, ...]
    seconds: float


@lru_cache(maxsize=1)
def begin(folder: Path) -> Start:
    """Calibrates the model of a rig's folder. The last one is kept, with the processor time that it took."""
    start = time.process_time()
    about = read_json(folder / "rig.json", "a rig of the naming benchmark")
    parts, held_out = read_logs(sorted(folder.glob("fit_*.csv")), [folder / "validation.csv"], None)
    model = load_model(folder / "model.yaml")
    rig = DynamicRig(model, parts, without=frozenset(BUILT_IN) - frozenset(about["candidates"]))
    fine, others = rig.with_parts(parts, False), rig.with_parts(held_out, True)
    found = calibration.run(*consistency.run(Logs(Fit(rig, {}, Settings()), fine, others)))
    estimates = found.estimates
    errors = prove(others, {"before": found.given, "calibrated": estimates, "after": estimates}).errors

    def above(which: str) -> tuple[int, ...]:
        speeds = {c: e for (c, signal), e in errors.items() if signal == "speed"}
        return tuple(c for c, e in speeds.items() if e[which] > EXPLAINED * e["noise"])

    missing = above("calibrated")
    verdict = "unknown" if missing else "calibration" if above("before") else "none"
    best = model if verdict == "none" else estimated_model(rig, estimates, "calibrated")
    return Start(rig, estimates, best, verdict, missing, time.process_time() - start)


def answer_beside(start: Start, clock: float, rig: str, named: Named, **file: str) -> dict[str, Any]:
    """The answer of a method that began with `start` and went on at the processor time `clock`."""
    seconds = start.seconds + time.process_time() - clock
    return answer(rig, "effects" if named else start.verdict, named, seconds, **file)


def name_beside(name_them: Callable[[Start], Named], folder: Path, out: Path) -> dict[str, Any]:
    """Asks for names where the calibrated model is not enough; the answer takes the held-out error of that model."""
    start = begin(folder)
    clock = time.process_time()
    named = name_them(start) if start.verdict == "unknown" else []
    start.model.to_yaml(out / f"{folder.name}.yaml", source="calibration")
    return answer_beside(start, clock, folder.name, named, model=f"{folder.name}.yaml")
