"""Backward elimination: which of the accepted effects are needed."""

from __future__ import annotations

from ..estimation import SCALED_TOGETHER, SETTLE_ITERATIONS, Estimate, far_from_noise, joined, settle, solve
from ..settings import rule
from .candidates import AFTER_ROUNDS, Accepted, Search
from .form_correction import attempts, refit_attempts

__all__ = ["drop_not_missed", "drop_unneeded", "prefer_form"]

DROP_UNNEEDED = rule(
    "drop_unneeded", "drop an effect that the known parameters replace, from where it led them"
)
DROP_NOT_MISSED = rule(
    "drop_not_missed", "backward elimination: drop an effect that is not missed beside the others"
)
PREFER_FORM = rule("prefer_form", "drop an effect if another form of those beside it explains more")


def drop_not_missed(search: Search) -> None:
    """Refits without each effect in turn, as long as that can still reach what all of them explain, and drops those that are not
    missed, the least missed one first."""
    fit = search.fit
    while fit.settings.uses(DROP_NOT_MISSED):
        without: list[tuple[Accepted, int, Estimate]] = []
        for one in search.accepted:
            c = fit.rig.channels[0] if one.channel is None else one.channel
            present = search.present[c]
            if len(present.placed_effects()) < 2:
                continue
            less = present.without(one.effect, one.channel)
            keep = [j for j, u in enumerate(present.unknowns) if u in less.unknowns]
            less.columns = {k: present.columns[k][:, keep] for k in fit.channels_of(less)}
            without.append((one, c, less))
        if not without:
            return
        races = [[search.present[c], less] for _, c, less in without]
        solve(fit.on(fit.rig.for_long_refits()), [p for *_, p in without], SETTLE_ITERATIONS, races=races)
        for one, c, less in without:
            one.gain, one.without = fit.gain(less, search.present[c]), less
        one, c, less = min(without, key=lambda entry: entry[0].gain - entry[0].needed)
        if one.gain > one.needed:
            return
        _drop(search, one, c, less)
        outcome = "not missed once the others are there"
        search.record(one.effect, one.channel, AFTER_ROUNDS, one.gain, outcome, less, one.needed)


def prefer_form(search: Search) -> None:
    """Drops an effect if another form of one that is accepted on its channel explains more: no rig has exactly the laws of the
    catalogue, and what a law leaves is no further effect."""
    fit = search.fit
    long = fit.on(fit.rig.for_long_refits())
    while fit.rig.has_hidden_states and fit.settings.uses(PREFER_FORM):
        replaced: list[tuple[Accepted, int]] = []
        for c in fit.rig.channels:
            for one in search.on(c):
                if one.without is None or one.without.channel != search.present[c].channel:
                    continue
                found = attempts(fit, one.without, one.without.placed_effects())
                refit_attempts(long, found)
                search.attempted += [t.estimate for t in found]
                if any(t.score < search.present[c].cost + one.needed for t in found):
                    replaced.append((one, c))
        if not replaced:
            return
        # Corrections bend one law into another, so of two that replace each other the one stays that explains more as it is.
        dropped, c = min(replaced, key=lambda r: r[0].gain - r[0].needed)
        assert dropped.without is not None
        less, present = dropped.without, search.present[c]
        outcome = "another form of the others does better"
        search.record(
            dropped.effect, c, AFTER_ROUNDS, fit.gain(less, present), outcome, present, dropped.needed
        )
        _drop(search, dropped, c, less)
        solve(long, [less], SETTLE_ITERATIONS)
        drop_not_missed(search)


def _drop(search: Search, dropped: Accepted, c: int, less: Estimate) -> None:
    """Drops an effect from channel c, of which `less` is the estimate without it. Of an effect that is left alone, the calibrated
    model is the estimate without it: the last one still had the other effect."""
    search.accepted.remove(dropped)
    search.put(c, less)
    left = [k for k in search.accepted if (k.effect, k.channel) in less.placed_effects()]
    if len(left) == 1:
        left[0].without = joined(search.calibrated) if less.channel is None else search.calibrated[c]


def drop_unneeded(search: Search) -> None:
    """Drops an effect that is alone on its channel if the known parameters, from where it has led them, do without it."""
    fit = search.fit
    if not fit.settings.uses(DROP_UNNEEDED):
        return
    starts: list[tuple[Accepted, int, list[Estimate]]] = []
    for one in search.accepted:
        c = one.channel
        if c is None or search.present[c].channel is None or len(search.on(c)) != 1 or one.without is None:
            continue
        if not far_from_noise(fit, one.without):
            starts.append((one, c, _without(search.present[c], one.without, one.effect)))
    long = fit.on(fit.rig.for_long_refits())
    races = [[search.present[c], *own] for _, c, own in starts]
    solve(long, [p for *_, own in starts for p in own], SETTLE_ITERATIONS, races=races)
    for one, c, own in starts:
        less = min(own, key=lambda p: p.cost)
        gain = fit.gain(less, search.present[c])
        if gain >= one.needed:
            # Little more than noise is left either way, and how far each is from its minimum may be all that parts them.
            settle(long, [less, search.present[c]])
            gain = fit.gain(less, search.present[c])
        if gain < one.needed:
            outcome = "the known parameters do as well, from where it led them"
            search.record(one.effect, c, AFTER_ROUNDS, gain, outcome, search.present[c], one.needed)
            search.accepted.remove(one)
            search.present[c] = less


def _without(present: Estimate, without: Estimate, effect: str) -> list[Estimate]:
    """The estimate without an effect that was accepted, all known parameters where it led them, or only those of the spool.

    What acts behind the valve may have moved to make room for the effect, while the spool's friction only left a local minimum.
    """
    led, before = present.without(effect).in_all_directions(), without.in_all_directions()
    spool = {*SCALED_TOGETHER["k"], "vs"}
    for j, u in enumerate(before.unknowns):
        if u.name in spool and u.name == led.unknowns[j].name:
            before.q[j] = led.q[j]
    return [led, before]
