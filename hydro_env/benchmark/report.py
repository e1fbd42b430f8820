"""The leaderboard as a table for the terminal and as one page of HTML that needs no network.

The page carries its data as JSON and draws with a few lines of JavaScript into SVG: a table that sorts, the
Pareto front (synchronisation error over tracking error) and the typical and the worst case behind every row.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from typing import Any

from hydro_env import __version__
from hydro_env.benchmark.cells import SCORE, SCORED
from hydro_env.pages import fill

__all__ = ["privileged_information", "scores_page", "scores_table"]

NEEDS = {
    "measurements": "",
    "bench": "valve bench",
    "parameters": "true valve parameters",
    "everything": "true parameters, state, future loads",
}
"""Privileged information: what a controller has beyond the measurements on the rig, by its attribute `needs`."""


def scores_table(scores: dict[str, Any]) -> str:
    """One block per split and scenario, one line per controller, one column per metric: interquartile
    means.
    """
    columns = _distinct(dict.fromkeys(row["metric"] for row in scores["rows"]))
    cells = {(r["split"], r["scenario"], r["controller"], r["metric"]): r for r in scores["rows"]}
    idle = {(f["split"], f["scenario"], f["controller"]) for f in scores["idle"]}
    failed = {(f["split"], f["scenario"], f["controller"]): f["reason"] for f in scores["failed"]}
    done = [(r["split"], r["scenario"]) for r in scores["rows"]]
    blocks = list(dict.fromkeys(done + [(f["split"], f["scenario"]) for f in scores["failed"]]))
    extras = {**_extras(scores), **_never(scores)}
    width = max([len(name + IDLE) for name in scores["controllers"]])
    lines = []
    for split, scenario in blocks:
        counts = [r["n"] for r in scores["rows"] if (r["split"], r["scenario"]) == (split, scenario)]
        n = max(counts, default=0)
        lines.append(f"\n{split} / {scenario}, {n} cases: interquartile mean and its 95 % interval")
        texts = {
            name: [
                extras.get((split, scenario, name, metric))
                or _cell(cells.get((split, scenario, name, metric)))
                for metric in columns
            ]
            + [extras.get((split, scenario, name, what), "-") for what in EXTRAS]
            for name in scores["controllers"]
            if (split, scenario, name) not in failed
        }
        heads = [_short(metric) for metric in columns] + list(EXTRAS)
        columns_of = zip(heads, *texts.values(), strict=True)
        wide = [2 + max(len(text) for text in column) for column in columns_of]
        lines.append("  " + "controller".ljust(width) + _row(heads, wide))
        for name in sorted(scores["controllers"], key=lambda name: (split, scenario, name) in idle):
            ran = name in texts
            row = _row(texts[name], wide) if ran else f"  failed: {failed[split, scenario, name]}"
            lines.append("  " + (name + IDLE * ((split, scenario, name) in idle)).ljust(width) + row)
    lines += _overall(scores, width)
    return "\n".join(lines).lstrip("\n")


def _overall(scores: dict[str, Any], width: int) -> list[str]:
    """The score over the whole suite, the best first; who was idle anywhere comes last."""
    idle = {each["controller"] for each in scores["idle"]}
    rows = [row for row in scores["overall"] if row["metric"] == SCORE.name]
    rows.sort(key=lambda row: (row["controller"] in idle, -row["iqm"]))
    lines = ["\nthe whole suite: normalised score, its 95 % interval, and its worst 5 %"] if rows else []
    for row in rows:
        name = row["controller"] + IDLE * (row["controller"] in idle)
        lines.append(f"  {name.ljust(width)}  {_cell(row)}  {row['cvar95']:.3g}")
    return lines


def _distinct(metrics: Iterable[str]) -> list[str]:
    """The metrics without those that are another one under a second name."""
    return list(
        {(SCORED[name].of, SCORED[name].more and name): name for name in reversed(list(metrics))}.values()
    )[::-1]


EXTRAS = ("better",)
"""Of the peak synchronisation error: the probability of improvement."""
IDLE = " (idle)"
"""Beside the name of a controller that hardly moves the motors."""


def _extras(scores: dict[str, Any]) -> dict[tuple[str, str, str, str], str]:
    return {
        (entry["split"], entry["scenario"], entry["controller"], EXTRAS[0]): f"{entry['probability']:.0%}"
        for entry in scores["improvement"]
        if entry["metric"] == "max_speed_difference_rpm"
    }


SETTLING = "sync_settling_time_s"


def _never(scores: dict[str, Any]) -> dict[tuple[str, str, str, str], str]:
    """What stands for a settling time where no case settled: the number would be the length of the episode."""
    return {
        (entry["split"], entry["scenario"], entry["controller"], SETTLING): "never settled"
        for entry in scores["never_settled"]
        if entry["cases"] == scores["splits"][entry["split"]]
    }


def _row(texts: list[str], widths: list[int]) -> str:
    return "".join(text.rjust(width) for text, width in zip(texts, widths, strict=True))


def _short(metric: str) -> str:
    """`max_speed_difference_rpm` as `peak sync error, rpm`, so that a line fits a terminal."""
    for long, short in (
        ("max_speed_difference_", "peak sync error_"),
        ("_speed_difference_", " diff_"),
        ("shaft_angle_difference_", "shaft angle_"),
        ("travel_per_s", "travel, 1/s"),
        ("reversals_per_s", "reversals, 1/s"),
    ):
        metric = metric.replace(long, short)
    head, _, unit = metric.rpartition("_")
    return f"{head.replace('_', ' ')}, {unit}" if unit in ("rpm", "s", "deg") else metric.replace("_", " ")


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return "-"
    return f"{row['iqm']:.3g} [{row['ci95'][0]:.3g}, {row['ci95'][1]:.3g}]"


def privileged_information(scores: dict[str, Any], name: str) -> str:
    """The privileged information of a controller in a few words; without it scores cannot be compared."""
    needs, plant = scores["needs"][name], scores["own_plant"].get(name)
    return ", ".join(filter(None, [NEEDS.get(needs, needs), plant and f"on {plant} valves"]))


def scores_page(scores: dict[str, Any], traces: dict[str, Any] | None) -> str:
    """The HTML page. `traces`: {"period_s", "limit_rpm", "metric", "splits": {split: {scenario: {controller: {"typical": case,
    "worst": case}}}}}, each case as `hydro_env.benchmark.command` thins it."""
    privileged = {name: privileged_information(scores, name) for name in scores["controllers"]}
    metrics = {
        name: {
            "title": ", ".join(filter(None, (each.title, each.unit))),
            "definition": each.definition,
            "more": each.more,
        }
        for name, each in SCORED.items()
    }
    columns = _distinct(dict.fromkeys(row["metric"] for row in scores["rows"]))
    page = files("hydro_env.benchmark").joinpath("scores_page.html")
    more = {
        "privileged": privileged, "metrics": metrics, "version": __version__, "settling": SETTLING, "columns": columns,
    }  # fmt: skip
    return fill(page, SCORES={**scores, **more}, TRACES=traces)
