"""What a practice rig hides: effects, their sizes, and base parameters that differ from the given model's.

Every seed has sizes of its own. A severity is a range of multiples of the catalogue's typical size, from what is barely
visible to the end of what is plausible; the draw is log-uniform within it and within the parameter's bounds. What gives
shape, not size, is drawn as well. None of it is taken from what a diagnosis assumes or begins with.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, check_known
from ..limits import Limits
from ..plant import CATALOGUE, PARAMETERS, Effect, Parameter, PlantModel, Scales, parameter_of, scales_of

#: Sizes, as multiples of the typical distance of a parameter from its neutral value: least and greatest.
SEVERITIES: dict[str, tuple[float, float]] = {"small": (0.2, 0.5), "medium": (0.4, 2.0), "large": (1.5, 3.0)}
#: Base parameters that `base_error` makes wrong.
UNCERTAIN = ("D", "J", "B", "Km", "beta", "m", "R", "L", "alpha", "k", "Kq", "Fc", "Fs")
#: What only shapes an effect is drawn within this factor of its usual value, both ways.
_SHAPE_FACTOR = 3.0
#: A drift slower than the log would not be seen: its time constant is drawn between these shares of the log's length.
_DRIFT = (0.15, 1.5)


@dataclass(frozen=True)
class Hidden:
    """An effect that acts on a channel: "1", "2", "both" or (effects of the whole rig) "rig"; parameters in SI."""

    name: str
    channel: str
    parameters: Mapping[str, float]


# --- the words of the command -----------------------------------------------------------------------------------------
def parse_effects(words: Iterable[str]) -> dict[str, str]:
    """`["dead_zone:1", "supply_droop"]` -> `{"dead_zone": "1", "supply_droop": "rig"}`.

    Without a channel both have the effect. InputError for an unknown effect or channel, or one that is named twice.
    """
    chosen: dict[str, str] = {}
    for word in words:
        name, _, channel = word.partition(":")
        check_known("unknown effect", [name], CATALOGUE)
        of_rig = CATALOGUE[name].scope == "rig"
        channel = channel or ("rig" if of_rig else "both")
        if of_rig and channel != "rig":
            raise InputError(f"{word}: {name} acts on the whole rig; leave the channel out")
        if channel not in (("rig",) if of_rig else ("1", "2", "both")):
            raise InputError(f"{word}: unknown channel {channel!r}; a channel is 1, 2 or both")
        if name in chosen:
            raise InputError(f"{word}: {name} is named twice; name it once, with channel 1, 2 or both")
        chosen[name] = channel
    return chosen


def parse_values(words: Iterable[str]) -> dict[str, float]:
    """`["dead_zone.overlap_positive=7e-5"]` -> `{"dead_zone.overlap_positive": 7e-5}` (SI). InputError if malformed."""
    values: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise InputError(
                f"{word}: expected EFFECT.PARAMETER=NUMBER in SI units, e.g. dead_zone.overlap_positive=7e-5"
            )
    return values


def _scales(given: PlantModel, channel: str) -> Scales:
    """What sizes of effects on a channel are usual on a rig like `given`."""
    return scales_of(given, {"1": 0, "2": 1}.get(channel))


def check_values(values: Mapping[str, float], effects: Mapping[str, str], given: PlantModel) -> None:
    """InputError unless every `effect.parameter` is of an effect to hide and within its bounds on a rig like `given`."""
    for key, value in values.items():
        name = key.partition(".")[0]
        if name not in effects:
            raise InputError(
                f"{key}: {name!r} is not among the effects to hide ({', '.join(effects) or 'none'})"
            )
        p = _scales(given, effects[name]).parameter(parameter_of(key))
        if value != p.nominal:
            Limits(p.low, p.high, unit=p.unit).check(value, key)


# --- drawing ----------------------------------------------------------------------------------------------------------
def _between(low: float, high: float, share: float) -> float:
    """A value between two positive ones, log-uniform where `share` is uniform in 0 to 1."""
    return float(low * (high / low) ** share)


def _inside(p: Parameter, low: float, high: float, share: float) -> float:
    """The same, within the parameter's bounds."""
    low, high = (min(max(v, p.low), p.high) for v in (low, high))
    return _between(low, high, share)


