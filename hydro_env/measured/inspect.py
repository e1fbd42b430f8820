"""A first mapping for a foreign log: which column is likely to be what, in which unit, and what would then be read.

`propose` makes a mapping file of the guesses of `measured.guess`. Every column stands in it with the reason; what only a person
can know is marked "to be decided". What the data gate then finds surely wrong (a sign, a unit, motors exchanged) is corrected
in the proposal and said, and a column that spoils the reading is left out.
"""

import os
import re
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import InputError
from ..units import UNITS, from_si
from ..validation import checked
from .formats import read_table
from .gate import LARGEST
from .guess import QUANTITIES, Column, Guess, by_behaviour, guesses
from .log import RigLog
from .log_files import read_log
from .mapping import (
    CHANNEL_SIGNALS,
    CHANNELS,
    RIG_SIGNALS,
    USUAL_UNITS,
    Mapping,
    TableStyle,
    contract_columns,
    contract_mapping,
    load_begun,
    quantity_of,
)
from .names import unit_of, words

_NEEDED = {"command": "V", "speed": "rpm"}


@dataclass
class Proposal:
    """A mapping file in the making: its content, why it is so, and what is to be decided; then what it reads, or None with the
    reason in `problem`."""

    content: dict[str, Any]
    why: list[str] = field(default_factory=list)
    open: list[str] = field(default_factory=list)
    log: RigLog | None = None
    problem: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """All that is to be said of it, in lines."""
        return (*self.why, *(f"to be decided: {each}" for each in self.open))

    @property
    def text(self) -> str:
        """The mapping file, "" where there is none."""
        lines = ["A guess from names, units and numbers; check it.", *self.notes]
        text = "".join(f"# {' '.join(line.split())}\n" for line in lines)
        content = yaml.safe_dump(self.content, sort_keys=False, allow_unicode=True)
        return text + content if self.content else ""


def propose(path: str | Path, begun: dict[str, Any] | None = None) -> Proposal:
    """Looks at a log and proposes a mapping that keeps what `begun`, the content of a mapping file, says already. InputError
    if the log cannot be read at all."""
    path, begun = Path(path), begun or {}
    draft = Proposal({"schema": "hydro_env/mapping/1", "name": re.sub(r"\W+", "_", path.name.split(".")[0])})
    columns = _columns(path, TableStyle(**begun.get("table", {})), draft.why)
    names = tuple(column.name for column in columns)
    if "time_s" in names and sum(name in contract_columns() for name in names) >= 3:
        draft.why.append("the header is the rig log's own: no mapping is needed")
        try:
            draft.content |= contract_mapping(names).model_dump(exclude_defaults=True, exclude_none=True)
        except InputError as error:
            return Proposal({}, draft.why, problem=f"{path}: {error}")
    else:
        _fill(draft, columns)
    draft.content |= begun
    _try(path, draft)
    return draft


def _columns(path: Path, style: TableStyle, notes: list[str]) -> list[Column]:
    """Every column of numbers of a file; `notes` gets the reasons why others are not read."""
    names: dict[str, str] = {}  # what a column is called, and the header's name of it
    left: set[str] = set()

    def choose(found: tuple[str, ...]) -> list[str]:
        names.clear()
        for place, name in enumerate(found, 1):
            names[name if name and found.count(name) == 1 else str(place)] = name
        return [name for name in names if name not in left]

    while True:
        try:
            table = read_table(path, choose, style)
            break
        except InputError as error:  # text, or on another clock
            said = str(error).removeprefix(f"{path}: ")
            named = [name for name in names if name not in left and repr(name) in said]
            if not named:
                raise
            bad = min(named, key=lambda name: said.index(repr(name)))
            left.add(bad)
            notes.append(f"{bad!r}: left out; {said}")
    for values in table.columns.values():  # what is larger is no measurement, and reading will say so
        values[np.abs(values) > LARGEST] = np.nan
    begin = os.path.commonprefix(list(names.values()))  # noqa: RUF071 (character by character is meant)
    shared = 1 + max(begin.rfind("."), begin.rfind("/"))  # the structure or the group of a binary file
    return [
        Column(name, values, unit_of(table.units.get(names[name], "")), names[name][shared:])
        for name, values in table.columns.items()
    ]


