"""Which effects are there: forward selection with joint refits, a penalty for the size of the library, backward steps.

For each channel: a first look at all candidates beside the present model, cheap refits of the promising ones
(base parameters move along frozen derivatives), full joint refits of the best, and the winner is taken if the deviance
falls by more than the penalty. The deviance counts independent samples (`fit.gain`), and the penalty per parameter is
2 ln(n0 / p) with n0 parameters in the library and p the accepted chance of a superfluous effect (PASTIS, Gerardos and
Ronceray 2025). Effects of the whole rig compete last, against what the channels found separately.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...plant import CATALOGUE
from ..estimation.global_search import best_of_all, mostly_explained, nearly_explained, unexplained
from ..estimation.least_squares import (
    Floors,
    Problem,
    beside,
    channels_of,
    differentiate,
    evaluate,
    gain,
    levels,
    solve,
)
from ..estimation.multistart import along_all, begun_anew, far_from_noise, from_given, take_over, unfolded
from ..estimation.noise import effective_samples
from ..estimation.unknowns import TOGETHER, bases_of
from ..models.base import Machine
from .form_correction import corrected, with_form
from .screening import Look, alike, first_look

__all__ = ["Choice", "Selection", "Trial", "at_edge", "penalty", "penalty_per_number", "select"]

#: Accepted chance of one superfluous effect.
FALSE_ALARM = 0.01
#: Cheap refits and full refits in a round.
CHEAP, FULL = 9, 3
#: The same in later rounds, where the first look is beside a better model.
LATER_CHEAP, LATER_FULL = 5, 2
#: Effects on a channel at most.
MOST = 3
#: A rival whose gain is less than this share behind counts as not told apart.
NEAR = 0.1
#: Most iterations of the joint refit of what was taken.
SETTLE = 12
#: Iterations of the refit of a rival in the place of what was taken.
AGAIN = 5
#: Share of its penalty that the best candidate must have reached to be refitted as far as it goes where none pays yet.
HOPE = 0.3
#: A gap (in `levels`, the signal where it is largest) beside what was taken from which the most promising candidates by their
#: first look are refitted as far as they go before all are given up, and how many.
MUCH, SECOND = 1.0, 2
#: Candidates whose cheap refit reached less than this share of the best one's are not refitted in full.
FAR = 0.5
#: What becomes of a candidate that explains something only at a size that no rig has.
EDGE = "only at the edge of its plausible range"
#: An effect must explain this share of what is left above the noise, in the signal where it explains most.
SHARE = 0.05
#: What stays of the gap after an effect is looked into if it is a larger share; no effect has exactly its law.
REST = 0.01


@dataclass
class Trial:
    """What became of a candidate: `gain` is the fall of the deviance, `needed` what it takes; `fate` in words."""

    effect: str
    channel: int | None
    round: int
    gain: float
    needed: float
    fate: str
    problem: Problem | None = None


@dataclass
class Choice:
    """An effect that was taken, its gain over leaving it out (`without`), and rivals that did nearly as well in its place."""

    effect: str
    channel: int | None
    gain: float
    needed: float
    rivals: dict[str, float] = field(default_factory=dict)  # name -> deficit of deviance
    without: Problem | None = None


@dataclass
class Selection:
    """The outcome: final problems by channel (the same joint problem for both where a rig effect was taken).

    `formed` are problems of channels with the form corrected of what had been taken when a further effect was tried.
    """

    problems: dict[int, Problem]
    choices: list[Choice]
    trials: list[Trial]
    placebo: dict[int, Problem]
    formed: dict[int, Problem] = field(default_factory=dict)

    def named(self) -> dict[int | None, list[str]]:
        """The effects that were taken by channel, None for those of the whole rig."""
        found: dict[int | None, list[str]] = {}
        for choice in self.choices:
            found.setdefault(choice.channel, []).append(choice.effect)
        return found


def penalty_per_number(machine: Machine) -> float:
    """Fall of the deviance that every parameter of an effect must pay for."""
    library = sum(len(CATALOGUE[name].parameters) for name in machine.candidates()) * len(machine.channels)
    return float(2.0 * np.log(max(library, 2) / FALSE_ALARM))


def penalty(machine: Machine, effect: str) -> float:
    """Fall of the deviance that the effect's parameters must pay for."""
    return penalty_per_number(machine) * len(CATALOGUE[effect].parameters)


