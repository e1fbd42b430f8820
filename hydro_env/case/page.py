"""The page of a case: what was known first, each question and its commands, what came back, and how probabilities moved."""

from importlib.resources import files
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..diagnosis.report import wording as words
from ..diagnosis.stages.naming import UNKNOWN
from ..pages import COLOURS, figure, render, svg
from .folder import CaseFile

#: Of bars, where there are more hypotheses than colours.
HATCHES = ("", "////", "....")


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
    looks = {
        h: {"color": COLOURS[n % len(COLOURS)], "hatch": HATCHES[n // len(COLOURS) % len(HATCHES)]}
        for n, h in enumerate(names)
    }
    looks[UNKNOWN] = {"color": "#8a8f9855"}
    drawing, (axis,) = figure(1, height=0.6 + 0.3 * len(bars) + 0.25 * ceil(len(looks) / 3))
    for row, (_, place) in enumerate(bars):
        left = 0.0
        for name, share in place.hypotheses.items():
            axis.barh(-row, share, left=left, height=0.7, edgecolor="white", linewidth=0.0, **looks[name])
            left += share
    labels = [f"after {n} answers, {words.where(p.channel)}" for n, p in bars]
    axis.set_yticks([-n for n in range(len(bars))], labels)
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("probability")
    for name, look in looks.items():
        axis.barh(0, 0.0, edgecolor="white", linewidth=0.0, label=words.plain(name), **look)
    axis.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.4, 1.0), frameon=False)
    return svg(drawing, "probabilities after each round")
