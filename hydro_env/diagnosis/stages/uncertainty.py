"""Uncertainty: estimates at their minimum, with intervals by a block bootstrap on their derivatives (`estimation.uncertainty`),
and whether the logs determine the known parameters at all."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..estimation.estimate import Estimates, distinct
from ..estimation.final_refinement import refine
from ..estimation.uncertainty import intervals_of
from ..logs import Logs
from ..models.base import RigModel

#: A command that moves by less than this share of the rated one, a few steps of a converter, is constant.
CONSTANT = 0.01


def settle(logs: Logs, estimates: Estimates) -> Estimates:
    """Refines the estimates that are reported (`estimation.final_refinement`), before they are proved and given intervals."""
    twins = {p: replace(p) for p in distinct(estimates)}
    refine(logs.fit, logs.fit.on(logs.fine), twins.values())
    return {c: twins[p] for c, p in estimates.items()}


def run(logs: Logs, estimates: Estimates) -> Estimates:
    """The estimates with intervals, those that have derivatives."""
    sure = {p: intervals_of(logs.fit, p) if p.unknowns and p.columns else None for p in distinct(estimates)}
    twins = {p: replace(p, intervals=own) for p, own in sure.items()}
    return {c: twins[p] for c, p in estimates.items()}


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
