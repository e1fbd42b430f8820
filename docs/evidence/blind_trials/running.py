"""Runs trials: makes practice logs, diagnoses them, keeps a row for each."""

from __future__ import annotations

import ast
import hashlib
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hydro_env
from hydro_env.diagnosis import Settings, diagnose
from hydro_env.errors import InputError
from hydro_env.experiments.coverage import by_channel
from hydro_env.files import write_json
from hydro_env.plant import CATALOGUE, PlantModel, simulate
from hydro_env.plant.sensors import NOISE
from hydro_env.practice.generate import Practice, make_practice
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json
from hydro_env.units import BAR, RPM

from .cases import GROUPS, Case
from .judging import covered, judge
from .rules import RULES

SCHEMA = "hydro_env/trials/4"

#: Columns of a log that show what an effect does: the simulator's signal, and the column's unit in SI.
_SHOWN = {
    "speed_{}_rpm": ("measured_speed", RPM),
    "current_{}_A": ("current", 1.0),
    "pressure_{}_bar": ("pressure", BAR),
}


@dataclass(frozen=True)
class Running:
    """How trials are run: length of a log (s), rows per second, threads of a diagnosis, the folder that keeps practice logs
    or has them already, rules of the diagnosis that are switched off, and its constants that have other values (`changed`)."""

    duration: float = 12.0
    rate: float = 1000.0
    jobs: int = 1
    logs: Path | None = None
    rules_off: tuple[str, ...] = ()
    constants: tuple[str, ...] = ()


