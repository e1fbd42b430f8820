"""Learning curves of Stable-Baselines3 at its default settings and with the recipes, and the line to beat:
`python -m agents.baselines --algo ppo sac --steps 150000 20000 --recipes ppo sac --seeds 5 --out runs/baselines`.

`--algo`: every seed is one rig, the plain observation, the environment's reward and the algorithm's own defaults: nothing is
tuned. `--recipes`: the training files of those names. OUT receives a sweep of `agents.sweep` for each of them, and
`baselines.json`, `.md` and `.png`: mean return, peak synchronisation error and tracking error over control periods, beside those
of classical controllers on the same episodes. The same command again goes on with what is not finished.

`--rung` trains on another rung of the ladder of tasks, from easy to hard. `--lines` measures the classical controllers on every
rung, without training, and writes the table of the documents, `ladder.md`.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hydro_env.errors import run_command
from hydro_env.files import write_bytes, write_json
from hydro_env.limits import CORES, Limits
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json
from hydro_env.training.recipes import RECIPES, recipe

__all__ = ["LADDER", "lines", "main", "training_file"]

SCHEMA = "hydro_env/baselines/1"
ALGORITHMS = ("ppo", "sac")

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
#: Controllers that the lines show; `probing_flow` has settings of its own on `rig`.
CONTROLLERS = ("pid_paper", "pid_tuned", "cross_coupled", "probing_flow")
SCENARIOS = ("random_steps", "setpoint_steps")
PEAK, TRACKING, RETURN = "max_speed_difference_rpm", "tracking_mae_rpm", "mean_return"
TITLES = {
    RETURN: "mean return",
    PEAK: "peak synchronisation error, rpm",
    TRACKING: "mean absolute tracking error, rpm",
}
#: Control periods between two points of a curve at default settings, and between checkpoints.
EVALUATE_EVERY, CHECKPOINT_EVERY = {"ppo": 10_000, "sac": 4_000}, 50_000


class Still:
    """Zero commands: what the other returns are to be compared with."""

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Has nothing to forget."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float64]:
        """Zero commands (n, 2)."""
        return np.zeros((len(observation), 2))


def training_file(algorithm: str, rung: str, steps: int, pairs: int) -> str:
    """The text of a training file that changes nothing of the algorithm's default settings."""
    table = {
        "HydraulicSync-v0": {"n_envs": 1, "n_timesteps": steps, "env_kwargs": LADDER[rung][1]},
        "training": {
            "algorithm": algorithm,
            "evaluate_every": EVALUATE_EVERY[algorithm],
            "checkpoint_every": CHECKPOINT_EVERY,
            "evaluate_scenarios": list(SCENARIOS),
            "evaluate_pairs": pairs,
        },
    }
    return yaml.safe_dump(table, sort_keys=False)


def lines(rung: str, pairs: int) -> dict[str, dict[str, dict[str, float]]]:
    """Of every controller and scenario: mean return, interquartile means of peak and tracking error, on the episodes that
    evaluations of a training run drive."""
    from hydro_env.benchmark.statistics import iqm
    from hydro_env.controllers import make_controller
    from hydro_env.controllers.rollout import roll_out
    from hydro_env.training.evaluate import scored_pairs

    found: dict[str, dict[str, dict[str, float]]] = {}
    for name in ("zero commands", *CONTROLLERS):
        found[name] = {}
        for scenario in SCENARIOS:
            own = "probing_flow_rig" if name == "probing_flow" and rung == "rig" else name
            controller = Still() if name == "zero commands" else make_controller(own)
            episodes = roll_out(controller, range(pairs), scenario=scenario, **scored_pairs(LADDER[rung][1]))
            metrics = episodes.metrics((PEAK, TRACKING))
            found[name][scenario] = {
                RETURN: float(np.mean(episodes.returns)),
                **{metric: float(iqm(values)) for metric, values in metrics.items()},
            }
    return found


