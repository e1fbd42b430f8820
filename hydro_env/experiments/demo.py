"""`hydro-env demo`: the paper's experiment, a leaderboard and one diagnosis, on one page.

Every number on the page is computed in the same run, but for the paper's published ones. The parts are the commands
`reproduce`, `benchmark`, `hide` and `diagnose`, whose own results stand in folders beside the page.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env import __version__
from hydro_env.benchmark import command as benchmark
from hydro_env.benchmark.report import privileged_information
from hydro_env.controllers.registry import CONTROLLERS
from hydro_env.diagnosis import Settings
from hydro_env.diagnosis import command as diagnosis
from hydro_env.experiments import reproduce
from hydro_env.experiments.shaft_animation import animation, record
from hydro_env.files import write_json, write_text
from hydro_env.pages import COLOURS, beside_results, figure, legend, png, render, svg
from hydro_env.practice import command as hide
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json

__all__ = ["run"]

HIDDEN = ("dead_zone:1",)
"""What the third part hides."""

BOARD = (
    ("setpoint_steps", "max_speed_difference_rpm", "set-point steps: peak synchronisation error, rpm"),
    ("setpoint_steps", "tracking_mae_rpm", "set-point steps: mean absolute tracking error, rpm"),
    ("load_step", "max_speed_difference_rpm", "load step: peak synchronisation error, rpm"),
    ("load_step", "tracking_mae_rpm", "load step: mean absolute tracking error, rpm"),
)
"""Columns of the leaderboard: scenario, metric, heading. The first two are drawn."""
PAPER, TUNED, BOUND = "pid_paper", "pid_tuned", "oracle"
SPLIT = "test_interp"
"""The one split of the quick suite; the animation shows one of its cases."""

GAPS = (
    ("before", "model as given"),
    ("calibrated", "calibrated"),
    ("placebo", "placebo: calibrated, with the best wrong effect"),
    ("after", "calibrated, with the named effect"),
)


class _Clock:
    """Says what is being done and remembers how long it took."""

    def __init__(self) -> None:
        self.parts: list[dict[str, Any]] = []

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        tqdm.write(f"{name} ...")
        start = time.perf_counter()
        yield
        seconds = time.perf_counter() - start
        self.parts.append({"name": name, "seconds": seconds})
        tqdm.write(f"{name}: {seconds:.1f} s")


def run(out: str | Path, *, seed: int = 0, jobs: int = 1) -> dict[str, Any]:
    """Runs the demo and writes `out/index.html`, `out/demo.png`, `out/demo.json` and a folder for each part.

    Args:
        out: an existing folder.
        seed: of the benchmark's pairs of valves and of the practice logs.
        jobs: processes of the scoreboard; the diagnosis has a thread for every core.

    Returns the content of demo.json: the numbers of the page and the seconds of each part.
    """
    out = Path(out)
    clock = _Clock()
    with clock.part("the paper's experiment"):
        paper = _paper(_folder(out, "reproduce"))
    with clock.part("scoreboard"):
        board = _board(_scored(_folder(out, "benchmark"), seed, jobs))
    with clock.part("diagnosis"):
        finding = _diagnosis(_folder(out, "practice"), _folder(out, "diagnosis"), seed)
    result = {
        "schema": "hydro_env/demo/1",
        "paper": paper["numbers"],
        "scores": board["numbers"],
        "diagnosis": finding["numbers"],
        "seconds": {part["name"]: part["seconds"] for part in clock.parts},
    }
    write_json(out / "demo.json", result)
    with beside_results(out / "index.html"):
        png(paper["drawing"], out / "demo.png")
        write_text(out / "index.html", page(paper, board, finding, clock.parts))
    return result


def page(
    paper: dict[str, Any], board: dict[str, Any], finding: dict[str, Any], parts: list[dict[str, Any]]
) -> str:
    """The HTML page; `parts` are the names and seconds of the parts."""
    from markupsafe import Markup

    return render(
        files(__package__).joinpath("demo.html"),
        title="Two hydraulic motors, two unequal valves",
        version=__version__,
        seconds=sum(part["seconds"] for part in parts),
        parts=parts,
        rig=Markup(files(__package__).joinpath("demo_rig.html").read_text(encoding="utf-8")),
        paper=paper,
        board=board,
        finding=finding,
    )


def _folder(out: Path, name: str) -> Path:
    folder = out / name
    folder.mkdir()
    return folder


def _short(value: float | None) -> str:
    """Three digits, as a reader wants them, and no zeros that say nothing."""
    if value is None or not np.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    digits = min(max(0, 2 - int(np.floor(np.log10(abs(value))))), 3)
    text = f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if float(text) == round(value) and value == round(value) else text


# --- 1. the paper's experiment ----------------------------------------------------------------------------------------
RIGS = (("tables", "the tables alone"), ("dead_zone", "with the dead zone"))
"""What reproduce's traces hold, and how the page calls it."""


