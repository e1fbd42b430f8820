"""How far probabilities can be believed: of names given with probability p, the share that is right (reliability diagram).

A name counts as right if it is hidden on that channel; one that is declared indistinguishable from the hidden one does not, since
such names share their probability. Names of a verdict `effects` are answers; those that an `unknown` lists are guesses, and are
counted apart. Intervals of shares are Wilson's (1927), at 95 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from .judging import sides

__all__ = ["EDGES", "Point", "draw", "given_names", "of_trials", "reliability", "reliability_lines", "wilson"]

#: Edges of the bins of probability.
EDGES = (0.0, 0.3, 0.5, 0.7, 0.9, 1.0)

#: A name that was given: its probability and whether it is right.
Point = tuple[float, bool]


def wilson(count: int, of: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson's interval of a share (Wilson 1927)."""
    if of == 0:
        return 0.0, 1.0
    p, n = count / of, float(of)
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def given_names(effects: Sequence[Mapping[str, Any]], hidden: set[tuple[str, str]]) -> list[Point]:
    """The names of a diagnosis that have a probability, against the set of hidden (effect, channel)."""
    return [
        (float(e["probability"]), all((e["name"], c) in hidden for c in sides(e["channel"])))
        for e in effects
        if e.get("probability") is not None
    ]


def of_trials(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Point]]:
    """The names of all trials by whether they were confirmed: "answers" and "guesses"."""
    found: dict[str, list[Point]] = {"answers": [], "guesses": []}
    for r in rows:
        hidden = {(n, c or "rig") for n, _, c in (word.partition(":") for word in r["hidden"])}
        found["answers" if r["verdict"] == "effects" else "guesses"] += given_names(r["effects"], hidden)
    return found


def reliability(points: Sequence[Point]) -> list[dict[str, Any]]:
    """For every bin that holds names: its edges, mean probability, how many are right, and the interval of that share."""
    found = []
    for low, high in pairwise(EDGES):
        own = [(p, right) for p, right in points if low <= p < high or p == high == EDGES[-1]]
        if own:
            count = sum(right for _, right in own)
            found.append(
                {
                    "from": low, "to": high, "names": len(own), "right": count,
                    "mean": sum(p for p, _ in own) / len(own), "ci95": wilson(count, len(own)),
                }
            )  # fmt: skip
    return found


def reliability_lines(named: Mapping[str, Sequence[Point]]) -> list[str]:
    """A table in Markdown, empty where no name has a probability."""
    lines = ["| names | probability | number | mean probability | right |", "|---|---|---|---|---|"]
    for what, points in named.items():
        for b in reliability(points):
            low, high = (round(100 * v) for v in b["ci95"])
            right = f"{b['right']} ({round(100 * b['right'] / b['names'])} %; {low} to {high} %)"
            lines.append(
                f"| {what} | {b['from']:g} to {b['to']:g} | {b['names']} | {b['mean']:.2f} | {right} |"
            )
    return lines if len(lines) > 2 else []


def draw(named: Mapping[str, Sequence[Point]], path: Path) -> None:
    """Writes the reliability diagram as a PNG. Needs the extra `report`."""
    import matplotlib
    from matplotlib.figure import Figure

    from hydro_env.pages import COLOURS, RC, png

    with matplotlib.rc_context(RC):
        made = Figure(figsize=(5.6, 4.8), layout="constrained")
        axes = made.subplots()
        axes.plot([0, 1], [0, 1], color="0.6", lw=1, ls="--", label="as said")
        for n, (what, points) in enumerate(named.items()):
            bins = reliability(points)
            if not bins:
                continue
            middle = [b["mean"] for b in bins]
            share = [b["right"] / b["names"] for b in bins]
            low, high = ([abs(b["ci95"][k] - s) for b, s in zip(bins, share, strict=True)] for k in (0, 1))
            label = f"{what} ({len(points)} names)"
            axes.errorbar(
                middle, share, [low, high], fmt="o", ms=5, capsize=3, color=COLOURS[n % len(COLOURS)], label=label
            )  # fmt: skip
            for x, y, b in zip(middle, share, bins, strict=True):
                axes.annotate(str(b["names"]), (x, y), (6, 5), textcoords="offset points", fontsize=8)
        axes.set(
            xlim=(-0.02, 1.05),
            ylim=(-0.02, 1.05),
            xlabel="probability that is given",
            ylabel="share that is right",
        )
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        png(made, path)
