"""What corrections of form have in common: they are fitted numbers, and no physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ...parameters import SPOOL_FORCE, Parameter
from ..effect import Effect, State

#: The family of these effects.
FAMILY = "shape"

NO_PHYSICS = "a correction of form, fitted; no physics"


def amount(
    name: str, unit: str, typical: float, note: str, low: float | None = None, scaling: Mapping[str, float] | None = None
) -> Parameter:  # fmt: skip
    """A number of a correction: neutral at 0, up to four times `typical` either way."""
    low = -4.0 * typical if low is None else low
    return Parameter(name, unit, 0.0, low, 4.0 * typical, NO_PHYSICS, note, typical, scaling=scaling or {})


def repeated(name: str, unit: str, nominal: float, low: float, high: float, **more: Any) -> Parameter:
    return Parameter(name, unit, nominal, low, high, NO_PHYSICS, "repeats what is corrected", **more)


def taken(name: str, unit: str, low: float, typical: float) -> Parameter:
    """What a correction takes away of a force to which the effect has added it."""
    note = "repeats what is corrected, taken away"
    return Parameter(name, unit, 0.0, low, 0.0, NO_PHYSICS, note, -typical, scaling=SPOOL_FORCE)


def correction(
    name: str, port: str, summary: str, parameters: tuple[Parameter, ...], laws: Mapping[str, Callable[..., float]],
    corrects: Mapping[str, Mapping[str, str | float]], states: tuple[State, ...] = (), **more: Any,
) -> Effect:  # fmt: skip
    return Effect(
        name=name, port=port, parameters=parameters, summary=summary, signature="what the form of a named effect leaves",
        source=NO_PHYSICS, laws=laws, corrects=corrects, states=states, family=FAMILY, **more,
    )  # fmt: skip
