"""Whether one policy is better on rigs that it never saw than controllers tuned for each of them.

    python -m docs.evidence.any_policy [CONTROLLER ...] --out DIR [--split test_any] [--first K] [--rigs N]

Each case of the split is a rig. Both `TUNED` laws are tuned on its model with the default search of `hydro-env tune`, and
drive it, as the controllers do, `TIMES` times in each of `SCENARIOS`. A pairwise comparison is one rig in one scenario: the share
of them in which a controller has the smaller mean is printed, and the mean ratio, with 95 % intervals by the bootstrap over rigs.
One that is idle, as the benchmark has it, loses against one that is not; ratios are those of rigs on which neither is.
What DIR holds is not run again. Writes any_policy.json.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from agents.command import run_command
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.controllers.tuning.search import Search, Task
from hydro_env.controllers.tuning.tune import run as tune
from hydro_env.files import write_json
from hydro_env.limits import Limits
from hydro_env.plant import PlantModel
from hydro_env.reading import read_json
from hydro_env.tasks import draw_pairs
from hydro_env.tasks.metrics import IDLE

TUNED = {"pid_tuned": "pid", "cross_coupled": "cross_coupled"}
SCENARIOS = "setpoint_steps", "random_steps"
METRICS = {
    "difference": "max_speed_difference_rpm",
    "tracking": "tracking_mae_rpm",
    "travel": "command_travel_per_s",
}
#: Episodes of a rig in a scenario, with other noise and profiles, and the seed of the search for its gains.
TIMES, SEED = 4, 10_000


def rig_of(split: str, case: int) -> PlantModel:
    """The model of a case; what is wrong with its sensors is no part of it."""
    values = {
        name: (float(value[0, 0]), float(value[0, 1]))
        for name, value in draw_pairs(split, [case]).values.items()
        if not name.startswith("speed_sensor.")
    }
    return PlantModel(values=values, name=f"{split}_{case}")


def _gains(law: str, split: str, case: int, out: Path) -> Path:
    """The gains file of a law that is tuned for a rig."""
    folder = out / "gains" / f"{split}_{case}_{law}"
    if not (folder / "gains.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        model = folder / "rig.yaml"
        model.write_text(yaml.safe_dump(rig_of(split, case).to_dict()), encoding="utf-8")
        tune(folder, Search(Task(law, plant=str(model), mismatch=None), SEED, progress=False), law)
    return folder / "gains.json"


def driven(controller: Any, split: str, case: int) -> dict[str, dict[str, float]]:
    """Mean metrics of a controller on a rig, by scenario, and whether it is idle (0 or 1); one that loses the motors has infinite
    ones."""
    found = {}
    for scenario in SCENARIOS:
        seeds = [case + 1000 * time for time in range(TIMES)]
        try:
            done = roll_out(controller, seeds, mismatch=split, scenario=scenario)
        except ValueError:
            found[scenario] = dict.fromkeys((*METRICS, "idle"), float("inf"))
            continue
        metrics = done.metrics(METRICS.values())
        found[scenario] = {short: float(np.mean(metrics[name])) for short, name in METRICS.items()}
        idle = found[scenario]["tracking"] > IDLE * np.abs(done.trace.setpoint_rpm).mean()
        found[scenario]["idle"] = float(idle)
    return found


def compared(
    rows: Mapping[str, Any], one: str, other: str, metric: str, draws: int = 2000
) -> tuple[str, str]:
    """Share of comparisons that `one` wins, and the geometric mean of its ratio to `other`, with intervals over rigs."""
    both = [row for row in rows.values() if one in row and other in row]
    values = np.array([[[row[name][s][metric] for s in SCENARIOS] for name in (one, other)] for row in both])
    idle = np.array(
        [[[row[name][s]["idle"] > 0.0 for s in SCENARIOS] for name in (one, other)] for row in both]
    )
    wins = np.where(idle[:, 0] == idle[:, 1], values[:, 0] < values[:, 1], idle[:, 1]).astype(float)
    ratio = np.log(np.maximum(values[:, 0], 1e-3) / np.maximum(values[:, 1], 1e-3))
    ratio[idle.any(axis=1) | ~np.isfinite(ratio)] = np.nan
    picked = np.random.default_rng(0).integers(0, len(both), (draws, len(both)))
    low, high = np.quantile(wins[picked].mean(axis=(1, 2)), [0.025, 0.975])
    a, b = np.exp(np.nanquantile(np.nanmean(ratio[picked], axis=(1, 2)), [0.025, 0.975]))
    return (
        f"{wins.mean():.2f} [{low:.2f}, {high:.2f}]",
        f"{np.exp(np.nanmean(ratio)):.2f} [{a:.2f}, {b:.2f}]",
    )


def _shown(rows: Mapping[str, Any], names: Sequence[str]) -> None:
    for name in (*TUNED, *names):
        of = [row[name][s] for row in rows.values() if name in row for s in SCENARIOS]
        print(
            name,
            {m: np.round(np.percentile([each[m] for each in of], [25, 50, 75]), 1).tolist() for m in METRICS},
        )
    for name in names:
        for other in TUNED:
            for metric in ("difference", "tracking"):
                wins, ratio = compared(rows, name, other, metric)
                print(f"{name} against {other}, {metric}: smaller in {wins}, ratio {ratio}, {len(rows)} rigs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("controllers", nargs="*", default=["gru_any"], help="names or files")
    add("--out", type=Path, required=True)
    add("--split", default="test_any")
    add("--first", type=Limits(0, 999, whole=True), default=0)
    add("--rigs", type=Limits(1, 1000, whole=True), default=50)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "any_policy.json"
    rows: dict[str, Any] = read_json(path, "rigs that were driven") if path.exists() else {}
    for case in range(given.first, given.first + given.rigs):
        row = rows.setdefault(f"{given.split} {case}", {})
        for name, law in TUNED.items():
            if name not in row:
                row[name] = driven(
                    make_controller(_gains(law, given.split, case, given.out)), given.split, case
                )
        for name in given.controllers:
            if name not in row:
                row[name] = driven(make_controller(name), given.split, case)
        write_json(path, rows)
        print(
            case,
            {
                name: {s: [round(v, 1) for v in each[s].values()] for s in SCENARIOS}
                for name, each in row.items()
            },
            flush=True,
        )
    _shown(rows, given.controllers)


if __name__ == "__main__":
    run_command(main)
