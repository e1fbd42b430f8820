"""Competing candidates on the beginning of the logs, where they are parted at little cost.

On whole logs a missing effect has pulled known parameters along, and a shaft is revolutions away from where it should be: from
there no small step leads to the right candidate. On the first half second there is one minimum, a simulation costs a twentieth,
and every candidate can be refitted from many sizes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..models.base import RigModel, Segment, Segments, effect_in, view
from .estimate import Estimate
from .fit import Fit
from .gauss_newton import solve
from .unknowns import effect_starts

__all__ = ["best_on_early_window", "early_window_of"]

#: Shares of the logs in turn, each twice as long as the one before (half a second of a log of 12 s, which holds one movement, to
#: 2.6 s), iterations with each, and the starts of each candidate that go on.
STAGES = ((0.04, 2, 2), (0.04, 6, 1), (0.11, 4, 1), (0.22, 3, 1))
#: Starts of each candidate that are improved, of all those that are simulated once: both signs of a size and one more.
FIRST_STARTS = 3
#: A candidate is dropped that is behind the best one by more than this, which pays for five parameters (`candidates.penalty`),
#: and by more than this share of what the best one gains over no effect.
FAR_BEHIND, OUT_OF_REACH = 100.0, 0.5
#: Candidates that go on in any case: as many as a channel may have effects.
KEPT = 3


def best_on_early_window(
    fit: Fit, presents: Sequence[tuple[int, Estimate]], names: Sequence[Sequence[str]]
) -> list[list[Estimate]]:
    """For each of `presents`, with its channel, the few extensions by one of the effects `names` on that channel that explain the
    beginning of the logs best.

    They come best first. They start from the estimate and from the known parameters as given, with every size and shape of the
    effect.
    """
    fields = [_starts(fit.rig, p, c, own) for (c, p), own in zip(presents, names, strict=True)]
    beginning = fit.on(early_window_of(fit.rig, STAGES[0][0]))
    beginning.evaluate([p for field in fields for p in field])
    fields = [_best_of_each(field, FIRST_STARTS) for field in fields]
    for share, iterations, kept in STAGES:
        beginning = fit.on(early_window_of(fit.rig, share))
        fields = [[p.at(p.q.copy()) for p in field] for field in fields]
        solve(beginning, [p for field in fields for p in field], iterations)
        fields = [_within_reach(_best_of_each(field, kept)) for field in fields]
    return [[p.at(p.q.copy()) for p in _best_of_each(field, 1) if p.label][:KEPT] for field in fields]


def _starts(rig: RigModel, present: Estimate, channel: int, names: Sequence[str]) -> list[Estimate]:
    """Every start of every candidate; without a label those that have no further effect."""
    found = [present.at(present.q.copy(), ""), present.from_given().at(present.from_given().q, "")]
    for name in names:
        for values in effect_starts(effect_in(rig, name, channel), math.inf, whole=True):
            one = present.with_effect(name, values, channel)
            found += [one, one.from_given()]
    return found


def _best_of_each(field: Sequence[Estimate], count: int) -> list[Estimate]:
    """The best `count` starts of each candidate, best first."""
    found: list[Estimate] = []
    for p in sorted(field, key=lambda p: p.cost):
        if sum(other.label == p.label for other in found) < count:
            found.append(p)
    return found


def _within_reach(field: Sequence[Estimate]) -> list[Estimate]:
    """Those of a field, best first, that may still become the best."""
    best = field[0].cost
    fall = min(p.cost for p in field if not p.label) - best
    found: list[Estimate] = []
    for p in field:
        near = p.cost - best < max(FAR_BEHIND, OUT_OF_REACH * fall)
        if near or not p.label or len({f.label for f in found} | {p.label}) <= KEPT:
            found.append(p)
    return found


def early_window_of(rig: RigModel, share: float) -> RigModel:
    """The model with only this share of each log, from its beginning, of which it also simulates no more."""
    rows = [max(2, math.ceil(share * len(part.log))) for part in rig.parts]
    parts = [part.first(n) for part, n in zip(rig.parts, rows, strict=True)]
    return view(rig, parts=parts, segments={c: _first(own, rows) for c, own in rig.segments.items()})


def _first(segments: Sequence[Segment], rows: Sequence[int]) -> Segments:
    """The samples of the first `rows` of each log, which again lie one behind the other in a vector."""
    place, found = 0, Segments()
    for s in segments:
        n = int(np.searchsorted(s.rows, rows[s.log]))
        late = None if s.late is None else s.late[:n]
        cut = replace(s, measured=s.measured[:n], rows=s.rows[:n], inside=s.inside[:n], late=late)
        cut.place = slice(place, place + n)
        place += n
        found.append(cut)
    return found
