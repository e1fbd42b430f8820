"""Uncertainty: estimates at their minimum, with intervals by a block bootstrap on their derivatives (`estimation.uncertainty`),
and whether the logs determine the known parameters at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..estimation.final_refinement import refine
from ..estimation.uncertainty import intervals_of
from ..logs import Logs
from ..models.base import RigModel
from .form_correction import Models

#: A command that moves by less than this share of the rated one, a few steps of a converter, is constant.
CONSTANT = 0.01


def settle(logs: Logs, models: Models) -> Models:
    """Refines the estimates that are reported (`estimation.final_refinement`), before they are proved and given intervals."""
    models, shown = models.with_twins()
    refine(logs.fit, logs.fit.on(logs.fine), shown)
    return models


def run(logs: Logs, models: Models) -> Models:
    """Sets the intervals of every estimate that has derivatives and is reported."""
    models, shown = models.with_twins()
    for one in shown:
        if one.unknowns and one.columns:
            one.intervals = intervals_of(logs.fit, one)
    return models


def undetermined(rig: RigModel) -> Iterator[str]:
    """Why the fit logs do not determine the known parameters, by channel.

    A constant command shows one point of operation and one way to it, which many values of the parameters give: a deviation of
    the rig from the model's equations, which every rig has, then decides between them.
    """
    for c in rig.channels if rig.has_hidden_states else ():
        commands = [p.log.command_V[p.inside, c] for p in rig.parts if c in p.log.channels]
        moves = max(float(np.nanmax(u) - np.nanmin(u)) for u in commands)
        if moves < CONSTANT * rig.model.value("u_rated", c):
            yield f"the command of channel {c + 1} is constant in the fit logs"
