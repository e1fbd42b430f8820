"""The gains of the controllers that ship, found by the search of `hydro-env tune`.

    python -m docs.evidence.shipped_gains --out DIR [--only NAME ...] [--seed N]

Each is searched from nothing at `PERIOD`, then from the gains found there at each of `OTHER_PERIODS`. DIR/NAME.json is written as
soon as it is found; one that is there from the same command is kept, so that an interrupted run goes on.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from agents.command import run_command
from hydro_env.controllers.registry import law_of
from hydro_env.controllers.tuning.gains import GainsFile, OtherPeriod, read_gains, write_gains
from hydro_env.controllers.tuning.search import Search, Task, drive, search
from hydro_env.controllers.tuning.tune import units_of
from hydro_env.limits import SEEDS

PERIOD, OTHER_PERIODS = 0.01, (0.005, 0.02)
#: The controllers that ship with gains found by search, by the name they ship under.
SHIPPED: dict[str, Task] = {
    "pid_tuned": Task("pid"),
    "master_slave": Task("master_slave"),
    "cross_coupled": Task("cross_coupled"),
    "relative_coupling": Task("relative_coupling"),
    "virtual_leader": Task("virtual_leader"),
    "disturbance_observer": Task("disturbance_observer"),
    "compensated": Task("compensated"),
    "servo_pid": Task("ramped_pid", plant="servo", mismatch=None),
}


def run(
    out: Path, names: Sequence[str] = tuple(SHIPPED), seed: int = 0, progress: bool = True
) -> dict[str, GainsFile]:
    """Tunes controllers of `SHIPPED` for all control periods; writes `out/NAME.json` for each."""
    return {name: _tuned(name, out, seed, progress) for name in names}


def _tuned(name: str, out: Path, seed: int, progress: bool) -> GainsFile:
    """Gains of one of `SHIPPED`, from `out` if the same command has left them there."""
    task, path = SHIPPED[name], out / f"{name}.json"
    origin = {
        "command": f"python -m docs.evidence.shipped_gains --only {name} --seed {seed}",
        "version": version("hydro_env"),
        "plant_drive_rpm": list(drive(task.plant)),
    }
    if path.exists():
        kept = read_gains(path)
        if origin.items() <= kept.tuning.items():
            return kept
    out.mkdir(parents=True, exist_ok=True)  # before minutes of work
    own = search(Search(task, seed, PERIOD, progress=progress))
    found = [
        search(Search(task, seed, period, progress=progress), [own["gains"]]) for period in OTHER_PERIODS
    ]
    for each in (own, *found):
        each["tuning"] = origin | each["tuning"]
    others = {f"{p:g}": OtherPeriod(**each) for p, each in zip(OTHER_PERIODS, found, strict=True)}
    plant = task.plant if task.mismatch is None else ""
    units = units_of(law_of(task.law))
    file = GainsFile(name=name, controller=task.law, units=units, plant=plant, periods=others, **own)
    write_gains(path, file)
    return file


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="shipped_gains", description="The gains of the controllers that ship."
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=SHIPPED, default=tuple(SHIPPED))
    parser.add_argument("--seed", type=SEEDS, default=0)
    given = parser.parse_args()
    found = run(given.out, given.only, given.seed)
    print(f"In {given.out}: {', '.join(f'{name}.json' for name in found)}")


if __name__ == "__main__":
    run_command(main)
