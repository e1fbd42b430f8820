"""Result files: what one controller reached in a suite with a protocol, so that others can cite it and check it.

A file has the values of every metric in every case, what they come to, and a digest of all that. `check` drives a random tenth of
the splits and scenarios again. Another kind of processor may differ in the last digit of a matrix product, of which a spool that
sticks makes more.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hydro_env.benchmark.cells import Cell, Conditions, drive, overall, score_ends, with_summaries
from hydro_env.controllers.registry import split_gains
from hydro_env.errors import InputError
from hydro_env.files import to_json, write_json
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json, read_yaml
from hydro_env.tasks import SPLITS, VERSIONS
from hydro_env.validation import FileTable, checked, known

__all__ = ["SCHEMA", "check", "read_declared", "read_result", "write_results"]

SCHEMA = "hydro_env/result/1"
#: Of the splits and scenarios that a check drives again.
SHARE = 0.1
#: What a controller may know, by its attribute `needs`; `servo valves` where it drives a plant of its own.
CLASSES = {
    "measurements": "signals only",
    "bench": "valve bench",
    "parameters": "everything",
    "everything": "everything",
}


_SUITE = ("suite", "first", "splits", "scenarios", "metrics", "seed", "control_period_s", "plant", "dtype")


class Declared(FileTable):
    """How an agent was trained, by who made it; nobody can measure that afterwards."""

    algorithm: str = ""
    training_split: Annotated[str, known("split", SPLITS)] = "train"
    periods: Annotated[float, Field(ge=0)] = 0.0
    wall_time_s: Annotated[float, Field(ge=0)] = 0.0
    seeds: tuple[int, ...] = ()
    chosen_on: Annotated[str, known("split", ("train", "val"))] = "val"
    source: str = ""


def read_declared(path: str | Path | None) -> dict[str, Any] | None:
    """What a YAML file declares. InputError for anything else."""
    return (
        None
        if path is None
        else checked(Declared, read_yaml(path, "how an agent was trained, in YAML"), path).model_dump()
    )


def write_results(
    out: Path, cells: Sequence[Cell], scores: Mapping[str, Any], declared: Mapping[str, Any] | None
) -> None:
    """Writes `result_NAME.json` of every controller that failed nowhere."""
    ends = score_ends(cells)
    for name in scores["controllers"]:
        own = [cell for cell in cells if cell.name == name]
        if any(cell.failure for cell in own):
            continue
        content = {
            "schema": SCHEMA, "versions": scores["versions"], "controller": name, **_origin(own[0].controller),
            "class": _class(own[0]), "declared": declared,
            "suite": {key: scores[key] for key in _SUITE},
            "decision_us": scores["decision_us"][name], "score_ends": {" ".join(place): pair for place, pair in ends.items()},
            "idle": sum(cell.idle for cell in own),
            "overall": {metric: summary.row for metric, summary in overall(own, ends).items()},
            "cases": [
                {
                    "split": cell.split, "scenario": cell.scenario, "faults": list(cell.faults),
                    "metrics": _short(cell.metrics, scores["metrics"]),
                }
                for cell in own
            ],
        }  # fmt: skip
        write_json(out / f"result_{name}.json", content | {"sha256": _digest(content)}, indent=None)


def read_result(path: str | Path) -> dict[str, Any]:
    """A result file. InputError where it is none, or was changed after it was written."""
    found = read_json(path, "a result of hydro-env benchmark", max_bytes=MAX_BYTES_OF_RESULTS)
    if not isinstance(found, dict) or found.get("schema") != SCHEMA:
        raise InputError(f"{path}: schema is not {SCHEMA!r}: no result of hydro-env benchmark --suite paper")
    if found.get("sha256") != _digest({key: value for key, value in found.items() if key != "sha256"}):
        raise InputError(f"{path}: sha256 does not belong to the content: the file was changed")
    return found


def check(
    path: str | Path, controllers: Sequence[Any] = (), *, seed: int = 0, trust: bool = False, engine: str = "local",
    jobs: int = 1, progress: bool = True,
) -> str:  # fmt: skip
    """Drives a random tenth of a result again and says what came of it.

    `controllers`: the controller where it is a file, else by its name in the result. InputError where the file is damaged or of
    another version, its summary does not follow from its values, or a value comes out differently.
    """
    found = read_result(path)
    for name, version in VERSIONS.items():
        if found["versions"].get(name) != version:
            told = f"{path}: was made with version {found['versions'].get(name)} of {name}, this is {version}"
            raise InputError(f"{told}: hydro_env {found['versions'].get('hydro_env')} is right")
    spec = controllers[0] if controllers else found["given"]
    if len(controllers) > 1 or _origin(spec)["file_sha256"] != found["file_sha256"]:
        told = f"{path}: is the result of {found['given']}"
        raise InputError(
            f"{told}, sha256 {found['file_sha256']}: give that file" if found["file_sha256"] else told
        )
    cells = _cells(found, spec, trust)
    _check_summary(path, found, cells)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(cells), math.ceil(SHARE * len(cells)), replace=False).tolist()
    where, values = found["suite"], 0
    conditions = Conditions(where["plant"], where["control_period_s"], where["seed"])
    for n, done in zip(
        chosen, drive([cells[n] for n in chosen], conditions, engine, jobs, progress), strict=True
    ):
        if done.failure:
            raise InputError(f"{path}: {cells[n].split}, {cells[n].scenario}: {done.failure}")
        for metric, kept in cells[n].metrics.items():
            again = done.metrics[metric]
            if (differ := np.flatnonzero(again != kept)).size:
                case = int(differ[0])
                told = f"{metric} of case {where['first'] + case} in {cells[n].split}, {cells[n].scenario} is {again[case]:.9g}"
                raise InputError(
                    f"{path}: {told} where the file has {kept[case]:.9g}; {differ.size} of {kept.size} differ"
                )
            values += kept.size
    places = ", ".join(f"{cells[n].split} {cells[n].scenario}" for n in chosen)
    return (
        f"{path}: {values} values of {found['controller']} are the same bit for bit ({places}; --seed {seed})"
    )


def _cells(found: Mapping[str, Any], spec: Any, trust: bool) -> list[Cell]:
    """The cells of a result with their values, for a controller to drive."""
    cases = [
        Cell(
            spec, found["controller"], each["split"], each["scenario"], len(each["faults"]), found["suite"]["first"],
            metrics={name: np.array(values, np.float32).astype(float) for name, values in each["metrics"].items()},
            faults=tuple(each["faults"]), trust=trust,
        )
        for each in found["cases"]
    ]  # fmt: skip
    return [with_summaries(cell) for cell in cases]


def _check_summary(path: str | Path, found: Mapping[str, Any], cells: Sequence[Cell]) -> None:
    ends = {tuple(key.split()): (low, high) for key, (low, high) in found["score_ends"].items()}
    again = overall(cells, ends)  # type: ignore[arg-type]
    for metric, row in found["overall"].items():
        if metric not in again or again[metric].row != row:
            raise InputError(f"{path}: overall {metric} does not follow from the values of the cases")


def _class(cell: Cell) -> str:
    return "servo valves" if cell.plant is not None else CLASSES.get(cell.needs, cell.needs)


def _short(metrics: Mapping[str, Any], names: Sequence[str]) -> dict[str, list[float]]:
    """Values of single precision with as few digits as tell them apart."""
    return {name: [float(str(np.float32(value))) for value in metrics[name]] for name in names}


def _origin(spec: Any) -> dict[str, str | None]:
    """What a controller is called, without the folder of its file, and the digest of that; None for one that ships."""
    given = split_gains(str(spec))[0]
    head = given.rpartition(":")[0]
    path = Path(head or given)
    if not path.is_file():
        return {"given": str(spec), "file_sha256": None}
    return {
        "given": str(spec).replace(str(path), path.name),
        "file_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(to_json(content).encode()).hexdigest()
