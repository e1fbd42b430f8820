"""Estimates begun anew from other places: friction makes a rough landscape with valleys that steps do not leave.

Known parameters that were fitted while an effect or its form was missing have moved to make up for it, often into such a
valley. Once the effect is there, they begin again at the model as given (`from_given`).

A spool that sticks a moment longer or shorter changes the logs by a jump, so Gauss-Newton steps end in the valley in which they
began. Here the friction of the spool is drawn anew several times, everything else stays where it was, all starts are improved
side by side, and each round goes on with the better half. It is worth the time only where little is left: what a missing
effect leaves is no matter of valleys.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from .fit import Floors, Problem, at_noise, channels_of, evaluate, floors_from, levels, lower, rescored, solve
from .machine import Machine
from .unknowns import TOGETHER

__all__ = [
    "STARTS",
    "along_all",
    "along_directions",
    "begun_anew",
    "far_from_noise",
    "from_given",
    "take_over",
    "unfolded",
]

#: Base parameters that are drawn anew, and the spread of the draws on the scale of their priors.
DRAWN, SPREAD = ("Fc", "Fs", "vs"), 1.0
#: A gap (in `levels`, the signal where it is largest) up to which a valley may be the cause.
LITTLE = 1.0
#: Base parameters that stay where they are when the others begin again: the current tells them, whatever is missing behind.
KEPT = ("R", "L")
#: New starts of a problem, and iterations of each round.
STARTS, ROUNDS = 12, (3, 3, 4)
#: Times the noise from which on a problem is fitted to the beginning of the logs first, the shares of the logs in turn, and
#: iterations with each; times the noise from which on a beginning is not explained.
UNFOLD, HORIZONS = 2.0, (0.07, 0.15, 0.22, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
EACH, STUCK = 2, 1.3


def begun_anew(
    machine: Machine, problems: Sequence[Problem], floors: Floors, seed: int = 0, whole: bool = False
) -> list[Problem]:
    """Improves those of `problems` that are near the noise and not at it, in place; returns the ones that became better.

    With `whole` also what is far from the noise begins anew, and all known parameters do, at the model as given.
    """
    rng = np.random.default_rng(seed)
    fields: list[tuple[Problem, list[Problem]]] = []
    for problem in problems:
        drawn = [j for j, u in enumerate(problem.unknowns) if u.name in DRAWN]
        if not drawn or at_noise(machine, problem, floors):
            continue
        if not whole and far_from_noise(machine, problem, floors):
            continue
        place = from_given(problem) if whole else problem
        starts = [_with_other_friction(place, rng) for _ in range(STARTS)]
        fields.append((problem, starts))
    for iterations in ROUNDS:
        solve(machine, [p for _, starts in fields for p in starts], floors, iterations)
        for _, starts in fields:
            starts.sort(key=lambda p: p.cost)
            # Nothing better than the noise can be found.
            keep = 1 if at_noise(machine, starts[0], floors) else max(2, len(starts) // 2)
            del starts[keep:]
    return [p for p, starts in fields if take_over(p, starts[0])]


def from_given(problem: Problem) -> Problem:
    """The problem with its known parameters at the model as given, but those of the coil, and its effects as they are."""
    known = np.array(["." not in u.name and u.name not in KEPT for u in problem.unknowns])
    q = np.clip(np.where(known, 0.0, problem.q), *problem.bounds)
    return Problem(
        problem.channel, problem.unknowns, q, problem.label, follow=problem.follow, together=problem.together
    )


def along_all(problem: Problem) -> Problem:
    """The same estimate, to go on with derivatives along every direction that ratios tell: for where nothing is missing."""
    return replace(problem, q=problem.q.copy(), together=tuple(TOGETHER), simulated={}, columns={})


def along_directions(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Improves in place, along every direction that ratios tell, those of `problems` that are near the noise and not at it: where
    next to nothing is missing these do not lead away, and an effect must not win by going along them alone."""
    near = [
        p
        for p in problems
        if p.unknowns and not far_from_noise(machine, p, floors) and not at_noise(machine, p, floors)
    ]
    finer = [along_all(p) for p in near]
    solve(machine, finer, floors, sum(ROUNDS))
    for problem, other in zip(near, finer, strict=True):
        take_over(problem, other)


def unfolded(machine: Machine, problems: Sequence[Problem], floors: Floors) -> list[Problem]:
    """Improves in place those of `problems` that are far from the noise: fitted to the beginning of the logs first, then to more
    and more of them. Returns the ones that became better.

    A shaft that nearly comes to rest turns on this way or that, and from then on is a turn off: the rest of the log then
    speaks of nothing else, and no small step repairs it. What lies before that moment tells the parameters, and these
    carry the simulation past it.
    """
    found = []
    for problem in problems:
        # What was missing made the noise look larger than it is seen now.
        seen = lower(floors, floors_from(machine, dict.fromkeys(channels_of(problem, machine), problem)))
        if at_noise(machine, problem, seen, UNFOLD):
            continue
        if take_over(problem, _unfolded(machine, problem, floors, seen)):
            found.append(problem)
    return found


def _unfolded(machine: Machine, problem: Problem, floors: Floors, seen: Floors) -> Problem:
    """The better of two starts, where the problem is and where the known parameters were given, fitted to more and more of the
    logs; on the way by the noise that is `seen`."""
    starts = [along_all(problem), along_all(from_given(problem))]
    for share in HORIZONS:
        beginning = _beginning(machine, share)
        for start in starts:
            start.simulated, start.columns = {}, {}
        solve(beginning, starts, seen, EACH)
        starts.sort(key=lambda p: p.cost)
        channels = channels_of(problem, machine)
        seen = lower(seen, floors_from(beginning, dict.fromkeys(channels, starts[0])))
        rescored(beginning, starts, seen)
        if not at_noise(beginning, starts[0], seen, STUCK):
            # A spool that sticks a moment longer, now, is worth other frictions before anything later is looked at.
            begun_anew(beginning, starts[:1], seen)
            if not at_noise(beginning, starts[0], seen, STUCK):
                break  # something is missing that this effect does not make up for
    evaluate(machine, starts, floors)
    solve(machine, starts, floors, ROUNDS[-1])
    return min(starts, key=lambda p: p.cost)


def _beginning(machine: Machine, share: float) -> Machine:
    """The machine with only this share of each log, from its beginning; the simulations are the same."""
    twin = copy(machine)
    twin.segments = {
        c: [replace(s, inside=s.inside & (np.arange(s.rows.size) < share * s.rows.size)) for s in segments]
        for c, segments in machine.segments.items()
    }
    return twin


def take_over(problem: Problem, other: Problem) -> bool:
    """Puts the estimate of `other` into `problem` if it explains the logs better; whether it does."""
    if not other.cost < problem.cost:
        return False
    problem.q, problem.cost, problem.spread = other.q, other.cost, other.spread
    problem.simulated, problem.columns = other.simulated, other.columns
    return True


def _with_other_friction(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem with the friction of the spool drawn anew."""
    drawn = [j for j, u in enumerate(problem.unknowns) if u.name in DRAWN]
    q = problem.q.copy()
    q[drawn] = SPREAD * rng.standard_normal(len(drawn))
    q = np.clip(q, *problem.bounds)
    return Problem(
        problem.channel, problem.unknowns, q, problem.label, follow=problem.follow, together=problem.together
    )


def far_from_noise(machine: Machine, problem: Problem, floors: Floors) -> bool:
    """Whether more is left than a valley leaves."""
    found = (levels(machine, problem.simulated[c], c, floors) for c in channels_of(problem, machine))
    return max(v for each in found for v in each.values()) > LITTLE
