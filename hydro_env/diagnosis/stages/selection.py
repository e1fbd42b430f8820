"""Selection of effects: forward steps with joint refits, a penalty for the size of the library, backward steps.

For each channel: a screening of all candidates beside the present estimate, short refits of the promising ones (base
parameters move along frozen derivatives), full joint refits of the best, and the winner is accepted if the deviance falls
by more than the penalty (`candidates.penalty`). The deviance counts independent samples (`Fit.gain`). Effects of the whole rig
compete last, against what the channels found separately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..estimation import SETTLE_ITERATIONS, Estimate, could_pay, grow_horizon, smallest_share, solve
from ..state import State
from .candidates import ACCEPTED, OUTDONE, Accepted, Search, Selection, judge, penalty
from .elimination import compare_competing, drop_not_missed, drop_unneeded
from .refits import refit_found, short_refit
from .rig_effects import select_rig_effects
from .screening import Screening, screen

__all__ = ["run", "select"]

#: Short refits and full refits in the first round, and in later ones, where the screening is beside a better model.
FIRST_REFITS, LATER_REFITS = (12, 3), (6, 2)
#: Iterations of a full refit, and of one where simulating costs next to nothing.
FULL_ITERATIONS, CHEAP_ITERATIONS = 3, 10
#: Candidates whose short refit reached less than this share of the best one's are not refitted in full.
WITHIN_REACH = 0.5
#: What stays of the residual after an effect is looked into if it is a larger share; no effect has exactly its law.
WORTH_ANOTHER = 0.01


@dataclass
class Refit:
    """A candidate on a channel and its estimate."""

    channel: int
    screened: Screening
    estimate: Estimate


def run(state: State) -> State:
    """Selects effects, estimates the noise again, and refits what was accepted."""
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
    fit = state.fit.with_noise_seen_by(selection.estimates)
    changed = [
        p for c, p in selection.estimates.items() if any(k.channel in (None, c) for k in selection.accepted)
    ]
    refit_found(fit, changed)
    return replace(state, fit=fit, selection=selection, final=selection.estimates, placebo=selection.placebo)


def select(search: Search) -> Selection:
    """Selects effects for every channel and for the rig, starting from the calibrated estimates and their screening."""
    fit, calibrated = search.fit, search.calibrated
    first = [c for c in fit.rig.channels if could_pay(fit, calibrated[c], c)]
    of_channels = [k for k in search.screening if k.channel is not None]
    _forward(search, first, of_channels)
    if len(fit.rig.channels) == 2 and any(k.channel is None for k in search.screening):
        search.progress("effects of the whole rig")
        select_rig_effects(search)
    if fit.rig.has_hidden_states:
        drop_unneeded(search)
    if any(len(search.on(c)) > 1 for c in fit.rig.channels):
        search.progress("can any of them be left out?")
        drop_not_missed(search)
    if search.accepted:
        search.progress("what else would do as well?")
        compare_competing(search)
    return Selection(search.present, search.accepted, search.candidates, search.placebo)


def _worth_another(search: Search, c: int) -> bool:
    """Whether a channel on which an effect was accepted has a residual left that is worth looking into."""
    fit, present = search.fit, search.present[c]
    left = 1.0 - smallest_share(fit, search.calibrated[c], present, c)
    return could_pay(fit, present, c) and left > WORTH_ANOTHER


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
        accepted = _round(search, channels, screening, number)
        channels = [c for c in accepted if _worth_another(search, c)]


def _round(search: Search, channels: Sequence[int], screening: Sequence[Screening], number: int) -> list[int]:
    """One forward step on every channel; returns the channels on which an effect was accepted."""
    fit, cheap = search.fit, search.fit.rig.simulation_is_cheap
    short, full = FIRST_REFITS if number == 1 or cheap else LATER_REFITS
    refits = _short_refits(search, channels, screening, number, short)
    if not refits:
        return []
    best = _best_refits(search, channels, refits, number, full)
    solve(fit, [r.estimate for r in best], CHEAP_ITERATIONS if cheap else FULL_ITERATIONS)
    accepted = [c for c in channels if _accept_best(search, c, [r for r in best if r.channel == c], number)]
    # The winners are refitted as far as they go: what is left afterwards decides on further effects. So are the placebos.
    winners, long = [search.present[c] for c in accepted], fit.on(fit.rig.for_long_refits())
    solve(long, winners + [search.placebo[c] for c in accepted if number == 1], SETTLE_ITERATIONS)
    if fit.rig.has_hidden_states:
        solve(long, grow_horizon(long, winners), SETTLE_ITERATIONS)
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
                refits.append(Refit(c, one, search.present[c].extended(one.effect, one.start)))
            else:
                search.record(one.effect, c, number, one.gain, "explains too little at first look")
    if refits:
        short_refit(search.fit, [r.estimate for r in refits])
    return refits


def _best_refits(
    search: Search, channels: Sequence[int], refits: Sequence[Refit], number: int, most: int
) -> list[Refit]:
    """The candidates of every channel that are worth a full refit: those within reach of the best, and one more."""
    best = []
    for c in channels:
        own = sorted((r for r in refits if r.channel == c), key=lambda r: r.estimate.cost)
        fall = [search.present[c].cost - r.estimate.cost for r in own]
        near = sum(each > WITHIN_REACH * fall[0] for each in fall[:most])
        worthwhile = max(min(near, most), min(2, len(own)))
        best += own[:worthwhile]
        for r in own[worthwhile:]:
            gain = search.fit.gain(search.present[c], r.estimate)
            search.record(r.screened.effect, c, number, gain, OUTDONE, r.estimate)
    return best


def _accept_best(search: Search, c: int, refits: Sequence[Refit], number: int) -> bool:
    """Judges the refitted candidates of a channel and accepts the best one, if it passes; whether it does."""
    fit, before = search.fit, search.present[c]
    refits = sorted(refits, key=lambda r: r.estimate.cost + penalty(fit, r.screened.effect))
    if not refits:
        return False
    gains = {r.screened.effect: fit.gain(before, r.estimate) for r in refits}
    accepted = False
    for place, r in enumerate(refits):
        effect, gain = r.screened.effect, gains[r.screened.effect]
        outcome = judge(fit, before, r.estimate, effect, gain)
        if place == 0:
            accepted = outcome == ACCEPTED
            if accepted:
                competing = search.competing(effect, gains)
                search.accepted.append(Accepted(effect, c, gain, penalty(fit, effect), competing, before))
        elif outcome == ACCEPTED:
            outcome = OUTDONE
        search.record(effect, c, number, gain, outcome, r.estimate)
    if number == 1:
        search.placebo[c] = refits[1 if accepted and len(refits) > 1 else 0].estimate
    if accepted:
        search.present[c] = refits[0].estimate
    return accepted