def _fill(draft: Proposal, columns: list[Column]) -> None:
    """Puts the most likely column of each signal into the draft."""
    nameless = all(column.label.isdecimal() for column in columns)
    found = by_behaviour(columns) if nameless else list(guesses(columns))
    # A speed is better than its position.
    found.sort(key=lambda guess: (guess.signal == "position", -guess.score))
    free = [column for column in columns if all(column is not guess.column for guess in found)]
    for column in free:
        known = ", ".join(sorted(column.meant - {"unknown", "symbol", "valve"}))
        told = f"{known}, nothing that a mapping has" if known else "not recognised"
        why = "constant" if column.is_constant else "no name" if nameless else told
        draft.why.append(f"{column.name!r}: {why}, left out")
    channels: dict[int, dict[str, Any]] = {1: {}, 2: {}}
    for guess in found:
        if guess.channel > 2:
            told = f"{guess.signal} of channel {guess.channel}, left out; a log has two"
            draft.why.append(f"{guess.column.name!r}: {told}")
        else:
            _put(draft, channels.get(guess.channel, draft.content), guess)
    _finish(draft, channels, [repr(column.name) for column in free])


def _put(draft: Proposal, target: dict[str, Any], guess: Guess) -> None:
    """Puts a guess into its channel or the rig, unless a better one is there."""
    name, signal = guess.column.name, "speed" if guess.signal == "position" else guess.signal
    where = f"channel {guess.channel}" if guess.channel else "the rig"
    place = f"channel_{guess.channel}.{signal}" if guess.channel else signal
    source, why, doubt = _source(guess)
    first = target.setdefault(signal, source)
    if first is source:
        what = "position, whose slope is the speed," if guess.signal == "position" else signal
        draft.why.append(f"{name!r}: {what} of {where} in {source['unit']} ({why})")
        doubts = (doubt, guess.doubt and f"{name!r}? {guess.doubt}")
        draft.open += [f"{place}: {each}" for each in doubts if each]
        return
    ports = _port(first["column"]), _port(name)
    if signal == "pressure" and "minus" not in first and ports == ("a", "b"):
        first["minus"] = source
        told = f"the other port's pressure, subtracted from {first['column']!r}; unequal areas need a scale"
    else:
        told = f"looks like another {signal} of {where}, left out"
    draft.why.append(f"{name!r}: {told}")


def _finish(draft: Proposal, channels: dict[int, dict[str, Any]], free: list[str]) -> None:
    """Puts the channels into the draft: those with a command and a speed, or, where there is none, what there is with marks for
    what is lacking. `free` are columns that are not used."""
    whole = [number for number, channel in channels.items() if channel.keys() >= _NEEDED.keys()]
    begun = [number for number, channel in channels.items() if channel.keys() & _NEEDED.keys()] or [1]
    others = f"; not used: {', '.join(free[:20])}" if free else ""
    for number, channel in channels.items():
        lacking = [signal for signal in _NEEDED if signal not in channel]
        if number not in (whole or begun):
            if channel:
                draft.why.append(f"channel {number}: no {' and '.join(lacking)} found, left out")
            continue
        for signal in lacking:
            channel[signal] = {"column": "?", "unit": _NEEDED[signal]}
            told = "no column looks like it; put its name and its unit in place of ?"
            draft.open.append(f"channel_{number}.{signal}: {told}{others}")
        if UNITS[channel["speed"]["unit"]].quantity in ("linear speed", "length"):
            channel["actuator"] = "cylinder"
            told = "it moves along a line, so taken for a cylinder; add its displacement (piston area)"
            draft.why.append(f"channel {number}: {told}")
        elif "minus" in channel.get("pressure", {}):
            # The sides of a motor are alike, so the load pressure follows from both lines.
            channel["pressure_b"] = channel["pressure"].pop("minus")
            channel["pressure_a"] = channel.pop("pressure")
        draft.content[f"channel_{number}"] = channel


