"""Adjusting the known parameters inside their plausible ranges: what the model can explain without any further effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...plant import parameter_of
from ..estimation.least_squares import Floors, Problem, evaluate, solve
from ..estimation.multistart import along_directions, begun_anew, take_over
from ..estimation.unknowns import Unknown, base_unknown, limited_by_effects
from ..models.base import Machine

__all__ = ["as_given", "base_unknowns", "calibrate"]


#: Parameters that act on the current alone of all signals before the spool.
COIL = ("R", "L")


def base_unknowns(machine: Machine, channel: int) -> list[Unknown]:
    """The parameters that calibration may adjust, about their values in the model as given.

    Parameters of effects that the model has already are among them.
    """
    limited = limited_by_effects()
    found = []
    for name in machine.base(channel):
        parameter = parameter_of(name) if name not in machine.own else machine.own[name]
        value = machine.given(name, channel)
        found.append(replace(base_unknown(parameter, value, name in limited), name=name, channel=channel))
    return found


def as_given(machine: Machine, floors: Floors) -> dict[int, Problem]:
    """The model as given, by channel."""
    problems = {c: Problem(c, [], np.zeros(0), "as given") for c in machine.channels}
    evaluate(machine, list(problems.values()), floors)
    return problems


def calibrate(machine: Machine, floors: Floors, iterations: int = 18) -> dict[int, Problem]:
    """Adjusts the base parameters of every channel, with priors about the model as given.

    The coil comes first, by the current alone: nothing behind it acts back, so that no missing effect can pull it away.
    What is not at the noise then is begun anew with other friction of the spool.
    """
    problems = {}
    for channel in machine.channels:
        unknowns = base_unknowns(machine, channel)
        problems[channel] = Problem(channel, unknowns, np.zeros(len(unknowns)), "calibrated")
    _coil_first(machine, problems, floors)
    # Two ways, of which either may end in a valley of the spool's friction: with and without the forces scaled together. Without
    # what is missing the other directions would lead far away from where it is found.
    apart = {} if machine.quick else {c: replace(p, q=p.q.copy(), together=()) for c, p in problems.items()}
    solve(machine, [*problems.values(), *apart.values()], floors, iterations)
    further = [problems[c] for c, other in apart.items() if take_over(problems[c], other)]
    solve(machine, further, floors, iterations // 3)
    if not machine.quick:
        solve(machine, begun_anew(machine, list(problems.values()), floors), floors, iterations)
        along_directions(machine, list(problems.values()), floors)
    return problems


def _coil_first(machine: Machine, problems: dict[int, Problem], floors: Floors) -> None:
    """Starts the coil's parameters where they explain the measured current best."""
    coils = {}
    for channel, problem in problems.items():
        own = [j for j, u in enumerate(problem.unknowns) if u.name in COIL]
        if own and any(s.signal == "current" for s in machine.segments[channel]):
            coils[channel] = own
    # Signals behind the coil are given so much noise that they do not count.
    deaf = {key: floor if key[1] == "current" else 1e6 * floor for key, floor in floors.items()}
    alone = {
        c: Problem(c, [problems[c].unknowns[j] for j in own], np.zeros(len(own)), "coil")
        for c, own in coils.items()
    }
    solve(machine, list(alone.values()), deaf, 6)
    for channel, own in coils.items():
        problems[channel].q[own] = alone[channel].q