def _paper(out: Path) -> dict[str, Any]:
    numbers = reproduce.run(out)
    steps, load = numbers["setpoint_steps"], numbers["load_step"]
    traces = np.genfromtxt(out / "traces.csv", delimiter=",", names=True)
    alt = "speeds of both motors in the paper's experiment and their difference"
    return {
        "published": _short(steps["published_rpm"]),
        "tables_only": _short(steps["tables_only_rpm"]),
        "with_dead_zone": _short(steps["with_dead_zone_rpm"]),
        "overlap": _short(steps["overlap_V1_m"] * 1e6),
        "equal_again": _short(steps["equal_again_after_s"]),
        "equal_within": _short(steps["equal_again_within_rpm"]),
        "published_again": _short(steps["published_equal_again_after_s"]),
        "load_published": _short(load["published_rpm"]),
        "load_simulated": _short(load["simulated_rpm"]),
        "nominal_torque": _short(load["nominal_torque_Nm"]),
        "largest_command": _short(load["largest_command_V"]),
        "links": sorted(f"{out.name}/{path.name}" for path in out.iterdir()),
        "picture": svg(_drawing(traces, steps["published_rpm"]), alt),
        "drawing": _drawing(traces, steps["published_rpm"]),
        "numbers": {"setpoint_steps": steps, "load_step": load},
    }


def _drawing(traces: Any, published: float) -> Any:
    """Speeds of both motors on each rig, and below them the differences beside the published one."""
    drawing, axes = figure(len(RIGS) + 1, height=1.9)
    time, last = traces["time_s"], axes[-1]
    for axis, (key, label), colour in zip(axes, RIGS, (COLOURS[4], COLOURS[3]), strict=False):
        speeds = [traces[f"{key}_speed_{motor}_rpm"] for motor in (1, 2)]
        axis.plot(time, traces["setpoint_rpm"], color=COLOURS[4], linewidth=0.9, label="set-point")
        for motor, speed in enumerate(speeds):
            axis.plot(time, speed, color=COLOURS[motor], label=f"motor {motor + 1}")
        axis.set_title(f"Speeds, {label}", loc="left", fontsize=9.5)
        axis.set_ylabel("rpm")
        last.plot(time, speeds[0] - speeds[1], color=colour, label=label)
    for side in (-1, 1):
        last.axhline(side * published, color=COLOURS[2], linestyle="--", linewidth=1.1)
    last.set_title(f"Speed difference; dashed: the {published:g} rpm of the paper", loc="left", fontsize=9.5)
    last.set(xlabel="time, s", ylabel="rpm", xlim=(0, time[-1]))
    legend(axes[0])
    legend(last)
    return drawing


# --- 2. the leaderboard -----------------------------------------------------------------------------------------------
def _scored(out: Path, seed: int, jobs: int) -> dict[str, Any]:
    return benchmark.run(
        out, selection=benchmark.Selection("quick"), conditions=benchmark.Conditions(seed=seed), jobs=jobs
    )


