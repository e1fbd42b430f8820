"""What closing the loop shows: means over hidden rigs with their intervals, as rows and as a table.

Intervals are 95 % percentile bootstrap ones of the mean over rigs: cases are drawn again, and in each of them its seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hydro_env.controllers.base import Floats

#: Models on which a controller is tuned.
SOURCES = ("wrong", "repaired", "true")
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")
RESAMPLES = 4000


def collect(scores: Sequence[Mapping[str, Any]], seed: int = 0) -> list[dict[str, Any]]:
    """Means over rigs by controller, scenario and metric, and what repairing the model changed.

    `scores` are rows {controller, tuned_on, rig, case, seed, scenario, metrics}. Of every controller that was tuned, the
    rows hold `wrong`, `repaired`, `true` as {mean, ci95}; `change`: mean on the repaired model over that on the wrong one,
    less 1; `better`: on how many rigs it was lower. Shipped controllers have `none` alone.
    """
    groups: dict[tuple[str, bool, str], list[Mapping[str, Any]]] = {}
    for s in scores:
        groups.setdefault((s["controller"], s["tuned_on"] == "none", s["scenario"]), []).append(s)
    return [
        {"controller": controller, "scenario": scenario, "metric": metric, **_compared(own, metric, seed)}
        for (controller, _, scenario), own in groups.items()
        for metric in METRICS
    ]


def _compared(scores: Sequence[Mapping[str, Any]], metric: str, seed: int) -> dict[str, Any]:
    """A controller on a scenario: means of a metric by model over the rigs that all models have, and the change."""
    values: dict[str, dict[tuple[str, int], float]] = {}
    for s in scores:
        values.setdefault(s["tuned_on"], {})[s["case"], s["seed"]] = s["metrics"][metric]
    rigs = sorted(set.intersection(*(set(each) for each in values.values())))
    drawn = _drawn(rigs, seed)
    of = {source: np.array([each[rig] for rig in rigs]) for source, each in values.items()}
    means = {source: each[drawn].mean(axis=1) for source, each in of.items()}
    row: dict[str, Any] = {"n": len(rigs)}
    for source, each in of.items():
        row[source] = {"mean": float(each.mean()), "ci95": _interval(means[source])}
    if {"wrong", "repaired"} <= of.keys():
        mean = float(of["repaired"].mean() / of["wrong"].mean() - 1.0)
        row["change"] = {"mean": mean, "ci95": _interval(means["repaired"] / means["wrong"] - 1.0)}
        row["better"] = int(np.sum(of["repaired"] < of["wrong"]))
    return row


def _drawn(rigs: Sequence[tuple[str, int]], seed: int) -> Any:
    """Places of the rigs in every resample (RESAMPLES, n): cases drawn again, and in each of them as many of its seeds."""
    stream = np.random.default_rng(seed)
    cases = [np.flatnonzero([case == each for case, _ in rigs]) for each in dict.fromkeys(c for c, _ in rigs)]
    size = max(len(each) for each in cases)  # cases of equal weight, also if a rig of one of them failed
    picked = stream.integers(len(cases), size=(RESAMPLES, len(cases)))
    return np.array(
        [np.concatenate([cases[c][stream.integers(len(cases[c]), size=size)] for c in row]) for row in picked]
    )


def _interval(values: Floats) -> list[float]:
    return [float(v) for v in np.percentile(values, [2.5, 97.5])]


def table(data: Mapping[str, Any]) -> str:
    """The scores as a table in Markdown, one line a controller and scenario."""
    lines = [
        "| controller | scenario | peak error, rpm: model as given | repaired | true | change by the repair | better on"
        " | RMS: as given, repaired, true | tracking error: as given, repaired, true |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    by = {(r["controller"], "none" in r, r["scenario"], r["metric"]): r for r in data["summary"]}
    for name, shipped in dict.fromkeys((r["controller"], "none" in r) for r in data["summary"]):
        for scenario in dict.fromkeys(r["scenario"] for r in data["summary"]):
            largest, rms, tracking = (by[name, shipped, scenario, metric] for metric in METRICS)
            sources = ("none",) if shipped else SOURCES
            titled = f"{name} as shipped" if shipped else name
            cells = [titled, scenario, *(_shown(largest[s]) for s in sources)]
            cells += [""] * 4 if shipped else [_change(largest), f"{largest['better']} of {largest['n']}"]
            cells += [", ".join(f"{row[s]['mean']:.1f}" for s in sources) for row in (rms, tracking)]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _shown(entry: Mapping[str, Any]) -> str:
    low, high = entry["ci95"]
    return f"{entry['mean']:.1f} [{low:.1f}, {high:.1f}]"


def _change(row: Mapping[str, Any]) -> str:
    low, high = (100.0 * v for v in row["change"]["ci95"])
    return f"{100.0 * row['change']['mean']:+.0f} % [{low:+.0f}, {high:+.0f}]"


def summary(data: Mapping[str, Any]) -> str:
    """What the command prints."""
    right = sum(row["right"] for row in data["rigs"])
    head = f"{len(data['rigs'])} hidden rigs, {right} named correctly. Errors on the hidden rigs:"
    failed = [f"failed: {each['task']}: {each['reason']}" for each in data["failed"]]
    return "\n".join([head, table(data), *failed])
