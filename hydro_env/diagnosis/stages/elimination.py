"""Backward elimination: which of the accepted effects are needed."""

from __future__ import annotations

from ..estimation import SCALED_TOGETHER, SETTLE_ITERATIONS, Estimate, far_from_noise, settle, solve
from .candidates import AFTER_ROUNDS
from .search import Search

__all__ = ["drop_unneeded", "prefer_form"]


def prefer_form(search: Search) -> None:
    """Drops the last effect of a channel if another form of those accepted before explains more: no rig has exactly the laws of
    the catalogue, and what a law leaves is no further effect."""
    fit = search.fit
    if not (fit.rig.has_hidden_states and fit.settings.uses("prefer_form")):
        return
    for c in fit.rig.channels:
        for one in reversed(search.on(c)):
            present, less = search.present[c], one.without
            left = [placed for placed in present.placed_effects() if placed != (one.effect, c)]
            if not left or less is None or less.placed_effects() != left:
                break  # it is alone, or others joined it since
            form = search.form_of(less)
            if form is None or form.score >= present.cost + one.needed:
                break
            outcome, gain = "another form of the others does better", fit.gain(less, present)
            search.record(one.effect, c, AFTER_ROUNDS, gain, outcome, present)
            search.accepted.remove(one)
            search.put(c, less)
            solve(search.fit, [less], SETTLE_ITERATIONS)


def drop_unneeded(search: Search) -> None:
    """Drops an effect that is alone on its channel if the known parameters, from where it has led them, do without it."""
    fit = search.fit
    for c in fit.rig.channels if fit.settings.uses("drop_unneeded") else ():
        own, present = search.on(c), search.present[c]
        before = own[0].without if len(own) == 1 and present.channel is not None else None
        if before is None or far_from_noise(fit, before):
            continue
        tries = _without(present, before, own[0].effect)
        solve(search.fit, tries, SETTLE_ITERATIONS)
        less = min(tries, key=lambda p: p.cost)
        if fit.gain(less, present) >= own[0].needed:
            # Little more than noise is left either way, and how far each is from its minimum may be all that parts them.
            settle(search.fit, [less, present])
        gain = fit.gain(less, present)
        if gain < own[0].needed:
            outcome = "the known parameters do as well, from where it led them"
            search.record(own[0].effect, c, AFTER_ROUNDS, gain, outcome, present)
            search.accepted.remove(own[0])
            search.put(c, less)


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
