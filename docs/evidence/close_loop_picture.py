"""The picture of closing the loop: every hidden rig before and after the repair, and one of them in time.

    python -m docs.evidence.close_loop_picture FOLDER --out DIR

`FOLDER` is what `hydro-env close-loop` or `python -m agents.close_loop` wrote; writes close_loop.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.close_loop import read
from agents.command import run_command
from hydro_env.pages import COLOURS, RC, png

SOURCES = {"wrong": "as given", "repaired": "repaired", "true": "true"}
NAMES = {
    "pid": "PID, gains per valve", "cross_coupled": "cross coupling", "model_inverse": "inverse of the model",
    "ppo": "PPO agent",
}  # fmt: skip
METRIC, SCENARIO = "max_speed_difference_rpm", "setpoint_steps"
PERIOD = 0.01


def draw(data: Mapping[str, Any], path: Path, shown: str = "model_inverse") -> None:
    """Writes the picture of the content of close_loop.json as a PNG. The traces are those of controller `shown` on the
    rig whose gain is the median one."""
    import matplotlib
    from matplotlib.figure import Figure

    drawn = [r for r in data["summary"] if (r["metric"], r["scenario"]) == (METRIC, SCENARIO)]
    rows = {r["controller"]: r for r in drawn if "wrong" in r}
    with matplotlib.rc_context(RC):
        made = Figure(figsize=(11.0, 4.4), layout="constrained")
        left, right = made.subplots(1, 2, width_ratios=[1.25, 1.0])
        colours = dict(zip(dict.fromkeys(s["case"] for s in data["rigs"]), COLOURS, strict=False))
        for place, row in enumerate(rows.values()):
            _dots(left, data, row, 4.0 * place, colours)
        left.set_yscale("log")
        left.set_ylabel("peak synchronisation error, rpm")
        places = [4.0 * p + i for p in range(len(rows)) for i in range(3)]
        left.set_xticks(places, [label for _ in rows for label in SOURCES.values()], fontsize=8, rotation=30)
        left.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        left.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")
        top = left.get_ylim()[1]
        for place, (name, row) in enumerate(rows.items()):
            said = NAMES.get(name, name) + ("" if row["n"] == len(data["rigs"]) else f", {row['n']} rigs")
            left.text(4.0 * place + 1.0, top, said, ha="center", va="bottom", fontsize=9)
        title = "Scored on the hidden rigs: set-point steps. Tuned on the ... model\n"
        left.set_title(title, loc="left", fontsize=10)
        for case, colour in colours.items():
            left.plot([], [], color=colour, marker="o", ms=4, lw=0.8, label=case.replace("_", " "))
        left.plot([], [], color="k", marker="_", ms=10, lw=2, label="mean, 95 %")
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16)}
        left.legend(fontsize=8, frameon=False, ncols=len(colours) + 1, **below)
        if "repaired" in rows.get(shown, {}):
            _traces(right, data, shown)
    png(made, path)


def _values(data: Mapping[str, Any], name: str) -> dict[str, dict[str, float]]:
    """Peak errors by rig and model."""
    found: dict[str, dict[str, float]] = {}
    for s in data["scores"]:
        if s["controller"] == name and s["scenario"] == SCENARIO and s["tuned_on"] in SOURCES:
            found.setdefault(s["rig"], {})[s["tuned_on"]] = s["metrics"][METRIC]
    return found


def _dots(
    axis: Any, data: Mapping[str, Any], row: Mapping[str, Any], start: float, colours: Mapping[str, str]
) -> None:
    """Every rig under one controller, and the means of a row of the summary."""
    cases = {rig["rig"]: rig["case"] for rig in data["rigs"]}
    for rig, each in _values(data, row["controller"]).items():
        places = [start + i for i, source in enumerate(SOURCES) if source in each]
        values = [each[source] for source in SOURCES if source in each]
        axis.plot(places, values, color=colours[cases[rig]], marker="o", ms=3.5, lw=0.8, alpha=0.8)
    for i, source in enumerate(SOURCES):
        if source in row:
            mean, (low, high) = row[source]["mean"], row[source]["ci95"]
            axis.plot([start + i] * 2, [low, high], color="k", lw=1.6, zorder=4)
            axis.plot([start + i - 0.28, start + i + 0.28], [mean] * 2, color="k", lw=2.4, zorder=4)


def _traces(axis: Any, data: Mapping[str, Any], name: str) -> None:
    """Speed differences before and after the repair on the rig with the median ratio of the peaks."""
    both = {rig: peaks for rig, peaks in _values(data, name).items() if {"wrong", "repaired"} <= peaks.keys()}
    ratios = {rig: peaks["repaired"] / peaks["wrong"] for rig, peaks in both.items()}
    rig = sorted(ratios, key=lambda each: ratios[each])[len(ratios) // 2]
    labels = {
        "wrong": ("tuned on the model as given", COLOURS[1]),
        "repaired": ("tuned on the repaired model", COLOURS[0]),
    }
    for s in data["scores"]:
        own = (s["controller"], s["rig"], s["scenario"]) == (name, rig, SCENARIO)
        if own and s["tuned_on"] in labels and "difference_rpm" in s:
            label, colour = labels[s["tuned_on"]]
            time = PERIOD * np.arange(len(s["difference_rpm"]))
            axis.plot(time, s["difference_rpm"], color=colour, lw=1.1, label=label)
    axis.set_xlabel("time, s")
    axis.set_ylabel("speed 1 - speed 2, rpm")
    effects = next(r["hidden"] for r in data["rigs"] if r["rig"] == rig)
    hidden = ", ".join(
        e["name"].replace("_", " ") + ("" if e["channel"] == "rig" else f" on channel {e['channel']}")
        for e in effects
    )
    axis.set_title(f"{NAMES.get(name, name)} on rig {rig}\nhidden: {hidden}", loc="left", fontsize=9)
    axis.legend(fontsize=8, frameon=False)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m docs.evidence.close_loop_picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()

    def work() -> None:
        data = read(given.folder)
        given.out.mkdir(parents=True, exist_ok=True)
        draw(data, given.out / "close_loop.png")

    run_command(work)


if __name__ == "__main__":
    main()
