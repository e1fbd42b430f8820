"""Values: what is estimated of effects and known parameters, in SI and with intervals, and the model that has them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...plant import CATALOGUE, Effect, PlantModel
from ..estimation.estimate import Estimate, Estimates
from ..estimation.uncertainty import TWO_SIDED_95
from ..models.base import RigModel, effect_in

#: No machine keeps to a law exactly, so the parameters of an effect mean something a little different in the rig's law. Standard
#: deviations of that: as far as a correction of form has moved the value, and at least these shares of a size (of its distance
#: from neutral) or of what shapes the law (found in blind trials, docs/evidence/notes.md).
SIZE_BY_FORM, SHAPE_BY_FORM = 0.03, 0.1


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval, SI."""

    value: float
    low: float
    high: float
    unit: str


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


def effect_values(estimates: Estimates, effect: str, channel: int | None) -> dict[str, Interval]:
    """The parameters of an effect on a channel (None: of the whole rig)."""
    channel = min(estimates) if channel is None else channel
    estimate = estimates[channel]
    every = ((u, j) for j, u in enumerate(estimate.unknowns) if u.channel in (None, channel))
    return {u.parameter: _interval(estimate, j) for u, j in every if u.effect == effect}


def widened_by_form(effect: Effect, name: str, found: Interval, bare: Interval, row: float = 0.0) -> Interval:
    """The value of an effect's parameter with the interval widened by what the law's form leaves open, see `SIZE_BY_FORM`.

    `bare` is its value without corrections of form; `row` the time from row to row of the logs, s. A time is known to half of
    that at best: a filter that is calculated once a row, y += (1 - exp(-row / T)) (x - y), is late by T - row / 2.
    """
    parameter = effect.parameter(name)
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
        return Interval(value, value, value, u.unit)
    low, high = (float(np.clip(u.value(float(end[j])), u.low, u.high)) for end in (sure.low, sure.high))
    return Interval(value, low, high, u.unit)


def known_parameters(rig: RigModel, estimates: Estimates) -> Iterator[KnownParameter]:
    """The base parameters of every channel, with those of effects that the model as given has."""
    for c, estimate in estimates.items():
        for j, u in enumerate(estimate.unknowns):
            if u.channel in (None, c) and not u.effect:
                value, (effect, _, own) = _interval(estimate, j), u.name.rpartition(".")
                if effect:
                    value = widened_by_form(effect_in(rig, effect, c), own, value, value, row_of(rig, c))
                yield KnownParameter(u.name, c, rig.given(u.name, c), value, u.usual)


def absent_effects(rig: RigModel, estimates: Estimates) -> list[tuple[str, int]]:
    """The effects that the model as given has on a channel and the logs do not show: the intervals of all that carries the size
    hold the neutral values, and one excludes the given value."""
    sizes: dict[tuple[str, int], list[tuple[bool, bool]]] = {}
    for p in known_parameters(rig, estimates):
        effect, _, own = p.symbol.rpartition(".")
        if effect and (parameter := effect_in(rig, effect, p.channel).parameter(own)).carries_size:
            neutral = min(parameter.neutral, max(parameter.high, p.nominal))
            holds = p.estimate.low <= neutral <= p.estimate.high
            sizes.setdefault((effect, p.channel), []).append((holds, p.moved))
    return [key for key, own in sizes.items() if all(h for h, _ in own) and any(m for _, m in own)]


def row_of(rig: RigModel, channel: int) -> float:
    """The longest time from row to row of the logs of a channel, s."""
    return max(s.period / s.step for s in rig.segments[channel])


def estimated_model(rig: RigModel, estimates: Estimates, name: str) -> PlantModel:
    """The model with the estimated values put in."""
    of_rig = {f"{e.name}.{p.name}" for e in CATALOGUE.values() if e.scope == "rig" for p in e.parameters}
    pairs: dict[str, tuple[float, float]] = {}
    for c, estimate in estimates.items():
        for parameter, value in estimate.values(c).items():
            if parameter in rig.own and parameter != "Kq":
                continue
            pair = [*pairs.get(parameter, rig.model.pair(parameter))]
            pair[c] = float(value)
            pairs[parameter] = (pair[c], pair[c]) if parameter in of_rig else (pair[0], pair[1])
    return rig.model.with_values(rig.written(pairs), name)
