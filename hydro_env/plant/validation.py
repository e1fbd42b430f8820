"""Which values and models are accepted: those that a component can have and that are simulated correctly."""

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from ..errors import InputError
from ..units import with_unit
from .catalogue.effect import CATALOGUE, parameter_of
from .friction import MAX_PEAK, MIN_FRICTION
from .parameters import Parameter
from .scales import PAPER, Rig, scales_of

if TYPE_CHECKING:
    from .model import PlantModel

#: Room for the rounding of a value that stands at an end.
_AT_END = 1e-9
#: Fastest ring of a motor against its line, rad/s: a thousand times that of the paper's, some thousand steps in a control period.
_FASTEST_RING = 1e5


def out_of_range(value: float, p: Parameter) -> str:
    """What is wrong with a value that is not simulated correctly or that no component has, "" if nothing is."""
    low, high = p.possible
    if value == p.neutral or inside(value, p.possible):
        return ""
    ends = f"{low:g} to {with_unit(high, p.unit)}" if high < math.inf else f"{with_unit(low, p.unit)} or more"
    return f"{with_unit(value, p.unit)} is out of range; {p.title} is {ends}"


def accepted(ends: tuple[float, float]) -> tuple[float, float]:
    """A range with room for rounding at its ends."""
    room = _AT_END * max((abs(end) for end in ends if math.isfinite(end)), default=0.0)
    return ends[0] - room, ends[1] + room


def inside(value: float, ends: tuple[float, float]) -> bool:
    """Whether a value is in a range, as far as rounding goes."""
    low, high = accepted(ends)
    return low <= value <= high


def wrong_values(model: Rig, names: Iterable[str]) -> Iterator[tuple[str, int, str]]:
    """Which of these values of a model are out of range on a rig of its size: name, channel, and what is wrong. Those by which
    the size goes come first."""
    sizes = PAPER, PAPER
    for name in sorted(names, key=lambda name: not parameter_of(name).absolute):
        if not parameter_of(name).absolute and sizes[0] is PAPER:
            sizes = scales_of(model, 0), scales_of(model, 1)
        for channel in (0, 1):
            p = sizes[channel].parameter(parameter_of(name))
            if wrong := out_of_range(model.value(name, channel), p):
                yield name, channel, wrong


def check_channel(model: "PlantModel", channel: int, where: str) -> None:
    """InputError for a spool whose dry friction is too small to be simulated, or that no stop holds, and for a motor that rings
    against its line faster than can be followed."""
    names = ("alpha", "R", "k", "Fc", "Fs", "x_max", "k_stop", "u_rated", "D", "J", "V", "beta")
    values = {name: model.value(name, channel) for name in names}
    greater, lesser = max(values["Fc"], values["Fs"]), min(values["Fc"], values["Fs"])
    least_friction = min(MIN_FRICTION, greater / MAX_PEAK)
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
    # No limit of the command counts as 300 V.
    pull = values["alpha"] * min(values["u_rated"], 300.0) / values["R"]
    force = max(pull, values["k"] * values["x_max"])
    least = force / values["x_max"] - 2.0 * values["k"]  # the stop yields by the stroke
    if values["k_stop"] < least:
        raise InputError(
            f"{where}: channel {channel + 1}: k_stop is {values['k_stop']:g}; against {force:.3g} N of the coil {least:.3g} N/m"
            " or more can be simulated"
        )
    largest = _FASTEST_RING * math.sqrt(values["J"] * values["V"] / values["beta"])
    if values["D"] > (1.0 + _AT_END) * largest:
        raise InputError(
            f"{where}: channel {channel + 1}: D is {values['D']:g}; with these J, V and beta {largest:.3g} m3/rad or less can be"
            " simulated"
        )
