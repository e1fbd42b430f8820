"""Methods that ship: each gets the folder of a rig and writes its answer, as anybody else's would.

diagnose   the diagnosis of this package
calibrate  known parameters adjusted, no effect named
ask        the diagnosis, and the questions that it asks (`dialogue`)
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ...diagnosis import Diagnosis, diagnose
from ...diagnosis.estimation.estimate import Estimate
from ...diagnosis.estimation.fit import Fit
from ...diagnosis.input.checks import read_logs
from ...diagnosis.logs import Logs
from ...diagnosis.models.dynamic_rig import DynamicRig
from ...diagnosis.settings import Settings
from ...diagnosis.stages import calibration, consistency
from ...diagnosis.stages.validation import prove
from ...diagnosis.stages.values import estimated_model
from ...errors import check_known
from ...files import write_json
from ...plant import BUILT_IN, PlantModel, load_model
from ...reading import read_json
from .answers import WHOLE, answer, read_answer
from .dialogue import Designer, asked, converse
from .sets import read_set

#: Takes the folder of a rig and a folder for its answer's files, and returns the answer; None where it waits for a log.
Method = Callable[[Path, Path], dict[str, Any] | None]

#: A speed of the validation log within this multiple of its noise counts as explained.
EXPLAINED = 1.3


def diagnosed(folder: Path, answers: Sequence[Path] = ()) -> Diagnosis:
    """The diagnosis of a rig's logs and `answers`."""
    rig = read_json(folder / "rig.json", "a rig of the naming benchmark")
    logs = [*sorted(folder.glob("fit_*.csv")), *answers]
    without = [n for n in BUILT_IN if n not in rig["candidates"]]
    return diagnose(logs, [folder / "validation.csv"], folder / "model.yaml", without=without)


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


def _calibrate(folder: Path, out: Path) -> dict[str, Any]:
    start = begin(folder)
    start.model.to_yaml(out / f"{folder.name}.yaml", source="calibration")
    return answer(folder.name, start.verdict, [], start.seconds, model=f"{folder.name}.yaml")


def asking(design: Designer, folder: Path, out: Path) -> dict[str, Any] | None:
    """Diagnoses a rig, asks it what `design` proposes, and diagnoses again; None while a question waits for an answer."""
    start = time.process_time()
    found = converse(design, partial(diagnosed, folder), folder, out / folder.name)
    if found is None:
        return None
    data, name = found.as_dict(), f"{folder.name}.yaml"
    (out / WHOLE).mkdir(exist_ok=True)
    write_json(out / WHOLE / f"{folder.name}.json", data)
    found.model.to_yaml(out / name, source="diagnosis of logs")
    effects = data["effects"] if found.verdict == "effects" else []
    named = [{key: effect[key] for key in ("name", "channel", "probability")} for effect in effects]
    return answer(folder.name, found.verdict, named, time.process_time() - start, model=name)


METHODS: dict[str, Method] = {
    "diagnose": partial(asking, lambda found, rng: None),
    "calibrate": _calibrate,
    "ask": partial(asking, asked),
}


def chosen(words: Sequence[str], methods: Mapping[str, Method]) -> dict[str, Method]:
    """The methods of these names, or all for `all`. InputError for a name that none has."""
    check_known("unknown method", words, [*methods, "all"])
    return dict(methods) if "all" in words else {word: methods[word] for word in words}


def run_methods(methods: Mapping[str, Method], folder: Path, out: Path) -> None:
    """Runs methods on every rig of the set in `folder`; answers go to `out/METHOD`. What is there already is kept.

    InputError for a set that cannot be read, or a malformed answer of an earlier run.
    """
    bar = tqdm(list(product(read_set(folder)["rigs"], methods)), unit="answer", disable=None)
    for rig, name in bar:
        bar.set_description(f"{rig} {name}")
        own = out / name
        own.mkdir(parents=True, exist_ok=True)
        path = own / f"{rig}.json"
        if path.exists():
            read_answer(path, rig)
        else:
            found = methods[name](folder / "rigs" / rig, own)
            if found is not None:
                write_json(path, found)
