"""What corrections of form have in common: they are fitted numbers, and no physics."""

from functools import partial
from math import nan
from typing import Any

from ...parameters import SPOOL_FORCE, Parameter
from ..effect import Effect

#: The family of these effects.
FAMILY = "shape"

NO_PHYSICS = "a correction of form, fitted; no physics"


def fitted(
    name: str, unit: str, nominal: float, low: float, high: float, note: str, typical: float = nan, **more: Any
) -> Parameter:  # fmt: skip
    """A number of a correction."""
    return Parameter(name, unit, nominal, low, high, NO_PHYSICS, note, typical, **more)


def amount(name: str, unit: str, typical: float, note: str, least: float = -4.0, **more: Any) -> Parameter:
    """One that is neutral at 0, from `least` to four times `typical`."""
    return fitted(name, unit, 0.0, least * typical, 4.0 * typical, note, typical, **more)


def repeated(name: str, unit: str, nominal: float, low: float, high: float, **more: Any) -> Parameter:
    return fitted(name, unit, nominal, low, high, "repeats what is corrected", **more)


def taken(name: str, low: float, typical: float) -> Parameter:
    """What a correction takes away of a force to which the effect has added it."""
    note = "repeats what is corrected, taken away"
    return fitted(name, "N", 0.0, low, 0.0, note, -typical, scaling=SPOOL_FORCE)


correction = partial(
    Effect, signature="what the form of a named effect leaves", source=NO_PHYSICS, family=FAMILY
)