def _source(guess: Guess) -> tuple[dict[str, Any], str, str]:
    """Column and unit of a signal, where the unit is from, and what of it is to be decided."""
    column, signal, unit = guess.column, guess.signal, guess.column.unit[0]
    source: dict[str, Any] = {"column": column.name}
    if unit and unit.quantity in QUANTITIES[signal]:
        source["unit"], why = unit.name, "unit from the file"
    else:
        source["unit"], why = _unit_by_size(column, signal), "unit guessed from the size of the numbers"
    doubts = []
    if source["unit"] == "rev" and not unit:
        source["scale"] = 1e-3
        doubts.append("scale is a guess: the revolutions per count")
    if source["unit"] == "":  # in none of the units of a command
        largest = float(np.max(np.abs(column.finite)))
        source |= {"unit": "fraction", "scale": float(f"{1.0 / largest:.4g}")}
        why = "taken as a share of its largest value"
        doubts.append(f"scale is a guess: 1 over the value at full command, here {largest:.6g}")
    if UNITS[source["unit"]].quantity == "fraction":
        source["full_scale"] = 10.0
        doubts.append("full_scale is a guess: the volts at 100 %")
    return source, why, "; ".join(doubts)


#: Units by signal, each with the largest size of numbers in it; a clock's size is its step.
_BY_SIZE: dict[str, list[tuple[float, str]]] = {
    "time": [(0.9, "s"), (500.0, "ms"), (inf, "us")],
    "stroke": [(3.0, "m"), (inf, "mm")], "angle": [(7.0, "rad"), (inf, "deg")],
    "pressure": [(1.0, "MPa"), (1500.0, "bar"), (5e4, "kPa"), (inf, "Pa")],
    "command": [(1.05, "fraction"), (80.0, "V"), (101.0, "percent"), (inf, "")],
    "speed": [(1.0, "m/s"), (5.0, "rad/s"), (inf, "rpm")],
    "flow": [(0.01, "m3/s"), (inf, "l/min")], "current": [(10.0, "A"), (inf, "mA")],
    "spool": [(inf, "mm")], "load": [(inf, "N m")], "temperature": [(inf, "degC")],
}  # fmt: skip
_STROKES = {"weg", "kolbenweg", "stroke", "hub", "piston", "kolben", "cyl", "zylinder", "cylinder"}


def _unit_by_size(column: Column, signal: str) -> str:
    """The unit in which the magnitudes make sense, "" for a command that no unit suits."""
    size = float(np.quantile(np.abs(column.finite), 0.99))
    if signal == "time":
        size = float(np.median(np.diff(column.finite)))
    elif signal == "position":
        if "counts" in column.meant:
            return "rev"
        signal = "stroke" if _STROKES & set(words(column.label)) else "angle"
    elif signal == "command" and column.unit[0] is not None:  # in a unit that no command has
        return ""
    rows = _BY_SIZE[{"supply": "pressure", "setpoint": "speed"}.get(signal, signal)]
    return next(unit for largest, unit in rows if size <= largest)


def _port(name: str) -> str:
    """The port (a, b) that a pressure's name gives, or nothing."""
    return next((word[-1] for word in words(name) if word in ("a", "b", "pa", "pb")), "")


