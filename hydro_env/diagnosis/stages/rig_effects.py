"""Effects of the whole rig, beside what the channels have."""

from __future__ import annotations

from ..estimation.estimate import Estimate, joined
from ..estimation.gauss_newton import SETTLE_ITERATIONS, solve
from .candidates import ACCEPTED, AFTER_ROUNDS, OUTDONE, Accepted, Candidate, is_neutral, judge, penalty
from .search import Search, short_refit

__all__ = ["drop_vanished", "rig_effect_leads", "select_rig_effects"]


def rig_effect_leads(search: Search) -> bool:
    """Whether an effect of the rig promises more at first look than the best effects of both channels together.

    It then comes first: beside it, channels are searched for what they have, without it for what imitates it.
    """
    best: dict[int | None, float] = {}
    for k in search.screening:
        best[k.channel] = max(best.get(k.channel, 0.0), k.gain)
    of_rig = best.pop(None, 0.0)
    return of_rig > sum(best.values())


def select_rig_effects(search: Search) -> None:
    """Accepts the effect of the rig that explains most beside what the channels have, each refitted as far as it goes."""
    fit, before = search.fit, joined(search.present)
    tries: list[Estimate] = []
    for one in (k for k in search.screening if k.channel is None):
        if one.gain > penalty(fit, one.effect):
            tries.append(before.extended(one.effect, one.start))
        else:
            search.record(one.effect, None, 1, one.gain, "explains too little at first look")
    if not tries:
        return
    short_refit(fit, tries)
    solve(fit, tries, SETTLE_ITERATIONS)
    best, *others = sorted(tries, key=lambda p: p.cost + penalty(fit, p.label))
    for p in (best, *others):
        gain = fit.gain(before, p)
        outcome = judge(fit, p, p.label, gain)
        outcome = OUTDONE if outcome == ACCEPTED and p is not best else outcome
        search.record(p.label, None, 1, gain, outcome, p)
        if outcome == ACCEPTED:
            found = Accepted(p.label, None, gain, penalty(fit, p.label), without=before)
            search.accepted, left = drop_vanished(best, [*search.accepted, found], search.candidates)
            if left is not best:
                solve(fit, [left], SETTLE_ITERATIONS)
            search.present = dict.fromkeys(fit.rig.channels, left)


def drop_vanished(
    estimate: Estimate, accepted: list[Accepted], candidates: list[Candidate]
) -> tuple[list[Accepted], Estimate]:
    """The effects that did not vanish when those of the rig joined them, and the estimate with these alone: what an effect of the
    rig explains is no channel's."""
    left, less = [], estimate
    for k in accepted:
        if k.channel is not None and is_neutral(estimate, k.effect, k.channel):
            outcome = "vanishes beside an effect of the whole rig"
            candidates.append(Candidate(k.effect, k.channel, AFTER_ROUNDS, 0.0, k.needed, outcome, estimate))
            less = less.without(k.effect, k.channel)
        else:
            left.append(k)
    return left, less
