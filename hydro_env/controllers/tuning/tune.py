"""Tunes a controller's gains on the training pairs: `hydro-env tune`.

The cost of one episode, in rpm, is
    tracking_mae_rpm + weight (max_speed_difference_rpm + 2 rms_speed_difference_rpm) + 5 command_variation:
the mean error of both motors to the set-point, plus the difference between them, which counts double by default since
moving together is the task. Its peak alone would not do: gains that let the motors hunt for ever, by as much as the last
reversal takes them apart, would cost nothing. Nor would commands full of noise, which wear valves out. The cost of a set of
gains is its mean over pairs and scenarios. Differential evolution (SciPy) searches the gains on the scale their `Gain` names; a
whole generation is one batch of rigs. All candidates drive the same pairs with the same noise. Only the split
`train` may be used, or the plant's own pair.

The controllers that ship (`--controller all`) have one budget, about that of the search of the law beneath the agents, which
had some 480 000 episodes. Each is searched twice, as a search may end in a valley: with few pairs and with many
(`SEARCHES`), at `PERIOD` and then, the first generation around the gains found there, at each of `OTHER_PERIODS`. Whichever
costs less on the many pairs ships. That is a quarter of an hour of a core for each controller; what has been found is kept
when the command is interrupted, and not searched again.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from math import inf, log
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from tqdm import tqdm

from hydro_env.controllers.base import FRACTION_PER_V, RPM, Controller, Floats, Gain
from hydro_env.controllers.registry import LAWS
from hydro_env.controllers.rollout import roll_out
from hydro_env.controllers.tuning.gains import GainsFile, read_gains, write_gains
from hydro_env.errors import InputError, suggestion
from hydro_env.files import output_folder
from hydro_env.plant import load_model, simulate
from hydro_env.tasks import load_scenario

__all__ = ["COMMON", "Task", "cost", "drive", "run", "run_all"]

POPULATION = 24
SCENARIOS = "setpoint_steps,random_steps"
CASES, TRIALS = 12, 480
"""Pairs of valves that a set of gains drives in every scenario, and how many sets are tried, where nothing else is asked for."""
EPISODES = 2 * CASES * TRIALS
PERIOD, OTHER_PERIODS = 0.01, (0.005, 0.02)


@dataclass(frozen=True)
class Budget:
    """`trials` sets of gains, each of which drives `cases` pairs of valves in both of `SCENARIOS`."""

    cases: int
    trials: int

    @property
    def episodes(self) -> int:
        return 2 * self.cases * self.trials


SEARCHES = (
    (Budget(cases=12, trials=480), Budget(cases=12, trials=144)),
    (Budget(cases=200, trials=960), Budget(cases=100, trials=240)),
)
"""What each controller of `COMMON` has at `PERIOD`, and at each of `OTHER_PERIODS`."""
JUDGED = 200
"""Pairs, from the seed of the search on, that the results of `SEARCHES` are compared on in both scenarios."""
AROUND = 0.15
"""A search around known gains begins within this share of every range to both sides of them."""
COSTS = ("tracking_mae_rpm", "max_speed_difference_rpm", "rms_speed_difference_rpm", "command_variation")
RMS, WEAR = 2.0, 5.0
"""How many rpm of the largest difference one of the RMS difference is worth, and how many rpm of tracking error one whole
rated command a second.
"""


@dataclass(frozen=True)
class Task:
    """What differs between the controllers that ship: the law, and what it is tuned for."""

    law: str
    weight: float = 2.0
    plant: str = "paper_dead_zone"
    mismatch: str | None = "train"
    calm: bool = True
    """Whether the RMS of the difference and the variation of the command count in the cost."""
    scenarios: tuple[str, ...] = tuple(SCENARIOS.split(","))


COMMON: dict[str, Task] = {
    "pid_tuned": Task("pid"),
    "master_slave": Task("master_slave"),
    "cross_coupled": Task("cross_coupled"),
    "relative_coupling": Task("relative_coupling"),
    "virtual_leader": Task("virtual_leader"),
    "disturbance_observer": Task("disturbance_observer"),
    "compensated": Task("compensated"),
    # With them the reference would trade its lead in the difference for calmer valves and loads that part the motors.
    "servo_pid": Task("ramped_pid", plant="servo", mismatch=None, calm=False),
}
"""The controllers that are tuned with the common budget, by the name they ship under."""


def cost(metrics: dict[str, Floats], weight: float, calm: bool = True) -> Floats:
    """Cost of every episode in rpm; the RMS of the difference and the variation of the command only count with `calm`."""
    peak, tracking = metrics["max_speed_difference_rpm"], metrics["tracking_mae_rpm"]
    if not calm:
        return tracking + weight * peak
    apart = peak + RMS * metrics["rms_speed_difference_rpm"]
    return tracking + weight * apart + WEAR * metrics["command_variation"]


def run_all(
    out: str | Path, *, names: list[str] | None = None, seed: int = 0, progress: bool = True
) -> dict[str, GainsFile]:
    """Tunes the controllers of `COMMON` (or those of them that are named) for all control periods with the common budget
    and writes `out/NAME.json` for each as soon as it is found. One that is there already from the same command is kept.

    InputError for a name that `COMMON` lacks, or a folder that cannot be written.
    """
    for name in names or ():
        if name not in COMMON:
            raise InputError(f"--only {name!r}: {suggestion(name, COMMON)}")
    return {name: _tuned(name, Path(out), seed, progress) for name in names or COMMON}


def _tuned(name: str, out: Path, seed: int, progress: bool) -> GainsFile:
    """Gains of one of `COMMON`, from `out` if the same command has left them there."""
    task, path = COMMON[name], out / f"{name}.json"
    origin = {
        "command": f"hydro-env tune --controller all --only {name} --seed {seed}",
        "version": version("hydro_env"),
        "plant_drive_rpm": list(drive(task.plant)),
        "budget": sum(first.episodes + len(OTHER_PERIODS) * other.episodes for first, other in SEARCHES),
    }
    if path.exists():
        kept = read_gains(path)
        if origin.items() <= kept.tuning.items():
            return kept
    with output_folder(out) as folder:
        found = [_by_period(task, seed, progress, *budgets) for budgets in SEARCHES]
        best = {period: _cheaper(task, seed, period, [each[period] for each in found]) for period in found[0]}
        for each in best.values():
            each["tuning"] = origin | each["tuning"]
        own = best.pop(PERIOD)
        others = {f"{period:g}": each for period, each in best.items()}
        plant = task.plant if task.mismatch is None else ""
        file = GainsFile(task.law, own["gains"], _units(LAWS[task.law]), own["tuning"], name, others, plant)
        write_gains(folder / path.name, file)
    return file


def _by_period(
    task: Task, seed: int, progress: bool, first: Budget, other: Budget
) -> dict[float, dict[str, Any]]:
    """What one search finds for every control period."""
    own = _search(task, seed, progress, PERIOD, first.cases, first.episodes)
    return {PERIOD: own} | {
        period: _search(task, seed, progress, period, other.cases, other.episodes, near=own["gains"])
        for period in OTHER_PERIODS
    }


def _cheaper(task: Task, seed: int, period: float, found: list[dict[str, Any]]) -> dict[str, Any]:
    """The one of several results of searches that costs least on the same `JUDGED` pairs, with what they all cost."""
    law = LAWS[task.law]
    costs = [
        float(_costs(law(task.law, **each["gains"]), 1, task, range(seed, seed + JUDGED), period)[0])
        for each in found
    ]
    told = ("cases", "trials", "episodes")
    searches = [
        {key: each["tuning"][key] for key in told} | {"cost_rpm": float(f"{cost:.5g}")}
        for each, cost in zip(found, costs, strict=True)
    ]
    best = found[int(np.argmin(costs))]
    return best | {"tuning": best["tuning"] | {"judged_on": JUDGED, "searches": searches}}


def run(
    out: str | Path,
    *,
    controller: str = "pid",
    plant: str = "paper_dead_zone",
    mismatch: str | None = "train",
    scenario: str = SCENARIOS,
    cases: int = CASES,
    episodes: int = EPISODES,
    weight: float = 2.0,
    control_period: float = 0.01,
    seed: int = 0,
    name: str | None = None,
    progress: bool = True,
) -> dict[str, Any]:
    """Searches the gains of a control law and writes `out/gains.json`, which `make_controller` reads.

    Args:
        out: folder for gains.json.
        controller: the control law, a key of `LAWS`.
        plant: preset or model file.
        mismatch: "train", or None for the plant's own pair of valves.
        scenario: what is driven; several are separated by commas and count equally.
        cases: pairs of valves each candidate drives in each scenario (seeds `seed`, `seed + 1`, ...).
        episodes: the budget: how many episodes may be simulated in all.
        weight: how many rpm of tracking error one rpm of the largest speed difference is worth.
        control_period: s.
        seed: of the search and of the pairs.
        name: the controller's name in score boards.
        progress: whether to show a progress bar.

    Returns what gains.json says. InputError for a control law or split that may not be tuned on.
    """
    task = Task(controller, weight, plant, mismatch, scenarios=tuple(scenario.split(",")))
    found = _search(task, seed, progress, control_period, cases, episodes)
    options = {
        "controller": controller,
        "plant": plant,
        "mismatch": mismatch or "none",
        "scenario": ",".join(found["tuning"]["scenarios"]),
        "cases": cases,
        "episodes": episodes,
        "weight": f"{weight:g}",
        "control-period": f"{control_period:g}",
        "seed": seed,
    }
    told = " ".join(f"--{key} {shlex.quote(str(v))}" for key, v in options.items())
    tuning = {"command": f"hydro-env tune {told}"} | found["tuning"]
    units = _units(LAWS[controller])
    with output_folder(out) as folder:
        write_gains(
            folder / "gains.json", GainsFile(controller, found["gains"], units, tuning, name or controller)
        )
    return {"controller": controller, "gains": found["gains"], "units": units, "tuning": tuning}


def _search(
    task: Task,
    seed: int,
    progress: bool,
    control_period: float,
    cases: int,
    episodes: int,
    near: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """The search itself: {"gains", "tuning"}, where the first generation lies around the gains `near` if given."""
    if task.law not in LAWS:
        raise InputError(f"unknown control law {task.law!r}; there are {', '.join(LAWS)}")
    if task.mismatch not in ("train", None):
        raise InputError(
            f"mismatch {task.mismatch!r}: gains are tuned on 'train' or on the plant's own pair, never on other splits"
        )
    task = replace(task, scenarios=tuple(load_scenario(each.strip()).name for each in task.scenarios))
    load_model(task.plant)  # here, since SciPy hides what goes wrong inside of a search
    generation = cases * POPULATION * len(task.scenarios)
    if cases < 1 or episodes < 2 * generation:
        raise InputError(
            f"episodes {episodes}: {cases} cases need at least {2 * generation} (two generations)"
        )
    law = LAWS[task.law]
    names = [gain.name for gain in law.GAINS]
    spent = 0

    def costs(genes: Floats) -> Floats:
        """Costs (candidates,) of genes (gains, candidates), all candidates and pairs in one batch."""
        nonlocal spent
        count = genes.shape[1]
        columns = np.repeat(_values(law, genes), cases, axis=1)[:, :, None]
        tried = law(task.law, **dict(zip(names, columns, strict=True)))
        found = _costs(tried, count, task, range(seed, seed + cases), control_period, bar)
        spent += cases * count * len(task.scenarios)
        return found

    generations = episodes // generation - 1
    bounds = _bounds(law)
    first = _latin_hypercube(bounds, np.random.default_rng(seed), None if near is None else _genes(law, near))
    label = f"{task.law} {control_period:g} s"
    with tqdm(total=(generations + 1) * generation, desc=label, unit="episode", disable=not progress) as bar:
        found = differential_evolution(
            costs, bounds, init=first, maxiter=generations,
            rng=np.random.default_rng(seed), vectorized=True, updating="deferred", mutation=(0.4, 0.9),
            recombination=0.9, polish=False, tol=0.0,
        )  # fmt: skip
    gains = {key: float(f"{value:.4g}") for key, value in zip(names, _values(law, found.x), strict=True)}
    if gains.get("slew", 0.0) * FRACTION_PER_V * control_period >= 2.0:
        del gains["slew"]  # the whole range within one period: no limit
    tuning = {
        "split": task.mismatch,
        "plant": str(task.plant),
        "scenarios": list(task.scenarios),
        "cases": cases,
        "trials": POPULATION * (generations + 1),
        "episodes": spent,
        "seed": seed,
        "control_period_s": control_period,
        "objective": "mean over pairs and scenarios of tracking_mae_rpm"
        + (
            f" + {task.weight:g} (max_speed_difference_rpm + {RMS:g} rms_speed_difference_rpm) + {WEAR:g} command_variation"
            if task.calm
            else f" + {task.weight:g} max_speed_difference_rpm"
        ),
        "optimiser": f"differential evolution, population {POPULATION}, {generations + 1} generations"
        + (", the first around the gains of another control period" if near else ""),
        "plant_dtype": "float32",
        "cost_rpm": float(f"{found.fun:.5g}"),
        "version": version("hydro_env"),
        "plant_drive_rpm": list(drive(task.plant)),
    }
    return {"gains": gains, "tuning": tuning}


def _costs(
    controller: Controller,
    count: int,
    task: Task,
    seeds: Sequence[int],
    control_period: float,
    bar: tqdm | None = None,
) -> Floats:
    """Costs (count,) of `count` sets of gains that `controller` holds, a row of gains for each pair of `seeds` in turn."""
    total = np.zeros(count)
    for scenario in task.scenarios:
        done = roll_out(
            controller, list(seeds) * count, plant=task.plant, mismatch=task.mismatch, scenario=scenario,
            control_period=control_period, dtype="float32",
        )  # fmt: skip
        costs = cost(done.metrics(COSTS), task.weight, task.calm)
        total += costs.reshape(count, len(seeds)).mean(axis=1) / len(task.scenarios)
        if bar is not None:
            bar.update(len(costs))
    return total


@lru_cache
def drive(plant: str) -> tuple[float, float]:
    """Speeds (rpm) of both motors of a plant after a fixed drive of 0.65 s: gains belong to a plant that still drives so."""
    levels = np.repeat([0.0, 0.4, -0.5, 0.6, 0.3], [10, 20, 15, 10, 11])
    rated = np.array(load_model(plant).pair("u_rated"))
    speed = simulate(load_model(plant), levels[:, None] * rated, None, 0.01, record=("speed",))["speed"][
        -1, 0
    ]
    return round(float(speed[0] / RPM), 2), round(float(speed[1] / RPM), 2)


def _units(law: type[Controller]) -> dict[str, str]:
    return {gain.name: gain.unit for gain in law.GAINS}


def _bounds(law: type[Controller]) -> Floats:
    """Where to search, (gains, 2): the logarithm of gains on a logarithmic scale."""
    rows = [(gain.low, gain.high) if not gain.log else (log(gain.low), log(gain.high)) for gain in law.GAINS]
    return np.array(rows)


def _values(law: type[Controller], genes: Floats) -> Floats:
    """Gains for what the search works with, both (gains, ...)."""
    return np.stack([np.exp(x) if gain.log else x for gain, x in zip(law.GAINS, genes, strict=True)])


def _genes(law: type[Controller], gains: Mapping[str, float]) -> Floats:
    """What the search works with for known gains, (gains,); one that is left out at the end of its range next to its default."""

    def of(gain: Gain) -> float:
        value = gains.get(gain.name, gain.default)
        value = min(max(inf if value is None else value, gain.low), gain.high)
        return log(value) if gain.log else value

    return np.array([of(gain) for gain in law.GAINS])


def _latin_hypercube(bounds: Floats, rng: np.random.Generator, middle: Floats | None) -> Floats:
    """First generation (POPULATION, gains): every gain's range is cut into equal parts, each used once;
    the first candidate is the middle of all ranges. With a `middle` (gains,), ranges are the part of `bounds` around it.
    """
    if middle is not None:
        reach = AROUND * (bounds[:, 1] - bounds[:, 0])
        bounds = np.stack(
            [np.maximum(bounds[:, 0], middle - reach), np.minimum(bounds[:, 1], middle + reach)], axis=1
        )
    parts = np.stack([rng.permutation(POPULATION) for _ in bounds], axis=1)
    share = (parts + rng.random(parts.shape)) / POPULATION
    share[0] = 0.5
    first = bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])
    if middle is not None:
        first[0] = middle
    return first
