"""Counts of trials as text: what was asked for, groups, intervals, times, and every trial that went wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydro_env.experiments.coverage import Point, given_names, reliability_lines
from hydro_env.files import write_text

from .cases import GROUPS, WITH_NAME, commands
from .judging import HELD_OUT_WITHIN, summary
from .running import SCHEMA

Row = Mapping[str, Any]


def markdown(header: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """The lines of a table."""
    lines = ["| " + " | ".join(map(str, cells)) + " |" for cells in (header, *rows)]
    return [lines[0], "|" + "---|" * len(header), *lines[1:]]


def _names(rows: Sequence[Row]) -> dict[str, list[Point]]:
    """The names of all trials by whether they were confirmed: "answers" and "guesses"."""
    found: dict[str, list[Point]] = {"answers": [], "guesses": []}
    for r in rows:
        hidden = {(n, c or "rig") for n, _, c in (word.partition(":") for word in r["hidden"])}
        found["answers" if r["verdict"] == "effects" else "guesses"] += given_names(r["effects"], hidden)
    return found


def share(count: int, of: int) -> str:
    return f"{count} of {of} ({100 * count / of:.0f} %)" if of else "-"


def table(rows: Sequence[Row]) -> str:
    """All of it in Markdown."""
    made = " and ".join(f"`{command}`" for command in commands(rows))
    parts = [
        [f"Made by {made}; {len(rows)} trials."], _criteria(rows), _groups(rows), _coverage(rows),
        reliability_lines(_names(rows)), _methods(rows), ["Trials that were not simply correct:"], _wrong(rows),
        _processor_time(rows), *_elapsed(rows), _rough(rows),
    ]  # fmt: skip
    return "\n\n".join("\n".join(part) for part in parts if part) + "\n"


def _criteria(rows: Sequence[Row]) -> list[str]:
    cells = []
    for s in summary(rows):
        if s["trials"]:
            target = "" if s["target"] is None else f"{100 * s['target']:.0f} %"
            cells.append([s["what"], ", ".join(s["groups"]), target, share(s["count"], s["trials"])])
    return markdown(["criterion", "trials", "target", "reached"], cells)


def _groups(rows: Sequence[Row]) -> list[str]:
    cells: list[list[object]] = []
    for group in GROUPS:
        own = [r for r in rows if r["group"] == group]
        if own:
            named = group in WITH_NAME
            times = sorted(r["cpu_s"] for r in own)
            cells.append(
                [
                    group, len(own), sum(r["right"] for r in own), sum(r["right"] or r["set"] for r in own),
                    sum(r["right"] or r["declared_set"] for r in own) if named else "-",
                    sum(r["channel"] for r in own) if named else "-", sum(r["sealed"] for r in own),
                    f"{times[len(times) // 2]:.0f}",
                ]
            )  # fmt: skip
    header = [
        "group", "trials", "correct", "correct or indistinguishable", "or `calibration` that lists it", "correct channel",
        "held-out error within 1.3", "median CPU, s",
    ]  # fmt: skip
    return markdown(header, cells)


def _coverage(rows: Sequence[Row]) -> list[str]:
    """How many true values the published intervals hold, by what they are of; the parameters that lie outside most often."""
    known = [r["covered"] for r in rows if "covered" in r]
    if not known:
        return []
    counts = {kind: [sum(c[kind][k] for c in known) for k in (0, 1)] for kind in ("base", "effects")}
    missed: dict[str, int] = {}
    for name in (n for c in known for n in c["outside"]):
        symbol = name if "." in name else name.rsplit("_", 1)[0]
        missed[symbol] = missed.get(symbol, 0) + 1
    worst = sorted(missed.items(), key=lambda item: -item[1])[:6]
    often = ", ".join(f"{name} ({count})" for name, count in worst) or "none"
    lines = [
        f"True values inside the published 95 % intervals: {share(*counts['base'])} of base parameters, "
        f"{share(*counts['effects'])} of parameters of correctly named effects. Most often outside: {often}."
    ]
    sure = [r["covered"] for r in rows if "at_90" in r.get("covered", {}) and r["verdict"] != "unknown"]
    if sure:
        number = {kind: sum(c[kind][1] for c in sure) for kind in counts}
        at_95 = " and ".join(share(sum(c[kind][0] for c in sure), number[kind]) for kind in counts)
        at_90 = " and ".join(share(sum(c["at_90"][kind] for c in sure), number[kind]) for kind in counts)
        lines.append(f"Where the verdict is not `unknown`: {at_95}; inside intervals of 90 %: {at_90}.")
    return lines


def _methods(rows: Sequence[Row]) -> list[str]:
    methods = [r.get("method", "?") for r in rows]
    if len(set(methods)) < 2:
        return []
    counts = ", ".join(f"{m} ({methods.count(m)})" for m in sorted(set(methods)))
    return [f"Ran on different states of the method: {counts}"]


def _wrong(rows: Sequence[Row]) -> list[str]:
    cells = []
    for r in rows:
        if r["right"]:
            continue
        names = ", ".join(
            f"{e['name']}:{e['channel']}"
            + (f" (or {', '.join(e['indistinguishable_from'])})" if e["indistinguishable_from"] else "")
            for e in r["effects"]
        )
        hidden = ", ".join(r["hidden"]) or "nothing"
        hidden += "" if r.get("visible", True) else " (reported as not detectable here)"
        error = f"{r['worst']:.2f} ({r['form']:.2f})"
        cells.append([r["group"], hidden, r["verdict"], names or "-", error, r["seed"]])
    header = [
        "group", "hidden", "verdict", "named", "held-out speed error, times the noise (true values)", "seed",
    ]  # fmt: skip
    return markdown(header, cells)


def _processor_time(rows: Sequence[Row]) -> list[str]:
    times = [r["cpu_s"] for r in rows]
    quick = sum(t <= 60.0 for t in times)
    return [
        f"Processor time of a diagnosis: {quick} of {len(times)} within 60 s, at most {max(times):.0f} s."
    ]


def _elapsed(rows: Sequence[Row]) -> list[list[str]]:
    parts = []
    for jobs in sorted({r.get("jobs", 1) for r in rows} - {1}):
        timed = [r for r in rows if r.get("jobs") == jobs]
        every = [(g, [r["seconds"] for r in timed if r["group"] == g]) for g in GROUPS]
        parts += [
            [f"Elapsed time with {jobs} threads: {_within([r['seconds'] for r in timed])}; of these"],
            [f"* {group}: {_within(own)}" for group, own in every if own],
        ]
    return parts


def _within(seconds: Sequence[float]) -> str:
    """How many of these times are within a minute, in words."""
    ordered = sorted(seconds)
    middle, longest = ordered[len(ordered) // 2], ordered[-1]
    return f"{sum(t <= 60.0 for t in ordered)} of {len(ordered)} within 60 s, median {middle:.0f} s, at most {longest:.0f} s"


def _rough(rows: Sequence[Row]) -> list[str]:
    """Correct names whose model does not explain the held-out log."""
    rough = [r for r in rows if (r["right"] or r["set"]) and r["verdict"] == "effects" and not r["sealed"]]
    each = [f"{', '.join(r['hidden'])} ({r['group']}) {r['worst']:.2f} ({r['form']:.2f})" for r in rough]
    return [
        f"Correctly named, but the held-out speed error stays above {HELD_OUT_WITHIN:g} times the noise (in brackets what the "
        f"true values in the catalogue's functional form leave): {'; '.join(each) or 'none'}."
    ]


#: What a published row keeps: what the table shows and counts.
_PUBLISHED = (
    "group", "hidden", "seed", "verdict", "named", "right", "set", "declared_set", "open", "channel", "alarm", "both", "sealed",
    "sealed_named", "sealed_form", "placebo", "worst", "form", "strength", "covered", "visible", "seconds", "cpu_s", "jobs",
    "method", "effects",
)  # fmt: skip


def publish(rows: Sequence[Row], folder: Path) -> None:
    """Writes FOLDER/trials.json, a line for each trial; `python docs/generate.py` then makes the page of it."""
    own = [{key: row[key] for key in _PUBLISHED if key in row} for row in rows]
    for row in own:
        row["effects"] = [
            {k: e[k] for k in ("name", "channel", "probability", "indistinguishable_from")}
            for e in row["effects"]
        ]
    lines = ",\n".join(f"  {json.dumps(row)}" for row in own)
    counts = ",\n".join(f"  {json.dumps(each)}" for each in summary(rows))
    text = f'{{\n "schema": "{SCHEMA}",\n "summary": [\n{counts}\n ],\n "rows": [\n{lines}\n ]\n}}\n'
    write_text(folder / "trials.json", text)
