"""Result files: what one controller reached in a suite with a protocol, so that others can cite it and check it.

A file has the values of every metric in every case, what they come to, and a digest of all that. `check` drives a random tenth of
the splits and scenarios again. Another kind of processor may differ in the last digit of a matrix product, of which a spool that
sticks makes more.
"""

import hashlib
import math
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from hydro_env.benchmark.cells import Cell, Conditions, by_name, cells_of, drive, overall, score_ends
from hydro_env.benchmark.statistics import Summary
from hydro_env.benchmark.suite import BASELINE, BOUND, Suite, shipped_suites
from hydro_env.controllers.registry import CONTROLLERS, source_of, split_gains
from hydro_env.errors import InputError
from hydro_env.files import to_json, write_json
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json, read_yaml
from hydro_env.tasks import SPLITS, VERSIONS
from hydro_env.validation import FileTable, Number, checked, known

SCHEMA = "hydro_env/result/1"
#: Of the splits and scenarios that a check drives again.
SHARE = 0.1
#: What a controller may know, by its attribute `needs`; `SERVO` where it drives a plant of its own.
CLASSES = {
    "measurements": "signals only",
    "bench": "valve bench",
    "parameters": "everything",
    "everything": "everything",
}
SERVO = "servo valves"


class Declared(FileTable):
    """How an agent was trained, by who made it; nobody can measure that afterwards."""

    algorithm: str = ""
    training_split: Annotated[str, known("split", SPLITS)] = "train"
    periods: Annotated[float, Field(ge=0)] = 0.0
    wall_time_s: Annotated[float, Field(ge=0)] = 0.0
    seeds: tuple[int, ...] = ()
    chosen_on: Annotated[str, known("split", ("train", "val"))] = "val"
    source: str = ""


class Place(FileTable):
    """A split and scenario in a file: the fault of every case, "" for none, and its values by metric."""

    split: str
    scenario: str
    faults: tuple[str, ...]
    metrics: dict[str, tuple[Number, ...]]


class Driven(FileTable):
    """What was driven, in a file."""

    suite: str
    first: int
    splits: dict[str, int]
    scenarios: tuple[str, ...]
    metrics: tuple[str, ...]
    seed: int
    control_period_s: Number
    plant: str
    dtype: str

    @property
    def table(self) -> Suite:
        """The suite. InputError for one that cannot be."""
        kept = {key: getattr(self, key) for key in ("first", "splits", "scenarios", "metrics")}
        return checked(Suite, {"name": self.suite, "protocol": True, **kept}, "suite")


class Result(FileTable):
    """What a result file holds."""

    FORMAT: ClassVar[str] = SCHEMA

    versions: dict[str, int | str]
    controller: str
    given: str
    file_sha256: str | None
    class_: Annotated[str, known("class", (*CLASSES.values(), SERVO)), Field(alias="class")]
    declared: Declared | None
    suite: Driven
    decision_us: Number
    score_ends: dict[str, tuple[Number, Number]]
    idle: int
    overall: dict[str, Summary]
    cases: tuple[Place, ...]
    sha256: str

    @model_validator(mode="after")
    def _complete(self) -> "Result":
        suite = self.suite
        places = [(split, scenario) for split in suite.splits for scenario in suite.scenarios]
        if [(each.split, each.scenario) for each in self.cases] != places:
            raise ValueError("cases: are not those of every split and scenario of the suite, in its order")
        for each in self.cases:
            sizes = {len(each.faults), *map(len, each.metrics.values())}
            if set(each.metrics) != set(suite.metrics) or sizes != {suite.splits[each.split]}:
                raise ValueError(
                    f"cases: {each.split} {each.scenario} has not a value of each metric for each case"
                )
        return self


def read_declared(path: str | Path | None) -> dict[str, Any] | None:
    """What a YAML file declares. InputError for anything else."""
    if path is None:
        return None
    return checked(Declared, read_yaml(path, "how an agent was trained, in YAML"), path).model_dump()


