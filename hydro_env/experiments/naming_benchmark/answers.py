"""Answers: `NAME.json` for each rig, and beside it what the answer refers to.

    {"schema": "hydro_env/naming_answer/1", "rig": "rig_001", "verdict": "effects",
     "effects": [{"name": "dead_zone", "channel": "1", "probability": 0.9}],
     "prediction": "rig_001.csv", "seconds": 12.3}

`verdict` is none, calibration, effects or unknown. `channel` is 1, 2, both or rig. `prediction` (columns time_s, speed_1_rpm,
speed_2_rpm, a row for each of commands.csv) or `model` (a model file) is optional; either gives the held-out error.
"""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, Field

from ...errors import InputError, check_known, located, shown
from ...plant import CATALOGUE
from ...reading import read_json
from ...validation import FileTable, Number, checked, known

SCHEMA = "hydro_env/naming_answer/1"
#: Folder beside the answers of a method with the whole diagnosis of each rig.
WHOLE = "whole"


class _Named(BaseModel):
    name: Annotated[str, known("effect", CATALOGUE)]
    channel: Literal["1", "2", "both", "rig"]
    probability: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.0


class _Answer(FileTable):
    FORMAT: ClassVar[str] = SCHEMA

    rig: str
    verdict: Literal["none", "calibration", "effects", "unknown"]
    effects: list[_Named]
    prediction: str | None = None
    model: str | None = None
    seconds: Annotated[Number, Field(ge=0.0)] | None = None


def answer(
    rig: str, verdict: str, effects: list[dict[str, Any]], seconds: float, **files: str
) -> dict[str, Any]:
    """The content of an answer's file; `files` are `prediction` or `model`."""
    return {
        "schema": SCHEMA, "rig": rig, "verdict": verdict, "effects": effects, "seconds": round(seconds, 2), **files,
    }  # fmt: skip


def read_answers(folder: Path, rigs: list[str], first: int | None = None) -> dict[str, dict[str, Any]]:
    """The answers of a folder by rig, for all rigs of a set or its `first` ones. InputError for a missing, foreign or malformed
    one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no folder of answers; expected one with a NAME.json for each rig")
    wanted = rigs[:first]
    missing = [name for name in wanted if not (folder / f"{name}.json").exists()]
    if missing:
        raise InputError(
            f"{folder}: {len(missing)} of {len(wanted)} answers are missing, the first is {missing[0]}.json"
        )
    with located(folder):
        check_known("the set has no rig", sorted(path.stem for path in folder.glob("*.json")), rigs)
    return {name: read_answer(folder / f"{name}.json", name) for name in wanted}


def read_answer(path: Path, rig: str) -> dict[str, Any]:
    """One answer. InputError that names file and key."""
    data: dict[str, Any] = read_json(path, "an answer of the naming benchmark")
    found = checked(_Answer, data, path)
    if found.rig != rig:
        raise InputError(f"{path}: rig is {shown(found.rig)}, expected {rig!r}")
    if (found.verdict == "effects") != bool(found.effects):
        raise InputError(f"{path}: effects: the verdict `effects`, and no other, names at least one")
    for key, name in (("prediction", found.prediction), ("model", found.model)):
        if name is not None and (Path(name).name != name or not (path.parent / name).is_file()):
            raise InputError(f"{path}: {key} is {shown(name)}, expected the name of a file beside it")
    return data
