"""Effects of the whole rig, beside the calibrated channels and beside what the channels have accepted."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimation import SETTLE_ITERATIONS, Estimate, joined, solve
from .candidates import (
    ACCEPTED,
    AFTER_ROUNDS,
    OUTDONE,
    WITHIN_REACH,
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

#: Iterations of the joint refit, which is slow.
ITERATIONS = 2


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
    """Accepts the effect of the rig that explains most, if it explains more than what the channels found separately."""
    fit = search.fit
    base, full = joined(search.calibrated), joined(search.present)
    tries: list[tuple[Screening, Estimate, Estimate, list[Accepted]]] = []
    for one in (k for k in search.screening if k.channel is None):
        if one.gain <= penalty(fit, one.effect):
            search.record(one.effect, None, 1, one.gain, "explains too little at first look")
            continue
        tries.append((one, base.extended(one.effect, one.start), base, []))
        if search.accepted:
            tries.append((one, full.extended(one.effect, one.start), full, search.accepted))
    if not tries:
        return
    short_refit(fit, [p for _, p, _, _ in tries])
    # What has not come near by then is not refitted in full, as on a channel.
    falls = [base.cost - p.cost for p in (full, *(p for _, p, _, _ in tries))]
    near = [p for _, p, _, _ in tries if base.cost - p.cost > WITHIN_REACH * max(falls)]
    solve(fit, near, ITERATIONS)

    def score(estimate: Estimate, names: Sequence[str]) -> float:
        return fit.gain(base, estimate, fit.rig.channels) - sum(penalty(fit, n) for n in names)

    best, best_score, accepted = full, score(full, [k.effect for k in search.accepted]), search.accepted
    for one, estimate, before, kept in tries:
        gain = fit.gain(before, estimate)
        reached = score(estimate, [k.effect for k in kept] + [one.effect])
        outcome = judge(fit, before, estimate, one.effect, gain)
        if outcome == ACCEPTED and reached > best_score:
            best, best_score = estimate, reached
            accepted = [*kept, Accepted(one.effect, None, gain, penalty(fit, one.effect), {}, before)]
        search.record(one.effect, None, 1, gain, OUTDONE if outcome == ACCEPTED else outcome, estimate)
    if best is full:
        return
    solve(fit, [best], SETTLE_ITERATIONS)
    for candidate in search.candidates:
        if candidate.estimate is best:
            candidate.outcome = ACCEPTED
    search.present = dict.fromkeys(fit.rig.channels, best)
    search.accepted = drop_vanished(best, accepted, search.candidates)


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
