"""A second search, global, on channels that keep a residual which nothing explains, or only what leaves most of it."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimation import (
    Estimate,
    mostly_explained,
    nearly_explained,
    restart_friction,
    search_all,
    settle,
    unexplained,
)
from ..settings import rule
from .candidates import ACCEPTED, OUTDONE, Accepted, Search, judge, penalty
from .refits import restart_present

__all__ = ["is_lost", "search_again"]

GLOBAL_SEARCH = rule("global_search", "search all effects from many starts where nothing explains a channel")


def is_lost(search: Search, c: int) -> bool:
    """Whether a channel has a residual that nothing explains, or only what leaves most of it."""
    fit, present = search.fit, search.present[c]
    if not (fit.rig.has_hidden_states and fit.settings.uses(GLOBAL_SEARCH)):
        return False
    if present.channel is None or not unexplained(fit, present, c):
        return False
    return present is search.calibrated[c] or not mostly_explained(fit, search.calibrated[c], present, c)


def search_again(search: Search, c: int) -> bool:
    """Tries all effects on channel c from many starts; one that explains nearly all replaces, in place, what was accepted
    there. Whether it does."""
    fit, calibrated = search.fit, search.calibrated[c]
    # A candidate must not win because its refit led the known parameters out of a local minimum.
    restart_friction(fit, [calibrated], whole=True)
    ranked: list[tuple[str, Estimate]] = []
    if unexplained(fit, calibrated, c):
        ranked = search_all(fit, calibrated, search.names, search.seconds)
        restart_present(fit, search.calibrated, [(c, p) for _, p in ranked])
    if not unexplained(fit, calibrated, c):
        search.accepted = [k for k in search.accepted if k.channel != c]
        search.present[c] = calibrated
        return False
    if not ranked:
        return False
    ranked.sort(key=lambda entry: entry[1].cost + penalty(fit, entry[0]))
    return _accept_best(search, c, ranked)


def _accept_best(search: Search, c: int, ranked: Sequence[tuple[str, Estimate]]) -> bool:
    fit, calibrated, own = search.fit, search.calibrated[c], search.on(c)
    gains = {effect: fit.gain(calibrated, p) for effect, p in ranked}
    effect, best = ranked[0]
    needed = penalty(fit, effect)
    outcome = judge(fit, calibrated, best, effect, gains[effect])
    worse = best.cost + needed >= search.present[c].cost + sum(k.needed for k in own)
    if outcome == ACCEPTED and (worse or not nearly_explained(fit, calibrated, best, c)):
        outcome = "leaves too much to be trusted"
    number = fit.settings.max_effects + 1
    for name, estimate in ranked:
        search.record(name, c, number, gains[name], outcome if name == effect else OUTDONE, estimate)
    if outcome != ACCEPTED:
        return False
    search.accepted = [k for k in search.accepted if k not in own]
    competing = search.competing(effect, gains)
    search.accepted.append(Accepted(effect, c, gains[effect], needed, competing, calibrated))
    search.present[c] = best
    if len(ranked) > 1:
        search.placebo[c] = ranked[1][1]
    settle(fit, [best, *(p for _, p in ranked[1:2])])
    return True
