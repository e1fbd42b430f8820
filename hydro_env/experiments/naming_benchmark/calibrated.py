"""The calibrated model of a rig, from which a method may begin, and whether it is enough."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

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


def begin(folder: Path) -> Start:
    """Calibrates the model of a rig's folder; `seconds` is the processor time that it took."""
    start = time.process_time()
    about = read_json(folder / "rig.json", "a rig of the naming benchmark")
    parts, held_out = read_logs(sorted(folder.glob("fit_*.csv")), [folder / "validation.csv"], None)
    model = load_model(folder / "model.yaml")
    rig = DynamicRig(model, parts, without=frozenset(BUILT_IN) - frozenset(about["candidates"]))
    fine, others = rig.with_parts(parts, False), rig.with_parts(held_out, True)
    found = calibration.run(consistency.run(Logs(Fit(rig, {}, Settings()), fine, others)))
    estimates = found.estimates
    errors = prove(others, {"before": found.given, "calibrated": estimates, "after": estimates}).errors

    def above(which: str) -> tuple[int, ...]:
        speeds = {c: e for (c, signal), e in errors.items() if signal == "speed"}
        return tuple(c for c, e in speeds.items() if e[which] > EXPLAINED * e["noise"])

    missing = above("calibrated")
    verdict = "unknown" if missing else "calibration" if above("before") else "none"
    best = model if verdict == "none" else estimated_model(rig, estimates, "calibrated")
    return Start(rig, estimates, best, verdict, missing, time.process_time() - start)
