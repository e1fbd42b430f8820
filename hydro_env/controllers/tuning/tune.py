"""Tunes a controller's gains on the training pairs: `hydro-env tune`; the search itself is in `tuning.search`.

It begins at the gains a law ships with, and at what the linearised plant makes of them.
By similarity gains of the paper's rig are the same numbers on a rig of another size. What similarity does not see is how stiff a
rig is: with little leakage or a short line the loop takes a tenth of the gain. The linearised plant sees that. Gains in V/rpm and
times in s are carried over a second time with the ratio of the gain and integral time that `tune_channel` finds on both plants.
"""

import shlex
from math import isfinite, log
from pathlib import Path

import numpy as np

from hydro_env.controllers.base import Controller
from hydro_env.controllers.registry import CONTROLLERS, law_of
from hydro_env.controllers.tuning.gains import GainsFile, read_gains, write_gains
from hydro_env.controllers.tuning.linearised import tune_channel
from hydro_env.controllers.tuning.search import Search, search
from hydro_env.plant import load_model, scales_of
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


def starts(name: str, plant: str, period: float) -> list[dict[str, float]]:
    """Gains in the units of the law, for a law by its name, a plant and a control period (s); none for a law without shipped
    gains or defaults.
    """
    law, shipped = law_of(name), _shipped(name, period)
    if not shipped:
        defaults = {gain.name: gain.default for gain in law.GAINS if gain.default is not None}
        return [defaults] if len(defaults) == len(law.GAINS) and all(map(isfinite, defaults.values())) else []
    gain, time = np.divide(_linear(plant), _linear("paper"))
    ratio = {"V/rpm": gain, "s": time}
    sizes = {each.name: float(ratio.get(each.unit, 1.0)) for each in law.GAINS}
    return [shipped, {key: value * sizes[key] for key, value in shipped.items()}]


def _shipped(name: str, period: float) -> dict[str, float]:
    """The gains of the first controller that ships with this law, for the nearest control period."""
    files = [entry.file for entry in CONTROLLERS.values() if entry.file and entry.file.suffix == ".json"]
    for found in map(read_gains, files):
        if found.controller == name:
            sets = found.by_period()
            return dict(sets[min(sets, key=lambda known: abs(log(known / period)))])
    return {}


def _linear(plant: str) -> tuple[float, float]:
    """Kp in V/rpm as on the paper's rig, and Ti in s; geometric means of both channels."""
    model = load_model(plant)
    found = [tune_channel(model, channel) for channel in (0, 1)]
    kp, ti = ((found[0][key] * found[1][key]) ** 0.5 for key in ("Kp", "Ti"))
    scales = scales_of(model)
    return kp * scales.factor("rpm") / scales.factor("V"), ti
