"""What the agents of `agents.baselines` are worth: their table, their picture, and the line to beat, the best of each class.

All are driven on the same pairs of `val`, by which no agent was chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.card import interval
from agents.curves import CLOCKS, draw
from hydro_env.benchmark.statistics import iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.files import write_bytes
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json
from hydro_env.training.evaluate import scored_pairs

SCENARIOS = ("random_steps", "setpoint_steps")
PEAK, TRACKING, RETURN = "max_speed_difference_rpm", "tracking_mae_rpm", "mean_return"
#: Pairs that score for each pair that chose.
SCORING = 2
LEARNT, CLONED = "signals only, learnt from the reward", "signals only, cloned"
#: Controllers that ship, by what they may know and how they came about.
CLASSES = {
    "signals only, classical": (
        "pid_paper", "pid_tuned", "master_slave", "cross_coupled", "relative_coupling", "virtual_leader", "disturbance_observer",
    ),
    LEARNT: ("ppo", "sac"),
    CLONED: (),
    "signals only, model-based law": ("adaptive_flow", "probing_flow"),
    "signals only, learnt from that law and the simulator's gradient": ("gru",),
    "valve bench": ("compensated", "bench_flow"),
    "servo valves": ("servo_pid",),
    "everything": ("oracle",),
}  # fmt: skip
#: Who all others are compared with, on the same episodes.
COMPARED = "gru"

#: Levels of the picture.
ON_THE_PICTURE = ("pid_tuned", "cross_coupled", "gru")
HEAD = [
    f"mean return in `{SCENARIOS[0]}`",
    *(f"peak / tracking error in `{each}`, rpm" for each in SCENARIOS),
]

#: Arguments of the environment for tasks from easy to hard, and what each adds.
LADDER: dict[str, tuple[str, dict[str, Any]]] = {
    "equal": (
        "two equal valves without dead zone",
        {"plant": "paper", "mismatch": {"Kq": 476106e-6, "Fc": 0.1, "Fs": 0.2, "vs": 0.007}},
    ),
    "pair": ("the paper's two valves, one with a dead zone, always the same", {"mismatch": "own"}),
    "train": ("another pair of valves in every episode: the default", {}),
    "test_extrap": ("valves beyond the training ranges", {"mismatch": "test_extrap"}),
    "rig": ("a realistic machine: 24 V coils, supply droop, friction of the motors", {"plant": "rig"}),
}
#: Controllers on the ladder; `probing_flow` has settings of its own on `rig`.
ON_THE_LADDER = ("zero commands", "pid_paper", "pid_tuned", "cross_coupled", "probing_flow")

Floats = NDArray[np.float64]
Scores = dict[str, dict[str, Floats]]
"""Per scenario and metric the values (policies, episodes)."""


class Still:
    """Zero commands: what the other returns are to be compared with."""

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Has nothing to forget."""

    def act(self, observation: NDArray[np.float32]) -> Floats:
        """Zero commands (n, 2)."""
        return np.zeros((len(observation), 2))


def drive(drivers: Sequence[Any], pairs: range, scenarios: Sequence[str] = SCENARIOS, **where: Any) -> Scores:
    """Return, peak and tracking error of every policy in every episode."""
    scores: Scores = {}
    for scenario in scenarios:
        rows = [roll_out(driver, pairs, scenario=scenario, **where) for driver in drivers]
        scores[scenario] = {RETURN: np.array([row.returns for row in rows])}
        for metric in (PEAK, TRACKING):
            scores[scenario][metric] = np.array([row.metrics([metric])[metric] for row in rows])
    return scores


