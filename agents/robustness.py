"""What spoils a controller: `python -m agents.robustness --out runs/robustness [CONTROLLER ...]`.

The set-point steps of the paper's section 4.1 under conditions that no law was tuned for: noisier sensors, delayed
commands, another control period, valves that change while they run, a faulty sensor. Scores are interquartile means over
pairs of `test_interp` (and `faulted`), cases that are used for nothing else; DIR receives `robustness.json` and
`robustness.md`.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.command import run_command
from hydro_env.benchmark.statistics import iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import SIGNALS
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.files import write_bytes
from hydro_env.limits import Limits
from hydro_env.plant import Plant, load_model
from hydro_env.tasks import Trace, compute

CONTROLLERS: tuple[str, ...] = (
    "pid_tuned",
    "cross_coupled",
    "virtual_leader",
    "adaptive_flow",
    "probing_flow",
    "ppo",
    "gru",
)
METRICS = ("max_speed_difference_rpm", "tracking_mae_rpm", "command_variation")
DURATION = 6.0


@dataclass(frozen=True)
class Condition:
    """One way to make life harder.

    delay: of the commands, s; drift: called with the plant, the values at the start and the share of the episode that is
    over (0 to 1) before every control period.
    """

    name: str
    mismatch: str = "test_interp"
    period: float = 0.01
    noise: float = 1.0
    delay: float = 0.0
    drift: Callable[[Plant, dict[str, Any], float], None] | None = None


def _drifting(plant: Plant, begin: dict[str, Any], over: float) -> None:
    """Valve 1 loses a quarter of its gain, the overlap of valve 2 grows by 60 um."""
    plant.set("Kq", begin["Kq"] * (1.0 - over * np.array([0.25, 0.0])))
    for side in ("positive", "negative"):
        name = f"dead_zone.overlap_{side}"
        plant.set(name, begin[name] + over * np.array([0.0, 60e-6]))


CONDITIONS = (
    Condition("as trained"),
    Condition("sensor noise x 3", noise=3.0),
    Condition("sensor noise x 10", noise=10.0),
    Condition("delay of one period", delay=0.01),
    Condition("delay of two periods", delay=0.02),
    Condition("control every 5 ms", period=0.005),
    Condition("control every 20 ms", period=0.02),
    Condition("valves drifting", drift=_drifting),
    Condition("one fault (split faulted)", mismatch="faulted"),
)


def drive(controller: Any, cases: Sequence[int], condition: Condition) -> dict[str, Any]:
    """Metrics of every case, each (len(cases),); what diverges counts as infinitely bad."""
    model = load_model("paper_dead_zone")
    if condition.delay:
        model = model.with_values({"command_delay.delay": condition.delay})
    env = HydraulicSyncVectorEnv(
        len(cases), plant=model, mismatch=condition.mismatch, scenario="setpoint_steps",
        control_period=condition.period, noise=condition.noise,
    )  # fmt: skip
    observation, info = env.reset(options={"case": list(cases)}, seed=[int(case) for case in cases])
    controller.reset(len(cases), condition.period)
    assert isinstance(env.plant, Plant)
    names = ("Kq", "dead_zone.overlap_positive", "dead_zone.overlap_negative")
    begin = {name: env.plant.get(name) for name in names}
    signals = {key: [np.array(info[key])] for key in SIGNALS}
    commands, bad = [], np.zeros(len(cases), bool)
    steps = round(DURATION / condition.period)
    for step in range(steps):
        if condition.drift is not None:
            condition.drift(env.plant, begin, step / steps)
        action = np.clip(np.nan_to_num(controller.act(observation)), -1.0, 1.0)
        observation, _, terminated, _, info = env.step(action.astype(np.float32))
        bad |= terminated
        commands.append(action)
        for key, rows in signals.items():
            rows.append(np.array(info[key]))
    arrays: dict[str, Any] = {key: np.array(rows) for key, rows in signals.items()}
    trace = Trace(period=condition.period, command=np.array(commands), **arrays)
    return {name: np.where(bad, np.inf, values) for name, values in compute(trace, METRICS).items()}


def study(
    names: Iterable[str], cases: Sequence[int], conditions: Iterable[Condition] = CONDITIONS
) -> list[dict[str, Any]]:
    """Rows with condition, controller, and per metric the interquartile mean; the 95th percentile of the difference."""
    rows = []
    names = list(names)
    for condition in tqdm(list(conditions), unit="condition"):
        for name in names:
            scores = drive(make_controller(name), cases, condition)
            row: dict[str, Any] = {"condition": condition.name, "controller": name, "pairs": len(cases)}
            row |= {metric: float(iqm(values)) for metric, values in scores.items()}
            row["p95_rpm"] = float(np.percentile(scores[METRICS[0]], 95))
            rows.append(row)
    return rows


def as_table(rows: list[dict[str, Any]]) -> str:
    """Markdown: a line per condition, a column per controller: largest difference (95th percentile) / tracking error."""
    names = list(dict.fromkeys(row["controller"] for row in rows))
    lines = ["| condition | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for condition in dict.fromkeys(row["condition"] for row in rows):
        cells = [
            f"{row[METRICS[0]]:.1f} ({row['p95_rpm']:.0f}) / {row[METRICS[1]]:.0f}"
            for row in rows
            if row["condition"] == condition
        ]
        lines.append(f"| {condition} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.robustness", description=__doc__)
    parser.add_argument("controllers", nargs="*", default=CONTROLLERS, help="names or policy files")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--first", type=Limits(0, 999, whole=True), default=200, help="first case of the split"
    )
    parser.add_argument("--cases", type=Limits(1, 1000, whole=True), default=100, help="pairs of valves")
    chosen = parser.parse_args()

    def run() -> None:
        if not 0 <= chosen.first < chosen.first + chosen.cases <= 1000:
            raise InputError("cases lie from 0 to 999")
        rows = study(chosen.controllers, range(chosen.first, chosen.first + chosen.cases))
        chosen.out.mkdir(parents=True, exist_ok=True)
        write_bytes(chosen.out / "robustness.json", json.dumps(rows, indent=1).encode())
        write_bytes(chosen.out / "robustness.md", as_table(rows).encode())
        print(as_table(rows))

    run_command(run)


if __name__ == "__main__":
    main()
