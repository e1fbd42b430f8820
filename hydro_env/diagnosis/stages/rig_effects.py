"""Effects of the whole rig, beside what the channels have."""

from __future__ import annotations

from ..estimation import SETTLE_ITERATIONS, Estimate, joined, solve
from .candidates import (
    ACCEPTED,
    AFTER_ROUNDS,
    OUTDONE,
    Accepted,
    Candidate,
    Search,
    is_neutral,
    judge,
    penalty,
)
from .refits import short_refit
from .screening import Screening

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
    tries: list[tuple[Screening, Estimate]] = []
    for one in (k for k in search.screening if k.channel is None):
        if one.gain > penalty(fit, one.effect):
            tries.append((one, before.extended(one.effect, one.start)))
        else:
            search.record(one.effect, None, 1, one.gain, "explains too little at first look")
    if not tries:
        return
    estimates = [p for _, p in tries]
    short_refit(fit, estimates)
    solve(fit, estimates, SETTLE_ITERATIONS, races=[estimates])
    tries.sort(key=lambda t: t[1].cost + penalty(fit, t[0].effect))
    for place, (one, estimate) in enumerate(tries):
        gain = fit.gain(before, estimate)
        outcome = judge(fit, estimate, one.effect, gain)
        if outcome == ACCEPTED and place:
            outcome = OUTDONE
        search.record(one.effect, None, 1, gain, outcome, estimate)
        if outcome == ACCEPTED:
            found = Accepted(one.effect, None, gain, penalty(fit, one.effect), without=before)
            every = [*search.accepted, found]
            search.accepted = drop_vanished(estimate, every, search.candidates)
            left = estimate
            for k in (k for k in every if k not in search.accepted):
                left = left.without(k.effect, k.channel)
            if left is not estimate:
                solve(fit, [left], SETTLE_ITERATIONS)
            search.present = dict.fromkeys(fit.rig.channels, left)


def drop_vanished(
    estimate: Estimate, accepted: list[Accepted], candidates: list[Candidate]
) -> list[Accepted]:
    """The effects that did not vanish when those of the rig joined them: what an effect of the rig explains is no channel's."""
    left = []
    for k in accepted:
        if k.channel is not None and is_neutral(estimate, k.effect, k.channel):
            outcome = "vanishes beside an effect of the whole rig"
            candidates.append(Candidate(k.effect, k.channel, AFTER_ROUNDS, 0.0, k.needed, outcome, estimate))
        else:
            left.append(k)
    return left
