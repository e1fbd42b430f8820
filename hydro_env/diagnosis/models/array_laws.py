"""The catalogue's laws on whole arrays: for models that are evaluated sample by sample rather than integrated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from ...plant import CATALOGUE, Effect
from ...plant.catalogue.effect import arguments, called_by

__all__ = ["apply_laws", "elementwise"]


@cache
def elementwise(law: Callable[..., float]) -> Callable[..., Any]:
    """A law of the catalogue, which is written for numbers, as a compiled function of arrays."""
    from numba import vectorize

    for helper in called_by(law):
        _callable_when_compiled(helper)
    return vectorize(law)


@cache
def _callable_when_compiled(helper: Callable[..., float]) -> None:
    """Has compiled functions call a plain one."""
    from numba.extending import register_jitable

    register_jitable(helper)


def apply_laws(quantity: str, value: np.ndarray, effects: list[str], known: Mapping[str, Any]) -> np.ndarray:
    """`value` passed through the laws that these effects have for `quantity`.

    `known` holds signals, base parameters and "effect.parameter" values that broadcast against `value`.
    """
    for name in effects:
        effect = CATALOGUE[name]
        law = effect.laws.get(quantity)
        if law is not None:
            value = elementwise(law)(value, *(argument(effect, a, known) for a in arguments(law)[1:]))
    return value


def argument(effect: Effect, name: str, known: Mapping[str, Any]) -> Any:
    """What an argument of a law stands for: the effect's own parameter or state, a signal, or a base parameter."""
    own = f"{effect.name}.{name}"
    return known[own] if own in known else known[name]
