"""What is done where everything failed: all effects of the catalogue once more, from many places and as far as they go.

A candidate is first judged after a few steps from the calibrated model, one start of each. That is enough for most. But
calibration without the effect that is missing has moved the known parameters to make up for it, often so far that a few steps
lead nowhere (the right effect then seems to explain nothing), and where an effect decides the way a shaft turns, only one start
of a dozen leads to it. So where the effects that were taken leave most of a channel's gap, every effect begins at several sizes
and shapes, from the calibrated model and from the model as given; all starts are improved side by side, and each round goes on
with the better ones. What is found must explain the gap nearly to the noise, or it is not used: among so many starts one is
always better than the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...plant import CATALOGUE
from ..models.base import Machine
from .least_squares import Floors, Problem, Vector, beside, evaluate, levels, rms, solve
from .multistart import from_given
from .unknowns import starts

__all__ = ["best_of_all", "mostly_explained", "nearly_all", "nearly_explained", "unexplained"]

#: Starts of an effect from the calibrated model and from the model as given.
FROM_CALIBRATED, FROM_GIVEN = 2, 1
#: Iterations of each round, and how many starts go on after it.
ROUNDS = ((1, 30), (2, 10), (3, 4), (4, 3))
#: Of these at most so many are of one effect.
OF_ONE = 2
#: Share of the gap that the named effects must explain, in `levels` or in power, or else the verdict is `unknown`.
MOST, MOST_POWER = 0.5, 0.8
#: A gap (in `levels`, summed over the signals) that is too small to speak of something unknown.
SMALL_LEVEL = 0.15
#: Share of the gap (in `levels`) that may be left by what is found here.
REST = 0.15


def unexplained(machine: Machine, problem: Problem, channel: int, floors: Floors) -> bool:
    """Whether a gap stays that is half as large again as the noise, in a signal of a log."""
    left = rms(machine, problem.simulated[channel], channel)
    return any(v > 1.5 * floors[channel, signal] for (_, signal), v in left.items())


def mostly_explained(machine: Machine, before: Problem, after: Problem, c: int, floors: Floors) -> bool:
    """Whether most of the gap that `before` leaves on channel c is explained by `after`, by level or by power.

    By level a few events count little, such as a spool that meets its end stop late in a model of another functional form;
    by power what is small everywhere counts little, such as the ripple that a steady model leaves.
    """
    old, new = (sum(levels(machine, p.simulated[c], c, floors).values()) for p in (before, after))
    by_level = new < SMALL_LEVEL or new < (1.0 - MOST) * old
    was, left = (rms(machine, p.simulated[c], c) for p in (before, after))
    excess = {k: left[k] ** 2 - floors[c, k[1]] ** 2 for k in left if left[k] > 2.0 * floors[c, k[1]]}
    by_power = all(e < (1.0 - MOST_POWER) * (was[k] ** 2 - floors[c, k[1]] ** 2) for k, e in excess.items())
    return by_level or by_power


def nearly_explained(machine: Machine, before: Problem, after: Problem, c: int, floors: Floors) -> bool:
    """Whether next to nothing of the gap that `before` leaves on channel c is left by `after`, by level."""
    return nearly_all(machine, before.simulated[c], after.simulated[c], c, floors)


def nearly_all(machine: Machine, before: Vector, after: Vector, c: int, floors: Floors) -> bool:
    """The same of simulated samples (n,)."""
    old, new = (sum(levels(machine, each, c, floors).values()) for each in (before, after))
    return new < max(SMALL_LEVEL, REST * old)


def best_of_all(
    machine: Machine, calibrated: Problem, effects: Sequence[str], floors: Floors, seconds: float
) -> list[tuple[str, Problem]]:
    """The effects that explain a channel best of `effects`, best first, each with its problem, refitted beside the known
    parameters from many starts."""
    begun = _starts(machine, calibrated, effects, floors, seconds)
    for iterations, keep in ROUNDS:
        solve(machine, begun, floors, iterations)
        begun = _best(begun, keep)
    return [(p.label, p) for p in _best(begun, len(begun), 1)]


def _starts(
    machine: Machine, calibrated: Problem, effects: Sequence[str], floors: Floors, seconds: float
) -> list[Problem]:
    """The most promising starts of every effect, by one simulation of each."""
    assert calibrated.channel is not None
    places = (calibrated, from_given(calibrated))
    found: list[list[Problem]] = []
    for place in places:
        every = [
            beside(place, name, start)
            for name in effects
            for start in starts(CATALOGUE[name], seconds, whole=True)
        ]
        evaluate(machine, every, floors)
        found.append([p for p in every if np.isfinite(p.cost)])
    near, far = found
    return _best(near, len(near), FROM_CALIBRATED) + _best(far, len(far), FROM_GIVEN)


def _best(problems: Sequence[Problem], most: int, of_one: int = OF_ONE) -> list[Problem]:
    """The best problems by cost, at most so many and at most so many of one effect."""
    kept: list[Problem] = []
    for p in sorted(problems, key=lambda p: p.cost):
        if len(kept) < most and sum(k.label == p.label for k in kept) < of_one:
            kept.append(p)
    return kept
