"""Estimates begun anew from other places: friction makes a rough landscape with valleys that steps do not leave.

Known parameters that were fitted while an effect or its form was missing have moved to make up for it, often into such a
valley. Once the effect is there, they begin again at the model as given (`from_given`).

A spool that sticks a moment longer or shorter changes the logs by a jump, so Gauss-Newton steps end in the valley in which they
began. Here the friction of the spool is drawn anew several times, everything else stays where it was, all starts are improved
side by side, and each round goes on with the better half. It is worth the time only where little is left: what a missing
effect leaves is no matter of valleys.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ...plant import CATALOGUE
from ..models.base import Machine, Segment
from .least_squares import (
    Floors,
    Problem,
    at_noise,
    channels_of,
    evaluate,
    floors_from,
    levels,
    lower,
    rescored,
    solve,
)
from .unknowns import TOGETHER
from .unknowns import starts as effect_starts

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
STARTS, ROUNDS = 12, (2, 3, 4)
#: Times the noise from which on a problem is fitted to the beginning of the logs first, the shares of the logs in turn, and
#: iterations with each; gap (in `levels`) from which on a beginning is not followed.
UNFOLD, HORIZONS = 2.0, (0.02, 0.04, 0.07, 0.11, 0.15, 0.22, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
EACH, STUCK = 2, 0.3
#: Share up to which a beginning is short: it costs little, so there are more iterations, and it is too short to show the noise.
SHORT, EARLY = 0.1, 12
#: Share of the logs by which at least they are lengthened.
FINE = 0.02
#: Starts that are improved on the first beginning, and that go on from there.
FIRST, GO_ON = 6, 2


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
    """The best of several starts, where the problem is and where the known parameters were given, there with other values of the
    effects too, fitted to more and more of the logs; on the way by the noise that is `seen`."""
    given = from_given(problem)
    starts = [along_all(p) for p in (problem, given, *_elsewhere(given))]
    evaluate(_beginning(machine, HORIZONS[0]), starts[GO_ON:], seen)
    starts[GO_ON:] = sorted(starts[GO_ON:], key=lambda p: p.cost)[: FIRST - GO_ON]
    ahead, reached, good = [*HORIZONS], 0.0, starts
    while ahead:
        share = ahead[0]
        beginning = _beginning(machine, share)
        starts = [replace(p, q=p.q.copy(), simulated={}, columns={}) for p in good]
        solve(beginning, starts, seen, EARLY if share < SHORT else EACH)
        starts.sort(key=lambda p: p.cost)
        del starts[GO_ON:]
        if share > SHORT:
            seen = lower(
                seen, floors_from(beginning, dict.fromkeys(channels_of(problem, machine), starts[0]))
            )
            rescored(beginning, starts, seen)
        if not _followed(beginning, starts[0], seen):
            if reached and share - reached > FINE:
                ahead.insert(0, 0.5 * (reached + share))  # not so far at once
                continue
            # A spool that sticks a moment longer, now, is worth other frictions before anything later is looked at.
            begun_anew(beginning, starts[:1], seen)
            if not _followed(beginning, starts[0], seen):
                break  # something is missing that this effect does not make up for
        reached, good = ahead.pop(0), starts
    for start in starts:
        start.columns = {}
    evaluate(machine, starts, floors)
    solve(machine, starts, floors, ROUNDS[-1])
    return min(starts, key=lambda p: p.cost)


def _followed(machine: Machine, problem: Problem, floors: Floors) -> bool:
    """Whether nothing but a few events is missed in any signal: a shaft that went the other way stays off, a spool that stuck
    a moment longer does not."""
    found = (levels(machine, problem.simulated[c], c, floors) for c in channels_of(problem, machine))
    return max(v for each in found for v in each.values()) < STUCK


def _elsewhere(problem: Problem) -> list[Problem]:
    """The problem with each of its effects at every size and shape that is worth a look: from the wrong side of a turn no small
    step leads to the right one."""
    found = []
    for effect in problem.effects():
        if problem.channel is None or CATALOGUE[effect].family:
            continue
        own = {u.name: j for j, u in enumerate(problem.unknowns)}
        for values in effect_starts(CATALOGUE[effect], math.inf, whole=True):
            q = problem.q.copy()
            for name, value in values.items():
                j = own.get(f"{effect}.{name}")
                if j is not None:
                    q[j] = problem.unknowns[j].q(value)
            found.append(replace(problem, q=np.clip(q, *problem.bounds)))
    return found


def _beginning(machine: Machine, share: float) -> Machine:
    """The machine with only this share of each log, from its beginning, of which it also simulates no more."""
    twin = copy(machine)
    rows = [max(2, math.ceil(share * len(part.log))) for part in machine.parts]
    twin.parts = [
        replace(part, log=part.log.first(n), inside=part.inside[:n])
        for part, n in zip(machine.parts, rows, strict=True)
    ]
    twin.segments = {c: _first(segments, rows) for c, segments in machine.segments.items()}
    return twin


def _first(segments: Sequence[Segment], rows: Sequence[int]) -> list[Segment]:
    """The samples of the first so many rows of each log, which again lie one behind the other in a vector."""
    place, found = 0, []
    for s in segments:
        n = int(np.searchsorted(s.rows, rows[s.log]))
        cut = replace(s, measured=s.measured[:n], rows=s.rows[:n], inside=s.inside[:n])
        cut.place = slice(place, place + n)
        place += n
        found.append(cut)
    return found


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
    # Derivatives of before are good enough for the first step.
    return Problem(
        problem.channel, problem.unknowns, q, problem.label, follow=problem.follow, together=problem.together,
        columns=dict(problem.columns),
    )  # fmt: skip


def far_from_noise(machine: Machine, problem: Problem, floors: Floors) -> bool:
    """Whether more is left than a valley leaves."""
    found = (levels(machine, problem.simulated[c], c, floors) for c in channels_of(problem, machine))
    return max(v for each in found for v in each.values()) > LITTLE