def extended(problem: Problem, look: Look) -> Problem:
    """The problem with an effect more, at the size of the first look; derivatives are taken along, new ones zero."""
    twin = beside(problem, look.effect, look.start)
    added = twin.unknowns[len(problem.unknowns) :]
    twin.columns = {c: np.hstack([m, np.zeros((m.shape[0], len(added)))]) for c, m in problem.columns.items()}
    return twin


def joined(problems: dict[int, Problem]) -> Problem:
    """The problems of the channels as one problem of the rig."""
    first = next(iter(problems.values()))
    if first.channel is None:
        return first
    # What a channel's problem estimates is that channel's own, also beside the other one.
    unknowns = [replace(u, channel=c) for c, p in problems.items() for u in p.unknowns]
    q = np.concatenate([p.q for p in problems.values()])
    whole = Problem(None, unknowns, q, "rig", simulated={c: p.simulated[c] for c, p in problems.items()})
    place = 0
    for c, p in problems.items():
        matrix = np.zeros((p.simulated[c].size, len(unknowns)))
        if c in p.columns:
            matrix[:, place : place + len(p.unknowns)] = p.columns[c]
        whole.columns[c] = matrix
        place += len(p.unknowns)
    whole.cost = sum(p.cost for p in problems.values())
    return whole


def select(
    machine: Machine, calibrated: dict[int, Problem], looks: Sequence[Look], floors: Floors, seconds: float,
    say: Callable[[str], None] = lambda text: None,
) -> Selection:  # fmt: skip
    """Selects effects for every channel and for the rig, starting from the calibrated model and its first look."""
    trials: list[Trial] = []
    choices: list[Choice] = []
    present = dict(calibrated)
    placebo: dict[int, Problem] = {}
    formed: dict[int, Problem] = {}
    names = [n for n in machine.candidates() if CATALOGUE[n].scope == "channel"]

    def forward(open_channels: list[int], numbers: Sequence[int], now: Sequence[Look]) -> None:
        for number in numbers:
            if not open_channels:
                break
            if number > 1:
                say(f"round {number}: looking at what is left")
                here = {c: present[c] for c in open_channels}
                now = first_look(machine, here, floors, names, seconds, looks)
            say(f"round {number}: refitting candidates")
            taken = _round(
                machine, present, open_channels, now, floors, number, trials, choices, placebo, formed
            )
            open_channels = [c for c in taken if _open(machine, calibrated[c], present[c], c, floors)]

    forward(
        [c for c in machine.channels if _left(machine, calibrated[c], c, floors)],
        range(1, MOST + 1),
        [k for k in looks if k.channel is not None],
    )
    whole = [k for k in looks if k.channel is None]
    if whole and len(machine.channels) == 2:
        say("effects of the whole rig")
        present, choices = _rig(machine, calibrated, present, whole, floors, trials, choices)
    lost = [c for c in machine.channels if _lost(machine, calibrated[c], present[c], c, floors)]
    if lost:
        say("once more from many places")
        found = [
            c
            for c in lost
            if _once_more(machine, calibrated, present, c, names, floors, seconds, trials, choices, placebo)
        ]
        forward(
            [c for c in found if _open(machine, calibrated[c], present[c], c, floors)], range(2, MOST + 1), []
        )
    if not machine.quick:
        _needed_after_all(machine, present, choices, floors, trials)
    if any(len([k for k in choices if k.channel == c]) > 1 for c in machine.channels):
        say("can any of them be left out?")
        _backward(machine, present, choices, floors, trials)
    if choices:
        say("what else would do as well?")
        _rivals_again(machine, present, choices, looks, floors)
    return Selection(present, choices, trials, placebo, formed)


def _left(machine: Machine, problem: Problem, channel: int, floors: Floors) -> bool:
    """Whether a channel has a gap above its noise that could pay for an effect."""
    worth, seen = 0.0, False
    for s in machine.segments[channel]:
        error = (s.measured - problem.simulated[channel][s.place])[s.used]
        if error.size:
            ratio = float(np.mean(error**2)) / floors[channel, s.signal] ** 2
            seen = seen or ratio > 1.04
            worth += effective_samples(error) * max(np.log(ratio), 0.0)
    return seen and worth > 20.0