def _board(scores: dict[str, Any]) -> dict[str, Any]:
    cells = {(row["controller"], row["scenario"], row["metric"]): row for row in scores["rows"]}
    shown = _chosen(scores, cells)
    agent = next(name for name in shown if _learned(name))
    titles = {PAPER: f"The paper's PID ({PAPER})", agent: f"The best agent ({agent})"}
    seeds = range(scores["seed"], scores["seed"] + scores["splits"][SPLIT])
    rows = []
    for name, why in shown.items():
        notes = [
            why,
            "a network from the observation alone" if _learned(name) else "",
            privileged_information(scores, name),
        ]
        found = [_cell(cells.get((name, scenario, metric))) for scenario, metric, _ in BOARD]
        rows.append(
            {"name": name, "note": "; ".join(filter(None, notes)), "learned": _learned(name), "cells": found}
        )
    recorded = record(titles, seeds, split=SPLIT, scenario=BOARD[0][0])
    return {
        "about": scores["about"],
        "cases": max(row["n"] for row in scores["rows"]),
        "controllers": len(scores["controllers"]),
        "columns": [heading for _, _, heading in BOARD],
        "rows": rows,
        "agent": agent,
        "seed": recorded["seed"],
        "animation": animation(recorded),
        "picture": svg(
            _front(scores, cells, shown), "peak synchronisation error over tracking error of every controller"
        ),
        "numbers": [
            row for row in scores["rows"] if (row["scenario"], row["metric"]) in {key[:2] for key in BOARD}
        ],
    }


def _learned(name: str) -> bool:
    file = CONTROLLERS[name].file
    return file is not None and file.suffix == ".npz"


def _chosen(scores: dict[str, Any], cells: dict[Any, Any]) -> dict[str, str]:
    """The rows that the page shows, and why these."""
    scored = [name for name in scores["controllers"] if (name, *BOARD[0][:2]) in cells]
    peak = {name: cells[name, *BOARD[0][:2]]["iqm"] for name in scored}
    plain = [name for name in scored if not privileged_information(scores, name)]
    law = min((name for name in plain if not _learned(name)), key=peak.__getitem__)
    agent = min((name for name in plain if _learned(name)), key=peak.__getitem__)
    return {
        PAPER: "Table III of the paper",
        TUNED: "the same law, gains found by search",
        law: "the law with the lowest peak error, without privileged information",
        agent: "the learned agent with the lowest peak error",
        BOUND: "the bound",
    }


def _cell(row: dict[str, Any] | None) -> dict[str, str]:
    if row is None:
        return {"text": "–", "interval": ""}
    low, high = row["ci95"]
    return {"text": _short(row["iqm"]), "interval": f"{_short(low)} to {_short(high)}"}


def _front(scores: dict[str, Any], cells: dict[Any, Any], shown: dict[str, str]) -> Any:
    """Peak synchronisation error over tracking error of every controller on the set-point steps, the rows of the table by name,
    and the Pareto front of those without privileged information."""
    drawing, (axis,) = figure(height=3.4)
    at = {
        name: [cells[name, scenario, metric]["iqm"] for scenario, metric, _ in (BOARD[1], BOARD[0])]
        for name in scores["controllers"]
        if (name, *BOARD[0][:2]) in cells
    }
    plain = [name for name in at if not privileged_information(scores, name)]
    for name, (x, y) in at.items():
        colour = COLOURS[1] if _learned(name) else COLOURS[0]
        hollow = {} if name in plain else {"markerfacecolor": "none"}
        axis.plot(x, y, "o", color=colour, markersize=6 if name in shown else 4, **hollow)
        if name in shown:
            axis.annotate(
                name, (x, y), (7, 3), textcoords="offset points", fontsize=9, color=colour, zorder=5
            )
    best = sorted(
        at[name] for name in plain
         if not any(at[n][0] <= at[name][0] and at[n][1] <= at[name][1] and n != name for n in plain)
    )  # fmt: skip
    axis.plot(*np.transpose(best), "--", color=COLOURS[4], linewidth=1.1, zorder=0)
    axis.set(
        xscale="log",
        yscale="log",
        xlabel="mean absolute tracking error, rpm",
        ylabel="peak synchronisation error, rpm",
    )
    for side, limits in ((axis.xaxis, axis.get_xlim()), (axis.yaxis, axis.get_ylim())):
        ticks = [digit * 10.0**power for power in range(-1, 4) for digit in (1, 2, 3, 5)]
        side.set_ticks([tick for tick in ticks if limits[0] <= tick <= limits[1]])
        side.set_major_formatter("{x:g}")
    axis.minorticks_off()
    return drawing


