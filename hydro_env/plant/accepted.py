"""Which values and models are accepted: those that a component can have and that are simulated correctly."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from ..errors import InputError
from .catalogue import CATALOGUE
from .catalogue.effect import arguments
from .parameters import Parameter
from .stiffness import (
    LEAST_FRICTION,
    MOST_FINER,
    MOST_PEAK,
    SPOOL,
    bristles_left,
    friction_left,
    greatest_force,
    parts_wanted,
)

if TYPE_CHECKING:
    from .model import PlantModel

__all__ = ["accepted", "check_spool", "inside", "out_of_range", "with_unit"]

#: A stiff channel takes a substep in at most 64 parts, of which the last third is a reserve.
_MOST_PARTS = 40.0
#: Substep over the time constant of the coil, at most, where an effect follows the rate of the current; in 64 parts.
_MOST_COIL = 12.5
#: Substep times the natural frequency of line and motor, at most, where effects act. `rig` is right at 7, and not at 70.
_MOST_RINGING = 20.0
#: Room for the rounding of a value that stands at an end.
_AT_END = 1e-9


def out_of_range(value: float, p: Parameter) -> str:
    """What is wrong with a value that is not simulated correctly or that no component has, "" if nothing is."""
    low, high = p.possible
    if value == p.neutral or inside(value, p.possible):
        return ""
    ends = f"{low:g} to {with_unit(high, p)}" if high < math.inf else f"{with_unit(low, p)} or more"
    return f"{with_unit(value, p)} is out of range; {p.title} is {ends}"


def accepted(ends: tuple[float, float]) -> tuple[float, float]:
    """A range with room for rounding at its ends."""
    room = _AT_END * max((abs(end) for end in ends if math.isfinite(end)), default=0.0)
    return ends[0] - room, ends[1] + room


def inside(value: float, ends: tuple[float, float]) -> bool:
    """Whether a value is in a range, as far as rounding goes."""
    low, high = accepted(ends)
    return low <= value <= high


def check_spool(model: PlantModel, channel: int, where: str) -> None:
    """InputError for a spool that no substep resolves or no stop holds: its mass or stop is too small."""
    values = {name: model.value(name, channel) for name in SPOOL}
    greater, lesser = max(values["Fc"], values["Fs"]), min(values["Fc"], values["Fs"])
    least_friction = min(LEAST_FRICTION, greater / MOST_PEAK)
    if lesser < (1.0 - _AT_END) * least_friction:
        raise InputError(
            f"{where}: channel {channel + 1} has {values['Fc']:g} N of Coulomb and {values['Fs']:g} N of static friction;"
            f" {least_friction:.3g} N or more of either can be simulated, or 0 of both"
        )
    for effect in map(CATALOGUE.__getitem__, model.declared):
        for base, own in effect.adds_to.items():
            values[base] += model.value(f"{effect.name}.{own}", channel)
        for base, own in effect.limits.items():
            values[base] = min(values[base], model.value(f"{effect.name}.{own}", channel))
    _check_coil(model, channel, where)
    _check_corners(model, channel, where)
    _check_shaft(model, channel, where)
    force = greatest_force(*(values[name] for name in ("alpha", "R", "k", "x_max", "u_rated")))
    least = force / values["x_max"] - 2.0 * values["k"]  # the stop yields by the stroke
    if values["k_stop"] < least:
        raise InputError(
            f"{where}: channel {channel + 1}: k_stop is {values['k_stop']:g}; against {force:.3g} N of the coil {least:.3g} N/m"
            " or more can be simulated"
        )
    Fc, Fs = (friction_left(values[a], values[b]) for a, b in (("Fc", "Fs"), ("Fs", "Fc")))
    soft = bristles_left(Fc, Fs) if max(values["Fc"], values["Fs"]) > 0.0 else 0.0
    values |= {"Fc": Fc, "Fs": Fs, "s0": soft * values["s0"], "s1": soft * values["s1"]}

    def parts(mass: float) -> float:
        return parts_wanted(model.substep, {**values, "m": mass})

    if parts(values["m"]) > _MOST_PARTS:
        low, high = values["m"], 1e6 * values["m"]
        for _ in range(60):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if parts(middle) > _MOST_PARTS else (low, middle)
        raise InputError(
            f"{where}: channel {channel + 1}: m is {values['m']:g}; with these Fc, Fs, s0, s1 and k_stop {high:.3g} kg or more"
            " can be simulated"
        )


def _check_coil(model: PlantModel, channel: int, where: str) -> None:
    """InputError for a coil that is too quick for an effect that follows the rate of the current."""
    if not any(CATALOGUE[name].reads("current_rate") for name in model.declared):
        return
    least = model.substep * model.value("R", channel) / _MOST_COIL
    if model.value("L", channel) < (1.0 - _AT_END) * least:
        raise InputError(
            f"{where}: channel {channel + 1}: L is {model.value('L', channel):g}; with a hysteresis that follows the current"
            f" {least:.3g} H or more can be simulated"
        )


def _check_shaft(model: PlantModel, channel: int, where: str) -> None:
    """InputError for a motor that rings too quickly against its line: effects on either are then not followed."""
    D, J, beta, V = (model.value(name, channel) for name in ("D", "J", "beta", "V"))
    most = _MOST_RINGING / model.substep * math.sqrt(V * J / beta)
    if model.declared and (1.0 + _AT_END) * most < D:
        raise InputError(
            f"{where}: channel {channel + 1}: D is {D:g}; with these J, beta, V and with effects {most:.3g} m3/rad or less can be"
            " simulated"
        )


def _check_corners(model: PlantModel, channel: int, where: str) -> None:
    """InputError for a valve, throttle, leakage or dry friction that is too quick for its volume or inertia."""
    for effect in map(CATALOGUE.__getitem__, model.declared):
        if effect.least_parts is None:
            continue
        own = {p.name: model.value(f"{effect.name}.{p.name}", channel) for p in effect.parameters}
        if effect.is_neutral(own):
            continue
        asked = [n for n in arguments(effect.least_parts) if n != "substep"]
        values = {n: own[n] if n in own else model.value(n, channel) for n in asked}
        wanted = partial(_wanted, effect.least_parts, model.substep, values)
        most = MOST_FINER * effect.corner_parts
        if wanted((), 1.0) > (1.0 + _AT_END) * most:
            # Those of which more would be worse still; a larger volume, say, would help.
            sizes = [n for n in asked if n in own and wanted((n,), 4.0) > wanted((), 1.0)]
            share = _largest_share(partial(wanted, sizes), most)
            p = effect.parameter(max(sizes, key=values.__getitem__))
            others = ", ".join(n for n in asked if n not in sizes)
            raise InputError(
                f"{where}: channel {channel + 1}: {effect.name}.{p.name} is {with_unit(own[p.name], p)}; with these {others}"
                f" {with_unit(float(f'{share * own[p.name]:.3g}'), p)} or less can be simulated"
            )


def _wanted(
    law: Callable[..., float], substep: float, values: dict[str, float], names: Sequence[str], share: float
) -> float:
    """How many parts a law wants, with so many times the values of these names."""
    return float(law(substep=substep, **values | {n: share * values[n] for n in names}))


def _largest_share(wanted: Callable[[float], float], most: float) -> float:
    """The share in [0, 1] at which `wanted`, which grows with it, reaches `most`."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if wanted(middle) <= most else (low, middle)
    return low


def with_unit(value: float, parameter: Parameter) -> str:
    """A value as text, with its unit."""
    return f"{value:g}" if parameter.unit == "1" else f"{value:g} {parameter.unit}"
