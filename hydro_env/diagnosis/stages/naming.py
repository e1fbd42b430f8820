"""Naming: the effects that were found, with probability, competing candidates, values and intervals."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...plant import CATALOGUE
from ..estimation.estimate import Estimate, Estimates
from ..estimation.fit import Fit
from ..estimation.uncertainty import probability_of_gain
from ..logs import place_of
from ..models.base import effect_in
from .candidates import Accepted, Selection
from .validation import AT_NOISE
from .values import Interval, effect_values, row_of, widened_by_form
from .verdict import Confirmed

#: Values of the two channels that differ by less (relative) are one effect of both: two valves of a kind differ as much.
SAME_VALUE = 0.15
#: Of names that the logs do not confirm the share that is right, as a factor on their probability: 17 of 80 guesses of three
#: blocks of blind trials were right whose probabilities sum to 63 (the mean of its posterior under a
#: uniform prior; docs/evidence/notes.md). What such logs hold may be no candidate at all.
UNCONFIRMED = 0.28
#: Of confirmed names that leave a signal of the held-out logs on their channel above its noise the share that is right, as a
#: factor: 20 of 22 in blind trials (mean and prior as above). What is left may be the mark of another cause.
INCOMPLETE = 0.88


#: Hypotheses beside names: the catalogue or this set of effects does not hold the cause; and no effect is there.
UNKNOWN, PARAMETERS = "something unknown", "nothing but parameters"


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was found, on these `channels` (none: on the whole rig). `shares` are the probabilities of all hypotheses
    about its place, which sum to one: the name, what it is indistinguishable from, `UNKNOWN` and `PARAMETERS`."""

    name: str
    channels: tuple[int, ...]
    parameters: dict[str, Interval]
    shares: Mapping[str, float]

    @property
    def probability(self) -> float:
        return round(self.shares[self.name], 3)

    @property
    def indistinguishable_from(self) -> list[str]:
        return [name for name in self.shares if name not in (self.name, UNKNOWN, PARAMETERS)]

    @property
    def channel(self) -> str:
        """ "1", "2", "both" or "rig"."""
        return "both" if len(self.channels) == 2 else place_of(self.channels[0] if self.channels else None)

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name, "channel": self.channel, "probability": self.probability,
            "indistinguishable_from": self.indistinguishable_from,
            "parameters": {name: vars(p) for name, p in self.parameters.items()},
        }  # fmt: skip


def run(selection: Selection, found: Confirmed) -> list[NamedEffect]:
    """Names the effects that were found; less likely are those of a verdict `unknown` and those that leave something."""
    named = []
    for n in name_effects(selection, found.models.final):
        trust = _trust(found, n)
        shares = {name: trust * share for name, share in n.shares.items()}
        named.append(replace(n, shares=shares | {UNKNOWN: shares[UNKNOWN] + 1.0 - trust}))
    return named


def _trust(found: Confirmed, named: NamedEffect) -> float:
    """The factor on the probability of a name for what it leaves."""
    if found.verdict == "unknown":
        return UNCONFIRMED
    return INCOMPLETE if found.proofs.left(named.channels or (0, 1)) > AT_NOISE else 1.0


def name_effects(selection: Selection, final: Estimates) -> list[NamedEffect]:
    """The effects with probability, competing candidates and values; equal ones on both channels become one of both.

    Values are those of `final`, where forms may be corrected; nothing else depends on that.
    """
    fit, found = selection.logs.fit, []
    for one in selection.accepted:
        c = fit.rig.channels[0] if one.channel is None else one.channel
        channels = () if one.channel is None else (one.channel,)
        bare, values = (effect_values(p, one.effect, one.channel) for p in (selection.estimates, final))
        row, effect = row_of(fit.rig, c), effect_in(fit.rig, one.effect, c)
        values = {name: widened_by_form(effect, name, v, bare[name], row) for name, v in values.items()}
        found.append(NamedEffect(one.effect, channels, values, _shares(fit, one, selection.estimates[c])))
    return _merged(found)


def _shares(fit: Fit, one: Accepted, estimate: Estimate) -> dict[str, float]:
    """How likely an effect is there, and is this one, each of its competitors, or one of another set of effects."""
    # Between names that are declared alike the law's exact form decides, which no machine keeps: they weigh the same.
    declared = CATALOGUE[one.effect].indistinguishable_from
    competitors = sorted(one.competing, key=one.competing.__getitem__)
    behind = [0.0 if n in declared else one.competing.get(n, 0.0) for n in competitors]
    half = 0.5 * fit.settings.temper
    others = [math.exp(-half * deficit) for deficit in (*behind, one.rival)]
    weight = 1.0 + sum(others)
    likely = 1.0 / (1.0 + math.exp(-half * (one.gain - one.needed)))
    if one.without is not None and one.without.channel == estimate.channel:
        likely = min(likely, probability_of_gain(fit, one.without, estimate, one.needed))
    weights = zip((one.effect, *competitors, UNKNOWN), (1.0, *others), strict=True)
    return {name: likely * w / weight for name, w in weights} | {PARAMETERS: 1.0 - likely}


def _merged(found: list[NamedEffect]) -> list[NamedEffect]:
    """An effect that both channels have with the same values, within `SAME_VALUE`, becomes one of both."""
    out: list[NamedEffect] = []
    for n in found:
        twin = next((o for o in out if o.name == n.name and {*o.channels, *n.channels} == {0, 1}), None)
        if twin is None or not all(_alike(twin.parameters[p], n.parameters[p]) for p in n.parameters):
            out.append(n)
            continue
        values = {name: _both(a, n.parameters[name]) for name, a in twin.parameters.items()}
        weaker = min(twin, n, key=lambda o: o.probability)
        shares = dict.fromkeys([*twin.shares, *n.shares], 0.0) | dict(weaker.shares)
        out[out.index(twin)] = NamedEffect(n.name, (0, 1), values, shares)
    return out


def _alike(a: Interval, b: Interval) -> bool:
    near = abs(a.value - b.value) <= SAME_VALUE * max(abs(a.value), abs(b.value))
    return bool(near or (a.low <= b.high and b.low <= a.high))


def _both(a: Interval, b: Interval) -> Interval:
    return Interval(0.5 * (a.value + b.value), min(a.low, b.low), max(a.high, b.high), a.unit)