def _open(machine: Machine, calibrated: Problem, present: Problem, channel: int, floors: Floors) -> bool:
    """Whether a channel on which an effect was taken has a gap left that is worth looking into."""
    return (
        _left(machine, present, channel, floors)
        and 1.0 - _explained(machine, calibrated, present, channel, floors) > REST
    )


def _lost(machine: Machine, calibrated: Problem, present: Problem, channel: int, floors: Floors) -> bool:
    """Whether a channel has a gap that nothing explains, or only what leaves most of it."""
    if machine.quick or present.channel is None or not unexplained(machine, present, channel, floors):
        return False
    return present is calibrated or not mostly_explained(machine, calibrated, present, channel, floors)


def _once_more(
    machine: Machine, calibrated: dict[int, Problem], present: dict[int, Problem], c: int, names: Sequence[str], floors: Floors,
    seconds: float, trials: list[Trial], choices: list[Choice], placebo: dict[int, Problem],
) -> bool:  # fmt: skip
    """Tries all effects on channel c from many places (`again`); one that explains nearly all replaces, in place, what was
    taken there. Whether it does."""
    # A candidate must not win because its refit led the known parameters out of a bad place.
    begun_anew(machine, [calibrated[c]], floors, whole=True)
    ranked: list[tuple[str, Problem]] = []
    if unexplained(machine, calibrated[c], c, floors):
        ranked = best_of_all(machine, calibrated[c], names, floors, seconds)
        _polish(machine, calibrated, [c], [(c, p) for _, p in ranked], floors)
    if not unexplained(machine, calibrated[c], c, floors):
        choices[:] = [k for k in choices if k.channel != c]
        present[c] = calibrated[c]
        return False
    if not ranked:
        return False
    ranked.sort(key=lambda entry: entry[1].cost + penalty(machine, entry[0]))
    gains = {effect: gain(machine, calibrated[c], p, floors) for effect, p in ranked}
    (effect, best), own = ranked[0], [k for k in choices if k.channel == c]
    needed = penalty(machine, effect)
    fate = _verdict(machine, calibrated[c], best, effect, c, gains[effect], needed, floors)
    worse = best.cost + needed >= present[c].cost + sum(k.needed for k in own)
    if fate == "taken" and (worse or not nearly_explained(machine, calibrated[c], best, c, floors)):
        fate = "leaves too much to be trusted"
    for name, problem in ranked:
        other = fate if name == effect else "others explain more"
        trials.append(Trial(name, c, MOST + 1, gains[name], penalty(machine, name), other, problem))
    if fate != "taken":
        return False
    choices[:] = [k for k in choices if k not in own]
    behind = {name: max(0.0, gains[effect] - g) for name, g in gains.items() if name != effect}
    rivals = {n: d for n, d in behind.items() if d < NEAR * gains[effect] or d < needed}
    choices.append(Choice(effect, c, gains[effect], needed, rivals, calibrated[c]))
    present[c] = best
    if len(ranked) > 1:
        placebo[c] = ranked[1][1]
    _settle(machine, [best, *(p for _, p in ranked[1:2])], floors)
    return True