# --- 3. the diagnosis -------------------------------------------------------------------------------------------------
def _diagnosis(practice: Path, out: Path, seed: int) -> dict[str, Any]:
    hide.run(HIDDEN, practice, seed=seed)
    truth = read_json(practice / "truth.json", "what `hydro-env hide` wrote", max_bytes=MAX_BYTES_OF_RESULTS)
    logs = {kind: [practice / name for name in truth["logs"][kind]] for kind in ("fit", "sealed")}
    diagnosis.run(
        logs["fit"], logs["sealed"], out, model=practice / "model.yaml", settings=Settings(seed=seed)
    )
    found = read_json(
        out / "diagnosis.json", "what `hydro-env diagnose` wrote", max_bytes=MAX_BYTES_OF_RESULTS
    )
    hidden = {effect["name"]: effect for effect in truth["effects"]}
    effects, parameters = [], []
    for effect in found["effects"]:
        effects.append(
            {
                "name": effect["name"],
                "where": _where(effect["channel"]),
                "probability": _short(effect.get("probability"))
                if effect.get("probability") is not None
                else "",
            }
        )
        for name, value in effect["parameters"].items():
            true = hidden.get(effect["name"], {}).get("parameters", {}).get(name, {}).get("value")
            parameters.append(_parameter(f"{effect['name']}.{name}", true, value))
    return {
        "hidden": ", ".join(
            f"{effect['name']} on {_where(effect['channel'])}" for effect in truth["effects"]
        ),
        "verdict": found["verdict"],
        "effects": effects,
        "parameters": parameters,
        "picture": svg(_gaps(found["gap"]["sealed"]), "error on the held-out log before and after"),
        "report": "diagnosis/report.html",
        "numbers": {"hidden": truth["effects"], **{key: found[key] for key in ("verdict", "effects", "gap")}},
    }


def _where(channel: str) -> str:
    return {"both": "both channels", "rig": "the whole rig"}.get(channel, f"channel {channel}")


def _parameter(name: str, true: float | None, found: dict[str, Any]) -> dict[str, str]:
    """A line of the table: hidden and found value; metres are shown as micrometres, the usual unit of a lap."""
    scale, unit = (1e6, "µm") if found["unit"] == "m" else (1.0, found["unit"])
    low, high = found.get("low"), found.get("high")
    text = f"{low * scale:.4g} to {high * scale:.4g}" if low is not None and high is not None else ""
    return {
        "name": name,
        "hidden": "none" if true is None else f"{true * scale:.4g}",
        "value": f"{found['value'] * scale:.4g}",
        "interval": text,
        "unit": unit,
    }


def _gaps(signals: dict[str, dict[str, float]]) -> Any:
    """Bars: error of each speed on the held-out log at every stage, with the noise as a line."""
    speeds = [name for name in signals if name.startswith("speed_")]
    drawing, axes = figure(len(speeds), height=1.5)
    shown = [signals[name][key] for name in speeds for key in ("noise", *(key for key, _ in GAPS))]
    least, most = min(shown), max(shown)
    for axis, name in zip(axes, speeds, strict=True):
        values = [signals[name][key] for key, _ in GAPS]
        colours = [COLOURS[4], COLOURS[4], COLOURS[1], COLOURS[0]]
        bars = axis.barh([label for _, label in GAPS], values, color=colours, height=0.62)
        axis.bar_label(bars, [f"{_short(value)} rpm" for value in values], padding=4, fontsize=8.5)
        axis.axvline(signals[name]["noise"], color=COLOURS[2], linestyle="--", linewidth=1.2)
        axis.invert_yaxis()
        axis.set(xscale="log", xlim=(0.5 * least, 2.0 * most))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.set_title(f"motor {name.split('_')[1]}; dashed: noise of the sensor", loc="left", fontsize=9)
        axis.grid(axis="y", visible=False)
    axes[-1].set_xlabel("error on the held-out log (RMS), rpm")
    return drawing