def training_files(arguments: argparse.Namespace) -> dict[str, Path]:
    """What the command trains: the training file by the name of its folder; writes those of default settings."""
    files = {}
    for algorithm, steps in zip(arguments.algo, arguments.steps, strict=True):
        files[algorithm] = arguments.out / f"{algorithm}.yml"
        write_bytes(
            files[algorithm], training_file(algorithm, arguments.rung, steps, arguments.pairs).encode()
        )
    return files | {f"{name}_recipe": recipe(name) for name in arguments.recipes}


def train(arguments: argparse.Namespace, command: str) -> None:
    """Trains every seed of every file; writes `baselines.json`, the picture and the table."""
    from agents.sweep import sweep
    from hydro_env.training.config import read_config

    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    curves, final = {}, {}
    for name, file in training_files(arguments).items():
        summary = sweep(
            read_config(file),
            range(arguments.seeds),
            out / name,
            jobs=arguments.jobs,
            pairs=arguments.pairs,
            command=command,
            progress=not arguments.quiet,
        )
        final[name] = summary["rows"]
        paths = [out / name / f"seed_{each['seed']}" / "curve.json" for each in summary["seeds"]]
        curves[name] = [read_json(path, "a learning curve", max_bytes=MAX_BYTES_OF_RESULTS) for path in paths]
        for each in summary["failed"]:
            print(f"{name}, seed {each['seed']} failed: {each['reason']}", file=sys.stderr)
    measured = {
        "schema": SCHEMA,
        "command": command,
        "rung": arguments.rung,
        "pairs": arguments.pairs,
        "curves": curves,
        "final": final,
        "lines": lines(arguments.rung, arguments.pairs),
    }
    write_json(out / "baselines.json", measured)
    draw(curves, measured["lines"], out / "baselines.png")
    summary_table(measured, out / "baselines.md")


def title(name: str) -> str:
    """What a folder holds, for readers: "PPO, default settings" of `ppo`, "PPO, recipe" of `ppo_recipe`."""
    algorithm, _, rest = name.partition("_")
    return f"{algorithm.upper()}, {'recipe' if rest else 'default settings'}"


def draw(
    curves: Mapping[str, Sequence[Any]], levels: Mapping[str, Mapping[str, Mapping[str, float]]], out: Path
) -> None:
    """Writes the picture: a panel for each figure, a line for each seed, `levels` as dashed lines."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter

    from agents.curves import COLOURS

    figure, axes = plt.subplots(1, 3, figsize=(14, 4.5))
    for axis, metric in zip(axes, (RETURN, PEAK, TRACKING), strict=True):
        for name, seeds in curves.items():
            algorithm, _, rest = name.partition("_")
            look = {"color": COLOURS[algorithm], "lw": 1.0, "ls": "-" if rest else ":", "marker": "."}
            for number, points in enumerate(seeds):
                values = [abs(_scores(point)[metric]) for point in points]
                label = f"{title(name)}, a line per seed" if number == 0 else None
                axis.plot([point["steps"] for point in points], values, label=label, markersize=3, **look)
        for name, level in levels.items():
            value = abs(level[SCENARIOS[0]][metric])
            axis.axhline(value, color="0.4", lw=1, ls="--")
            axis.text(1.01, value, name, transform=axis.get_yaxis_transform(), fontsize=8, va="center")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.set_xlabel("control periods")
        axis.set_ylabel(TITLES[metric] if metric != RETURN else "minus the mean return")
        axis.grid(True, which="major", color="0.9")
    axes[1].legend(fontsize=8, loc="upper right")
    figure.suptitle(
        f"Stable-Baselines3 in {SCENARIOS[0]}, pairs of val; lower is better in every panel", fontsize=10
    )
    figure.tight_layout()
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=90)
    plt.close(figure)
    write_bytes(out, memory.getvalue())


def _scores(point: Mapping[str, Any]) -> Mapping[str, float]:
    """Those of a point of a curve in the scenario that is drawn."""
    scores: Mapping[str, float] = point["scenarios"][SCENARIOS[0]]
    return scores


def ladder(arguments: argparse.Namespace) -> None:
    """Measures the lines of every rung; writes `ladder.json` and `ladder.md`."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    found = {rung: lines(rung, arguments.pairs) for rung in LADDER}
    write_json(arguments.out / "ladder.json", {"schema": SCHEMA, "pairs": arguments.pairs, "lines": found})
    names = ["zero commands", *CONTROLLERS]
    rows = []
    for rung, levels in found.items():
        what, kwargs = LADDER[rung]
        returns = [f"{levels[name][SCENARIOS[0]][RETURN]:.0f}" for name in names]
        rows.append([f"`{rung}`: {what}", f"`{_arguments(kwargs)}`" if kwargs else "none", *returns])
    write_table(
        arguments.out / "ladder.md", ["rung", "arguments of `gymnasium.make`", *map(_code, names)], rows
    )


