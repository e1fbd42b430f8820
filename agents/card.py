"""Scores on test pairs, as the tables of cards and docs: `python -m agents.card ppo` or several at once.

While an agent is developed its makers look at some test pairs, and what they see there steers what they try next. So the
tables are filled from cases that nobody looks at before: by default 500 to 699 of each split. `seeds:FOLDER` stands for
all policies `FOLDER/*/policy.npz`, whose scores are pooled: their interval is over pairs and over training seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.command import run_command
from hydro_env.benchmark.statistics import cvar, iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.limits import Limits
from hydro_env.training.evaluate import METRICS

ROWS = (
    *(("test_interp", name) for name in ("setpoint_steps", "load_step", "staircase", "sine", "unequal_load")),
    ("test_extrap", "setpoint_steps"),
    ("paper_pair", "setpoint_steps"),
)
HEAD = [
    "| controller | split | scenario | largest difference [95 % interval] | its 95th percentile | mean of the worst 5 %"
    " | RMS difference | tracking error | command travel, 1/s |",
    "|---|---|---|---|---|---|---|---|---|",
]

Floats = NDArray[np.float64]


def interval(
    values: Floats, statistic: Callable[[Floats], Any] = iqm, resamples: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """95 % percentile bootstrap interval of a statistic of values (policies, pairs): both are resampled."""
    stream = np.random.default_rng(seed)
    policies, pairs = values.shape
    means = []
    for _ in range(resamples):
        drawn = values[stream.integers(policies, size=policies)][:, stream.integers(pairs, size=pairs)]
        means.append(float(statistic(drawn.ravel())))
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def _drivers(name: str) -> list[Any]:
    """The controllers that a name stands for."""
    if name.startswith("seeds:"):
        found = sorted(Path(name.removeprefix("seeds:")).glob("*/policy.npz"))
        if not found:
            raise InputError(f"{name}: there is no */policy.npz")
        return [make_controller(str(path)) for path in found]
    return [make_controller(name)]


def card_rows(
    name: str,
    first: int = 500,
    cases: int = 200,
    rows: Sequence[tuple[str, str]] = ROWS,
    preset: str = "paper_dead_zone",
) -> list[str]:
    """Lines of a table (Markdown) for one controller on a preset."""
    drivers = _drivers(name)
    # what belongs to another plant is driven on that plant's own pair
    plant = getattr(drivers[0], "plant", None)
    lines = []
    for split, scenario in rows:
        count = min(cases, 20) if split == "paper_pair" else cases  # one pair, 20 times other noise
        where: dict[str, Any] = {"plant": plant or preset, "mismatch": None if plant else split}
        seeds = range(first, first + count)
        runs = [roll_out(driver, seeds, scenario=scenario, **where).metrics(METRICS) for driver in drivers]
        scores = {metric: np.array([run[metric] for run in runs]) for metric in METRICS}
        largest = scores[METRICS[0]]
        low, high = interval(largest)
        means = [float(iqm(scores[metric].ravel())) for metric in METRICS]
        lines.append(
            f"| {name} | {split} | {scenario} | {means[0]:.1f} [{low:.1f}, {high:.1f}]"
            f" | {np.percentile(largest, 95):.1f} | {cvar(largest):.1f}"
            f" | {means[1]:.1f} | {means[2]:.1f} | {means[3]:.2f} |"
        )
        if len(drivers) > 1:
            each = ", ".join(f"{float(iqm(row)):.1f}" for row in largest)
            lines[-1] += f" each: {each}"
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.card", description=__doc__)
    parser.add_argument("controllers", nargs="+", help="shipped controllers, policy files, or seeds:FOLDER")
    parser.add_argument(
        "--first",
        type=Limits(0, 10**6, whole=True),
        default=500,
        help="first case of each split; beyond 999 the same cases with other noise",
    )
    parser.add_argument(
        "--cases", type=Limits(1, 1000, whole=True), default=200, help="pairs of valves in each split"
    )
    parser.add_argument("--plant", default="paper_dead_zone", help="preset that is driven")
    chosen = parser.parse_args()

    def run() -> None:
        print("\n".join(HEAD), flush=True)
        for name in chosen.controllers:
            print("\n".join(card_rows(name, chosen.first, chosen.cases, preset=chosen.plant)), flush=True)

    run_command(run)


if __name__ == "__main__":
    main()
