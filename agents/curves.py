"""Learning curves of runs over steps and wall time: `python -m agents.curves runs/ppo --out docs/images/agents_curves.png`.

Reads each run's `curve.json`; a folder of `agents.sweep` stands for all its seeds. Beside the picture a JSON file of the same
name holds the points.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.command import run_command
from hydro_env.errors import InputError
from hydro_env.files import write_bytes
from hydro_env.reading import MOST_BYTES_OF_RESULTS, read_json
from hydro_env.training.config import read_config

__all__ = ["draw", "read_curves"]

COLOURS = {"ppo": "#0072b2", "sac": "#d55e00"}


def read_curves(runs: Sequence[Path]) -> list[dict[str, Any]]:
    """Per run its folder, algorithm, seed and points. InputError for a folder without a curve."""
    found = []
    for run in runs:
        folders = [run] if (run / "curve.json").is_file() else sorted(run.glob("seed_*"))
        if not folders:
            raise InputError(f"{run}: holds no curve.json of a training run")
        for folder in folders:
            training = read_config(folder / "config.yml").training
            points = read_json(
                folder / "curve.json", "the curve of a training run", most=MOST_BYTES_OF_RESULTS
            )
            found.append(
                {"run": folder.name, "algorithm": training.algorithm, "seed": training.seed, "points": points}
            )
    return found


def draw(curves: list[dict[str, Any]], levels: dict[str, float], out: Path) -> None:
    """Writes picture and JSON; `levels` are horizontal lines, by what they mean, rpm."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(10, 6), sharey="row", sharex="col")
    for curve in curves:
        colour = COLOURS[curve["algorithm"]]
        for column, key in enumerate(("steps", "seconds")):
            x = [point[key] / (1.0 if key == "seconds" else 1e3) for point in curve["points"]]
            for row, name in enumerate(("max_speed_difference_rpm", "tracking_mae_rpm")):
                axes[row, column].plot(
                    x, [point[name] for point in curve["points"]], ".-", color=colour, lw=1
                )
    for name, colour in COLOURS.items():
        axes[0, 0].plot([], [], color=colour, label=name)
    for text, level in levels.items():
        axes[0, 0].axhline(level, color="0.5", lw=1, ls="--")
        axes[0, 1].axhline(level, color="0.5", lw=1, ls="--", label=text)
    for axis in axes[0]:
        axis.legend(fontsize=8)
    axes[0, 0].set_ylabel("largest difference, rpm")
    axes[1, 0].set_ylabel("tracking error, rpm")
    axes[1, 0].set_xlabel("thousand control periods")
    axes[1, 1].set_xlabel("seconds, one thread")
    figure.suptitle("val, setpoint_steps, interquartile means; a line per seed", fontsize=10)
    figure.tight_layout()
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=80)
    plt.close(figure)
    write_bytes(out, memory.getvalue())
    write_bytes(out.with_suffix(".json"), json.dumps({"levels": levels, "curves": curves}, indent=1).encode())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.curves", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs")
    parser.add_argument("--out", type=Path, required=True, help="the picture (.png)")
    chosen = parser.parse_args()

    def run() -> None:
        from hydro_env.benchmark.statistics import iqm
        from hydro_env.controllers import make_controller
        from hydro_env.controllers.rollout import roll_out
        from hydro_env.training.evaluate import METRICS

        curves = read_curves(chosen.runs)
        scores = roll_out(make_controller("probing_flow"), range(128), mismatch="val").metrics(METRICS)
        draw(curves, {"the law alone": float(iqm(scores[METRICS[0]]))}, chosen.out)

    run_command(run)


if __name__ == "__main__":
    main()
