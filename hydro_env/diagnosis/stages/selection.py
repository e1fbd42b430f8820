"""Selection of effects: forward steps with joint refits, a penalty for the size of the library, backward steps.

For each channel: a screening of all candidates beside the present estimate, short refits of the promising ones (base
parameters move along frozen derivatives), full joint refits of the best, and the winner is accepted if the deviance falls
by more than the penalty (`candidates.penalty`). The deviance counts independent samples (`Fit.gain`). A set of local effects is
compared with one that has an effect of the whole rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ..estimation import (
    SETTLE_ITERATIONS,
    Estimate,
    Fit,
    best_on_early_window,
    could_pay,
    grow_horizon,
    joined,
    solve,
    unexplained,
)
from ..settings import rule
from ..state import State
from . import rattling, screening
from .candidates import (
    ACCEPTED,
    OUTDONE,
    VANISHED,
    WITHIN_REACH,
    Accepted,
    Search,
    Selection,
    judge,
    penalty,
)
from .elimination import drop_unneeded, prefer_form
from .form_correction import attempts, given_on, refit_attempts
from .refits import short_refit
from .rig_effects import rig_effect_leads, select_rig_effects
from .screening import Screening, screen

__all__ = ["better_set", "run", "select"]

COMPETE_ON_BEGINNING = rule(
    "compete_on_beginning",
    "compare all candidates on the beginning of the logs where the best one leaves something",
)
COMPARE_SETS = rule(
    "compare_sets", "compare a set of local effects with one that has an effect of the whole rig"
)

#: Short refits and full refits in the first round, and in later ones, where the screening is beside a better model.
FIRST_REFITS, LATER_REFITS = (12, 3), (6, 2)
#: Iterations of a full refit, and of one where simulating costs next to nothing.
FULL_ITERATIONS, CHEAP_ITERATIONS = 3, 10


@dataclass(eq=False)
class Refit:
    """A candidate on a channel and its estimate."""

    channel: int
    screened: Screening
    estimate: Estimate


@dataclass
class Contest:
    """The candidates of a channel in a round: those that are refitted in full, best first, and the rest.

    `gains` are those of the refitted ones when all had been refitted alike, by effect.
    """

    channel: int
    refits: list[Refit]
    outdone: list[Refit]
    gains: dict[str, float] = field(default_factory=dict)

    def rank(self, search: Search) -> None:
        """Sorts the refitted ones, the best of each effect first, and counts their gains."""
        fit, before = search.fit, search.present[self.channel]
        self.refits.sort(key=lambda r: r.estimate.cost + penalty(fit, r.screened.effect))
        best: dict[str, Refit] = {}
        for r in self.refits:
            best.setdefault(r.screened.effect, r)
        self.refits = [*best.values()]
        self.outdone = [r for r in self.outdone if r.screened.effect not in best]
        self.gains = {effect: fit.gain(before, r.estimate) for effect, r in best.items()}


def run(state: State) -> State:
    """Selects effects and estimates the noise again."""
    selection = select(
        Search(
            state.fit,
            state.calibrated,
            state.screening,
            state.seconds,
            dict(state.calibrated),
            state.progress,
        )
    )
    following = rattling.beside(state, {c: selection.in_best_form(c) for c in selection.estimates})
    if following is not state:
        return run(screening.run(following))
    fit = state.fit.with_noise_seen_by(selection.estimates)
    fit.rescore([*selection.estimates.values(), *selection.placebo.values()])
    return replace(state, fit=fit, selection=selection, final=selection.estimates, placebo=selection.placebo)


def select(search: Search) -> Selection:
    """Selects effects for every channel and for the rig, starting from the calibrated estimates and their screening.

    What acts on both channels is searched for in two ways: first on each channel, or first on the rig, whichever promises more.
    Several local effects imitate one of the rig, and the other way round, so the other way is gone as well where another set
    may do better, and the sets are compared.
    """
    fit = search.fit
    whole = len(fit.rig.channels) == 2 and any(k.channel is None for k in search.screening)
    leads = whole and rig_effect_leads(search)
    _search(search, leads)
    compared = fit.settings.uses(COMPARE_SETS) or not search.accepted
    if whole and compared and _may_be_outdone(search, leads):
        other = search.afresh()
        _search(other, not leads)
        search = better_set(search, other)
    return Selection(search.present, search.accepted, search.candidates, search.placebo, search.attempted)


def _has_rig_effect(search: Search) -> bool:
    return any(k.channel is None for k in search.accepted)


def _search(search: Search, rig_first: bool) -> None:
    """Searches for a set of effects: first for one of the rig and then beside it on the channels, or the other way round."""
    fit = search.fit
    first = [c for c in fit.rig.channels if _worth_another(search, c)]
    of_channels = [k for k in search.screening if k.channel is not None]
    if not rig_first:
        _forward(search, first, of_channels)
    if len(fit.rig.channels) == 2:
        search.progress("effects of the whole rig")
        select_rig_effects(search)
    if _has_rig_effect(search):
        if rig_first:
            _set_placebos(search, first, of_channels)
        _forward_beside_rig_effect(search)
    if fit.rig.has_hidden_states:
        drop_unneeded(search)
    if any(len(p.placed_effects()) > 1 for p in search.present.values()):
        search.progress("can any of them be left out?")
        prefer_form(search)


def _may_be_outdone(search: Search, rig_first: bool) -> bool:
    """Whether the other way may lead to a set of effects that does better: a smaller one, or one that explains what this one
    leaves."""
    if not search.accepted:
        return rig_first
    several = not rig_first and len(search.accepted) > 1
    return several or any(_worth_another(search, c) for c in search.fit.rig.channels)


def better_set(search: Search, other: Search) -> Search:
    """The search whose set of effects explains more, with what the effects of each must pay for.

    Both go as far as they can first. The one that is left knows how far the other one is behind (`Accepted.rival`).
    """
    fit = search.fit
    if not other.accepted:
        return search
    _settle(fit, [*{id(p): p for s in (search, other) for p in s.present.values()}.values()])
    pairs = sorted(((joined(s.present), s) for s in (search, other)), key=lambda pair: pair[0].cost)
    (more, best), (less, rest) = pairs
    # In the samples that are independent beside the one that explains more.
    ahead = fit.gain(less, more, fit.rig.channels) - best.needed + rest.needed
    if ahead < 0.0:
        best, rest = rest, best
    names = {(k.effect, k.channel) for k in rest.accepted}
    for k in best.accepted:
        if (k.effect, k.channel) not in names:
            k.rival = abs(ahead)
    for candidate in rest.candidates:
        if candidate.accepted:
            candidate.outcome = OUTDONE
    best.candidates += rest.candidates
    best.placebo = best.placebo or rest.placebo
    return best


def _worth_another(search: Search, c: int) -> bool:
    """Whether a channel has a residual left that is worth looking into and is no matter of the form of what was accepted."""
    fit, present = search.fit, search.present[c]
    if not could_pay(fit, present, c):
        return False
    if not fit.rig.has_hidden_states or not (present.effects() or given_on(fit, present)):
        return True
    return could_pay(fit, _in_other_form(search, present), c)


# --- forward steps --------------------------------------------------------------------------------------------------------
def _forward(search: Search, channels: list[int], screening: Sequence[Screening]) -> None:
    """Rounds, as long as an effect is accepted on a channel and leaves something."""
    for number in range(1, search.fit.settings.max_effects + 1):
        if not channels:
            break
        if number > 1:
            search.progress(f"round {number}: screening what is left")
            here = {c: search.present[c] for c in channels}
            screening = screen(search.fit, here, search.names, search.seconds, search.screening)
        search.progress(f"round {number}: refitting candidates")
        # Channels that are estimated together take turns: what one of them gets changes the model of both.
        turns = [[c] for c in channels] if search.of_rig else [channels]
        accepted = [c for turn in turns for c in _round(search, turn, screening, number)]
        channels = [c for c in accepted if _worth_another(search, c)]


def _forward_beside_rig_effect(search: Search) -> None:
    """Further rounds where an effect of the rig was accepted: before, it had hidden what else there is on each channel."""
    fit = search.fit
    for number in range(2, fit.settings.max_effects + 1):
        channels = [c for c in fit.rig.channels if _worth_another(search, c)]
        if not channels:
            return
        search.progress(f"round {number}: screening what is left beside the effect of the rig")
        screening = screen(fit, search.present, search.names, search.seconds, search.screening)
        # One channel at a time: what one of them gets changes the model of both.
        if not [c for c in channels if _round(search, [c], screening, number)]:
            return


def _set_placebos(search: Search, channels: Sequence[int], screening: Sequence[Screening]) -> None:
    """The best candidate of each channel at first look, refitted, as the placebo beside an effect of the rig."""
    if not search.of_rig:
        return
    best = {k.channel: k for k in reversed(screening)}
    search.placebo = {c: search.calibrated[c].extended(best[c].effect, best[c].start, c) for c in channels}
    placebos = list(search.placebo.values())
    short_refit(search.fit, placebos)
    solve(search.fit.on(search.fit.rig.for_long_refits()), placebos, SETTLE_ITERATIONS)


def _round(search: Search, channels: Sequence[int], screening: Sequence[Screening], number: int) -> list[int]:
    """One forward step on every channel; returns the channels on which an effect was accepted."""
    fit, cheap = search.fit, search.fit.rig.simulation_is_cheap
    short, full = FIRST_REFITS if number == 1 or cheap else LATER_REFITS
    refits = _short_refits(search, channels, screening, number, short)
    if not refits:
        return []
    contests = [_contest(search, c, [r for r in refits if r.channel == c], full) for c in channels]
    contests = [k for k in contests if k.refits]
    solve(
        fit, [r.estimate for k in contests for r in k.refits], CHEAP_ITERATIONS if cheap else FULL_ITERATIONS
    )
    for k in contests:
        k.rank(search)
    # Before it is judged: in a local minimum the right one gains little, too.
    _settle(fit, [k.refits[0].estimate for k in contests])
    _compete_on_beginning(search, contests)
    accepted = [k.channel for k in contests if _accept_best(search, k, number)]
    if number == 1:
        # As far as what was accepted has been, unless they cannot reach it any more.
        long, races = (
            fit.on(fit.rig.for_long_refits()),
            [[search.present[c], search.placebo[c]] for c in accepted],
        )
        solve(long, [search.placebo[c] for c in accepted], SETTLE_ITERATIONS, races=races)
    return accepted


def _short_refits(
    search: Search, channels: Sequence[int], screening: Sequence[Screening], number: int, most: int
) -> list[Refit]:
    """Short refits of the most promising candidates of every channel, or of all where simulating costs next to nothing."""
    refits = []
    for c in channels:
        here = {k.effect for k in search.on(c)}
        own = [k for k in screening if k.channel == c and k.effect not in here]
        for place, one in enumerate(own):
            if search.fit.rig.simulation_is_cheap or (place < most and one.gain > 0.0):
                refits.append(Refit(c, one, search.present[c].extended(one.effect, one.start, c)))
            else:
                search.record(one.effect, c, number, one.gain, "explains too little at first look")
    for r in refits:
        r.screened.begin(search.fit, r.estimate)
    if refits:
        short_refit(search.fit, [r.estimate for r in refits])
    return refits


def _contest(search: Search, c: int, refits: Sequence[Refit], most: int) -> Contest:
    """The candidates of a channel, best first; those within reach of the best, and one more, are to be refitted in full."""
    own = sorted(refits, key=lambda r: r.estimate.cost)
    fall = [search.present[c].cost - r.estimate.cost for r in own]
    near = sum(each > WITHIN_REACH * fall[0] for each in fall[:most])
    worthwhile = max(min(near, most), min(2, len(own)))
    return Contest(c, own[:worthwhile], own[worthwhile:])


def _compete_on_beginning(search: Search, contests: Sequence[Contest]) -> None:
    """Where the best candidate leaves more than another form of it would explain, every effect that the logs would show competes
    anew on their beginning, and the best are refitted beside those that the screening proposed, the two best as far as they go.
    """
    fit = search.fit
    if not (fit.rig.has_hidden_states and fit.settings.uses(COMPETE_ON_BEGINNING)):
        return
    left = [
        k
        for k in contests
        if unexplained(fit, k.refits[0].estimate, k.channel)
        and unexplained(fit, _in_other_form(search, k.refits[0].estimate), k.channel)
    ]
    screened = {(k.effect, k.channel): k for k in search.screening}
    names = []
    for k in left:
        here = {n for n, c in search.present[k.channel].placed_effects() if c in (None, k.channel)}
        new = [n for n in search.names if n not in here]
        seen = [screened.get((n, k.channel)) for n in new]
        names.append([one.effect for one in seen if one is not None and one.shows])
    presents = [(k.channel, search.present[k.channel]) for k in left]
    found = best_on_early_window(fit, presents, names) if left else []
    # The others race among themselves, since the best so far has been refitted for longer; then the best of them is, too.
    leaders = [k.refits[0] for k in left]
    for k, own in zip(left, found, strict=True):
        k.refits = k.refits[1:] + [Refit(k.channel, screened[p.label, k.channel], p) for p in own]
    races = [[r.estimate for r in k.refits] for k in left]
    solve(fit, [p for race in races for p in race], SETTLE_ITERATIONS, races=races)
    for k in left:
        k.rank(search)
    _settle(fit, [r.estimate for k in left for r in k.refits[:1]])
    for k, leader in zip(left, leaders, strict=True):
        k.refits.append(leader)
        k.rank(search)


def _in_other_form(search: Search, estimate: Estimate) -> Estimate:
    """The estimate with the correction of form that explains most of what it leaves, if one does; remembered in the search."""
    known = next((better for own, better in search.corrected if own is estimate), None)
    if known is None:
        fit = search.fit
        found = attempts(fit, estimate, estimate.placed_effects())
        refit_attempts(fit.on(fit.rig.for_long_refits()), found)
        best = min(found, key=lambda t: t.score, default=None)
        better = best is not None and best.score < estimate.cost
        known = best.estimate if best is not None and better else estimate
        search.corrected.append((estimate, known))
        search.attempted += [t.estimate for t in found]
    return known


def _settle(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Improves estimates as far as they go, in place."""
    long = fit.on(fit.rig.for_long_refits())
    solve(long, estimates, SETTLE_ITERATIONS)
    if fit.rig.has_hidden_states:
        solve(long, grow_horizon(long, estimates), SETTLE_ITERATIONS)


