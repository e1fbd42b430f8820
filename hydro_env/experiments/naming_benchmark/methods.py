"""Methods that ship: each gets the folder of a rig and writes its answer, as anybody else's would.

diagnose   the diagnosis of this package
calibrate  known parameters adjusted, no effect named
ask        the diagnosis, and the questions that it asks (`dialogue`)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ...diagnosis import Diagnosis, diagnose
from ...errors import check_known
from ...files import write_json
from ...plant import BUILT_IN
from ...reading import read_json
from .answers import answer, read_answer
from .calibrated import begin
from .certainty import WHOLE
from .dialogue import Designer, asked, converse
from .sets import read_set

#: Takes the folder of a rig and a folder for its answer's files, and returns the answer; None where it waits for a log.
Method = Callable[[Path, Path], dict[str, Any] | None]


def diagnosed(folder: Path, answers: Sequence[Path] = ()) -> Diagnosis:
    """The diagnosis of a rig's logs and `answers`."""
    rig = read_json(folder / "rig.json", "a rig of the naming benchmark")
    logs = [*sorted(folder.glob("fit_*.csv")), *answers]
    without = [n for n in BUILT_IN if n not in rig["candidates"]]
    return diagnose(logs, [folder / "validation.csv"], folder / "model.yaml", without=without)


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
