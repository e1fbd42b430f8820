"""Tunes a controller's gains on the training pairs: `hydro-env tune`; the search itself is in `tuning.search`."""

from __future__ import annotations

import shlex
from pathlib import Path

from hydro_env.controllers.base import Controller
from hydro_env.controllers.registry import law_of
from hydro_env.controllers.tuning.gains import GainsFile, write_gains
from hydro_env.controllers.tuning.search import Search, search
from hydro_env.controllers.tuning.start import starts
from hydro_env.tasks import OWN


def run(out: str | Path, wanted: Search, name: str | None = None) -> GainsFile:
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
    called, units = name or task.law.rpartition(":")[2], units_of(law_of(task.law))
    file = GainsFile(name=called, controller=task.law, gains=found["gains"], units=units, tuning=tuning)
    return write_gains(Path(out) / "gains.json", file)


def summary(found: GainsFile) -> str:
    """What a run says: the cost beside that of the first gains and of motors at rest, and how far the search has come."""
    tuning = found.tuning
    others = {"the gains it began with": tuning.get("start"), "motors at rest": tuning["at_rest"]}
    beside = ", ".join(f"{value:.4g} with {what}" for what, value in others.items() if value is not None)
    lines = [
        f"cost {tuning['cost']:.4g} rpm on {tuning['judged_on']} other pairs ({beside}); "
        f"the last quarter of the search gained {tuning['last_quarter_gained_percent']:.2g} %"
    ]
    lines += [f"{name} = {value:.4g} {found.units[name]}" for name, value in found.gains.items()]
    for name, end in tuning["at_end_of_range"].items():
        lines.append(f"{name} ended at the {'upper' if end else 'lower'} end of its range")
    if tuning["cost"] > 0.95 * tuning["at_rest"]:
        lines.append(f"{found.controller} is hardly better here than motors at rest: try another control law")
    return "\n".join(lines)


def units_of(law: type[Controller]) -> dict[str, str]:
    """The units of a law's gains, by their names."""
    return {gain.name: gain.unit for gain in law.GAINS}