def _try(path: Path, draft: Proposal) -> None:
    """Reads the log by the draft. What the gate finds surely wrong is corrected once; columns that cannot be read as what they
    are taken for are left out."""
    content, corrected = draft.content, False
    channels = [content[key] for key in CHANNELS if key in content]
    if any(channel.get(signal, {}).get("column") == "?" for channel in channels for signal in _NEEDED):
        draft.problem = "no channel with a command and a speed was found; name them by hand"
    while True:
        if "time" not in content:
            content["time"] = {"sample_rate": 1000}
            draft.open.append("time.sample_rate: no usable clock was found; put the rows per second")
        if draft.problem:
            return
        try:
            log = read_log(path, checked(Mapping, content, path))
        except InputError as error:
            problem = str(error).removeprefix(f"{path}: ")
            draft.problem = "" if _left_out(draft, problem) else problem
            continue
        fixes = [finding for finding in log.findings if finding.sure and finding.fix]
        if corrected or not fixes:
            draft.log = log
            return
        corrected = True
        for finding in fixes:
            _merge(content, finding.fix or {})
            draft.why.append(f"corrected in the proposal: {finding.text}")


def _left_out(draft: Proposal, problem: str) -> bool:
    """Whether a column could be left out that the problem names, and that is not needed."""
    content = draft.content
    both = [key for key in CHANNELS if key in content]
    optional = [(content, signal) for signal in RIG_SIGNALS]
    optional += [
        (content[key], signal) for key in both for signal in CHANNEL_SIGNALS if signal not in _NEEDED
    ]

    def spoils(source: dict[str, Any]) -> bool:
        columns = source.get("column"), source.get("minus", {}).get("column")
        return any(repr(column) in problem for column in columns if column is not None)

    for target, signal in (*optional, (content, "time")):
        if signal in target and (spoils(target[signal]) or f"{signal} of a " in problem):
            draft.why.append(f"{target.pop(signal)['column']!r}: left out; {problem}")
            return True
    bad = [key for key in both if any(spoils(content[key][signal]) for signal in _NEEDED)]
    if len(both) < 2 or len(bad) != 1:
        return False
    del content[bad[0]]
    draft.why.append(f"channel {bad[0][-1]}: left out; {problem}")
    return True


def _merge(content: dict[str, Any], fix: dict[str, Any]) -> None:
    for key, value in fix.items():
        if isinstance(value, dict):
            _merge(content.setdefault(key, {}), value)
        else:
            content[key] = value


def shown(path: str | Path, mapping: str | Path | None = None) -> tuple[str, str]:
    """What would be read of a log, as text for a terminal, and the proposed mapping file ("" where a whole one was given)."""
    begun = load_begun(mapping) if mapping is not None else {}
    if isinstance(begun, Mapping):
        proposal = Proposal({}, [f"read with {mapping}"], log=read_log(path, begun))
    else:
        proposal = propose(path, begun)
    lines = [str(path), *(f"  {note}" for note in proposal.notes)]
    log = proposal.log
    if log is None:
        return "\n".join([*lines, f"not readable yet: {proposal.problem}"]), proposal.text
    uneven = "" if log.uniform else ", unevenly spaced: it would be put on an even grid"
    span = f"{log.time_s[0]:.6g} to {log.time_s[-1]:.6g} s at {1.0 / log.period:.6g} Hz"
    lines.append(f"{len(log)} rows, {span}{uneven}")
    numbers = [0, 1, len(log) // 2]
    rows = "".join(f"{f'at {log.time_s[n]:.3g} s':>13}" for n in numbers)
    lines.append(f"  {'signal':<14}{'unit':<7}{'least':>11}{'median':>11}{'most':>11}{rows}")
    for signal in log.signals:
        for c in (None,) if signal in RIG_SIGNALS else log.channels:
            values = log.of(signal, c)
            if values is None or not log.has(signal, c):
                continue
            name = USUAL_UNITS[quantity_of(signal, log.kinds[log.channels[0] if c is None else c])]
            quantiles = "".join(f"{from_si(np.nanquantile(values, q), name):11.4g}" for q in (0.0, 0.5, 1.0))
            examples = "".join(f"{from_si(values[n], name):13.4g}" for n in numbers)
            lines.append(f"  {signal + ('' if c is None else f' {c + 1}'):<14}{name:<7}{quantiles}{examples}")
    notes = [f"  {'wrong' if f.sure else 'note'}: {f.text}" for f in log.findings]
    lines += notes or ["  nothing suspicious found"]
    return "\n".join(lines), proposal.text