def write_results(
    out: Path, cells: Sequence[Cell], scores: Mapping[str, Any], declared: Mapping[str, Any]
) -> None:
    """Writes `result_NAME.json` of every controller that failed nowhere; `declared` by the names of those it is declared of."""
    ends = score_ends(cells)
    for name, own in by_name(cells).items():
        if any(cell.failure for cell in own):
            continue
        content = {
            "schema": SCHEMA, "versions": scores["versions"], "controller": name, **_origin(own[0].controller),
            "class": _class(own[0]), "declared": declared.get(name),
            "suite": {key: scores[key] for key in Driven.model_fields},
            "decision_us": scores["decision_us"][name], "score_ends": {" ".join(place): pair for place, pair in ends.items()},
            "idle": sum(cell.idle for cell in own),
            "overall": {metric: summary.row for metric, summary in overall(own, ends).items()},
            "cases": [
                {
                    "split": cell.split, "scenario": cell.scenario, "faults": list(cell.faults),
                    # Single precision with as few digits as tell values apart.
                    "metrics": {m: [float(str(np.float32(v))) for v in cell.metrics[m]] for m in scores["metrics"]},
                }
                for cell in own
            ],
        }  # fmt: skip
        written = re.sub(r"[^A-Za-z0-9_.=,+-]", "_", name)
        write_json(out / f"result_{written}.json", content | {"sha256": _digest(content)}, indent=None)


def read_result(path: str | Path) -> dict[str, Any]:
    """A result file. InputError where it is none, or was changed after it was written."""
    found: dict[str, Any] = read_json(path, "a result of hydro-env benchmark", max_bytes=MAX_BYTES_OF_RESULTS)
    if not isinstance(found, dict) or found.get("schema") != SCHEMA:
        raise InputError(f"{path}: schema is not {SCHEMA!r}: no result of hydro-env benchmark --suite paper")
    if found.get("sha256") != _digest({key: value for key, value in found.items() if key != "sha256"}):
        raise InputError(f"{path}: sha256 does not belong to the content: the file was changed")
    checked(Result, found, path)
    return found


def check_protocol(suite: Suite, conditions: Conditions) -> None:
    """InputError for a protocol that ships if anything of it is changed."""
    shipped, limit = shipped_suites().get(suite.name), conditions.limit
    if shipped is not None and shipped.protocol and (suite, conditions) != (shipped, Conditions(limit=limit)):
        told = "splits, scenarios, cases, plant, control period and seed stay as they are"
        raise InputError(
            f"suite {suite.name} is a protocol: {told}; a copy of it in a YAML file may be changed"
        )


def check(
    path: str | Path, controllers: Sequence[Any] = (), *, seed: int | None = None, trust: bool = False, engine: str = "local",
    jobs: int = 1, progress: bool = True,
) -> str:  # fmt: skip
    """Drives a random tenth of a result again, with those who set the ends of its score, and says what came of it.

    `controllers`: the controller where it is none that ships; code that only the file names is not run. `seed` draws the tenth;
    None: another one each time. InputError where the file is damaged, of another version or no protocol, its summary does not
    follow from its values, or a value comes out differently.
    """
    found = read_result(path)
    for name, version in VERSIONS.items():
        if found["versions"].get(name) != version:
            told = f"{path}: was made with version {found['versions'].get(name)} of {name}, this is {version}"
            raise InputError(f"{told}: hydro_env {found['versions'].get('hydro_env')} is right")
    where = Driven(**found["suite"])
    conditions = Conditions(where.plant, where.control_period_s, where.seed)
    check_protocol(where.table, conditions)
    if where.dtype != conditions.dtype:
        raise InputError(f"{path}: dtype is {where.dtype}, should be {conditions.dtype}")
    spec = _given(path, found, controllers)
    cells = _cells(found, spec, trust)
    _check_summary(path, found, cells)
    made = next(cells_of([spec], where.table, trust))
    if _class(made) != found["class"]:
        raise InputError(f"{path}: class is {found['class']!r}, the controller's is {_class(made)!r}")
    seed = secrets.randbelow(10**6) if seed is None else seed
    rng = np.random.default_rng(seed)
    chosen = [cells[n] for n in rng.choice(len(cells), math.ceil(SHARE * len(cells)), replace=False)]
    # Those who set the ends of the score, beside the controller.
    beside = [replace(cell, controller=name, name=name) for cell in chosen for name in (BASELINE, BOUND)]
    done = drive([*chosen, *beside], conditions, engine, jobs, progress)
    values = sum(_compared(path, cell, again) for cell, again in zip(chosen, done, strict=False))
    ends = {" ".join(place): list(pair) for place, pair in score_ends(done[len(chosen) :]).items()}
    places = [f"{cell.split} {cell.scenario}" for cell in chosen]
    for place in places:
        kept, right = found["score_ends"].get(place, []), ends.get(place, [])
        if len(kept) != len(right) or not np.allclose(kept, right, rtol=1e-9):
            raise InputError(f"{path}: score_ends of {place} are {kept}, should be {right}")
    if sum(cell.idle for cell in done[: len(chosen)]) > found["idle"]:
        raise InputError(
            f"{path}: idle is {found['idle']}, the controller is idle in more of {', '.join(places)}"
        )
    told = f"{values} values of {found['controller']} are the same bit for bit"
    return f"{path}: {told} ({', '.join(places)}; --seed {seed})"


