"""What the name of a column says: its words, what they mean, and its unit."""

import re
from functools import cache
from itertools import pairwise

from hydro_env.errors import InputError
from hydro_env.reading import shipped_yaml
from hydro_env.units import Unit, unit

_PLAIN = str.maketrans({"ö": "oe", "ü": "ue", "ä": "ae", "Ö": "Oe", "Ü": "Ue", "Ä": "Ae", "ß": "ss"})
_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
#: Where a word ends: before a capital, at a digit.
_SEAMS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])")


@cache
def _known() -> tuple[dict[str, str], dict[str, str], list[str]]:
    """What the words of words.yaml mean, what its symbols mean, and the words that are found inside of others, longest first."""
    content = shipped_yaml(__package__, "words.yaml")
    meaning = {word: meant for meant, text in content["words"].items() for word in text.split()}
    inside = sorted((word for word in meaning if len(word) > 3 and word != "last"), key=len, reverse=True)
    return meaning, content["symbols"], inside


def words(name: str) -> list[str]:
    """`motorSpeed_1 [1/min]` -> motor, speed, 1: in lower case, without what stands in brackets."""
    bare = _BRACKETS.sub(" ", name).translate(_PLAIN)
    return [word.lower() for word in re.split(r"[^0-9A-Za-z]+", _SEAMS.sub(" ", bare)) if word]


def meanings(name: str) -> set[str]:
    """What the words of a name mean, keys of words.yaml; "symbol" if all of it is from a letter or two."""
    meaning, symbol, long = _known()
    found: set[str] = set()
    symbols: set[str] = set()
    each = words(_without_ending(name)[0])
    for pair in pairwise(each):  # x dot, set point
        if (joined := "".join(pair)) in meaning and len(joined) > 3:
            found.add(meaning[joined])
            each = [word for word in each if word not in pair]
    for word in each:
        if word in symbol:
            symbols.add(symbol[word])
        elif word in meaning:
            found.add(meaning[word])
        elif not word.isdigit():
            inside = [known for known in long if known in word]
            longest = [known for n, known in enumerate(inside) if not any(known in one for one in inside[:n])]
            found |= {meaning[known] for known in longest} or ({"unknown"} if not unit_of(word) else set())
    found.discard("neutral")
    if symbols and not found - {"demanded", "order", "valve"}:
        found |= symbols | {"symbol"}
    return found


def unit_of(text: str) -> Unit | None:
    """The unit that a text stands for, if it does; a number or nothing is none."""
    try:
        return None if not text.strip() or text.strip().isdigit() else unit(text.strip())
    except InputError:
        return None


def bracketed(name: str) -> Unit | None:
    """The unit in brackets: `p1 [kPa]`, `Current (mA) - Plot 0`."""
    return next((found for text in reversed(_BRACKETS.findall(name)) if (found := unit_of(text))), None)


def named_unit(name: str) -> tuple[Unit | None, bool]:
    """The unit in brackets or in the last words (`flow_lpm_2`, `commanded_deg_s`, `Speed rad/s`), and whether it is surely one:
    one or two letters may mean something else (p_A, u_in)."""
    found = bracketed(name)
    return (found, True) if found else _without_ending(name)[1:]


def _without_ending(name: str) -> tuple[str, Unit | None, bool]:
    parts = [part for part in re.split(r"[_\s]+", _BRACKETS.sub(" ", name)) if part and part != "per"]
    numbers = []
    while parts and parts[-1].isdigit():
        numbers.append(parts.pop())
    for many in (2, 1):
        if len(parts) > many and (found := unit_of("/".join(parts[-many:]))):
            return "_".join([*parts[:-many], *numbers]), found, many > 1 or len(parts[-1]) > 2
    return "_".join([*parts, *numbers]), None, False