def _round(
    machine: Machine, present: dict[int, Problem], channels: Sequence[int], looks: Sequence[Look], floors: Floors,
    number: int, trials: list[Trial], choices: list[Choice], placebo: dict[int, Problem], formed: dict[int, Problem],
) -> list[int]:  # fmt: skip
    """One forward step on every open channel; returns the channels on which an effect was taken."""
    cheap, full = (CHEAP, FULL) if number == 1 or machine.quick else (LATER_CHEAP, LATER_FULL)
    batch: list[tuple[int, Look, Problem]] = []
    for c in channels:
        here = {k.effect for k in choices if k.channel == c}
        own = [k for k in looks if k.channel == c and k.effect not in here]
        for place, look in enumerate(own):
            if machine.quick or (place < cheap and look.gain > 0.0):
                batch.append((c, look, extended(present[c], look)))
            else:
                trials.append(
                    Trial(
                        look.effect,
                        c,
                        number,
                        look.gain,
                        penalty(machine, look.effect),
                        "explains too little at first look",
                    )
                )
    if not batch:
        return []
    _cheap(machine, [p for _, _, p in batch], floors)
    best: list[tuple[int, Look, Problem]] = []
    for c in channels:
        own_batch = sorted((b for b in batch if b[0] == c), key=lambda b: b[2].cost)
        worthwhile = _worthwhile(present[c], [b[2] for b in own_batch], full)
        best += own_batch[:worthwhile]
        for _, look, problem in own_batch[worthwhile:]:
            found = gain(machine, present[c], problem, floors)
            trials.append(
                Trial(
                    look.effect,
                    c,
                    number,
                    found,
                    penalty(machine, look.effect),
                    "others explain more",
                    problem,
                )
            )
    solve(machine, [p for _, _, p in best], floors, 10 if machine.quick else 3)
    _polish(machine, present, channels, [(c, p) for c, _, p in best], floors)
    if number == 1 and not machine.quick:
        _settle(machine, _last_hopes(machine, present, channels, best, floors), floors)
    elif not machine.quick:
        _second_wind(machine, present, channels, batch, best, trials, floors)
    taken = []
    for c in channels:
        own_best = sorted(
            ((look, p) for k, look, p in best if k == c),
            key=lambda b: b[1].cost + penalty(machine, b[0].effect),
        )
        for place, (look, problem) in enumerate(own_best):
            found, needed = gain(machine, present[c], problem, floors), penalty(machine, look.effect)
            fate = _verdict(machine, present[c], problem, look.effect, c, found, needed, floors)
            before = [(k.effect, k.channel) for k in choices if k.channel == c]
            if place == 0 and fate == EDGE and _form_leads_inside(machine, present[c], problem, look, floors):
                fate = "taken"
            first = place == 0 and fate == "taken"
            if first and before and _form_does(machine, present[c], before, look, problem, floors, formed):
                fate = "a correction of the form of what is named already does as well"
            if place == 0 and fate == "taken":
                rivals = {
                    o.effect: max(
                        0.0, gain(machine, present[c], problem, floors) - gain(machine, present[c], p, floors)
                    )
                    for o, p in own_best[1:]
                }
                choices.append(
                    Choice(
                        look.effect,
                        c,
                        found,
                        needed,
                        {n: d for n, d in rivals.items() if d < NEAR * found or d < needed},
                        present[c],
                    )
                )
                taken.append(c)
            elif place > 0 and fate == "taken":
                fate = "others explain more"
            trials.append(Trial(look.effect, c, number, found, needed, fate, problem))
        if own_best and number == 1:
            wrong = own_best[1] if c in taken and len(own_best) > 1 else own_best[0]
            placebo[c] = wrong[1]
        if c in taken:
            present[c] = own_best[0][1]
    # The winners are taken as far as they go: what is left afterwards decides on further effects. So are the placebos.
    winners = [present[c] for c in taken]
    _settle(machine, winners + [placebo[c] for c in taken if number == 1], floors)
    if not machine.quick:
        solve(machine, unfolded(machine, winners, floors), floors, SETTLE)
    return taken


def _last_hopes(
    machine: Machine,
    present: dict[int, Problem],
    channels: Sequence[int],
    best: Sequence[tuple[int, Look, Problem]],
    floors: Floors,
) -> list[Problem]:
    """The best candidate of every channel on which none pays yet, if it pays for some of itself: with few signals a refit is
    not settled after some steps."""
    found = []
    for c in channels:
        own = [(look, p) for k, look, p in best if k == c]
        paid = [gain(machine, present[c], p, floors) / penalty(machine, look.effect) for look, p in own]
        if own and HOPE < max(paid) < 1.0:
            found.append(own[int(np.argmax(paid))][1])
    return found


