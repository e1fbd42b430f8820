"""Answers: `NAME.json` for each rig, and beside it what the answer refers to.

    {"schema": "hydro_env/naming_answer/1", "rig": "rig_001", "verdict": "effects",
     "effects": [{"name": "dead_zone", "channel": "1", "probability": 0.9}],
     "prediction": "rig_001.csv", "seconds": 12.3}

`verdict` is none, calibration, effects or unknown. `channel` is 1, 2, both or rig. `prediction` (columns time_s, speed_1_rpm,
speed_2_rpm, a row for each of commands.csv) or `model` (a model file) is optional; either gives the sealed error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...errors import InputError, shown, suggestion
from ...plant import CATALOGUE
from ...reading import read_json

__all__ = ["CHANNELS", "SCHEMA", "VERDICTS", "answer", "read_answer", "read_answers"]

SCHEMA = "hydro_env/naming_answer/1"
VERDICTS = ("none", "calibration", "effects", "unknown")
CHANNELS = ("1", "2", "both", "rig")
_KEYS = ("schema", "rig", "verdict", "effects", "prediction", "model", "seconds")


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
    foreign = sorted(p.name for p in folder.glob("*.json") if p.stem not in rigs)
    if foreign:
        raise InputError(
            f"{folder / foreign[0]}: the set has no rig of that name; {suggestion(Path(foreign[0]).stem, rigs)}"
        )
    return {name: read_answer(folder / f"{name}.json", name) for name in wanted}


def read_answer(path: Path, rig: str) -> dict[str, Any]:
    """One answer. InputError that names file and key."""
    data = read_json(path, "an answer of the naming benchmark")
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f"{path}: schema: expected {SCHEMA!r}")
    for key in data:
        if key not in _KEYS:
            raise InputError(f"{path}: unknown key {shown(key)}: {suggestion(key, _KEYS)}")
    if data.get("rig") != rig:
        raise InputError(f"{path}: rig is {shown(data.get('rig'))}, expected {rig!r}")
    if data.get("verdict") not in VERDICTS:
        raise InputError(f"{path}: verdict is {shown(data.get('verdict'))}, expected {', '.join(VERDICTS)}")
    seconds = data.get("seconds")
    if seconds is not None and not _number(seconds, math.inf):
        raise InputError(f"{path}: seconds is {shown(seconds)}, expected a number from 0")
    _check_effects(path, data)
    for key in ("prediction", "model"):
        _check_file(path, key, data.get(key))
    return data


def _number(value: object, most: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= most


def _check_effects(path: Path, data: Mapping[str, Any]) -> None:
    effects = data.get("effects")
    if not isinstance(effects, list):
        raise InputError(f"{path}: effects is {shown(effects)}, expected a list")
    if (data["verdict"] == "effects") != bool(effects):
        raise InputError(f"{path}: effects: the verdict `effects`, and no other, names at least one")
    for n, effect in enumerate(effects):
        where = f"{path}: effects[{n}]"
        if not isinstance(effect, dict):
            raise InputError(f"{where} is {shown(effect)}, expected a table with name and channel")
        if effect.get("name") not in CATALOGUE:
            raise InputError(
                f"{where}: unknown effect {shown(effect.get('name'))}: {suggestion(effect.get('name'), CATALOGUE)}"
            )
        if effect.get("channel") not in CHANNELS:
            raise InputError(
                f"{where}: channel is {shown(effect.get('channel'))}, expected {', '.join(CHANNELS)}"
            )
        if "probability" in effect and not _number(effect["probability"], 1.0):
            raise InputError(
                f"{where}: probability is {shown(effect['probability'])}, expected a number from 0 to 1"
            )


def _check_file(path: Path, key: str, name: object) -> None:
    if name is None:
        return
    if not isinstance(name, str) or not name or Path(name).name != name:
        raise InputError(f"{path}: {key} is {shown(name)}, expected the name of a file beside it")
    if not (path.parent / name).is_file():
        raise InputError(f"{path}: {key}: there is no file {name} beside it")
