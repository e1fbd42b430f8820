"""Tunes a controller's gains on the training pairs: `hydro-env tune`.

The cost of one episode, in rpm, is  tracking_mae_rpm + weight * max_speed_difference_rpm:  the mean error of
both motors to the set-point, plus the largest difference between them, which counts double by default since
moving together is the task. The cost of a set of gains is its mean
over pairs and scenarios. Differential evolution (SciPy) searches the gains on the scale their `Gain` names; a
whole generation is one batch of rigs. All candidates drive the same pairs with the same noise. Only the split
`train` may be used, or the plant's own pair.
"""

from __future__ import annotations

import shlex
from math import log
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from tqdm import tqdm

from hydro_env.controllers.base import Controller, Floats
from hydro_env.controllers.gains import GainsFile, write_gains
from hydro_env.controllers.registry import LAWS
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.files import output_folder
from hydro_env.plant import load_model
from hydro_env.tasks import load_scenario

__all__ = ["cost", "run"]

POPULATION = 24
COSTS = ("tracking_mae_rpm", "max_speed_difference_rpm")


def cost(metrics: dict[str, Floats], weight: float) -> Floats:
    """Cost of every episode in rpm."""
    return metrics["tracking_mae_rpm"] + weight * metrics["max_speed_difference_rpm"]


def run(
    out: str | Path,
    *,
    controller: str = "pid",
    plant: str = "paper_dead_zone",
    mismatch: str | None = "train",
    scenario: str = "setpoint_steps,random_steps",
    cases: int = 12,
    episodes: int = 12288,
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
    if controller not in LAWS:
        raise InputError(f"unknown control law {controller!r}; there are {', '.join(LAWS)}")
    if mismatch not in ("train", None):
        raise InputError(
            f"mismatch {mismatch!r}: gains are tuned on 'train' or on the plant's own pair, never on other splits"
        )
    scenarios = [load_scenario(each.strip()).name for each in scenario.split(",")]
    load_model(plant)  # here, since SciPy hides what goes wrong inside of a search
    generation = cases * POPULATION * len(scenarios)
    if cases < 1 or episodes < 2 * generation:
        raise InputError(
            f"episodes {episodes}: {cases} cases need at least {2 * generation} (two generations)"
        )
    law = LAWS[controller]
    names = [gain.name for gain in law.GAINS]
    seeds = [seed + i for i in range(cases)]
    spent = 0

    def mean_costs(genes: Floats) -> Floats:
        """Costs (candidates,) of genes (gains, candidates), all candidates and pairs in one batch."""
        nonlocal spent
        count = genes.shape[1]
        columns = np.repeat(_values(law, genes), cases, axis=1)[:, :, None]
        tried = law(controller, **dict(zip(names, columns, strict=True)))
        total = np.zeros(count)
        for each in scenarios:
            done = roll_out(
                tried,
                seeds * count,
                plant=plant,
                mismatch=mismatch,
                scenario=each,
                control_period=control_period,
            )
            total += cost(done.metrics(COSTS), weight).reshape(count, cases).mean(axis=1) / len(scenarios)
            spent += cases * count
            bar.update(cases * count)
        return total

    generations = episodes // generation - 1
    bounds = _bounds(law)
    with tqdm(total=(generations + 1) * generation, unit="episode", disable=not progress) as bar:
        found = differential_evolution(
            mean_costs, bounds, init=_latin_hypercube(bounds, np.random.default_rng(seed)), maxiter=generations,
            rng=np.random.default_rng(seed), vectorized=True, updating="deferred", mutation=(0.4, 0.9),
            recombination=0.9, polish=False, tol=0.0,
        )  # fmt: skip
    gains = {key: float(f"{value:.4g}") for key, value in zip(names, _values(law, found.x), strict=True)}
    options = {
        "controller": controller,
        "plant": plant,
        "mismatch": mismatch or "none",
        "scenario": ",".join(scenarios),
        "cases": cases,
        "episodes": episodes,
        "weight": f"{weight:g}",
        "control-period": f"{control_period:g}",
        "seed": seed,
    }
    tuning = {
        "command": "hydro-env tune "
        + " ".join(f"--{key} {shlex.quote(str(v))}" for key, v in options.items()),
        "split": mismatch,
        "plant": str(plant),
        "scenarios": scenarios,
        "cases": cases,
        "episodes": spent,
        "seed": seed,
        "control_period_s": control_period,
        "objective": f"mean over pairs and scenarios of tracking_mae_rpm + {weight:g} max_speed_difference_rpm",
        "optimiser": f"differential evolution, population {POPULATION}, {generations} generations",
        "cost_rpm": float(f"{found.fun:.5g}"),
    }
    units = {gain.name: gain.unit for gain in law.GAINS}
    with output_folder(out) as folder:
        write_gains(
            folder / "gains.json", GainsFile(controller, dict(gains), units, tuning, name or controller)
        )
    return {"controller": controller, "gains": gains, "units": units, "tuning": tuning}


def _bounds(law: type[Controller]) -> Floats:
    """Where to search, (gains, 2): the logarithm of gains on a logarithmic scale."""
    rows = [(gain.low, gain.high) if not gain.log else (log(gain.low), log(gain.high)) for gain in law.GAINS]
    return np.array(rows)


def _values(law: type[Controller], genes: Floats) -> Floats:
    """Gains for what the search works with, both (gains, ...)."""
    return np.stack([np.exp(x) if gain.log else x for gain, x in zip(law.GAINS, genes, strict=True)])


def _latin_hypercube(bounds: Floats, rng: np.random.Generator) -> Floats:
    """First generation (POPULATION, gains): every gain's range is cut into equal parts, each used once;
    the first candidate is the middle of all ranges.
    """
    parts = np.stack([rng.permutation(POPULATION) for _ in bounds], axis=1)
    share = (parts + rng.random(parts.shape)) / POPULATION
    share[0] = 0.5
    return bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])
