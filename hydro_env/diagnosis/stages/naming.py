"""Naming: the effects that were found, with probability, competing candidates, values and intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...plant import CATALOGUE, PlantModel, parameter_of
from ..estimation import Estimate, Fit, Unknown, probability_of_gain
from ..models.base import RigModel
from ..state import Estimates, State
from .candidates import Accepted, Selection
from .form_correction import is_correction
from .screening import Screening, alike

__all__ = [
    "Interval", "KnownParameter", "NamedEffect", "absent_effects", "at_bounds", "effect_values", "estimated_model",
    "known_parameters", "name_effects", "run", "widened_by_form",
]  # fmt: skip

#: Values of the two channels that differ by less (relative) are one effect of both.
SAME_VALUE = 0.15
#: Of names that the logs do not confirm the share that is right, as a factor on their probability: 17 of 80 guesses of three
#: blocks of blind trials were right whose probabilities sum to 63 (blocks 210000, 310000 and 320000 of seeds; the mean of its
#: posterior under a uniform prior). What such logs hold may be no candidate at all.
UNCONFIRMED = 0.28
#: A confirmed name that leaves a signal of the held-out logs on its channel above so many times the noise, and the share of such
#: names that is right, as a factor: 20 of 22 in blind trials (mean and prior as above). What is left may be the mark of
#: another cause.
LEFT, INCOMPLETE = 1.1, 0.88
#: No machine keeps to a law exactly, so the parameters of an effect mean something a little different in the rig's law. Standard
#: deviations of that: as far as a correction of form has moved the value, and at least these shares of a size (of its distance
#: from neutral) or of what shapes the law (blocks 310000 and 320000 of blind trials).
SIZE_BY_FORM, SHAPE_BY_FORM = 0.03, 0.1
#: Half the width of a 95 % interval in standard deviations.
TWO_SIDED_95 = 1.96
#: A candidate of the same signature competes if it gained this share of what the accepted one did.
NEARLY_AS_MUCH = 0.9


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval, SI; `without_one_manoeuvre` is its largest move when one manoeuvre is left out."""

    value: float
    low: float
    high: float
    unit: str
    without_one_manoeuvre: float = 0.0


