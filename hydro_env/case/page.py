"""The page of a case: what was known first, each question and its commands, what came back, and how probabilities moved."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..diagnosis.report import wording as words
from ..diagnosis.stages.naming import UNKNOWN
from ..pages import COLOURS, figure, render, svg
from .folder import CaseFile


def case_page(folder: Path, case: CaseFile) -> str:
    """The HTML page. The commands are read from the folder."""
    pictures = {q.commands: q.commands and _commands(folder / q.commands) for q in case.asked}
    return render(
        files(__package__).joinpath("case.html"), title=f"Case {folder.absolute().name}", version=__version__, case=case,
        pictures=pictures, moved=_probabilities(case), words=words,
    )  # fmt: skip


def _commands(path: Path) -> Any:
    table = np.genfromtxt(path, delimiter=",", names=True)
    names = table.dtype.names or ()
    loads = [n for n in names if n.startswith("load")]
    drawing, axes = figure(2 if loads else 1, height=1.7, left=0.95)
    for axis, kind, label in zip(axes, ("command", "load"), ("command, V", "load, N m"), strict=False):
        for colour, name in zip(COLOURS, (n for n in names if n.startswith(kind)), strict=False):
            channel = name.split("_")[1]
            axis.step(table["time_s"], table[name], where="post", color=colour, label=f"channel {channel}")
        axis.set_ylabel(label)
    axes[0].legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes[-1].set_xlabel("time, s")
    return svg(drawing, "commands and loads of the question")


def _probabilities(case: CaseFile) -> Any:
    """A bar for every place of every round, from the first one down."""
    bars = [(n, place) for n, r in enumerate(case.rounds) for place in r.open]
    names = list(dict.fromkeys(h for _, place in bars for h in place.hypotheses if h != UNKNOWN))
    colours = {h: COLOURS[n % len(COLOURS)] for n, h in enumerate(names)} | {UNKNOWN: "#8a8f9855"}
    drawing, (axis,) = figure(1, height=0.9 + 0.3 * len(bars))
    for row, (_, place) in enumerate(bars):
        left = 0.0
        for name, share in place.hypotheses.items():
            axis.barh(-row, share, left=left, height=0.7, color=colours[name])
            left += share
    axis.set_yticks(
        [-n for n in range(len(bars))],
        [f"after {n} answers, {words.where(p.channel)}" for n, p in bars],
    )
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("probability")
    for name in colours:
        axis.barh(0, 0.0, color=colours[name], label=words.plain(name))
    axis.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.4, 1.0), frameon=False)
    return svg(drawing, "probabilities after each round")
