"""What is estimated: numbers with a start, plausible bounds and a scale on which steps are of order one.

A calibrated base parameter has a prior about the value in the model as given; a parameter of an effect has none beyond
its bounds. Estimation works in the coordinate q: 0 at the centre, 1 one scale away (logarithmic where the parameter
varies by factors).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...plant import CATALOGUE, PARAMETERS, Effect, Parameter, parameter_of
from ...plant.parameters import SCALINGS

#: Largest standard deviation of the prior of a base parameter, relative (or share of its range): data sheets leave as much
#: open; and of friction, which dirt and wear change by factors.
PRIOR_SPREAD, FRICTION_SPREAD = 0.3, 0.5
#: Base parameters that an effect of the catalogue adds to may be larger by this factor only, a standard deviation of the others'
#: priors, exp(`PRIOR_SPREAD`): more has a name there.
BASE_OF_EFFECT_FACTOR = 1.35

#: Scale of a number that is known: a step of derivatives changes nothing.
HELD_SCALE = 1e-6

#: First looks at an effect: sizes over the typical one, so near to each other that a step (`STEP_FACTORS`) leads from one to the
#: next. What limits is first looked at with limits of the typical one over these:
#: it acts nowhere but beyond its limit, so that from too far away no derivative leads there.
SIZE_FACTORS = (0.35, 1.0, 2.2, -0.35, -1.0, -2.2)
LIMIT_FACTORS = (0.5, 1.0, 0.7, 1.4, 2.0)

#: Directions in which logs fix ratios only, by the base parameter that names each, and the base parameters that are scaled
#: together in it, with their powers (`Parameter.scaling`).
SCALED_TOGETHER: dict[str, dict[str, float]] = {
    direction: {p.name: p.scaling[direction] for p in PARAMETERS.values() if direction in p.scaling}
    for direction in SCALINGS
}


def less_taken(values: dict[str, float], effect: str, start: dict[str, float]) -> dict[str, float]:
    """The base parameters in `values` that an effect with the values `start` {own name: value} takes from, reduced by that."""
    taken = {p.part_of: start[p.name] for p in CATALOGUE[effect].parameters if p.part_of in values}
    return {name: max(values[name] - size, 0.25 * values[name]) for name, size in taken.items()}


@dataclass(frozen=True)
class Unknown:
    """One number to be estimated: a base parameter of the plant, or one of an `effect`.

    `prior` is whether leaving q = 0 costs anything; `channel` whose number it is, None for one that both channels share;
    `typical` the usual size of a parameter that carries its effect's.
    """

    parameter: str
    unit: str
    center: float
    low: float
    high: float
    scale: float
    log: bool
    prior: bool
    channel: int | None = None
    effect: str = ""
    typical: float = math.nan

    @cached_property
    def name(self) -> str:
        """The name in a model: "Kq" or "dead_zone.overlap_positive"."""
        return f"{self.effect}.{self.parameter}" if self.effect else self.parameter

    def value(self, q: float) -> float:
        return self.center * math.exp(self.scale * q) if self.log else self.center + self.scale * q

    def q(self, value: float) -> float:
        if self.log:
            return math.log(value / self.center) / self.scale
        return (value - self.center) / self.scale

    @cached_property
    def bounds(self) -> tuple[float, float]:
        """Bounds of q."""
        return self.q(self.low), self.q(self.high)

    @property
    def is_order(self) -> bool:
        """Whether it is a number of periods in a turn, of an effect that is sought."""
        return bool(self.effect) and CATALOGUE[self.effect].parameter(self.parameter).role == "order"

    def held(self, value: float) -> "Unknown":
        """The same at a value that is known."""
        return replace(self, center=value, low=value, high=value, scale=HELD_SCALE, log=False, prior=False)

    @cached_property
    def usual(self) -> tuple[float, float]:
        """The plausible values within one scale of the centre."""
        return max(self.value(-1.0), self.low), min(self.value(1.0), self.high)


def limited_by_effects() -> set[str]:
    """Base parameters that some effect adds to."""
    return {name for effect in CATALOGUE.values() for name in effect.adds_to}


def _plausible(parameter: Parameter, value: float) -> tuple[float, float]:
    """The plausible range of a base parameter that is given as `value`.

    A given value outside of the usual range is plausible all the same (a flywheel, another coil): the range then lies about
    it, as wide as in the table. So no range rests on a value of a machine of another size, and 0 is plausible where it is given
    or the table has it.
    """
    low, high = parameter.low, parameter.high
    if value > 0.0 and not low <= value <= high:
        wide = math.sqrt(high / low) if low > 0.0 else parameter.high / parameter.nominal
        low, high = (value / wide if low > 0.0 else 0.0), value * wide
    least, most = parameter.possible
    return min(max(low, least), value), max(min(high, most), value)


def base_unknown(parameter: Parameter, value: float, limited: bool = False) -> Unknown:
    """A base parameter, with the ranges that are usual on its rig, about the value `value` of the model as given; `limited` for
    one that an effect adds to."""
    low, high = _plausible(parameter, value)
    log = parameter.log and value > 0.0
    if log:
        low = max(low, value / 20.0)
        if limited:
            high = min(high, value * BASE_OF_EFFECT_FACTOR)
        scale = min(math.log(high / low) / 4.0, FRICTION_SPREAD if limited else PRIOR_SPREAD)
    else:
        scale = min((high - low) / 4.0, PRIOR_SPREAD * max(abs(value), 0.25 * (high - low)))
    return Unknown(parameter.name, parameter.unit, value, low, high, scale, log, True)


def given_unknown(name: str, p: Parameter, value: float) -> Unknown:
    """A parameter of an effect that the model as given has, named "EFFECT.PARAMETER", about its value there.

    Its range reaches to neutral, so that calibration can find that the effect is absent. Sizes change by dirt and wear, like
    friction. An angle at the beginning of a log is not known beforehand.
    """
    if p.role == "order":  # a number of teeth or pistons is known
        return Unknown(name, p.unit, value, value, value, HELD_SCALE, False, True)
    low, high = min(p.low, value), max(p.high, value)
    if math.isinf(high):
        high = 20.0 * max(abs(value), abs(low))
    if p.role == "size":
        low, high = min(low, p.neutral), max(high, p.neutral)
    spread = FRICTION_SPREAD if p.carries_size else PRIOR_SPREAD
    if low > 0.0 and (p.log or p.role == "limit"):
        return Unknown(name, p.unit, value, low, high, min(spread, math.log(high / low) / 4.0), True, True)
    usual = abs(p.typical - p.neutral) if p.carries_size else high - low
    scale = 0.15 * (high - low) if p.role == "phase" else spread * max(abs(value), 0.25 * usual)
    return Unknown(name, p.unit, value, low, high, min(scale, (high - low) / 4.0), False, p.role != "phase")


def within(unknown: Unknown, low: float, high: float) -> Unknown:
    """An unknown whose plausible range is known beforehand; the range is four standard deviations of its prior wide."""
    low = max(low, unknown.center / 20.0) if unknown.log else low
    wide = unknown.scale * (unknown.q(high) - unknown.q(low))
    return replace(unknown, low=low, high=high, scale=max(0.25 * wide, 1e-6), prior=True)


def effect_starts(effect: Effect, seconds: float, whole: bool = False) -> list[dict[str, float]]:
    """Values of the effect's parameters worth a first look: sizes together, small to large, with every shape.

    `seconds` is the length of the longest log: nobody sees a drift of minutes in seconds. What comes in many shapes is given
    in one size unless the `whole` list is wanted.
    """
    sizes = [p for p in effect.parameters if p.carries_size]
    shapes = [p for p in effect.parameters if not p.carries_size]
    factors = LIMIT_FACTORS if all(p.role == "limit" for p in sizes) else SIZE_FACTORS
    rows = [{p.name: _sized(p, factor) for p in sizes} for factor in factors]
    rows = [row for row in rows if all(v is not None for v in row.values())]
    if len({p.unit for p in sizes}) == 1 and len(sizes) == 2 and all(p.role == "size" for p in sizes):
        # Two sizes of a kind, such as the overlaps of the two directions, may be unequal.
        rows += [{p.name: _sized(p, 1.0 if p is alone else 0.0) for p in sizes} for alone in sizes]
    values = itertools.product(*(_shapes(p, seconds) for p in shapes))
    variants = [{p.name: value for p, value in zip(shapes, own, strict=True)} for own in values]
    if len(variants) > 3 and not whole:
        rows = rows[1:2]
    rows = [{**row, **shape} for row in rows for shape in variants]
    return rows  # type: ignore[return-value]


def _sized(p: Parameter, factor: float) -> float | None:
    if p.role == "limit":
        return min(p.typical / factor, 0.95 * p.high) if factor > 0.0 else None
    if p.log and p.nominal > 0.0:
        value = p.nominal * math.exp(math.log(p.typical / p.nominal) * factor)
    else:
        value = p.nominal + (p.typical - p.nominal) * factor
    return value if p.low <= value <= p.high else None


def _shapes(p: Parameter, seconds: float) -> list[float]:
    if p.role == "phase":
        return [-0.75 * math.pi, -0.25 * math.pi, 0.25 * math.pi, 0.75 * math.pi]
    if p.role == "order":
        return [float(n) for n in range(math.ceil(p.low), math.floor(p.high) + 1)]
    if p.role == "time_constant" and p.nominal > seconds:
        return [min(max(0.4 * seconds, p.low), p.high)]
    return list(p.starts) or [p.nominal]


def effect_unknowns(effect: Effect, start: dict[str, float]) -> list[Unknown]:
    """The parameters of an effect; `start` gives their values {own name: value} at the first look."""
    return [_effect_unknown(effect.name, p, start[p.name]) for p in effect.parameters]


def _effect_unknown(effect: str, p: Parameter, start: float) -> Unknown:
    shape = not p.carries_size
    low, high = min(p.low, start), max(p.high, start)
    if p.low > 0.0 and (p.log or p.role == "limit"):
        scale = 0.5 if shape else 0.25
        return Unknown(p.name, p.unit, start, low, high, scale, True, shape, effect=effect, typical=p.typical)
    order = p.role == "order"
    scale = 0.1 if order else 0.15 * (p.high - p.low) if shape else abs(p.typical - p.nominal)
    prior = shape and not order
    return Unknown(p.name, p.unit, start, low, high, scale, False, prior, effect=effect, typical=p.typical)


def scaled(unknowns: Sequence[Unknown], q: np.ndarray, j: int, size: float) -> np.ndarray:
    """The change of q (n,) that scales all that the direction of unknown j (`SCALED_TOGETHER`) has on its channel, as a step
    `size` of j does.

    On the spool all that moves it is scaled but the damping and the bristles, which are not calibrated. What logs
    say of such a direction is little, so it must be seen as one, not as a difference of large changes.
    """
    own = unknowns[j]
    factor = own.value(float(q[j]) + size) / own.value(float(q[j]))
    change = np.zeros(len(unknowns))
    for n, u in enumerate(unknowns):
        power = parameter_of(u.name).scaling.get(own.name, 0.0) if u.channel in (None, own.channel) else 0.0
        if power:
            value = u.value(float(q[n]))
            change[n] = u.q(value * factor**power) - q[n]
    return change