def _second_wind(
    machine: Machine,
    present: dict[int, Problem],
    channels: Sequence[int],
    batch: Sequence[tuple[int, Look, Problem]],
    best: list[tuple[int, Look, Problem]],
    trials: list[Trial],
    floors: Floors,
) -> None:
    """Refits as far as they go, in place, the candidates of most promise by their first look where none pays in a later round
    though much is left.

    What was taken first has made up for what is still missing, and so have the known parameters: from there the few steps of
    a cheap refit may lead away, and a candidate that ends beyond where it began says nothing. Those that were not among the
    `best` join them.
    """
    fresh: list[tuple[tuple[int, Look, Problem], Problem]] = []
    for c in channels:
        pays = any(
            gain(machine, present[c], p, floors) > penalty(machine, k.effect)
            for own, k, p in best
            if own == c
        )
        if pays or max(levels(machine, present[c].simulated[c], c, floors).values()) < MUCH:
            continue
        promising = sorted((b for b in batch if b[0] == c), key=lambda b: -b[1].gain)[:SECOND]
        fresh += [(b, extended(present[c], b[1])) for b in promising]
    _settle(machine, [p for _, p in fresh], floors)
    for entry, problem in fresh:
        take_over(entry[2], problem)
        if not any(p is entry[2] for *_, p in best):
            best.append(entry)
            trials[:] = [t for t in trials if t.problem is not entry[2]]


