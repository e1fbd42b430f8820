"""How far the probabilities of trials can be believed: names by how they were given, and the reliability diagram."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydro_env.experiments.coverage import Point, given_names, reliability, wilson


def of_trials(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Point]]:
    """The names of all trials by whether they were confirmed: "answers" and "guesses"."""
    found: dict[str, list[Point]] = {"answers": [], "guesses": []}
    for r in rows:
        hidden = {(n, c or "rig") for n, _, c in (word.partition(":") for word in r["hidden"])}
        found["answers" if r["verdict"] == "effects" else "guesses"] += given_names(r["effects"], hidden)
    return found


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
            ends = [wilson(b["right"], b["names"]) for b in bins]
            low, high = ([abs(end[k] - s) for end, s in zip(ends, share, strict=True)] for k in (0, 1))
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