@contextmanager
def changed(constants: Sequence[str], rules_off: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
    """Gives constants of the diagnosis other values for a while ("estimation.fit.SMALL_SUM=0.3"), wherever they are used, and
    switches rules off; yields constants that are fields of `Settings`, "settings.NAME=VALUE". InputError for one that is not
    there."""
    fields: dict[str, Any] = {}
    before: list[tuple[Any, str, Any]] = []
    texts = (text.partition("=") for text in constants)
    wanted = [(name, ast.literal_eval(value)) for name, _, value in texts]
    wanted += [each for n in rules_off for each in RULES[n].items()]
    try:
        for name, value in wanted:
            place, _, own = name.rpartition(".")
            home = Settings() if place == "settings" else sys.modules.get(f"hydro_env.diagnosis.{place}")
            if not hasattr(home, own):
                raise InputError(f"--constant {name}: the diagnosis has no constant {name}")
            if place == "settings":
                fields[own] = value
                continue
            known = getattr(home, own)
            users = [m for n, m in sys.modules.items() if n.startswith("hydro_env.diagnosis")]
            for module in (m for m in users if getattr(m, own, None) is known):
                before.append((module, own, known))
                setattr(module, own, value)
        yield fields
    finally:
        for module, own, known in before:
            setattr(module, own, known)


def method() -> str:
    """Hash of the sources of diagnosis and plant, without the report: rows with the same one ran on the same method."""
    package = Path(hydro_env.__file__).parent
    sources = [p for room in ("diagnosis", "plant") for p in sorted((package / room).rglob("*.py"))]
    sources = [p for p in sources if p.parent.name != "report"]
    return hashlib.sha256(b"".join(p.read_bytes() for p in sources)).hexdigest()[:10]


# --- logs ---------------------------------------------------------------------------------------------------------------
def practice_logs(case: Case, folder: Path, how: Running = Running()) -> None:
    """Makes the logs of a trial in `folder`, unless they are there, and form.json beside them.

    form.json says what the true values in the catalogue's form leave of each speed on the held-out log, RMS in rpm, noise and
    all; and `strength`, how far the hidden effects move the recorded signal of the fit logs that they move most, RMS in
    multiples of its noise.
    """
    if (folder / "form.json").exists():
        return
    practice = make_practice(
        case.hidden, severity=case.severity, base_error=case.base_error, noise=case.noise, record=case.record,
        seed=case.seed, duration=how.duration, rate=how.rate,
    )  # fmt: skip
    practice.write(folder)
    write_json(
        folder / "form.json",
        {**_form(practice, how.rate), "strength": _strength(practice, how.rate, case.noise)},
    )


def _simulated(model: PlantModel, log: Mapping[str, NDArray[Any]], rate: float) -> dict[str, NDArray[Any]]:
    """Columns of a log as the compiled plant gives them for its commands and loads."""
    command = np.column_stack([log[f"command_{c}_V"] for c in (1, 2)])
    load = np.column_stack([log.get(f"load_{c}_Nm", np.zeros(len(command))) for c in (1, 2)])
    found = simulate(model, command, load, 1.0 / rate, record=[signal for signal, _ in _SHOWN.values()])
    return {
        column.format(c): found[signal][:, 0, c - 1] / unit
        for column, (signal, unit) in _SHOWN.items()
        for c in (1, 2)
    }


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _form(practice: Practice, rate: float) -> dict[str, float]:
    log = practice.logs["sealed"]
    found = _simulated(practice.true, log, rate)
    return {name: _rms(log[name] - found[name]) for name in ("speed_1_rpm", "speed_2_rpm")}


def _strength(practice: Practice, rate: float, noise: float) -> float:
    neutral = {
        f"{h.name}.{p.name}": practice.given.pair(f"{h.name}.{p.name}")
        for h in practice.hidden
        for p in CATALOGUE[h.name].parameters
    }
    without = practice.true.with_values(neutral)
    most = 0.0
    for name, log in practice.logs.items():
        if name.startswith("fit"):
            one, other = (_simulated(model, log, rate) for model in (practice.true, without))
            for column in set(one) & set(log):
                signal, _, unit = column.split("_")
                most = max(most, _rms(one[column] - other[column]) / (noise * NOISE[f"{signal}_{unit}"]))
    return most


@contextmanager
def _folder(case: Case, logs: Path | None) -> Iterator[Path]:
    """The folder of a trial's logs: one of `logs` that stays, or one for this once."""
    if logs is not None:
        yield logs / f"{case.group}_{case.seed}"
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


# --- trials -------------------------------------------------------------------------------------------------------------
def run_case(case: Case, how: Running = Running()) -> dict[str, Any]:
    """Hides, diagnoses and judges; one row of trials.json."""
    with _folder(case, how.logs) as folder:
        practice_logs(case, folder, how)
        truth, form = (read_json(folder / name, "a practice rig") for name in ("truth.json", "form.json"))
        files = [folder / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
        without = [h["name"] for h in truth["effects"]] if case.unlisted else []
        if not case.twins:
            without += [twin for name in without for twin in CATALOGUE[name].indistinguishable_from]
        begin, cpu = time.perf_counter(), time.process_time()
        with changed(how.constants, how.rules_off) as fields:
            settings = Settings(**fields)
            data = diagnose(
                files[:2],
                files[2:],
                model=folder / "model.yaml",
                without=without,
                jobs=how.jobs,
                settings=settings,
            ).as_dict()
        seconds, cpu_s = time.perf_counter() - begin, time.process_time() - cpu
    hidden = by_channel(truth["effects"])
    tried = [t for t in data["candidates"] if t["refitted"] and t["gain"] > 0.5 * t["needed"]]
    visible = [data["detectable"].get(name, {}).get(c) for name, c in hidden]
    return {
        **asdict(case), "sizes": _sizes(truth), **judge(data, hidden, truth["verdict"], case.unlisted, form),
        "covered": covered(data, truth), "strength": form.get("strength"), "rules_off": [*how.rules_off, *how.constants],
        "visible": all(v is not False for v in visible), "seconds": round(seconds, 1), "cpu_s": round(cpu_s, 1),
        "jobs": how.jobs, "gap": data["gap"]["sealed"], "effects": data["effects"], "method": method(),
        "corrections": [[k["correction"], k["channel"]] for k in data.get("form_corrections", [])],
        "tried": [[t["effect"], t["channel"], t["gain"], t["needed"], t["outcome"]] for t in tried],
    }  # fmt: skip


def _sizes(truth: Mapping[str, Any]) -> dict[str, float]:
    return {
        f"{h['name']}.{n}": p["value"]
        for h in truth["effects"]
        for n, p in h["parameters"].items()
        if p["value"] is not None
    }


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """All rows that the slices of a run have left in a folder, in the order of groups and seeds; a trial that two of them ran
    counts once."""
    rows = [r for path in sorted(folder.glob("trials*.json")) for r in _rows(path)]
    once = {(r["group"], r["seed"]): r for r in reversed(rows)}
    return sorted(once.values(), key=lambda r: (list(GROUPS).index(r["group"]), r["seed"]))


def _rows(path: Path) -> list[dict[str, Any]]:
    return list(read_json(path, "the trials of a run", max_bytes=MAX_BYTES_OF_RESULTS)["rows"])


def run_trials(
    out: Path, wanted: Sequence[Case], how: Running = Running(), *, minutes: float = math.inf, name: str = "trials.json",
    say: Callable[[str], None] = print,
) -> list[dict[str, Any]]:  # fmt: skip
    """Runs the trials that the folder `out` lacks, for `minutes` at most; its file `name` holds what is done so far.

    Returns all rows of the folder.
    """
    out.mkdir(parents=True, exist_ok=True)
    path = out / name
    own = _rows(path) if path.exists() else []
    end = time.monotonic() + 60.0 * minutes
    for case in wanted:
        if any((r["group"], tuple(r["hidden"]), r["seed"]) == _key(case) for r in rows_of(out)):
            continue
        if time.monotonic() > end:
            break
        own.append(run_case(case, how))
        write_json(path, {"schema": SCHEMA, "rows": own})
        say(line(own[-1]))
    return rows_of(out)


def _key(case: Case) -> tuple[str, tuple[str, ...], int]:
    return case.group, case.hidden, case.seed


def line(row: Mapping[str, Any]) -> str:
    """One trial in a line."""
    mark = "right" if row["right"] else "set" if row["set"] else "WRONG"
    hidden = ", ".join(row["hidden"]) or "nothing"
    return (
        f"{row['group']:<12}{hidden:<44}{mark:<7}{row['verdict']:<12}{', '.join(row['named']) or '-':<60}"
        f"{row['worst']:6.2f} x noise (true values {row['form']:.2f}) {row['cpu_s']:4.0f} s CPU"
    )