@dataclass(frozen=True)
class KnownParameter:
    """A base parameter of a channel: its nominal value (as given), its estimate, and the range in which such a value usually
    lies about the given one: one standard deviation of the prior of calibration either way."""

    symbol: str
    channel: int
    nominal: float
    estimate: Interval
    usual: tuple[float, float]

    @property
    def name(self) -> str:
        return f"{self.symbol}_{self.channel + 1}"

    @property
    def change(self) -> float:
        """The relative change; infinite from 0."""
        away = self.estimate.value - self.nominal
        return away / self.nominal if self.nominal else math.copysign(math.inf, away) if away else 0.0

    def moved_by(self, digits: int = 0) -> str:
        """The change in words: "+12 %", or "from 0"."""
        return f"{100.0 * self.change:+.{digits}f} %" if math.isfinite(self.change) else "from 0"

    @property
    def moved(self) -> bool:
        """Whether the interval excludes the nominal value."""
        return not self.estimate.low <= self.nominal <= self.estimate.high

    @property
    def unusual(self) -> bool:
        """Whether it moved, and further than such values usually do."""
        return self.moved and not self.usual[0] <= self.estimate.value <= self.usual[1]


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was found, on these `channels` (none: on the whole rig)."""

    name: str
    channels: tuple[int, ...]
    probability: float
    indistinguishable_from: list[str]
    parameters: dict[str, Interval]

    @property
    def channel(self) -> str:
        """ "1", "2", "both" or "rig"."""
        return (
            "rig" if not self.channels else "both" if len(self.channels) == 2 else str(self.channels[0] + 1)
        )

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name, "channel": self.channel, "probability": self.probability,
            "indistinguishable_from": self.indistinguishable_from,
            "parameters": {name: vars(p) for name, p in self.parameters.items()},
        }  # fmt: skip


def run(state: State) -> State:
    """Names the effects that were found; less likely are those of a verdict `unknown` and those that leave something."""
    found = name_effects(state.fit, state.selection, state.screening, state.final)
    trusted = [replace(n, probability=round(_trust(state, n) * n.probability, 3)) for n in found]
    return replace(state, effects=trusted)


def _trust(state: State, named: NamedEffect) -> float:
    """The factor on the probability of a name for what it leaves."""
    if state.verdict == "unknown":
        return UNCONFIRMED
    channels = named.channels or state.rig.channels
    left = max(e["after"] / e["noise"] for (c, _), e in state.judged.errors.items() if c in channels)
    # A reduced model is not held against the noise, which is not all that it leaves out.
    return INCOMPLETE if state.rig.has_hidden_states and left > LEFT else 1.0


def name_effects(
    fit: Fit, selection: Selection, screening: Sequence[Screening], final: Estimates
) -> list[NamedEffect]:
    """The effects with probability, competing candidates and values; equal ones on both channels become one of both.

    Values are those of `final`, where forms may be corrected; nothing else depends on that.
    """
    same = alike(screening)
    found = []
    for one in selection.accepted:
        c = fit.rig.channels[0] if one.channel is None else one.channel
        # Alike by direction is not enough: a competing candidate must also have done nearly as well when it was refitted.
        competitors = sorted(one.competing, key=lambda n: one.competing[n])
        tied = same.get((one.effect, one.channel), [])
        competitors += [n for n in tied if n not in competitors and _did_nearly_as_well(selection, one, n)]
        channels = () if one.channel is None else (one.channel,)
        probability = _probability(fit, one, competitors, selection.estimates[c])
        bare, values = (effect_values(p[c], one.effect, c) for p in (selection.estimates, final))
        row = row_of(fit.rig, c)
        values = {name: widened_by_form(one.effect, name, v, bare[name], row) for name, v in values.items()}
        found.append(NamedEffect(one.effect, channels, round(probability, 3), competitors, values))
    return _merged(found)


def _probability(fit: Fit, one: Accepted, competitors: Sequence[str], estimate: Estimate) -> float:
    """How likely an effect is there, and is this one and none of its competitors."""
    # Between names that are declared alike the law's exact form decides, which no machine keeps: they weigh the same.
    declared = CATALOGUE[one.effect].indistinguishable_from
    behind = [0.0 if n in declared else one.competing.get(n, 0.0) for n in competitors]
    half = 0.5 * fit.settings.temper
    weight = 1.0 + sum(math.exp(-half * deficit) for deficit in (*behind, one.rival))
    likely = 1.0 / (1.0 + math.exp(-half * (one.gain - one.needed)))
    if one.without is not None and one.without.channel == estimate.channel:
        likely = min(likely, probability_of_gain(fit, one.without, estimate, one.needed))
    return likely / weight


def _did_nearly_as_well(selection: Selection, one: Accepted, name: str) -> bool:
    return any(
        t.gain > NEARLY_AS_MUCH * one.gain
        for t in selection.candidates
        if t.effect == name and t.channel == one.channel and t.estimate is not None
    )


def _merged(found: list[NamedEffect]) -> list[NamedEffect]:
    """An effect that both channels have with the same values, within `SAME_VALUE`, becomes one of both."""
    out: list[NamedEffect] = []
    for n in found:
        twin = next((o for o in out if o.name == n.name and {*o.channels, *n.channels} == {0, 1}), None)
        if twin is None or not all(_alike(twin.parameters[p], n.parameters[p]) for p in n.parameters):
            out.append(n)
            continue
        values = {name: _both(a, n.parameters[name]) for name, a in twin.parameters.items()}
        competitors = list(dict.fromkeys(twin.indistinguishable_from + n.indistinguishable_from))
        probability = min(twin.probability, n.probability)
        out[out.index(twin)] = NamedEffect(n.name, (0, 1), probability, competitors, values)
    return out


def _alike(a: Interval, b: Interval) -> bool:
    if a.low <= b.high and b.low <= a.high:
        return True
    return bool(abs(a.value - b.value) <= SAME_VALUE * max(abs(a.value), abs(b.value)))


def _both(a: Interval, b: Interval) -> Interval:
    moved = max(a.without_one_manoeuvre, b.without_one_manoeuvre)
    return Interval(0.5 * (a.value + b.value), min(a.low, b.low), max(a.high, b.high), a.unit, moved)


# --- values ---------------------------------------------------------------------------------------------------------------
def effect_values(estimate: Estimate, effect: str, channel: int) -> dict[str, Interval]:
    """The parameters of an effect on a channel."""
    return {
        u.parameter: _interval(estimate, j)
        for j, u in enumerate(estimate.unknowns)
        if u.effect == effect and u.channel in (None, channel)
    }


def widened_by_form(effect: str, name: str, found: Interval, bare: Interval, row: float = 0.0) -> Interval:
    """The value of an effect's parameter with the interval widened by what the law's form leaves open, see `SIZE_BY_FORM`.

    `bare` is its value without corrections of form; `row` the time from row to row of the logs, s. A time is known to half of
    that at best: a filter that is calculated once a row, y += (1 - exp(-row / T)) (x - y), is late by T - row / 2.
    """
    parameter = CATALOGUE[effect].parameter(name)
    share = {"size": SIZE_BY_FORM, "limit": SIZE_BY_FORM}.get(parameter.role, SHAPE_BY_FORM)
    away = abs(found.value - (parameter.neutral if parameter.role == "size" else 0.0))
    # An angle or a number of strokes has no law whose form could differ.
    law = 0.0 if parameter.role in ("phase", "order") else share * away
    form = TWO_SIDED_95 * max(law, abs(found.value - bare.value))
    sampled = 0.5 * row if parameter.unit == "s" else 0.0
    low = found.value - math.hypot(found.value - found.low, form, sampled)
    high = found.value + math.hypot(found.high - found.value, form, sampled)
    low, high = max(low, min(found.low, parameter.low)), min(high, max(found.high, parameter.high))
    return replace(found, low=low, high=high)


def _interval(estimate: Estimate, j: int) -> Interval:
    u, q, sure = estimate.unknowns[j], float(estimate.q[j]), estimate.intervals
    value = float(u.value(q))
    if sure is None:
        ends, moved = [value, value], 0.0
    else:
        ends = [u.value(float(sure.low[j])), u.value(float(sure.high[j]))]
        moved = max(abs(u.value(q + d) - value) for d in (-float(sure.without[j]), float(sure.without[j])))
    low, high = (min(max(v, u.low), u.high) for v in (min(ends), max(ends)))
    return Interval(value, float(low), float(high), u.unit, float(moved))


def known_parameters(rig: RigModel, estimates: Estimates) -> list[KnownParameter]:
    """The base parameters of every channel, with those of effects that the model as given has."""
    found = []
    for c, estimate in estimates.items():
        for j, u in enumerate(estimate.unknowns):
            if u.channel in (None, c) and not u.effect:
                value, (effect, _, own) = _interval(estimate, j), u.name.rpartition(".")
                value = widened_by_form(effect, own, value, value, row_of(rig, c)) if effect else value
                found.append(KnownParameter(u.name, c, rig.given(u.name, c), value, u.usual))
    return found


def absent_effects(rig: RigModel, estimates: Estimates) -> list[tuple[str, int]]:
    """The effects that the model as given has on a channel and the logs do not show: the intervals of all that carries the size
    hold the neutral values, and one excludes the given value."""
    sizes: dict[tuple[str, int], list[tuple[bool, bool]]] = {}
    for p in known_parameters(rig, estimates):
        effect, _, own = p.symbol.rpartition(".")
        if effect and (parameter := CATALOGUE[effect].parameter(own)).carries_size:
            neutral = min(parameter.neutral, max(parameter.high, p.nominal))
            holds = p.estimate.low <= neutral <= p.estimate.high
            sizes.setdefault((effect, p.channel), []).append((holds, p.moved))
    return [key for key, own in sizes.items() if all(h for h, _ in own) and any(m for _, m in own)]


def row_of(rig: RigModel, channel: int) -> float:
    """The longest time from row to row of the logs of a channel, s."""
    return max(s.period / s.step for s in rig.segments[channel])


def at_bounds(estimates: Estimates) -> list[str]:
    """Estimates at the end of their plausible range, by "J of channel 1"."""
    found = []
    for c, estimate in estimates.items():
        for u, q in zip(estimate.unknowns, estimate.q, strict=True):
            # What stayed as given may be given at the end of its range; a correction is no physics.
            if abs(q) <= 1e-3 * (u.bounds[1] - u.bounds[0]) or (u.effect and is_correction(u.effect)):
                continue
            if "." in u.parameter and _nearest_end(u, float(q)) == parameter_of(u.parameter).neutral:
                continue  # a given effect that is absent
            if u.channel in (None, c) and u.at_bound(float(q)) and u.high > u.low:
                found.append(f"{u.name} of channel {c + 1} ({u.value(float(q)):.3g} {u.unit})")
    return found


def _nearest_end(unknown: Unknown, q: float) -> float:
    """The end of an unknown's range that is nearest; infinite where that end of a limit stands for no limit."""
    if unknown.value(q) < 0.5 * (unknown.low + unknown.high):
        return unknown.low
    return math.inf if parameter_of(unknown.parameter).role == "limit" else unknown.high


def estimated_model(rig: RigModel, estimates: Estimates, name: str) -> PlantModel:
    """The model with the estimated values put in."""
    of_rig = {f"{e.name}.{p.name}" for e in CATALOGUE.values() if e.scope == "rig" for p in e.parameters}
    pairs: dict[str, tuple[float, float]] = {}
    for c, estimate in estimates.items():
        for parameter, value in estimate.values(c).items():
            if parameter in rig.own and parameter != "Kq":
                continue
            parameter_of(parameter)
            pair = [*pairs.get(parameter, rig.model.pair(parameter))]
            pair[c] = float(value)
            pairs[parameter] = (pair[c], pair[c]) if parameter in of_rig else (pair[0], pair[1])
    return rig.model.with_values(rig.written(pairs), name)
