"""Tunes a controller's gains on the training pairs: `hydro-env tune`; the search itself is in `tuning.search`.

The controllers that ship (`--controller all`) are found by the same search, from nothing at `PERIOD`, then from the gains found
there at each of `OTHER_PERIODS`. What has been found is kept when the command is interrupted, and not searched again.
"""

from __future__ import annotations

import shlex
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hydro_env.controllers.base import Controller
from hydro_env.controllers.registry import law_of
from hydro_env.controllers.tuning.gains import GainsFile, OtherPeriod, read_gains, write_gains
from hydro_env.controllers.tuning.search import Search, Task, drive, search
from hydro_env.controllers.tuning.start import starts
from hydro_env.errors import check_known
from hydro_env.tasks import OWN

PERIOD, OTHER_PERIODS = 0.01, (0.005, 0.02)


COMMON: dict[str, Task] = {
    "pid_tuned": Task("pid"),
    "master_slave": Task("master_slave"),
    "cross_coupled": Task("cross_coupled"),
    "relative_coupling": Task("relative_coupling"),
    "virtual_leader": Task("virtual_leader"),
    "disturbance_observer": Task("disturbance_observer"),
    "compensated": Task("compensated"),
    "servo_pid": Task("ramped_pid", plant="servo", mismatch=None),
}
"""The controllers that ship with gains found by search, by the name they ship under."""


def run(out: str | Path, wanted: Search, name: str | None = None) -> dict[str, Any]:
    """Searches the gains of a control law and writes `out/gains.json`, which `make_controller` reads. `name`: the controller's
    in leaderboards. Returns what gains.json says. InputError as `search`.
    """
    task = wanted.task
    found = search(wanted, starts(task.law, task.plant, wanted.period))
    options = {
        "controller": task.law,
        "plant": task.plant,
        "mismatch": task.mismatch or OWN,
        "scenario": ",".join(found["tuning"]["scenarios"]),
        "cases": wanted.cases,
        "episodes": wanted.episodes,
        "weight": f"{task.weight:g}",
        "control-period": f"{wanted.period:g}",
        "seed": wanted.seed,
    }
    words = " ".join(f"--{key} {shlex.quote(str(value))}" for key, value in options.items())
    tuning = {"command": f"hydro-env tune {words}"} | found["tuning"]
    file = GainsFile(
        name=name or task.law.rpartition(":")[2],
        controller=task.law,
        gains=found["gains"],
        units=_units(law_of(task.law)),
        tuning=tuning,
    )
    write_gains(Path(out) / "gains.json", file)
    return {"controller": task.law, "gains": file.gains, "units": file.units, "tuning": tuning}


def summary(found: dict[str, Any]) -> str:
    """What a run says: the cost beside that of the first gains and of motors at rest, and how far the search has come."""
    tuning, units = found["tuning"], found["units"]
    others = {"the gains it began with": tuning.get("start"), "motors at rest": tuning["at_rest"]}
    beside = ", ".join(f"{value:.4g} with {what}" for what, value in others.items() if value is not None)
    lines = [
        f"cost {tuning['cost']:.4g} rpm on {tuning['judged_on']} other pairs ({beside}); "
        f"the last quarter of the search gained {tuning['last_quarter_gained_percent']:.2g} %"
    ]
    lines += [f"{name} = {value:.4g} {units[name]}" for name, value in found["gains"].items()]
    for name, end in tuning["at_end_of_range"].items():
        lines.append(f"{name} ended at the {'upper' if end else 'lower'} end of its range")
    if tuning["cost"] > 0.95 * tuning["at_rest"]:
        lines.append(
            f"{found['controller']} is hardly better here than motors at rest: try another control law"
        )
    return "\n".join(lines)


def run_all(
    out: str | Path, *, names: list[str] | None = None, seed: int = 0, progress: bool = True
) -> dict[str, GainsFile]:
    """Tunes the controllers of `COMMON` (or those of them that are named) for all control periods and writes `out/NAME.json`
    for each as soon as it is found. One that is there already from the same command is kept.

    InputError for a name that `COMMON` lacks, OSError for a folder that cannot be written.
    """
    check_known("--only", names or (), COMMON)
    return {name: _tuned(name, Path(out), seed, progress) for name in names or COMMON}


def _tuned(name: str, out: Path, seed: int, progress: bool) -> GainsFile:
    """Gains of one of `COMMON`, from `out` if the same command has left them there."""
    task, path = COMMON[name], out / f"{name}.json"
    origin = {
        "command": f"hydro-env tune --controller all --only {name} --seed {seed}",
        "version": version("hydro_env"),
        "plant_drive_rpm": list(drive(task.plant)),
    }
    if path.exists():
        kept = read_gains(path)
        if origin.items() <= kept.tuning.items():
            return kept
    out.mkdir(parents=True, exist_ok=True)  # before hours of work
    own = search(Search(task, seed, PERIOD, progress=progress))
    found = [
        search(Search(task, seed, period, progress=progress), [own["gains"]]) for period in OTHER_PERIODS
    ]
    for each in (own, *found):
        each["tuning"] = origin | each["tuning"]
    others = {f"{p:g}": OtherPeriod(**each) for p, each in zip(OTHER_PERIODS, found, strict=True)}
    plant = task.plant if task.mismatch is None else ""
    units = _units(law_of(task.law))
    file = GainsFile(name=name, controller=task.law, units=units, plant=plant, periods=others, **own)
    write_gains(path, file)
    return file


def _units(law: type[Controller]) -> dict[str, str]:
    return {gain.name: gain.unit for gain in law.GAINS}
