"""The report: a page that needs no network, for a manager (first sentence, first picture) and an engineer (the rest)."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from importlib.resources import files

from ... import __version__
from ...pages import render
from ...plant import CATALOGUE
from ..stages.next_experiment import NextExperiment
from ..stages.values import known_parameters
from ..state import State
from . import pictures, statements
from . import wording as words

__all__ = ["report_page"]


def report_page(
    state: State, next_experiment: NextExperiment | None, warnings: Sequence[str], seconds: float
) -> str:
    """The HTML page."""
    return render(
        files(__package__).joinpath("page.html"),
        title=f"Diagnosis of {statements.log_names(state)}, model {state.rig.model.name}, {date.today()}", version=__version__,
        state=state, next_experiment=next_experiment, warnings=warnings, seconds=seconds, say=statements, words=words,
        catalogue=CATALOGUE, head=statements.headline(state), columns=statements.error_columns(state),
        parameters=[(p, statements.comment(state.rig, p)) for p in known_parameters(state.rig, state.models.shown)],
        traces=pictures.traces(state), maps=pictures.maps(state),
    )  # fmt: skip
