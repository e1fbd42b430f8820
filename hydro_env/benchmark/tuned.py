"""Gains for the plant under test: controllers that ship with gains for the paper's plant are tuned for another one first."""

import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hydro_env.controllers.registry import CONTROLLERS, law_of, source_of
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.controllers.tuning.search import Search, Task, drive
from hydro_env.controllers.tuning.tune import run as tune
from hydro_env.errors import InputError, InputWarning
from hydro_env.parallel import Failure
from hydro_env.parallel import run as run_tasks
from hydro_env.plant import load_model, preset_names

#: Of the search, beyond the cases of every benchmark: gains do not know the noise that they are scored with.
SEED = 10_000


#: The name of a shipped controller, a search for its gains, and the gains file.
Job = tuple[str, Search, Path]


def _job(name: str, wanted: Search, folder: Path) -> Job:
    """A search whose gains file lies in a folder that is named by all that the gains depend on."""
    model = load_model(wanted.task.plant).to_dict()
    search = replace(wanted, task=replace(wanted.task, plant=""))
    digest = hashlib.sha256(repr((model, search, version("hydro_env"))).encode()).hexdigest()[:12]
    return name, wanted, folder / f"{name}-{digest}" / "gains.json"


def _search(job: Job) -> None:
    name, wanted, path = job
    tune(path.parent, wanted, name)


def _law(name: str) -> str:
    """The law of a controller that ships with gains for the paper's plant, "" for all others."""
    entry = CONTROLLERS.get(name)
    if entry is None or entry.file is None or entry.file.suffix != ".json":
        return ""
    shipped = read_gains(entry.file)
    return shipped.controller if law_of(shipped.controller).similar and not shipped.plant else ""


def tuned(
    specs: Sequence[Any], plant: Any, *, own: bool, period: float, folder: Path, engine: str, jobs: int, progress: bool
) -> tuple[list[Any], list[str]]:  # fmt: skip
    """Controllers for a benchmark, and the names of those that are tuned for its plant: on a plant file, those that ship with
    gains are replaced by gains files of `folder`, found at this control period (s) for the plant's `own` pair of valves or for
    drawn pairs. What the same search has left there is taken. InputError if a search fails.
    """
    if not isinstance(plant, str | Path) or str(plant) in preset_names():
        return list(specs), []
    jobs_of = {}
    for name in specs:
        if isinstance(name, str) and (law := _law(name)):
            task = Task(law, plant=str(plant), mismatch=None if own else "train")
            jobs_of[name] = _job(name, Search(task, SEED, period, progress=False), folder)
    missing = [job for job in jobs_of.values() if not job[2].exists()]
    if missing and progress:
        names = ", ".join(name for name, _, _ in missing)
        print(f"Tuning for {plant} first, gains in {folder}: {names}", flush=True)
    results = run_tasks(missing, _search, engine=engine, jobs=jobs, progress=progress, unit="controller")
    for (name, _, _), result in zip(missing, results, strict=True):
        if isinstance(result, Failure):
            raise InputError(f"{name} cannot be tuned for {plant}: {result}; --as-shipped does without")
    return [str(jobs_of[s][2]) if isinstance(s, str) and s in jobs_of else s for s in specs], [*jobs_of]


def warn_of_others(specs: Sequence[Any], plant: Any) -> None:
    """InputWarning for each gains file that was tuned on a plant which drives otherwise."""
    if not isinstance(plant, str | Path):
        return
    for path in filter(None, (source_of(spec) for spec in specs if isinstance(spec, str))):
        found = read_gains(path) if path.suffix == ".json" else None
        known = found.tuning.get("plant_drive_rpm") if found else None
        if found and known and not found.plant and known != list(drive(str(plant))):
            message = f"{path}: tuned on {found.tuning.get('plant')}, which drives otherwise than {plant}"
            warnings.warn(
                f"{message}; hydro-env tune --plant {plant} finds gains for it", InputWarning, stacklevel=2
            )