def _settle(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Improves the estimates of all as far as they go, also from the known parameters as given, which were moved by what was
    missing."""
    again = [] if machine.quick else [along_all(from_given(p)) for p in problems]
    solve(machine, [*problems, *again], floors, SETTLE, races=list(zip(problems, again, strict=False)))
    for problem, other in zip(problems, again, strict=False):
        take_over(problem, other)


def _form_does(
    machine: Machine,
    before: Problem,
    named: Sequence[tuple[str, int | None]],
    look: Look,
    after: Problem,
    floors: Floors,
    every: dict[int, Problem],
) -> bool:
    """Whether a further effect only mends the form of those that are named already.

    The effects `named` are corrected in their form (`shape`); the further one must then still pay. What comes of the correction
    goes to `every`, by channel.
    """
    formed, kept = corrected(machine, before, named, floors, penalty_per_number(machine), check=False)
    if not kept:
        return False
    if formed.channel is not None:
        every[formed.channel] = formed
    added = [u for u in after.unknowns if u.name.startswith(f"{look.effect}.")]
    q = np.array([v for u, v in zip(after.unknowns, after.q, strict=True) if u in added])
    both = Problem(
        formed.channel,
        [*formed.unknowns, *added],
        np.concatenate([formed.q, q]),
        look.effect,
        follow=formed.follow,
    )
    # The further effect may have led the known parameters elsewhere: from there it must be allowed to pay, too.
    there = Problem(both.channel, both.unknowns, both.q.copy(), both.label, follow=both.follow)
    moved = {u.name: v for u, v in zip(after.unknowns, after.q, strict=True)}
    there.q[:] = [moved.get(u.name, v) for u, v in zip(both.unknowns, both.q, strict=True)]
    solve(machine, [both, there], floors, AGAIN)
    take_over(both, there)
    needed = penalty(machine, look.effect)
    share = _share(machine, formed, both, channels_of(both, machine), floors)
    return gain(machine, formed, both, floors) < needed or share < SHARE or _neutral(both, look.effect)


def _form_leads_inside(machine: Machine, before: Problem, after: Problem, look: Look, floors: Floors) -> bool:
    """Whether an effect that ends at the edge of its range ends inside once its form is corrected, and then pays for both.

    A rig's law is another one than the catalogue's, and a size at the edge may make up for nothing but that.
    """
    per_number = penalty_per_number(machine)
    for numbers, formed in with_form(machine, after, look.effect, floors):
        needed = penalty(machine, look.effect) + per_number * numbers
        if not at_edge(formed, look.effect) and gain(machine, before, formed, floors) > needed:
            return True
    return False


def _worthwhile(present: Problem, ranked: Sequence[Problem], most: int) -> int:
    """How many of the candidates, best first, are worth a full refit: those within reach of the best, and one more."""
    best = present.cost - ranked[0].cost
    near = sum(present.cost - p.cost > FAR * best for p in ranked[:most])
    return max(min(near, most), min(2, len(ranked)))


def _polish(
    machine: Machine,
    present: dict[int, Problem],
    channels: Sequence[int],
    best: Sequence[tuple[int, Problem]],
    floors: Floors,
) -> None:
    """Restarts the present models from the base parameters that their best extensions found.

    A candidate must not win because its refit led the known parameters out of a bad place.
    """
    restarts = {}
    for c in channels:
        own = min((p for k, p in best if k == c), key=lambda p: p.cost, default=None)
        if own is not None:
            size = len(present[c].unknowns)
            restarts[c] = Problem(c, present[c].unknowns, own.q[:size].copy(), present[c].label)
    solve(machine, list(restarts.values()), floors, 2)
    # Where the base parameters alone get nowhere from there, the effect was no crutch for them.
    going = {c: p for c, p in restarts.items() if p.cost < present[c].cost}
    solve(machine, list(going.values()), floors, 6)
    for c, problem in going.items():
        if problem.cost < present[c].cost:
            present[c].q, present[c].cost, present[c].spread = problem.q, problem.cost, problem.spread
            present[c].simulated, present[c].columns = problem.simulated, problem.columns


def _cheap(machine: Machine, problems: Sequence[Problem], floors: Floors) -> None:
    """Two steps along the derivatives of the base parameters as they are and fresh ones of the new effect.

    Where simulating costs next to nothing all derivatives are fresh and there are more steps.
    """
    evaluate(machine, problems, floors)
    if machine.quick:
        differentiate(machine, problems, floors)
        solve(machine, problems, floors, 10)
        return
    fresh = [
        [
            j
            for j, u in enumerate(p.unknowns)
            if u.name.startswith(f"{p.label}.") or u.name in bases_of(p.label)
        ]
        for p in problems
    ]
    for _ in range(2):
        differentiate(machine, problems, floors, fresh)
        solve(machine, problems, floors, 1)


def _verdict(
    machine: Machine,
    before: Problem,
    after: Problem,
    effect: str,
    channel: int,
    found: float,
    needed: float,
    floors: Floors,
) -> str:
    if found < needed:
        return "gains less than chance could"
    if _share(machine, before, after, channels_of(after, machine), floors) < SHARE:
        return "explains no noticeable share of the gap"
    if _neutral(after, effect):
        return "vanishes when refitted"
    if at_edge(after, effect):
        # A size beyond what rigs have makes up for something else; where the last plausible one leaves nothing it does not.
        enough = all(nearly_explained(machine, before, after, c, floors) for c in channels_of(after, machine))
        return "taken" if enough else EDGE
    return "taken"


def at_edge(problem: Problem, effect: str) -> bool:
    """Whether a size of an effect ends at a bound of its range that is not its neutral value."""
    for u, q in zip(problem.unknowns, problem.q, strict=True):
        own, _, name = u.name.partition(".")
        if own != effect or u.prior or not u.at_bound(float(q)):
            continue
        parameter = CATALOGUE[effect].parameter(name)
        near = u.low if u.value(float(q)) < 0.5 * (u.low + u.high) else u.high
        if (
            parameter.typical != parameter.nominal
            and near != parameter.nominal
            and np.isfinite(parameter.nominal)
        ):
            return True
    return False


def _neutral(problem: Problem, effect: str, channel: int | None = None) -> bool:
    """Whether the estimate of an effect is its neutral value; `channel` says whose, where the problem is the rig's."""
    values = {
        u.name.split(".", 1)[1]: u.value(q)
        for u, q in zip(problem.unknowns, problem.q, strict=True)
        if u.name.startswith(f"{effect}.") and (channel is None or u.channel in (None, channel))
    }
    sizes = {p.name: (p.nominal, p.typical) for p in CATALOGUE[effect].parameters}
    return all(
        np.isfinite(neutral) and abs(values[name] - neutral) < 0.02 * abs(typical - neutral)
        for name, (neutral, typical) in sizes.items()
        if typical is not None and typical != neutral
    )


def _explained(machine: Machine, before: Problem, after: Problem, channel: int, floors: Floors) -> float:
    """Share of the variance above the noise that is explained, in the signal and log where it is smallest of those that
    mattered."""
    shares = [1.0]
    for s in machine.segments[channel]:
        floor = floors[channel, s.signal] ** 2
        old, new = (
            float(np.mean((s.measured - p.simulated[channel][s.place])[s.used] ** 2)) / floor - 1.0
            for p in (before, after)
        )
        if old > 0.5:
            shares.append(1.0 - new / old)
    return min(shares)


def _share(
    machine: Machine, before: Problem, after: Problem, channels: Sequence[int], floors: Floors
) -> float:
    """Share of the gap (in `levels`) that is explained, in the signal where it is largest."""
    best = 0.0
    for c in channels:
        old, new = (levels(machine, p.simulated[c], c, floors) for p in (before, after))
        best = max([best, *(1.0 - new[s] / old[s] for s in old if old[s] > 0.01)])
    return best


def _rig(
    machine: Machine, calibrated: dict[int, Problem], present: dict[int, Problem], looks: Sequence[Look], floors: Floors,
    trials: list[Trial], choices: list[Choice],
) -> tuple[dict[int, Problem], list[Choice]]:  # fmt: skip
    """Effects of the whole rig, beside the calibrated channels and beside what the channels have taken."""
    base, full = joined(calibrated), joined(present)
    tries: list[tuple[Look, Problem, Problem, list[Choice]]] = []
    for look in looks:
        if look.gain <= penalty(machine, look.effect):
            trials.append(
                Trial(
                    look.effect,
                    None,
                    1,
                    look.gain,
                    penalty(machine, look.effect),
                    "explains too little at first look",
                )
            )
            continue
        tries.append((look, extended(base, look), base, []))
        if choices:
            tries.append((look, extended(full, look), full, choices))
    if not tries:
        return present, choices
    _cheap(machine, [p for _, p, _, _ in tries], floors)
    solve(machine, [p for _, p, _, _ in tries], floors, 2)

    def score(problem: Problem, names: Sequence[str]) -> float:
        return gain(machine, base, problem, floors, machine.channels) - sum(
            penalty(machine, n) for n in names
        )

    best, best_score, best_choices = full, score(full, [k.effect for k in choices]), choices
    for look, problem, before, kept in tries:
        found, needed = gain(machine, before, problem, floors), penalty(machine, look.effect)
        reached = score(problem, [k.effect for k in kept] + [look.effect])
        fate = _verdict(machine, before, problem, look.effect, 0, found, needed, floors)
        if fate == "taken" and reached > best_score:
            best, best_score = problem, reached
            best_choices = [*kept, Choice(look.effect, None, found, needed, {}, before)]
        trials.append(
            Trial(
                look.effect,
                None,
                1,
                found,
                needed,
                fate if fate != "taken" else "others explain more",
                problem,
            )
        )
    if best is full:
        return present, choices
    _settle(machine, [best], floors)
    for trial in trials:
        if trial.problem is best:
            trial.fate = "taken"
    return dict.fromkeys(machine.channels, best), _still_there(best, best_choices, trials)


def _still_there(problem: Problem, choices: list[Choice], trials: list[Trial]) -> list[Choice]:
    """The effects that did not vanish when those of the rig joined them: what an effect of the rig explains is no channel's."""
    left = []
    for k in choices:
        if k.channel is not None and _neutral(problem, k.effect, k.channel):
            fate = "vanishes beside an effect of the whole rig"
            trials.append(Trial(k.effect, k.channel, 9, 0.0, k.needed, fate, problem))
        else:
            left.append(k)
    return left


def _backward(
    machine: Machine, present: dict[int, Problem], choices: list[Choice], floors: Floors, trials: list[Trial]
) -> None:
    """Refits without each effect in turn and drops those that are not missed."""
    while True:
        without = []
        for choice in choices:
            c = choice.channel
            if c is None or present[c].channel is None or sum(k.channel == c for k in choices) < 2:
                continue
            keep = [
                j for j, u in enumerate(present[c].unknowns) if not u.name.startswith(f"{choice.effect}.")
            ]
            less = Problem(
                c, [present[c].unknowns[j] for j in keep], present[c].q[keep], "without " + choice.effect
            )
            less.columns = {c: present[c].columns[c][:, keep]}
            without.append((choice, less))
        if not without:
            return
        solve(machine, [p for _, p in without], floors, 3)
        missed = [
            (gain(machine, p, present[k.channel], floors) - k.needed, k, p)
            for k, p in without
            if k.channel is not None
        ]
        for worth, choice, less in missed:
            choice.gain, choice.without = worth + choice.needed, less
        worth, choice, less = min(missed, key=lambda m: m[0])
        if worth > 0.0 or choice.channel is None:
            return
        present[choice.channel] = less
        choices.remove(choice)
        trials.append(
            Trial(
                choice.effect,
                choice.channel,
                9,
                choice.gain,
                choice.needed,
                "not missed once the others are there",
                less,
            )
        )


def _needed_after_all(
    machine: Machine, present: dict[int, Problem], choices: list[Choice], floors: Floors, trials: list[Trial]
) -> None:
    """Drops an effect that is alone on its channel if the known parameters, from where it has led them, do without it."""
    alone = [k for k in choices if k.channel is not None and present[k.channel].channel is not None]
    alone = [k for k in alone if sum(o.channel == k.channel for o in choices) == 1]
    alone = [k for k in alone if k.without is not None and not far_from_noise(machine, k.without, floors)]
    starts = {id(k): _without_it(present[k.channel], k) for k in alone if k.channel is not None}
    solve(machine, [p for own in starts.values() for p in own], floors, SETTLE)
    for choice in alone:
        c, less = choice.channel, min(starts[id(choice)], key=lambda p: p.cost)
        assert c is not None
        found = gain(machine, less, present[c], floors)
        if found < choice.needed:
            fate = "the known parameters do as well, from where it led them"
            trials.append(Trial(choice.effect, c, 9, found, choice.needed, fate, present[c]))
            choices.remove(choice)
            present[c] = less


def _without_it(problem: Problem, choice: Choice) -> list[Problem]:
    """The problem without an effect that was taken, all known parameters where it led them, or only those of the spool.

    What acts behind the valve may have moved to make room for the effect, while the spool's friction only left a valley.
    """
    assert choice.without is not None
    led, before = along_all(_less(problem, choice.effect)), along_all(choice.without)
    spool = {*TOGETHER["k"], "vs"}
    for j, u in enumerate(before.unknowns):
        if u.name in spool and u.name == led.unknowns[j].name:
            before.q[j] = led.q[j]
    return [led, before]


def _rivals_again(
    machine: Machine,
    present: dict[int, Problem],
    choices: list[Choice],
    looks: Sequence[Look],
    floors: Floors,
) -> None:
    """Puts rivals in the place of what was taken, once everything else is there.

    They are those that were near while another effect was still missing, those whose signature has the same direction, and
    those that the catalogue declares to be hardly told apart: a rival that a screening passed over must still be listed.
    Each starts from the base parameters found. One that does better than the effect it stands for takes its place.
    """
    starts, same = {(k.effect, k.channel): k for k in looks}, alike(looks)
    swaps: list[tuple[Choice, str, Problem]] = []
    for choice in choices:
        c = choice.channel
        if c is None or choice.without is None or present[c].channel is None:
            continue
        own = {k.effect for k in choices if k.channel == c}
        declared = CATALOGUE[choice.effect].indistinguishable_from
        again = (
            *sorted(choice.rivals, key=lambda n: choice.rivals[n])[:4],
            *declared,
            *same.get((choice.effect, c), [])[:2],
        )
        for rival in dict.fromkeys(again):
            if (rival, c) in starts and rival not in own:
                swaps.append((choice, rival, extended(_less(present[c], choice.effect), starts[rival, c])))
    solve(machine, [p for _, _, p in swaps], floors, AGAIN)
    for choice, rival, problem in sorted(swaps, key=lambda s: s[2].cost):
        assert choice.without is not None and choice.channel is not None
        c = choice.channel
        if {*problem.effects()} - {rival} != {*present[c].effects()} - {choice.effect}:
            continue  # another effect of this channel was replaced meanwhile
        own_gain = gain(machine, choice.without, present[c], floors)
        behind = own_gain - gain(machine, choice.without, problem, floors)
        better = behind < -0.5 * choice.needed and problem.cost < present[c].cost
        if better and not (_neutral(problem, rival) or at_edge(problem, rival)):
            choice.rivals.pop(rival, None)
            if -behind < max(NEAR * own_gain, choice.needed):
                choice.rivals[choice.effect] = -behind
            choice.effect, choice.gain, present[c] = rival, own_gain - behind, problem
        elif behind < max(NEAR * own_gain, choice.needed):
            choice.rivals[rival] = max(behind, 0.0)
        else:
            choice.rivals.pop(rival, None)


def _less(problem: Problem, effect: str) -> Problem:
    """The problem without an effect, at the same values of everything else."""
    keep = [j for j, u in enumerate(problem.unknowns) if not u.name.startswith(f"{effect}.")]
    return Problem(problem.channel, [problem.unknowns[j] for j in keep], problem.q[keep], f"without {effect}")
