"""Corrections of form: what the law of a named effect leaves, put right at its own port. This is not physics.

A rig's effect has another functional form than the catalogue's: a corner is rounded, a gain is no straight line, a lag has a
second pole. Once an effect has its name, the corrections that belong to it (`plant.shapes`) are fitted jointly with its
parameters and the base parameters. Each number of a correction has a prior about zero, and a correction stays only if the
deviance of the fit logs falls by more than the penalty that a further effect would have to pay. It never names anything:
effects are chosen without it, and where nothing is named there is nothing to correct.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ...plant import CATALOGUE
from ...plant.catalogue.form_corrections import CORRECTIONS, FAMILY, follows
from ..estimation.least_squares import Floors, Problem, Vector, at_noise, channels_of, solve, stretch_costs
from ..estimation.multistart import along_all, begun_anew, far_from_noise, from_given, take_over, unfolded
from ..estimation.unknowns import Unknown
from ..models.base import Machine

__all__ = [
    "Corrected",
    "changes",
    "corrected",
    "corrected_all",
    "held_out",
    "is_correction",
    "own_size",
    "placebo_too",
    "with_correction",
    "with_form",
]

#: Iterations of a joint refit with a correction, and of the one that is kept.
TRY, SETTLE, HALF = 8, 12, 5
#: Length of the stretches that are fitted and left out in turn, s.
STRETCH_S = 1.0
#: What is left, in times the noise, from which a corrected model is begun anew.
AGAIN = 1.05
#: Corrections of one problem at most.
MOST = 2


@dataclass(frozen=True)
class Corrected:
    """A correction that stayed: of which effect, on which channel (None: the rig), by how much the cost of the fit logs fell,
    and by how much where it was not fitted (`held_out`)."""

    effect: str
    correction: str
    channel: int | None
    fall: float
    held_out: float


def is_correction(effect: str) -> bool:
    """Whether an effect of the catalogue is a correction of form."""
    return CATALOGUE[effect].family == FAMILY


def own_size(correction: str, effect: str) -> int:
    """How many numbers a correction of `effect` adds."""
    return len(CATALOGUE[correction].parameters) - len(CORRECTIONS[effect][correction])


def with_correction(problem: Problem, effect: str, correction: str, channel: int | None = None) -> Problem:
    """The problem with a correction of one of its effects more; `channel` is the effect's, where the problem is the rig's.

    Numbers of either sign begin at zero, others at their usual size: a corner that is rounded ever less has no derivative.
    """
    alone = channel if problem.channel is None else None
    # What a placebo does not have it does not repeat: that number of the correction stays neutral.
    own = {u.name for u in problem.unknowns}
    every = follows(correction, effect)
    repeated = {
        name: source
        for name, source in every.items()
        if not isinstance(source, str) or source.removeprefix("-") in own
    }
    added = []
    for p in CATALOGUE[correction].parameters:
        name = f"{correction}.{p.name}"
        if name in every:
            continue
        if p.log:
            added.append(Unknown(name, p.unit, p.nominal, p.low, p.high, 0.7, True, True, alone))
        else:
            # The prior is as wide as a correction usually is: ridge regression, in other words.
            shape = p.typical is None or p.typical == p.nominal
            scale = 0.15 * (p.high - p.low) if shape else abs(p.typical or 1.0)
            added.append(Unknown(name, p.unit, p.nominal, p.low, p.high, scale, False, True, alone))
    q = np.concatenate([problem.q, [1.0 if u.low == u.center == 0.0 else 0.0 for u in added]])
    label, follow = f"{problem.label} + {correction}", {**problem.follow, **repeated}
    return Problem(problem.channel, [*problem.unknowns, *added], q, label, follow=follow)


def corrected(
    machine: Machine, problem: Problem, named: Sequence[tuple[str, int | None]], floors: Floors, per_number: float,
    check: bool = True, earlier: Problem | None = None,
) -> tuple[Problem, list[Corrected]]:  # fmt: skip
    """The problem with those corrections of its effects `named` (with their channels) that pay for themselves; the problem
    itself if none does.

    `per_number` is the fall of the cost that every number must pay for; with `check`, a correction must also help on
    stretches of the fit logs that were left out (`held_out`). `earlier` is a corrected problem that was found before.
    """
    kept: list[Corrected] = []
    for number in range(MOST):
        if machine.quick or at_noise(machine, problem, floors):
            break
        if number and far_from_noise(machine, problem, floors):
            break  # with the form put right that matters most, what is left is no matter of form
        tries = [
            (effect, channel, correction, with_correction(problem, effect, correction, channel))
            for effect, channel in dict.fromkeys(named)
            for correction in CORRECTIONS.get(effect, {})
            if not any(k.correction == correction for k in kept)
        ]
        if not tries:
            break
        _from_both_places(machine, [p for *_, p in tries], floors, best_only=True)
        if number == 0 and problem.channel is not None:
            unfolded(machine, [min((p for *_, p in tries), key=lambda p: p.cost)], floors)
        _take_up(machine, [p for *_, p in tries], earlier, floors)
        worth = [problem.cost - p.cost - per_number * own_size(k, e) for e, _, k, p in tries]
        effect, channel, correction, best = tries[int(np.argmax(worth))]
        if max(worth) <= 0.0:
            break
        sure = held_out(machine, problem, best, floors) if check else (np.inf, np.inf)
        # It must help in both halves, and in all pay for its numbers there too.
        if min(sure) <= 0.0 or sum(sure) < per_number * own_size(correction, effect):
            break
        solve(machine, [best], floors, SETTLE)
        kept.append(Corrected(effect, correction, channel, problem.cost - best.cost, sum(sure)))
        problem = best
    return problem, kept


def _take_up(machine: Machine, problems: Sequence[Problem], earlier: Problem | None, floors: Floors) -> None:
    """Puts an estimate that was found before into the problem of the same unknowns, if it is better there."""
    for problem in problems:
        if earlier is not None and [u.name for u in problem.unknowns] == [u.name for u in earlier.unknowns]:
            again = replace(problem, q=np.clip(earlier.q, *problem.bounds), simulated={}, columns={})
            solve(machine, [again], floors, TRY)
            take_over(problem, again)


def _from_both_places(
    machine: Machine, problems: Sequence[Problem], floors: Floors, best_only: bool = False
) -> None:
    """Improves all, or only what may become the best: the known parameters have moved to make up for the form, so they begin
    where they are and where they were given. Those of a whole rig, whose simulations are slow, begin where they are."""
    again = {id(p): along_all(from_given(p)) for p in problems if p.channel is not None}
    races = [[p, again[id(p)]] for p in problems if id(p) in again]
    every = [*problems, *again.values()]
    solve(machine, every, floors, TRY, races=[every] if best_only else races)
    for problem in problems:
        if id(problem) in again:
            take_over(problem, again[id(problem)])


def with_form(machine: Machine, problem: Problem, effect: str, floors: Floors) -> list[tuple[int, Problem]]:
    """The problem of a channel refitted with each correction of the form of one of its effects; how many numbers each adds."""
    found = [(own_size(k, effect), with_correction(problem, effect, k)) for k in CORRECTIONS.get(effect, {})]
    if not machine.quick:
        _from_both_places(machine, [p for _, p in found], floors)
    return found if not machine.quick else []


def corrected_all(
    machine: Machine, problems: dict[int, Problem], named: Mapping[int | None, Sequence[str]], floors: Floors, per_number: float,
    earlier: Mapping[int, Problem] | None = None,
) -> tuple[dict[int, Problem], list[Corrected]]:  # fmt: skip
    """Every problem with the corrections of what is named there: `named` by channel, None for effects of the whole rig;
    `earlier` are corrected problems of channels that were found before.

    What is near the noise then, and not at it, is begun anew with other friction of the spool, as calibrated models are, for the
    same reason: other draws than those with which calibration began.
    """
    found: dict[int, Problem] = dict(problems)
    every: list[Corrected] = []
    for problem in {id(p): p for p in problems.values()}.values():
        c = problem.channel
        names = [(n, channel) for channel, own in named.items() if c is None or channel == c for n in own]
        if machine.quick or not named or at_noise(machine, problem, floors):
            continue
        known = (earlier or {}).get(c) if c is not None else None
        better, kept = corrected(machine, problem, names, floors, per_number, earlier=known)
        if better is problem:
            better = replace(problem, q=problem.q.copy(), columns=dict(problem.columns))
        if not at_noise(machine, better, floors, AGAIN):
            solve(machine, begun_anew(machine, [better], floors, 1), floors, SETTLE)
        found.update(dict.fromkeys(channels_of(problem, machine), better))
        every += kept
    return found, every


def placebo_too(
    machine: Machine, placebo: dict[int, Problem], kept: Sequence[Corrected], floors: Floors
) -> dict[int, Problem]:
    """The placebos with as many corrections as the named effects of their channels have, untested: their own ones where there
    are some, else the same."""
    found = dict(placebo)
    for c, problem in placebo.items():
        for number, k in enumerate(k for k in kept if k.channel in (None, c)):
            effects = [n for n in problem.effects() if not is_correction(n)]
            own = [(n, name) for n in effects for name in CORRECTIONS.get(n, {})]
            effect, name = own[number] if number < len(own) else (k.effect, k.correction)
            if name in problem.effects() or CATALOGUE[name].scope == "rig":
                continue
            problem = with_correction(problem, effect, name, k.channel)
        if problem is not placebo[c]:
            solve(machine, [problem], floors, TRY + SETTLE)
            found[c] = problem
    return found


def changes(machine: Machine, problem: Problem, correction: str, channel: int) -> dict[str, float]:
    """How large a correction is: RMS by which it changes every simulated signal of a channel, SI."""
    with_it = problem.request()
    values = {n: v for n, v in with_it.values.items() if not n.startswith(f"{correction}.")}
    both = machine.predict([with_it, replace(with_it, values=values)])
    change = both[0][channel] - both[1][channel]
    found: dict[str, list[Vector]] = {}
    for s in machine.segments[channel]:
        found.setdefault(s.signal, []).append(change[s.place][s.used])
    return {name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in found.items()}


def held_out(machine: Machine, problem: Problem, best: Problem, floors: Floors) -> tuple[float, float]:
    """How far the cost falls by a correction where it was not fitted: the fall in each half of the fit logs.

    Every second stretch of the fit logs is left out; the effects' parameters are fitted to the others, without the
    correction as in `problem` and with it as in `best`, and both are compared on what was left out; then the other way
    round. The base parameters stay where each of the two has them: fitted anew they would end in other valleys of friction in
    every half, and that would be compared.
    """
    falls = []
    for half in (0, 1):
        seen, unseen = _half(machine, half), _half(machine, 1 - half)
        both = [_effects_only(p) for p in (problem, best)]
        solve(seen, both, floors, HALF)
        bare, better = (
            sum(stretch_costs(unseen, p, c, floors, STRETCH_S).sum() for c in channels_of(problem, machine))
            for p in both
        )
        falls.append(float(bare - better))
    return falls[0], falls[1]


def _effects_only(problem: Problem) -> Problem:
    """The problem with its base parameters given, where they are one channel's; else a copy."""
    own = [j for j, u in enumerate(problem.unknowns) if "." in u.name or problem.channel is None]
    values = {
        u.name: u.value(v) for u, v in zip(problem.unknowns, problem.q, strict=True) if "." not in u.name
    }
    given = values if problem.channel is not None else {}
    return Problem(
        problem.channel,
        [problem.unknowns[j] for j in own],
        problem.q[own],
        problem.label,
        follow={**problem.follow, **given},
    )


def _half(machine: Machine, half: int) -> Machine:
    """The machine with every second stretch of its logs only; the simulations are the same."""
    twin = copy(machine)
    twin.segments = {
        c: [
            replace(
                s, inside=s.inside & ((np.arange(s.rows.size) * s.period / STRETCH_S).astype(int) % 2 == half)
            )
            for s in segments
        ]
        for c, segments in machine.segments.items()
    }
    return twin