def report(out: Path, titles: Mapping[str, str], pairs: int) -> None:
    """Scores what was trained in OUT/STEPS/AGENT/seed_N by the pairs of `val` that follow the first `pairs`; writes tables,
    picture and the points of the curves. `titles`: of the agents, for readers."""
    seeds = range(pairs, pairs * (1 + SCORING))
    scores: dict[str, Scores] = {}
    classes: dict[str, list[str]] = {kind: list(names) for kind, names in CLASSES.items()}
    curves, rows = [], []
    for folder in sorted({path.parent.parent for path in out.glob("*/*/*/finished")}):
        title, steps = titles[folder.name], int(folder.parent.name)
        drivers, points = zip(*(_run(path.parent) for path in sorted(folder.glob("*/finished"))), strict=True)
        curves += [{"algorithm": title, "seed": n, "points": each} for n, each in enumerate(points)]
        name = f"{title}, {steps:,} periods"
        classes[CLONED if title.startswith("clone") else LEARNT].append(name)
        scores[name] = drive(drivers, seeds, mismatch="val")
        minutes = (np.median([each[-1][key] for each in points]) / 60.0 for key in ("seconds", "cpu_seconds"))
        time = " / ".join(f"{each:.1f}" for each in minutes)
        rows.append([title, f"{steps:,}", str(len(drivers)), time, *_cells(scores[name])])
        print(" | ".join(rows[-1]), flush=True)
    rows.sort(key=lambda row: float(row[4].split()[0]))
    head = ["agent", "control periods", "seeds", "minutes by the clock / of the processor", *HEAD]
    write_table(out / "baselines.md", head, rows)
    for name in (name for names in CLASSES.values() for name in names):
        driver = make_controller(name)
        where = {"plant": driver.plant, "mismatch": None} if driver.plant else {"mismatch": "val"}
        scores[name] = drive([driver], seeds, **where)
        print(" | ".join([name, *_cells(scores[name])]), flush=True)
    head = ["class", "best", *HEAD, f"more than `{COMPARED}`"]
    rows = [
        _best(kind, {name: scores[name] for name in names}, scores[COMPARED])
        for kind, names in classes.items()
        if names
    ]
    write_table(out / "line_to_beat.md", head, rows)
    levels = {name: float(scores[name][SCENARIOS[0]][RETURN].mean()) for name in ON_THE_PICTURE}
    if curves:
        what = f"pairs of val, {SCENARIOS[0]}; a line per seed"
        draw(curves, levels, out / "baselines.png", {RETURN: "minus the mean return"}, "seconds", what)


def _run(folder: Path) -> tuple[Any, list[dict[str, Any]]]:
    """The controller that a run left, a policy file or a model of Stable-Baselines3, and the points of its curve."""
    path = folder / "policy.npz"
    driver = make_controller(
        str(path) if path.is_file() else f"{folder / 'agent.zip'}:increment=0.3", trust=True
    )
    points = read_json(folder / "curve.json", "a learning curve", max_bytes=MAX_BYTES_OF_RESULTS)
    keys = ("steps", *CLOCKS, RETURN, PEAK, TRACKING)
    return driver, [{key: round(point[key], 2) for key in keys} for point in points]


def _cells(scores: Scores) -> list[str]:
    """Mean return with its interval over policies and episodes, and interquartile means of the errors."""
    cells = [_mean(scores[SCENARIOS[0]][RETURN], "{:.1f} [{:.1f}, {:.1f}]")]
    for values in scores.values():
        peak, tracking = (iqm(values[metric].ravel()) for metric in (PEAK, TRACKING))
        cells.append(f"{peak:.1f} / {tracking:.1f}")
    return cells


def _mean(values: Floats, form: str) -> str:
    """The mean of values (policies, episodes) and its interval."""
    return form.format(np.mean(values), *interval(values, np.mean))


def _best(kind: str, scores: Mapping[str, Scores], compared: Scores) -> list[str]:
    """A row for the best of a class by the mean return, and what it has more than another controller on the same episodes."""
    best = max(scores, key=lambda name: float(scores[name][SCENARIOS[0]][RETURN].mean()))
    more = scores[best][SCENARIOS[0]][RETURN] - compared[SCENARIOS[0]][RETURN]
    return [
        kind,
        _code(best),
        *_cells(scores[best]),
        _mean(more, "{:+.1f} [{:+.1f}, {:+.1f}]") if more.any() else "",
    ]


def ladder(out: Path, pairs: int) -> None:
    """Measures classical controllers on every rung in the first `pairs` episodes; writes `ladder.md`."""
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for rung, (what, kwargs) in LADDER.items():
        row = [f"`{rung}`: {what}", f"`{_arguments(kwargs)}`" if kwargs else "none"]
        for name in ON_THE_LADDER:
            driver = Still() if name == "zero commands" else make_controller(name)
            scores = drive([driver], range(pairs), SCENARIOS[:1], **scored_pairs(kwargs))
            row.append(f"{np.mean(scores[SCENARIOS[0]][RETURN]):.0f}")
        rows.append(row)
    write_table(
        out / "ladder.md", ["rung", "arguments of `gymnasium.make`", *map(_code, ON_THE_LADDER)], rows
    )


def write_table(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in Markdown, which `docs/generate.py NAME=FILE` takes."""
    text = "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])
    write_bytes(path, f"{text}\n".encode())
    print(path)


def _code(name: str) -> str:
    return name if " " in name else f"`{name}`"


def _arguments(kwargs: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={value!r}" for key, value in kwargs.items())