def _given(path: str | Path, found: Mapping[str, Any], controllers: Sequence[Any]) -> Any:
    """The controller of a result: one that ships, or that of the file which was given and has the same content."""
    spec = controllers[0] if controllers else found["given"]
    digest, there = found["file_sha256"], controllers or split_gains(spec)[0] in CONTROLLERS
    if not there or len(controllers) > 1 or _origin(spec)["file_sha256"] != digest:
        wanted = f", sha256 {digest}: give that file" if digest or not there else ""
        raise InputError(f"{path}: is the result of {found['given']}{wanted}")
    return spec


def _compared(path: str | Path, cell: Cell, again: Cell) -> int:
    """How many values of a cell were compared. InputError for one that differs."""
    where = f"{cell.split}, {cell.scenario}"
    if again.failure:
        raise InputError(f"{path}: {where}: {again.failure}")
    if again.faults != cell.faults:
        raise InputError(f"{path}: faults of {where} are not those of its cases")
    for metric, kept in cell.metrics.items():
        if (differ := np.flatnonzero(again.metrics[metric] != kept)).size:
            case = int(differ[0])
            told = f"{metric} of case {cell.first + case} in {where} is {again.metrics[metric][case]:.9g}"
            raise InputError(
                f"{path}: {told} where the file has {kept[case]:.9g}; {differ.size} of {kept.size} differ"
            )
    return sum(kept.size for kept in cell.metrics.values())


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
    return [cell.with_summaries() for cell in cases]


def _check_summary(path: str | Path, found: Mapping[str, Any], cells: Sequence[Cell]) -> None:
    ends = {key.partition(" ")[::2]: pair for key, pair in found["score_ends"].items()}
    again = {metric: summary.row for metric, summary in overall(cells, ends).items()}
    for metric in again.keys() | found["overall"].keys():
        right, kept = (
            np.hstack([rows.get(metric, {}).get(key, []) for key in ("iqm", "ci95", "cvar95", "n")])
            for rows in (again, found["overall"])
        )
        # Another machine may add up in another order.
        if right.size != kept.size or not np.allclose(right, kept, rtol=1e-9, atol=1e-9):
            raise InputError(f"{path}: overall {metric} does not follow from the values of the cases")


def _class(cell: Cell) -> str:
    return SERVO if cell.plant is not None else CLASSES.get(cell.needs, cell.needs)


def _origin(spec: Any) -> dict[str, str | None]:
    """What a controller is called, without the folder of its file, and the digest of that; None for one that ships."""
    given, digest = str(spec), None
    if (path := source_of(given)) is not None:
        given, digest = given.replace(str(path), path.name), hashlib.sha256(path.read_bytes()).hexdigest()
    return {"given": given, "file_sha256": digest}


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(to_json(content).encode()).hexdigest()
