"""The report: a page that needs no network, for a manager (first sentence, first picture) and an engineer (the rest)."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from ... import __version__
from ...pages import render
from ...plant import CATALOGUE
from ..stages.naming import known_parameters
from ..stages.screening import detectable, hidden_by_calibration
from . import pictures, statements
from . import wording as words

if TYPE_CHECKING:
    from ..input.parts import Part
    from ..result import Diagnosis

__all__ = ["report_page"]


def report_page(found: Diagnosis) -> str:
    """The HTML page."""
    state = found.state
    return render(
        files(__package__).joinpath("page.html"),
        title=f"Diagnosis of {statements.log_names(found)}, model {state.model.name}, {date.today()}", version=__version__,
        found=found, words=words, catalogue=CATALOGUE, next_step=statements.next_step(found),
        sentence=statements.sentence(found), head=statements.headline(found),
        left=[text for text in (statements.left_over(found), statements.weak_proof(found)) if text],
        named=[(n, statements.effect_values(found, n), statements.remaining(found, n)) for n in found.effects],
        corrections=statements.correction_texts(found), columns=statements.error_columns(found),
        errors=statements.errors_of(state.on_held_out), bars=pictures.bars(found), traces=pictures.traces(found),
        locations=[(p, statements.windows_text(found, p)) for p in statements.shown_locations(found)],
        maps=pictures.maps(found), next_experiment=state.next_experiment, ranking=statements.ranking(found),
        parameters=[(p, statements.comment(found, p)) for p in known_parameters(state.rig, state.shown)],
        detectable=_detectable(found),
        logs=_names(state.rig.parts), held_out=_names(state.held_out_parts),
    )  # fmt: skip


def _names(parts: Sequence[Part]) -> list[str]:
    """Parts of logs without the folders, which need not be there when the page is read: the demo's get another name."""
    return [Path(part.label).name for part in parts]


def _detectable(found: Diagnosis) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """The heads of the table of what could be seen, and its rows."""
    seen, hidden = detectable(found.state.screening), hidden_by_calibration(found.state.screening)
    columns = [str(c + 1) for c in found.state.rig.channels]
    columns += ["rig"] if any("rig" in row for row in seen.values()) else []
    marks = {True: "yes", False: "no", None: ""}
    return columns, [
        (name, ["calibration hides it" if c in hidden.get(name, ()) else marks[row.get(c)] for c in columns])
        for name, row in seen.items()
    ]
