"""Tunes a controller's gains on the training pairs: `hydro-env tune`.

The cost of one episode, in rpm:  tracking_mae_rpm + weight * max_speed_difference_rpm, the mean over both
motors of the error to the set-point, plus the largest difference between the motors; the cost of a set of
gains is the mean over the pairs, plus the same for the worst tenth of them by `tail`. Differential
evolution (SciPy, vectorised: a whole generation is one batch of rigs) searches the gains on the scale their
`Gain` names. All candidates drive the same pairs with the same noise. Only the split `train` is used,
unless the rig's own pair is.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from tqdm import tqdm

from hydro_env.controllers.base import Floats
from hydro_env.controllers.gains import GainsFile, write_gains
from hydro_env.controllers.registry import LAWS
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.files import output_folder

__all__ = ["cost", "run"]

POPULATION = 24


def cost(metrics: dict[str, Floats], weight: float) -> Floats:
    """Cost of every episode in rpm."""
    return metrics["tracking_mae_rpm"] + weight * metrics["max_speed_difference_rpm"]


def run(
    out: str | Path,
    *,
    controller: str = "pid",
    plant: str = "paper_dead_zone",
    mismatch: str | None = "train",
    scenario: str = "setpoint_steps",
    cases: int = 16,
    episodes: int = 6144,
    weight: float = 1.0,
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
        scenario: what is driven.
        cases: pairs of valves each candidate drives (seeds `seed`, `seed + 1`, ...).
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
    if cases < 1 or episodes < cases * POPULATION * 2:
        raise InputError(
            f"episodes {episodes}: {cases} cases need at least {cases * POPULATION * 2} (two generations)"
        )
    law = LAWS[controller]
    low, high, logarithmic = (
        np.array([getattr(gain, key) for gain in law.GAINS]) for key in ("low", "high", "log")
    )
    bounds = np.stack(
        [np.where(logarithmic, np.log(low), low), np.where(logarithmic, np.log(high), high)], axis=1
    )
    seeds = [seed + i for i in range(cases)]
    generations = episodes // (cases * POPULATION) - 1
    spent = 0

    def physical(genes: Floats) -> Floats:
        flags = logarithmic.reshape(-1, *[1] * (genes.ndim - 1))
        return np.where(flags, np.exp(np.where(flags, genes, 0.0)), genes)

    def costs(genes: Floats) -> Floats:
        """Costs (candidates,) of genes (gains, candidates), all candidates and pairs in one batch."""
        nonlocal spent
        values = np.repeat(physical(genes), cases, axis=1)[:, :, None]
        tried = law(controller, **{gain.name: column for gain, column in zip(law.GAINS, values, strict=True)})
        count = genes.shape[1]
        done = roll_out(
            tried,
            seeds * count,
            plant=plant,
            mismatch=mismatch,
            scenario=scenario,
            control_period=control_period,
        )
        spent += cases * count
        bar.update(cases * count)
        each = cost(done.metrics(("tracking_mae_rpm", "max_speed_difference_rpm")), weight)
        return np.mean(np.nan_to_num(each.reshape(count, cases), nan=1e6, posinf=1e6), axis=1)

    with tqdm(total=(generations + 1) * cases * POPULATION, unit="episode", disable=not progress) as bar:
        start = _latin_hypercube(bounds, np.random.default_rng(seed))
        found = differential_evolution(
            costs, bounds, init=start, maxiter=generations, rng=np.random.default_rng(seed),
            vectorized=True, updating="deferred", mutation=(0.4, 0.9), recombination=0.9, polish=False, tol=0.0,
        )  # fmt: skip
    gains = {
        gain.name: float(f"{value:.4g}") for gain, value in zip(law.GAINS, physical(found.x), strict=True)
    }
    command = (
        f"hydro-env tune --controller {controller} --plant {shlex.quote(str(plant))} --mismatch {mismatch or 'none'} "
        f"--scenario {scenario} --cases {cases} --episodes {episodes} --weight {weight:g} "
        f"--control-period {control_period:g} --seed {seed}"
    )
    tuning = {
        "command": command,
        "split": mismatch,
        "plant": str(plant),
        "scenario": scenario,
        "cases": cases,
        "episodes": spent,
        "seed": seed,
        "control_period_s": control_period,
        "objective": f"mean over the pairs of tracking_mae_rpm + {weight:g} max_speed_difference_rpm",
        "optimiser": f"differential evolution, population {POPULATION}, {generations} generations",
        "cost_rpm": float(f"{found.fun:.5g}"),
    }
    file = GainsFile(controller, dict(gains), {g.name: g.unit for g in law.GAINS}, tuning, name or controller)
    with output_folder(out) as folder:
        write_gains(folder / "gains.json", file)
    return {"controller": controller, "gains": gains, "units": file.units, "tuning": tuning}


def _latin_hypercube(bounds: Floats, rng: np.random.Generator) -> Floats:
    """First generation (POPULATION, gains): every gain's range is cut into equal parts, each used once."""
    parts = np.stack([rng.permutation(POPULATION) for _ in bounds], axis=1)
    share = (parts + rng.random(parts.shape)) / POPULATION
    return bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])
