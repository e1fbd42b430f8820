"""Uncertainty: intervals of all estimates, by a block bootstrap on their derivatives (`estimation.uncertainty`), and whether the
logs determine the known parameters at all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..estimation import Estimate, intervals_of
from ..logs import Estimates, Logs
from ..models.base import RigModel
from .form_correction import Models

__all__ = ["run", "undetermined"]

#: A command that moves by less than this share of the rated one, a few steps of a converter, is constant.
CONSTANT = 0.01
#: Of the known parameters' prior variance the logs must take away this share on average, or they hardly speak of them.
LEARNED = 0.5


def run(logs: Logs, models: Models) -> Models:
    """Sets the intervals of every estimate that has derivatives and is reported."""

    def certain(estimates: list[Estimate]) -> None:
        for one in estimates:
            if one.unknowns and one.columns:
                one.intervals = intervals_of(logs.fit, one)

    return models.changed(certain)


def undetermined(rig: RigModel, shown: Estimates) -> Iterator[str]:
    """Why the fit logs do not determine the known parameters, by channel.

    A constant command shows one point of operation and one way to it, which many values of the parameters give: a deviation of
    the rig from the model's equations, which every rig has, then decides between them.
    """
    for c in rig.channels if rig.has_hidden_states else ():
        commands = [p.log.command_V[p.inside, c] for p in rig.parts if c in p.log.channels]
        moves = max(float(np.nanmax(u) - np.nanmin(u)) for u in commands)
        if moves < CONSTANT * rig.model.value("u_rated", c):
            yield f"the command of channel {c + 1} is constant in the fit logs"
            continue
        estimate = shown[c]
        known = np.array([u.prior and not u.effect for u in estimate.unknowns], bool)
        learned = estimate.intervals.learned[known] if estimate.intervals is not None else np.ones(1)
        if learned.size and learned.mean() < LEARNED:
            few = int((learned < LEARNED).sum())
            yield f"of {learned.size} known parameters of channel {c + 1} the fit logs leave {few} about as uncertain as before"