def summary_table(measured: Mapping[str, Any], out: Path) -> None:
    """Writes the last row of figures of every algorithm and the lines; over seeds the interquartile mean and its interval."""
    head = ["controller", "mean return"]
    head += [f"peak / tracking error in `{scenario}`, rpm" for scenario in SCENARIOS]
    rows = []
    for name, final in measured["final"].items():
        cells = {(row["scenario"], row["metric"]): row for row in final}
        if cells:
            best = cells[SCENARIOS[0], RETURN]
            row = [
                f"{title(name)}, best of each of {best['n']} seeds",
                "{:.0f} [{:.0f}, {:.0f}]".format(best["iqm"], *best["ci95"]),
            ]
            row += [f"{cells[s, PEAK]['iqm']:.0f} / {cells[s, TRACKING]['iqm']:.0f}" for s in SCENARIOS]
            rows.append(row)
    for name, levels in measured["lines"].items():
        errors = [f"{levels[s][PEAK]:.0f} / {levels[s][TRACKING]:.0f}" for s in SCENARIOS]
        rows.append([_code(name), f"{levels[SCENARIOS[0]][RETURN]:.0f}", *errors])
    write_table(out, head, rows)


def write_table(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table in Markdown, which `docs/generate.py NAME=FILE` takes."""
    text = "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])
    write_bytes(path, f"{text}\n".encode())
    print(path)


def _code(name: str) -> str:
    return f"`{name}`" if "_" in name else name


def _arguments(kwargs: Mapping[str, Any]) -> str:
    return ", ".join(f"{key}={value!r}" for key, value in kwargs.items())


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m agents.baselines",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--algo", choices=ALGORITHMS, nargs="*", default=[], help="at default settings")
    parser.add_argument("--recipes", choices=RECIPES, nargs="*", default=[], help="by their training files")
    parser.add_argument("--seeds", type=Limits(1, 1000, whole=True), default=5, help="how many, from 0 on")
    parser.add_argument(
        "--steps",
        type=Limits(1, 10**12, whole=True),
        nargs="*",
        default=[],
        help="control periods at default settings, one for each --algo",
    )
    parser.add_argument("--rung", choices=LADDER, default="train", help="of the ladder of tasks")
    parser.add_argument(
        "--pairs", type=Limits(1, 500, whole=True), default=64, help="episodes of an evaluation"
    )
    parser.add_argument("--jobs", type=CORES, default=1, help="seeds trained side by side")
    parser.add_argument("--lines", action="store_true", help="the classical controllers alone, on every rung")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    arguments = parser.parse_args()
    if len(arguments.steps) != len(arguments.algo):
        parser.error("--steps takes one number for each --algo")
    command = " ".join(["python -m agents.baselines", *sys.argv[1:]])
    run_command(lambda: ladder(arguments) if arguments.lines else train(arguments, command))


if __name__ == "__main__":
    main()
