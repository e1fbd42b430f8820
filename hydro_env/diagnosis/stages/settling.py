"""What is reported goes all the way to its minimum (`estimation.final_refinement`), before it is proved and given intervals."""

from __future__ import annotations

from ..estimation import refine
from ..logs import Logs
from .form_correction import Models

__all__ = ["run"]


def run(logs: Logs, models: Models) -> Models:
    """Refines the estimates that are reported."""
    return models.changed(lambda estimates: refine(logs.fit, logs.fit.on(logs.fine), estimates))
