"""Settings of a controller's parts: small frozen dataclasses, every field with a unit and a reason for its value.

    @dataclass(frozen=True)
    class ReferenceSettings:
        rate: float = setting(42.0, "1/s", "how fast the reference runs to the set-point", TUNED)

`from_table` builds them from nested tables, as of a YAML or JSON file. Compiled code takes no dataclass: `numbers_of` makes a
named tuple class of the same fields, `numbers` fills it.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, is_dataclass
from typing import Any, TypeVar, get_args, get_type_hints

from hydro_env.errors import InputError, shown, suggestion

__all__ = ["HAND", "TUNED", "from_table", "numbers", "numbers_of", "setting"]

TUNED = "tuned on `train`"
"""Found by an evolution strategy, or by trial, on pairs of the split `train`; docs/explanation/agents.md tells how."""
HAND = "set by hand"
"""Chosen once, never searched for."""

S = TypeVar("S")


def setting(default: Any, unit: str, summary: str, reason: str = "") -> Any:
    """A field of a settings dataclass. `reason`: where the value comes from, unless the summary says it."""
    return field(default=default, metadata={"unit": unit, "summary": summary, "reason": reason})


def numbers_of(kind: type) -> Any:
    """A named tuple class for the fields of a settings dataclass; assign it to `Numbers` of the same module, by which name
    Numba's cache finds it again: `ReferenceNumbers = numbers_of(ReferenceSettings)`."""
    name = kind.__name__.replace("Settings", "Numbers")
    return namedtuple(name, [each.name for each in fields(kind)], module=kind.__module__)


def numbers(kind: Any, settings: Any) -> Any:
    """The settings as the named tuple class `kind` that `numbers_of` made."""
    return kind(*(getattr(settings, name) for name in kind._fields))


def from_table(kind: type[S], table: Any, where: str = "") -> S:
    """Settings of a dataclass from a table; fields that are left out keep their default. A field that is itself a settings
    dataclass takes a table; one that may be None takes null. InputError, which begins with `where`, for anything else."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}should be a table, found {type(table).__name__}")
    kinds, known = get_type_hints(kind), {each.name: each for each in fields(kind)}  # type: ignore[arg-type]
    values = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{where}{shown(key)} is unknown: {suggestion(key, known)}")
        values[key] = _value(f"{where}{key}: ", known[key], kinds[key], value)
    return kind(**values)


def _value(where: str, each: Field[Any], kind: Any, value: Any) -> Any:
    """One field's value, checked."""
    inner = [k for k in (kind, *get_args(kind)) if is_dataclass(k)]
    if inner:
        if value is None and type(None) in get_args(kind):
            return None
        return from_table(inner[0], value, where)  # type: ignore[arg-type]
    if kind is bool:
        if not isinstance(value, bool):
            raise InputError(f"{where[:-2]} {shown(value)} should be true or false")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e5:
        raise InputError(f"{where[:-2]} {shown(value)} should be a number below 100000")
    if each.default is not MISSING and each.default >= 0 and value < 0:
        raise InputError(f"{where[:-2]} {shown(value)} should be at least 0")
    return kind(value)
