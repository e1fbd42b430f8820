"""What a column is likely to hold: by its unit first, then by the words of its name, then by how its numbers behave."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydro_env.measured.channels import follow
from hydro_env.measured.names import meanings, named_unit, words
from hydro_env.units import Unit

#: What a signal may be measured as; a position is a source of speed.
QUANTITIES = {
    "time": ("time",), "temperature": ("temperature",), "setpoint": ("angular speed", "linear speed"),
    "command": ("voltage", "fraction"), "current": ("current",), "spool": ("length",), "supply": ("pressure",),
    "pressure": ("pressure",), "flow": ("flow",), "load": ("torque", "force"), "speed": ("angular speed", "linear speed"),
    "position": ("angle", "length"), "pressure_a": ("pressure",), "pressure_b": ("pressure",),
}  # fmt: skip
_RIG = ("time", "supply", "temperature", "setpoint")
#: What a unit says where the name says nothing.
_ALONE = {quantity: signal for signal in reversed(QUANTITIES) for quantity in QUANTITIES[signal]
          if signal not in ("setpoint", "spool", "supply", "pressure_a", "pressure_b")}  # fmt: skip
#: Meanings with which a unit alone says nothing more.
_DECIDED = {"demanded", "order", "source", "tank", "foreign"}
_SIDES = {"left": 1, "links": 1, "l": 1, "main": 1, "right": 2, "rechts": 2, "r": 2, "jib": 2}


@dataclass(frozen=True)
class Column:
    """A column of a file, the unit that the file gives for it or None, and its name without what all names begin with."""

    name: str
    values: np.ndarray
    said: Unit | None
    label: str

    @cached_property
    def unit(self) -> tuple[Unit | None, bool]:
        """The unit of the file or of the name, and whether it surely is one."""
        return (self.said, True) if self.said else named_unit(self.label)

    @cached_property
    def meant(self) -> set[str]:
        """What the name means."""
        return meanings(self.label)

    @cached_property
    def finite(self) -> np.ndarray:
        """The values that are there, (n,)."""
        return self.values[np.isfinite(self.values)]

    @property
    def is_constant(self) -> bool:
        """Whether nothing is measured here."""
        return not self.finite.size or float(np.ptp(self.finite)) == 0.0

    @property
    def rises(self) -> bool:
        """Whether the values could be those of a clock."""
        return len(self.finite) > 1 and not self.is_constant and bool(np.all(np.diff(self.finite) >= 0.0))


@dataclass(frozen=True)
class Guess:
    """A column as a signal of a channel (0: of the rig). `score` orders guesses of one signal; `doubt` says what is to be
    decided by who knows the rig, "" where nothing is."""

    column: Column
    signal: str
    channel: int
    score: float
    doubt: str = ""


def guesses(columns: list[Column]) -> Iterator[Guess]:
    """The most likely signal of each column that has one; one that is constant has none."""
    zero = any(word == "0" for column in columns for word in words(column.label))
    for column in columns:
        if column.is_constant:
            continue
        score, signal = max(((_score(column, each), each) for each in QUANTITIES), key=lambda pair: pair[0])
        doubt = ""
        unit, sure = column.unit
        silent = column.meant <= {"unknown", "valve"} or "symbol" in column.meant
        if score <= 0.0 and unit and sure and silent and not column.meant & _DECIDED:
            signal, score, doubt = _ALONE.get(unit.quantity, ""), 0.5, "nothing but its unit says so"
        if score > 0.0 and signal and (signal != "time" or column.rises or not doubt):
            yield Guess(column, signal, 0 if signal in _RIG else _channel(column.label, zero), score, doubt)


def _score(column: Column, signal: str) -> float:
    """What speaks for it: words 2, symbols and what is merely likely 1, a unit that fits 2; one that does not rules it out."""
    named = _named(column, signal)
    unit, sure = column.unit
    if signal == "time" and not column.rises:
        named = 0.0 if "symbol" in column.meant and not unit else named - 0.5
    if named <= 0.0:
        return 0.0
    if unit is None or (signal == "command" and unit.quantity == "current"):  # the valve has an amplifier
        return named
    return named + (2.0 if unit.quantity in QUANTITIES[signal] else -np.inf if sure else -0.5)


def _named(column: Column, signal: str) -> float:
    """What the words say for it, and the unit where they leave it open."""
    meant, unit = column.meant, column.unit[0]
    quantity = unit.quantity if unit else ""
    size = 1.0 if "symbol" in meant else 2.0
    others = meant - {"unknown", "symbol", "demanded", "order", "valve"}
    if meant & {"foreign", "tank"} or ("source" in meant) != (signal == "supply"):
        return 0.0
    if meant & {"demanded", "order"}:  # what is asked for is not what is measured
        if signal == "command" and not others - {"voltage", "speed", "current"}:
            fits = quantity in (*QUANTITIES["command"], "current") or "order" in meant
            return size if fits else 0.0
        if signal == "setpoint" and not others - {"speed"}:
            fits = "speed" in meant or quantity in QUANTITIES["setpoint"]
            return (2.0 if fits else 1.0) if "demanded" in meant or (fits and unit) else 0.0
        return 0.0
    if signal == "command":
        return 1.0 if meant & {"valve", "voltage"} and not others - {"voltage"} else 0.0
    if signal == "supply":
        return 0.0 if others - {"source", "pressure"} else size
    if signal == "spool" and {"valve", "position"} <= meant:
        return 3.0
    if signal == "temperature" and others == {"oil"}:
        return 1.0
    if signal == "load" and others - {"load"}:  # a load pressure
        return 0.0
    return size if signal in meant or (signal == "position" and "counts" in meant) else 0.0


def _channel(name: str, zero: bool) -> int:
    """The channel by a number or a side in the name, 1 where there is none; numbers may be from 0."""
    for word in words(name):
        if word in _SIDES:
            return _SIDES[word]
        if word.isdecimal() and len(word) < 3:
            return int(word) + zero
    return 1


def by_behaviour(columns: list[Column]) -> list[Guess]:
    """Time, command and speed among columns without names: what rises is the clock; of the others the calmest is the command,
    and the speed is what follows it most."""
    free = [column for column in columns if not column.is_constant]
    found = []
    clock = next((column for column in free if column.rises), None)
    if clock:
        free.remove(clock)
        found.append(Guess(clock, "time", 0, 0.5, "it is the first that rises from row to row"))
    if len(free) > 1:
        command = min(free, key=_unrest)
        free.remove(command)
        follows = [abs(follow(command.values, column.values, 0.01)) for column in free]
        speed = free[int(np.argmax(follows))]
        found.append(Guess(command, "command", 1, 0.5, "it is the one with the least noise"))
        doubt = f"it is the one that follows column {command.name!r} most"
        found.append(Guess(speed, "speed", 1, 0.5, doubt))
    return found


def _unrest(column: Column) -> float:
    """The share of noise in a signal: its differences of the second order beside itself, steps left aside."""
    if len(column.finite) < 3:
        return 0.0
    return float(np.median(np.abs(np.diff(column.finite, 2))) / np.std(column.finite))
