"""What the name of a column says: its words and its unit."""

from __future__ import annotations

import re

from hydro_env.errors import InputError
from hydro_env.units import Unit, unit

__all__ = ["bracketed", "ending", "unit_of", "words"]

_PLAIN = str.maketrans({"ö": "oe", "ü": "ue", "ä": "ae", "Ö": "Oe", "Ü": "Ue", "Ä": "Ae", "ß": "ss"})
_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
#: Where a word ends: before a capital, at a digit.
_SEAMS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])")


def words(name: str) -> list[str]:
    """`motorSpeed_1 [1/min]` -> motor, speed, 1: in lower case, without what stands in brackets."""
    bare = _BRACKETS.sub(" ", name).translate(_PLAIN)
    return [word.lower() for word in re.split(r"[^0-9A-Za-z]+", _SEAMS.sub(" ", bare)) if word]


def unit_of(text: str) -> Unit | None:
    """The unit that a text stands for, if it does; a number or nothing is none."""
    try:
        return None if not text.strip() or text.strip().isdigit() else unit(text.strip())
    except InputError:
        return None


def bracketed(name: str) -> Unit | None:
    """The unit in brackets: `p1 [kPa]`, `Current (mA) - Plot 0`."""
    return next((found for text in reversed(_BRACKETS.findall(name)) if (found := unit_of(text))), None)


def ending(name: str) -> Unit | None:
    """The unit that the last words are: `time_s`, `flow_lpm_2`, `commanded_deg_s`, `Speed rad/s`."""
    parts = [part for part in re.split(r"[_\s]+", _BRACKETS.sub(" ", name)) if part and part != "per"]
    while parts and parts[-1].isdigit():
        parts.pop()
    for many in (2, 1):
        if len(parts) > many and (found := unit_of("/".join(parts[-many:]))):
            return found
    return None
