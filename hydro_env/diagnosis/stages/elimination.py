"""Backward elimination: which of the accepted effects are needed."""

from __future__ import annotations

from ..estimation import SETTLE_ITERATIONS, solve
from .candidates import AFTER_ROUNDS
from .search import Search

__all__ = ["prefer_form"]


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
