"""`hydro-env demo`: the paper's experiment, a leaderboard and one diagnosis, on one page.

Every number on the page is computed in the same run, but for the paper's published ones. The parts are the commands
`reproduce`, `benchmark`, `hide` and `diagnose`, whose own results stand in folders beside the page.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env import __version__
from hydro_env.benchmark import command as benchmark
from hydro_env.benchmark.cells import Conditions
from hydro_env.benchmark.report import privileged_information
from hydro_env.case import command as diagnosis
from hydro_env.controllers.registry import CONTROLLERS, make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.diagnosis import Settings
from hydro_env.experiments import reproduce
from hydro_env.files import write_json, write_text
from hydro_env.pages import COLOURS, beside_results, figure, fill, png, render, svg
from hydro_env.practice import generate as hide
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json
from hydro_env.tasks import Trace

#: What the third part hides.
HIDDEN = ("dead_zone:1",)

#: Columns of the leaderboard: scenario, metric, heading. The first two are drawn.
BOARD = (
    ("setpoint_steps", "max_speed_difference_rpm", "set-point steps: peak synchronisation error, rpm"),
    ("setpoint_steps", "tracking_mae_rpm", "set-point steps: mean absolute tracking error, rpm"),
    ("load_step", "max_speed_difference_rpm", "load step: peak synchronisation error, rpm"),
    ("load_step", "tracking_mae_rpm", "load step: mean absolute tracking error, rpm"),
)
PAPER, TUNED, BOUND = "pid_paper", "pid_tuned", "oracle"
#: The one split of the quick suite; the animation shows one of its cases.
SPLIT = "test_interp"

#: The agent for every rig, and the split of rigs that it was not trained on.
ANY, UNSEEN = "gru_any", "test_any"

GAPS = (
    ("before", "model as given"),
    ("calibrated", "calibrated"),
    ("placebo", "placebo: calibrated, with the best wrong effect"),
    ("after", "calibrated, with the named effect"),
)

#: Step between the rows of a trace that are kept: 20 ms, in which a shaft at 600 rpm turns by 72 degrees.
EVERY = 2


@contextmanager
def _timed(name: str, seconds: dict[str, float]) -> Iterator[None]:
    """Says what is being done, and keeps in `seconds` how long it took."""
    tqdm.write(f"{name} ...")
    start = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - start
    tqdm.write(f"{name}: {seconds[name]:.1f} s")


def run(out: str | Path, *, seed: int = 0, jobs: int = 1) -> dict[str, Any]:
    """Runs the demo and writes `out/index.html`, `out/demo.png`, `out/demo.json` and a folder for each part.

    Args:
        out: an existing folder.
        seed: of the benchmark's pairs of valves and of the practice logs.
        jobs: processes of the scoreboard; the diagnosis has a thread for every core.

    Returns the content of demo.json: the numbers of the page and the seconds of each part.
    """
    out = Path(out)
    seconds: dict[str, float] = {}
    for name in ("reproduce", "benchmark", "practice", "diagnosis"):
        (out / name).mkdir()
    with _timed("the paper's experiment", seconds):
        paper = reproduce.run(out / "reproduce")
    with _timed("scoreboard", seconds):
        quick, conditions = benchmark.Selection("quick"), Conditions(seed=seed)
        scores = benchmark.run(out / "benchmark", selection=quick, conditions=conditions, jobs=jobs)
    with _timed("diagnosis", seconds):
        finding = _diagnosis(out / "practice", out / "diagnosis", seed)
    shown = {(scenario, metric) for scenario, metric, _ in BOARD}
    result = {
        "schema": "hydro_env/demo/1",
        "paper": {key: paper.numbers[key] for key in ("setpoint_steps", "load_step")},
        "scores": [row for row in scores["rows"] if (row["scenario"], row["metric"]) in shown],
        "diagnosis": finding,
        "seconds": seconds,
    }
    write_json(out / "demo.json", result)
    with beside_results(out / "index.html"):
        png(reproduce.draw_steps(paper), out / "demo.png")
        alt = "speeds of both motors in the paper's experiment and their difference"
        speeds = svg(reproduce.draw_steps(paper), alt)
        gaps = svg(_gaps(finding["gap"]["sealed"]), "error on the held-out log before and after")
        links = sorted(f"reproduce/{path.name}" for path in (out / "reproduce").iterdir())
        published = {**paper.numbers, "picture": speeds, "links": links}
        write_text(out / "index.html", page(published, _board(scores), {**finding, "picture": gaps}, seconds))
    return result


def page(
    paper: dict[str, Any], board: dict[str, Any], finding: dict[str, Any], seconds: dict[str, float]
) -> str:
    """The HTML page; `paper` is the content of reproduce.json with `picture` and `links`, `seconds` are those of each part."""
    from markupsafe import Markup

    return render(
        files(__package__).joinpath("demo.html"),
        title="Two hydraulic motors, two unequal valves",
        version=__version__,
        seconds=seconds,
        rig=Markup(files(__package__).joinpath("demo_rig.html").read_text(encoding="utf-8")),
        paper=paper,
        board=board,
        finding=finding,
        short=_short,
    )


def _short(value: float | None) -> str:
    """Three digits, as a reader wants them, and no zeros that say nothing."""
    if value is None or not np.isfinite(value):
        return "–"
    if value == round(value):
        return f"{value:z.0f}"
    return f"{value:.{min(max(0, 2 - int(np.floor(np.log10(abs(value))))), 3)}f}"


# --- 2. the leaderboard -----------------------------------------------------------------------------------------------
def _board(scores: dict[str, Any]) -> dict[str, Any]:
    cells = {(row["controller"], row["scenario"], row["metric"]): row for row in scores["rows"]}
    at = {
        name: [cells[name, scenario, metric]["iqm"] for scenario, metric, _ in (BOARD[1], BOARD[0])]
        for name in scores["controllers"]
        if (name, *BOARD[0][:2]) in cells
    }
    plain = [name for name in at if not privileged_information(scores, name)]
    law, agent = (
        min((name for name in plain if _learned(name) is learned), key=lambda name: at[name][1])
        for learned in (False, True)
    )
    shown = {
        PAPER: "Table III of the paper",
        TUNED: "the same law, gains found by search",
        law: "the law with the lowest peak error, without privileged information",
        agent: "the learned agent with the lowest peak error",
        BOUND: "the bound",
    }
    titles = {PAPER: f"The paper's PID ({PAPER})", agent: f"The best agent ({agent})"}
    seeds = range(scores["seed"], scores["seed"] + scores["splits"][SPLIT])
    rows = []
    for name, why in shown.items():
        learned = "a network from the observation alone" if _learned(name) else ""
        note = "; ".join(filter(None, [why, learned, privileged_information(scores, name)]))
        found = [cells.get((name, scenario, metric)) for scenario, metric, _ in BOARD]
        rows.append({"name": name, "note": note, "learned": bool(learned), "cells": found})
    recorded = record(titles, seeds, split=SPLIT, scenario=BOARD[0][0])
    alt = "peak synchronisation error over tracking error of every controller"
    return {
        "unseen": svg(_on_a_rig(scores["seed"]), "speeds and commands of a rig that the agent was not trained on"),
        "about": scores["about"], "cases": max(row["n"] for row in scores["rows"]),
        "controllers": len(scores["controllers"]), "columns": [heading for _, _, heading in BOARD], "rows": rows,
        "agent": agent, "seed": recorded["seed"], "animation": animation(recorded),
        "picture": svg(_front(at, plain, shown), alt),
    }  # fmt: skip


def _learned(name: str) -> bool:
    file = CONTROLLERS[name].file
    return file is not None and file.suffix == ".npz"


def _front(at: dict[str, list[float]], plain: list[str], shown: dict[str, str]) -> Any:
    """Peak synchronisation error over tracking error on the set-point steps, `at` [tracking error, peak] of every controller, the
    rows of the table by name, and the Pareto front of those that are `plain`: without privileged information."""
    drawing, (axis,) = figure(height=3.4)
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


def _on_a_rig(case: int) -> Any:
    """Speeds and commands under the agent for every rig, on one that it was not trained on."""
    trace = roll_out(make_controller(ANY), [case], mismatch=UNSEEN, scenario=BOARD[0][0]).trace
    drawing, (speeds, commands) = figure(2, height=1.7)
    time_s = trace.period * np.arange(len(trace.speed_rpm))
    speeds.plot(time_s, trace.setpoint_rpm[:, 0], color=COLOURS[4], linewidth=0.8)
    reproduce.draw_speeds(speeds, time_s, trace.speed_rpm[:, 0], linewidth=1.1)
    for motor in (0, 1):
        commands.step(
            time_s[1:], 100.0 * trace.command[:, 0, motor], color=COLOURS[motor], linewidth=0.9, where="pre"
        )
    speeds.legend(loc="lower left", fontsize=8)
    speeds.set_ylabel("speed, rpm")
    commands.set(ylabel="command, %", xlabel="time, s")
    return drawing


# --- both shafts under several controllers on the same pair of valves, as an animation ---------------------------------
def record(titles: Mapping[str, str], seeds: Sequence[int], *, split: str, scenario: str) -> dict[str, Any]:
    """Drives the same pair of valves with every controller.

    Args:
        titles: what the page calls each controller, by its name.
        seeds: cases of the split. The one is shown whose largest speed difference under the first controller is the median.
        split, scenario: what is driven.

    Returns what the page's script draws: `seed` of the case, `period_s` between the samples, `setpoint_rpm` (T,), and for every
    controller in `runs` `speed_rpm` (2, T) in whole rpm, `ahead_deg` (T,), by how much shaft 1 is ahead of shaft 2, and
    `command_percent` (2, T) of the rated command, that which is in force from then on.
    """
    where: dict[str, Any] = {"mismatch": split, "scenario": scenario}
    name, *_ = titles
    trace = roll_out(make_controller(name), seeds, **where).trace
    peaks = np.abs(trace.difference_rpm).max(axis=0)
    seed = seeds[int(np.argsort(peaks, kind="stable")[(len(seeds) - 1) // 2])]
    traces = {name: roll_out(make_controller(name), [seed], **where).trace for name in titles}
    return {
        "seed": seed,
        "period_s": EVERY * trace.period,
        "setpoint_rpm": _whole(traces[name].setpoint_rpm[::EVERY, 0]),
        "runs": [{"name": name, "title": titles[name], **_drawn(each)} for name, each in traces.items()],
    }


def _drawn(trace: Trace) -> dict[str, Any]:
    command = np.vstack([trace.command[:, 0], trace.command[-1:, 0]])  # after the last row the last one stays
    return {
        "speed_rpm": [_whole(trace.speed_rpm[::EVERY, 0, motor]) for motor in (0, 1)],
        "ahead_deg": _whole(trace.angle_difference_deg[::EVERY, 0]),
        "command_percent": [_whole(100.0 * command[::EVERY, motor]) for motor in (0, 1)],
    }


def _whole(values: Any) -> list[int]:
    return np.rint(values).astype(int).tolist()


def animation(recorded: Mapping[str, Any]) -> Any:
    """The part of a page (`Markup`) that plays what `record` returns; one to a page, since its elements have ids."""
    from markupsafe import Markup

    return Markup(fill(files(__package__).joinpath("shaft_animation.html"), TRACES=recorded))


# --- 3. the diagnosis -------------------------------------------------------------------------------------------------
def _diagnosis(practice: Path, out: Path, seed: int) -> dict[str, Any]:
    """Hides and diagnoses; the hidden effects and what was found."""
    truth = hide.run(HIDDEN, practice, seed=seed).truth
    fit, held_out = ([practice / name for name in truth["logs"][kind]] for kind in ("fit", "sealed"))
    diagnosis.run(fit, held_out, out, model=practice / "model.yaml", settings=Settings(seed=seed))
    found = read_json(
        out / "diagnosis.json", "what `hydro-env diagnose` wrote", max_bytes=MAX_BYTES_OF_RESULTS
    )
    return {"hidden": truth["effects"], **{key: found[key] for key in ("verdict", "effects", "gap")}}


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
