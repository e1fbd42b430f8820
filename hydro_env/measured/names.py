"""What the name of a column says: its words, what they mean, and its unit."""

from __future__ import annotations

import re
from itertools import pairwise

from hydro_env.errors import InputError
from hydro_env.units import Unit, unit

_PLAIN = str.maketrans({"ö": "oe", "ü": "ue", "ä": "ae", "Ö": "Oe", "Ü": "Ue", "Ä": "Ae", "ß": "ss"})
_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
#: Where a word ends: before a capital, at a digit.
_SEAMS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])")
#: Words by what they mean. Words of four letters and more are also found inside of longer ones (Drehzahlsollwert).
_WORDS = {
    "time": "time zeit timestamp zeitstempel clock temps xvalue",
    "demanded": "setpoint set ref reference soll sollwert desired target demand nref commanded",
    "order": "cmd command stell stellgroesse stellsignal stellwert ansteuerung steuersignal pwm duty",
    "valve": "valve ventil control steuer drive input",
    "voltage": "volt volts voltage spannung",
    "source": "battery batterie batt akku vbat bus supply versorgung psupply psys sys system netz pump pumpe",
    "tank": "tank return ruecklauf leak leck",
    "temperature": "temp temperature temperatur toil degc",
    "oil": "oel oil",
    "current": "current strom coil amp ampere",
    "spool": "spool schieber lvdt",
    "load": "load torque moment last lastmoment drehmoment tau force kraft",
    "flow": "flow durchfluss volumenstrom",
    "pressure": "pressure druck differenzdruck",
    "speed": "speed rpm vel velocity drehzahl omega xdot geschwindigkeit",
    "position": "pos position angle winkel weg kolbenweg theta phi stroke hub lage distance displacement",
    "counts": "encoder enc count counts ticks",
    "foreign": "error err fehler abweichung pid integral status flag state mode quat quaternion gyro accel imu gps roll pitch"
    " yaw",
    "neutral": "left right links rechts l r main jib a b motor cyl cylinder zyl zylinder axis achse kanal channel ch ist istwert"
    " act actual meas measured dcv sensor signal value wert kolben piston filtered filt raw line port in out",
}  # fmt: skip
#: Symbols of quantities: they count where nothing but neutral words stands beside them.
_SYMBOLS = {
    "t": "time", "u": "order", "y": "valve", "i": "current", "n": "speed", "w": "speed", "v": "speed", "p": "pressure",
    "dp": "pressure", "pl": "pressure", "pa": "pressure", "pb": "pressure", "ps": "source", "pt": "tank", "q": "flow",
    "m": "load", "x": "position", "xv": "spool",
}  # fmt: skip
_MEANING = {word: meaning for meaning, text in _WORDS.items() for word in text.split()}
_INSIDE = sorted((word for word in _MEANING if len(word) > 3 and word != "last"), key=len, reverse=True)


def words(name: str) -> list[str]:
    """`motorSpeed_1 [1/min]` -> motor, speed, 1: in lower case, without what stands in brackets."""
    bare = _BRACKETS.sub(" ", name).translate(_PLAIN)
    return [word.lower() for word in re.split(r"[^0-9A-Za-z]+", _SEAMS.sub(" ", bare)) if word]


def meanings(name: str) -> set[str]:
    """What the words of a name mean, keys of the table above; "symbol" if all of it is from a letter or two."""
    found: set[str] = set()
    rest = []
    each = words(_without_ending(name)[0])
    for pair in pairwise(each):  # x dot, set point
        if (joined := "".join(pair)) in _MEANING and len(joined) > 3:
            found.add(_MEANING[joined])
            each = [word for word in each if word not in pair]
    for word in each:
        if word in _SYMBOLS or word.isdigit():
            rest.append(word)
        elif word in _MEANING:
            found.add(_MEANING[word])
        else:
            inside = [known for known in _INSIDE if known in word]
            longest = [known for n, known in enumerate(inside) if not any(known in one for one in inside[:n])]
            found |= {_MEANING[known] for known in longest} or ({"unknown"} if not unit_of(word) else set())
    found.discard("neutral")
    symbols = {_SYMBOLS[word] for word in rest if word in _SYMBOLS}
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