def _adopt_base(search: Search, c: int, vanished: Refit) -> bool:
    """Takes over the known parameters of a candidate that vanished, if they explain the logs better; whether it does."""
    fit, present = search.fit, search.present[c]
    less = vanished.estimate.without(vanished.screened.effect, c)
    solve(fit, [less], CHEAP_ITERATIONS)
    return fit.gain(present, less) > 0.0 and present.adopt(less)


def _accept_best(search: Search, contest: Contest, number: int) -> bool:
    """Judges the refitted candidates of a channel and accepts the best one, if it passes; whether it does."""
    fit, c, gains = search.fit, contest.channel, contest.gains
    before = search.present[c]
    judged, accepted = "", False
    for place, r in enumerate(contest.refits):
        effect, gain = r.screened.effect, fit.gain(before, r.estimate)
        outcome = judge(fit, r.estimate, effect, gain, c)
        if place == 0:
            judged, accepted = outcome, outcome == ACCEPTED
            if accepted:
                competing = search.competing(effect, gains)
                search.accepted.append(Accepted(effect, c, gain, penalty(fit, effect), competing, before))
        elif outcome == ACCEPTED:
            outcome = OUTDONE
        search.record(effect, c, number, gain, outcome, r.estimate)
    for r in contest.outdone:
        search.record(r.screened.effect, c, number, fit.gain(before, r.estimate), OUTDONE, r.estimate)
    refits = contest.refits
    if number == 1:
        search.placebo[c] = refits[1 if accepted and len(refits) > 1 else 0].estimate
    if accepted:
        search.put(c, refits[0].estimate)
        return True
    return judged == VANISHED and _adopt_base(search, c, refits[0])
