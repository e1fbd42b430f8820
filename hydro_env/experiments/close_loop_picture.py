"""The picture of `hydro-env close-loop`: every hidden rig before and after the repair, and one of them in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.pages import COLOURS, RC, png

__all__ = ["draw"]

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

    tuned = [r["controller"] for r in data["summary"] if "wrong" in r and _is(r)]
    with matplotlib.rc_context(RC):
        made = Figure(figsize=(11.0, 4.4), layout="constrained")
        left, right = made.subplots(1, 2, width_ratios=[1.25, 1.0])
        colours = dict(zip(dict.fromkeys(s["case"] for s in data["rigs"]), COLOURS, strict=False))
        for place, name in enumerate(tuned):
            _dots(left, data, name, 4.0 * place, colours)
        left.set_yscale("log")
        left.set_ylabel("peak synchronisation error, rpm")
        places = [4.0 * p + i for p in range(len(tuned)) for i in range(3)]
        left.set_xticks(places, [label for _ in tuned for label in SOURCES.values()], fontsize=8, rotation=30)
        left.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        left.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")
        top = left.get_ylim()[1]
        for place, name in enumerate(tuned):
            count = next(
                r["n"] for r in data["summary"] if r["controller"] == name and "wrong" in r and _is(r)
            )
            said = NAMES.get(name, name) + ("" if count == len(data["rigs"]) else f", {count} rigs")
            left.text(4.0 * place + 1.0, top, said, ha="center", va="bottom", fontsize=9)
        left.set_title(
            "Scored on the hidden rigs: set-point steps. Tuned on the ... model\n", loc="left", fontsize=10
        )
        for case, colour in colours.items():
            left.plot([], [], color=colour, marker="o", ms=4, lw=0.8, label=case.replace("_", " "))
        left.plot([], [], color="k", marker="_", ms=10, lw=2, label="mean, 95 %")
        left.legend(
            fontsize=8, frameon=False, ncols=len(colours) + 1, loc="upper center", bbox_to_anchor=(0.5, -0.16)
        )
        rig = _typical(data, shown)
        if rig is not None:
            _traces(right, data, shown, rig)
    png(made, path)


def _is(row: Mapping[str, Any]) -> bool:
    return row["metric"] == METRIC and row["scenario"] == SCENARIO


def _values(data: Mapping[str, Any], name: str) -> dict[str, dict[str, float]]:
    """Largest differences by rig and model."""
    found: dict[str, dict[str, list[float]]] = {}
    for s in data["scores"]:
        if s["controller"] == name and s["scenario"] == SCENARIO and s["tuned_on"] in SOURCES:
            found.setdefault(s["rig"], {}).setdefault(s["tuned_on"], []).append(s["metrics"][METRIC])
    return {rig: {k: float(np.mean(v)) for k, v in each.items()} for rig, each in found.items()}


def _dots(axis: Any, data: Mapping[str, Any], name: str, start: float, colours: Mapping[str, str]) -> None:
    cases = {row["rig"]: row["case"] for row in data["rigs"]}
    for rig, each in _values(data, name).items():
        places = [start + i for i, source in enumerate(SOURCES) if source in each]
        values = [each[source] for source in SOURCES if source in each]
        axis.plot(places, values, color=colours[cases[rig]], marker="o", ms=3.5, lw=0.8, alpha=0.8)
    row = next(r for r in data["summary"] if r["controller"] == name and "wrong" in r and _is(r))
    for i, source in enumerate(SOURCES):
        if source in row:
            mean, (low, high) = row[source]["mean"], row[source]["ci95"]
            axis.plot([start + i] * 2, [low, high], color="k", lw=1.6, zorder=4)
            axis.plot([start + i - 0.28, start + i + 0.28], [mean] * 2, color="k", lw=2.4, zorder=4)


def _typical(data: Mapping[str, Any], name: str) -> str | None:
    """The rig with the median ratio of after to before."""
    ratios = {
        r: v["repaired"] / v["wrong"]
        for r, v in _values(data, name).items()
        if {"wrong", "repaired"} <= v.keys()
    }
    ordered = sorted(ratios, key=lambda rig: ratios[rig])
    return ordered[len(ordered) // 2] if ordered else None


def _traces(axis: Any, data: Mapping[str, Any], name: str, rig: str) -> None:
    row = next(r for r in data["rigs"] if r["rig"] == rig)
    hidden = ", ".join(_said(e) for e in row["hidden"])
    for source, colour in (("wrong", COLOURS[1]), ("repaired", COLOURS[0])):
        wanted = (name, source, rig, SCENARIO)
        for s in data["scores"]:
            if (s["controller"], s["tuned_on"], s["rig"], s["scenario"]) == wanted and "difference_rpm" in s:
                values: Sequence[float] = s["difference_rpm"]
                axis.plot(
                    np.arange(len(values)) * PERIOD,
                    values,
                    color=colour,
                    lw=1.1,
                    label=f"tuned on the model: {SOURCES[source]}"
                    if source == "wrong"
                    else f"tuned on the {source} model",
                )
    axis.set_xlabel("time, s")
    axis.set_ylabel("speed 1 - speed 2, rpm")
    axis.set_title(f"{NAMES.get(name, name)} on rig {rig}\nhidden: {hidden}", loc="left", fontsize=9)
    axis.legend(fontsize=8, frameon=False)


def _said(effect: Mapping[str, Any]) -> str:
    channel = effect["channel"]
    return effect["name"].replace("_", " ") + ("" if channel == "rig" else f" on channel {channel}")
