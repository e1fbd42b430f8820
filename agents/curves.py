"""Learning curves of runs over steps and wall time: `python -m agents.curves runs/ppo --out runs/ppo/curves.png`.

Reads each run's `curve.json`; a folder of `agents.sweep` stands for all its seeds. Curves over more than a factor of fifty are
drawn over logarithms. Beside the picture a JSON file of the same name holds the points. A table of the scores after 10^5, 10^6
periods and so on is printed.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Mapping, Sequence
from math import log10
from pathlib import Path
from statistics import median
from typing import Any

from agents.command import run_command
from agents.recurrent.settings import read_settings
from hydro_env.errors import InputError
from hydro_env.files import write_bytes
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json, read_yaml
from hydro_env.training.config import read_config

COLOURS = {"ppo": "#0072b2", "sac": "#d55e00", "imitation": "#009e73", "gradient": "#cc79a7"}
"""Of algorithms, and of the stages of a recurrent policy."""
CLOCKS = {"cpu_seconds": "minutes, one thread", "seconds": "minutes by the clock"}
ERRORS = {"max_speed_difference_rpm": "largest difference, rpm", "tracking_mae_rpm": "tracking error, rpm"}


def read_curves(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """Per run its folder, algorithm, seed and points. InputError for a folder without a curve."""
    found = []
    for run in runs:
        folders = [run] if (run / "curve.json").is_file() else sorted(run.glob("seed_*"))
        if not folders:
            raise InputError(f"{run}: holds no curve.json of a training run")
        for folder in folders:
            algorithm, seed = _trained(folder / "config.yml")
            points = read_json(
                folder / "curve.json", "the curve of a training run", max_bytes=MAX_BYTES_OF_RESULTS
            )
            found.append({"run": folder.name, "algorithm": algorithm, "seed": seed, "points": points})
    return found


def _trained(path: Path) -> tuple[str, int]:
    """Algorithm and seed of a training file, of Stable-Baselines3 or of `agents.recurrent`."""
    if "gradient" in read_yaml(path, "a training file in YAML"):
        return "gru", read_settings(path).training.seed
    training = read_config(path).training
    return training.algorithm, training.seed


def _parts(curve: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """The points of a curve by what they are coloured for: the stages of a recurrent policy, or the algorithm."""
    parts: dict[str, list[dict[str, Any]]] = {}
    for point in curve["points"]:
        parts.setdefault(point.get("stage", curve["algorithm"]), []).append(point)
    return parts


def draw(
    curves: list[dict[str, Any]],
    levels: dict[str, float],
    out: Path,
    scores: Mapping[str, str] = ERRORS,
    clock: str = "cpu_seconds",
    title: str = "val, setpoint_steps, interquartile means; a line per seed",
) -> None:
    """Writes picture and JSON: a row for each score, by its key and what it is, without signs. `levels` are horizontal lines in
    the first row, by what they mean; `clock` is a key of `CLOCKS`."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        len(scores),
        2,
        figsize=(10, 4 + len(scores)),
        sharey="row",
        sharex="col",
        squeeze=False,
        layout="constrained",
    )
    named = [(name, points) for curve in curves for name, points in _parts(curve).items()]
    names = list(dict.fromkeys(name for name, _ in named))
    colours = {name: COLOURS.get(name, f"C{number}") for number, name in enumerate(names)}
    for name, points in named:
        periods = [point["steps"] / 1e6 for point in points]
        minutes = [point.get(clock, point["seconds"]) / 60.0 for point in points]
        for row, score in zip(axes, scores, strict=True):
            for axis, x in zip(row, (periods, minutes), strict=True):
                axis.plot(x, [abs(point[score]) for point in points], ".-", color=colours[name], lw=1)
    for name, colour in colours.items():
        axes[0, 0].plot([], [], color=colour, label=name)
    for text, level in levels.items():
        axes[0, 0].axhline(abs(level), color="0.5", lw=1, ls="--")
        axes[0, 1].axhline(abs(level), color="0.5", lw=1, ls="--")
        axes[0, 1].text(
            1.0, abs(level), f" {text}", fontsize=7, transform=axes[0, 1].get_yaxis_transform(), va="center"
        )
    figure.legend(fontsize=8, ncols=3, loc="outside lower center")
    steps = [point["steps"] for _, points in named for point in points]
    if max(steps) > 50 * min(steps):
        for axis in axes.flat:
            axis.set_xscale("log")
            axis.set_yscale("log")
    for axis, label in zip(axes[:, 0], scores.values(), strict=True):
        axis.set_ylabel(label)
    axes[-1, 0].set_xlabel("million control periods")
    axes[-1, 1].set_xlabel(CLOCKS[clock])
    figure.suptitle(title, fontsize=10)
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=80)
    plt.close(figure)
    write_bytes(out, memory.getvalue())
    write_bytes(out.with_suffix(".json"), json.dumps({"levels": levels, "curves": curves}, indent=1).encode())


def table(curves: list[dict[str, Any]]) -> str:
    """Rows of algorithms, columns of powers of ten: largest difference / tracking error in rpm and minutes on one thread, the
    median over runs of each one's point that is nearest, within a factor of 1.5."""
    rows: dict[str, dict[int, list[dict[str, Any]]]] = {}
    for curve in curves:
        for power in range(4, 10):
            near = min(curve["points"], key=lambda point: abs(log10(point["steps"]) - power))
            if abs(log10(near["steps"]) - power) < log10(1.5):
                rows.setdefault(curve["algorithm"], {}).setdefault(power, []).append(near)
    powers = sorted({power for row in rows.values() for power in row})
    lines = ["| periods |" + "".join(f" 10^{power} |" for power in powers), "|---|" + "---|" * len(powers)]
    for name, row in rows.items():
        cells = [_cell(row.get(power, [])) for power in powers]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(points: list[dict[str, Any]]) -> str:
    if not points:
        return ""
    difference, tracking = (
        median(p[key] for p in points) for key in ("max_speed_difference_rpm", "tracking_mae_rpm")
    )
    minutes = median(p.get("cpu_seconds", p["seconds"]) for p in points) / 60.0
    return f"{difference:.1f} / {tracking:.1f} ({minutes:.1f} min)"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.curves", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs")
    parser.add_argument("--out", type=Path, required=True, help="the picture (.png)")
    parser.add_argument("--law", default="probing_flow", help="controller whose score is the line")
    parser.add_argument("--plant", default="paper_dead_zone", help="preset that it drives")
    chosen = parser.parse_args()

    def run() -> None:
        from hydro_env.benchmark.statistics import iqm
        from hydro_env.controllers import make_controller
        from hydro_env.controllers.rollout import roll_out
        from hydro_env.training.evaluate import METRICS

        curves = read_curves(chosen.runs)
        law = make_controller(chosen.law)
        scores = roll_out(law, range(128), plant=chosen.plant, mismatch="val").metrics(METRICS)
        draw(curves, {"the law alone": float(iqm(scores[METRICS[0]]))}, chosen.out)
        print(table(curves))

    run_command(run)


if __name__ == "__main__":
    main()
