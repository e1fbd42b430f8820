"""Settings of a controller's parts: small frozen dataclasses, every field with a unit and a reason for its value.

    @dataclass(frozen=True)
    class ReferenceSettings:
        rate: float = setting(42.0, "1/s", "how fast the reference runs to the set-point", TUNED)

Compiled code takes no dataclass: `numbers_of` makes a named tuple class of the same fields, `numbers` fills it.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import field, fields
from typing import Any

TUNED = "tuned on `train`"
"""Found by an evolution strategy, or by trial, on pairs of the split `train`; docs/evidence/notes.md has the trials."""
HAND = "set by hand"
"""Chosen once, never searched for."""


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