def _shape(p: Parameter, duration: float, share: float) -> float:
    """A parameter that gives shape, not size."""
    if p.role == "time_constant" and p.nominal > duration:
        return _inside(p, _DRIFT[0] * duration, _DRIFT[1] * duration, share)
    if p.role == "order":  # teeth, pistons or lobes to a turn
        return float(math.floor(p.low + share * (p.high - p.low + 1.0)))
    if p.log:
        return _inside(p, p.nominal / _SHAPE_FACTOR, p.nominal * _SHAPE_FACTOR, share)
    return p.low + share * (p.high - p.low) if math.isfinite(p.high - p.low) else p.nominal


def _size(p: Parameter, severity: str, share: float, turned: bool) -> float:
    """A parameter that gives size; `turned`: to the other side of the neutral value, where both make sense."""
    least, most = SEVERITIES[severity]
    if p.role == "limit":  # the lower it is the more it does
        return _inside(p, p.typical / math.sqrt(most), p.typical / math.sqrt(least), share)
    by_factor = p.log and p.nominal > 0.0

    def away(value: float) -> float:
        return math.log(value / p.nominal) if by_factor else value - p.nominal

    step = away(p.typical)
    if turned and p.low < p.nominal < p.high:
        step = -step
    room = away(p.high if step > 0.0 else p.low) / step
    moved = step * _between(min(least, room), min(most, room), share)
    value = p.nominal * math.exp(moved) if by_factor else p.nominal + moved
    return min(max(value, p.low), p.high)


def _draw(effect: Effect, severity: str, duration: float, rng: np.random.Generator) -> dict[str, float]:
    """Values of all parameters of an effect."""
    found = {}
    for p in effect.parameters:
        share, side = rng.random(2)  # drawn always: a seed means the same rig
        sized = p.carries_size
        found[p.name] = (
            _size(p, severity, share, turned=bool(side < 0.5)) if sized else _shape(p, duration, share)
        )
    for p in effect.parameters:
        if p.not_below:
            found[p.not_below], found[p.name] = sorted((found[p.not_below], found[p.name]))
    return found


def choose(
    given: PlantModel, effects: Mapping[str, str], values: Mapping[str, float], severity: str, duration: float,
    rng: np.random.Generator,
) -> Iterator[Hidden]:  # fmt: skip
    """What is hidden in a rig like `given`: `effects` {name: channel} with drawn parameters, but for the `values`
    {effect.parameter: SI}.

    InputError if an effect would be neutral.
    """
    for name, channel in effects.items():
        # Everything is drawn, so that an explicit value changes no other one.
        chosen = _draw(_scales(given, channel).effect(CATALOGUE[name]), severity, duration, rng)
        chosen |= {own: values[key] for own in chosen if (key := f"{name}.{own}") in values}
        if CATALOGUE[name].is_neutral(chosen):
            raise InputError(
                f"{name}: with these values nothing is hidden; a size away from the neutral one is needed"
            )
        yield Hidden(name, channel, chosen)


# --- the rig ----------------------------------------------------------------------------------------------------------
def true_model(
    given: PlantModel, hidden: Sequence[Hidden], base_error: float, rng: np.random.Generator
) -> tuple[PlantModel, dict[str, Any]]:
    """The model that makes the logs, and what is wrong with the base parameters of the given one."""
    changed: dict[str, list[float]] = {}
    for name in UNCERTAIN if base_error else ():
        p, old = PARAMETERS[name], np.array(given.pair(name))
        new = old * (1.0 + base_error * rng.uniform(-1.0, 1.0, 2))
        changed[name] = np.clip(new, np.minimum(p.low, old), np.maximum(p.high, old)).tolist()
    if changed:
        # Static friction is never below sliding friction.
        changed["Fs"] = list(map(max, changed["Fs"], changed["Fc"]))
    wrong = {
        f"{name}_{c + 1}": {"nominal": given.value(name, c), "value": new[c], "unit": PARAMETERS[name].unit}
        for name, new in changed.items()
        for c in (0, 1)
    }
    true = given.with_values(changed, name="rig")
    for h in hidden:
        acts_on = h.channel != "2", h.channel != "1"
        for c, acts in enumerate(given.effects.get(h.name, ())):
            if acts_on[c] and not CATALOGUE[h.name].is_neutral(acts):
                raise InputError(
                    f"{h.name}: model {given.name!r} has this effect on channel {c + 1} already; "
                    "hide another effect, or begin with a model without this one"
                )
        values = {f"{h.name}.{own}": value for own, value in h.parameters.items()}
        true = true.with_values({n: np.where(acts_on, v, true.pair(n)) for n, v in values.items()})
    return true, wrong
