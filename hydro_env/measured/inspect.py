"""A first mapping for a foreign log: which column is likely to be what, in which unit, and what would then be read.

`propose` goes by names ("Drehzahl_1 [1/min]", "p_A2_bar", "cmd left"), by the units that the file gives and, where it gives
none, by magnitudes; every guess says why it was made. What the data gate then finds surely wrong (a sign, a unit, motors
exchanged) is corrected in the proposal and said. The text is a mapping file to be read by a person and corrected, not to be
trusted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as Table
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import InputError
from ..units import UNITS, unit
from .formats import read_table
from .gate import LARGEST
from .log import RigLog
from .log_files import read_log
from .mapping import Mapping, contract_columns, contract_mapping, load_mapping

__all__ = ["Proposal", "propose", "shown"]

#: Words of a column's name, by signal; the first signal that has one wins.
_WORDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("time", ("time", "zeit", "timestamp", "t", "clock", "temps")),
    ("supply", ("ps", "supply", "psupply", "psys", "versorgung", "pumpe", "pump")),
    ("temperature", ("temp", "temperature", "temperatur", "toil", "oel", "degc")),
    ("setpoint", ("setpoint", "ref", "reference", "soll", "sollwert", "solldrehzahl", "desired", "target", "nref")),
    ("command", ("cmd", "command", "u", "volt", "voltage", "spannung", "stell", "stellgroesse", "valve", "ventil", "drive")),
    ("current", ("i", "current", "strom", "coil", "amp", "ampere")),
    ("spool", ("spool", "schieber", "xv", "lvdt")),
    ("load", ("load", "torque", "moment", "last", "lastmoment", "drehmoment", "m", "tau", "force", "kraft")),
    ("flow", ("flow", "q", "durchfluss", "volumenstrom")),
    ("pressure", ("p", "pressure", "druck", "dp", "pl", "pa", "pb", "differenzdruck")),
    ("speed", ("speed", "rpm", "n", "vel", "velocity", "drehzahl", "omega", "w", "v", "xdot", "geschwindigkeit")),
)  # fmt: skip
_QUANTITIES = {
    "time": ("time",), "supply": ("pressure",), "temperature": ("temperature",), "setpoint": ("angular speed", "linear speed"),
    "command": ("voltage", "fraction"), "current": ("current",), "spool": ("length",), "load": ("torque", "force"),
    "flow": ("flow",), "pressure": ("pressure",), "speed": ("angular speed", "linear speed"),
    "pressure_a": ("pressure",), "pressure_b": ("pressure",),
}  # fmt: skip
_RIG = ("time", "supply", "temperature", "setpoint")
_SIDES = {"1": 1, "2": 2, "left": 1, "right": 2, "links": 1, "rechts": 2, "l": 1, "r": 2, "main": 1, "jib": 2}
_SHOWN = {
    "angular speed": "rpm", "linear speed": "mm/s", "pressure": "bar", "voltage": "V", "current": "A", "length": "mm",
    "torque": "N m", "force": "N", "flow": "l/min", "temperature": "degC", "time": "s",
}  # fmt: skip

_PLAIN = {
    ord(a): b for a, b in (("ö", "oe"), ("ü", "ue"), ("ä", "ae"), ("Ö", "Oe"), ("Ü", "Ue"), ("Ä", "Ae"))
}


@dataclass(frozen=True)
class Proposal:
    """`text` is the mapping file; `notes` say why; `log` is what it reads, or None with the reason in `problem`."""

    text: str
    notes: tuple[str, ...]
    log: RigLog | None
    problem: str


def _columns(path: Path, notes: list[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Every column of numbers of a file, and the units that the file gives; `notes` gets the reasons why others are not read."""

    def read(wanted: tuple[str, ...] | None) -> Any:
        def choose(names: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(n for n in names if n) if wanted is None else wanted

        return read_table(path, choose)

    try:
        table = read(None)
        return table.columns, table.units
    except InputError as error:
        names: tuple[str, ...] = ()

        def remember(found: tuple[str, ...]) -> tuple[str, ...]:
            nonlocal names
            names = found
            return found[:0]

        try:
            read_table(path, remember)
        except InputError:
            if not names:
                raise error from None
        columns, units = {}, {}
        for name in names:  # some columns are text, or on another clock
            try:
                table = read((name,))
            except InputError as reason:
                notes.append(f"{name!r}: left out; {str(reason).removeprefix(f'{path}: ')}")
                continue
            columns[name], units = table.columns[name], table.units
        longest = max((len(v) for v in columns.values()), default=0)
        return {n: v for n, v in columns.items() if len(v) == longest}, units


def _words(name: str) -> list[str]:
    """`motorSpeed_1 [1/min]` -> motor, speed, 1, without what stands in brackets."""
    bare = re.sub(r"[\[(].*?[\])]", " ", name)
    bare = re.sub(r"([a-zäöü])([A-Z])", r"\1 \2", bare)
    bare = re.sub(r"([A-Za-zäöü])(\d)", r"\1 \2", bare)
    plain = bare.translate(_PLAIN)
    return [w.lower() for w in re.split(r"[^0-9A-Za-z]+", plain) if w]


def _unit_of(name: str, quantities: tuple[str, ...]) -> str | None:
    """The unit that a name gives, in brackets or as its last word."""
    texts = re.findall(r"[\[(](.*?)[\])]", name) + re.split(r"[_\s]", name)[1:][::-1]
    for text in texts:
        try:
            found = unit(text.strip())
        except InputError:
            continue
        if text.strip() and found.quantity in quantities and not text.strip().isdigit():
            return found.name
    return None


def _guessed_unit(signal: str, values: np.ndarray) -> str:
    """The unit in which the magnitudes make sense."""
    finite = np.abs(values[np.isfinite(values)])
    size = float(np.quantile(finite, 0.99)) if finite.size else 0.0
    if signal == "time":
        step = float(np.median(np.diff(values[np.isfinite(values)]))) if values.size > 2 else 0.0
        return "us" if step >= 500.0 else "ms" if step >= 0.9 else "s"
    if signal in ("pressure", "supply"):
        return "Pa" if size > 5e4 else "kPa" if size > 1500.0 else "bar" if size > 1.0 else "MPa"
    if signal == "command":
        return "fraction" if size <= 1.05 else "V" if size <= 80.0 else "percent" if size <= 101.0 else "mV"
    if signal in ("speed", "setpoint"):
        return "rpm" if size > 5.0 else "m/s" if size < 1.0 else "rad/s"
    if signal == "flow":
        return "m3/s" if size < 0.01 else "l/min"
    if signal == "current":
        return "mA" if size > 10.0 else "A"
    return {"spool": "mm", "load": "N m", "temperature": "degC"}[signal]


def _signal_of(name: str) -> str | None:
    words = _words(name)
    for signal, known in _WORDS:
        if any(w in known for w in words):
            return signal
    joined = " ".join(words)
    for signal, known in _WORDS:
        if any(len(k) > 3 and k in joined for k in known):
            return signal
    return None


def propose(path: str | Path) -> Proposal:
    """Looks at a log and proposes a mapping. InputError if it cannot be read at all."""
    path = Path(path)
    notes: list[str] = []
    columns, units = _columns(path, notes)
    for values in columns.values():  # what is larger is no measurement, and reading will say so
        values[np.abs(values) > LARGEST] = np.nan
    if {"time_s"} <= set(columns) and sum(n in contract_columns() for n in columns) >= 3:
        try:
            mapping = contract_mapping(tuple(columns), path)
        except InputError as error:
            return Proposal("", (*notes, "the header is the rig log's own"), None, str(error))
        content = mapping.model_dump(by_alias=True, exclude_defaults=True, exclude_none=True)
        content = {"schema": content.pop("schema_", None) or content.pop("schema"), **content}
        return _tried(path, content, [*notes, "the header is the rig log's own: no mapping is needed"])
    return _tried(path, _guessed(path, columns, units, notes), notes)


def _guessed(
    path: Path, columns: Table[str, np.ndarray], units: Table[str, str], notes: list[str]
) -> dict[str, Any]:
    """The content of a mapping file by names, units and magnitudes; `notes` are added to."""
    content: dict[str, Any] = {
        "schema": "hydro_env/mapping/1",
        "name": re.sub(r"\W+", "_", path.name.split(".")[0]),
    }
    channels: dict[int, dict[str, Any]] = {1: {}, 2: {}}
    for name, values in columns.items():
        signal = _signal_of(name)
        if signal is None:
            notes.append(f"{name!r}: not recognised, left out")
            continue
        if not np.isfinite(values).any() or np.ptp(values[np.isfinite(values)]) == 0.0:
            notes.append(f"{name!r}: constant, left out")
            continue
        if signal in _RIG:
            where, target = "the rig", content
        else:
            number = next((_SIDES[w] for w in _words(name) if w in _SIDES), 1)
            where, target = f"channel {number}", channels[number]
        source, why = _source(name, values, signal, units.get(name))
        first = target.setdefault(signal, source)
        if first is source:
            notes.append(f"{name!r}: {signal} of {where} in {source['unit']} ({why})")
        elif (
            signal == "pressure"
            and "minus" not in first
            and (_port(name), _port(first["column"])) == ("b", "a")
        ):
            first["minus"] = source
            notes.append(
                f"{name!r}: the other port's pressure, subtracted from {first['column']!r}; unequal areas need a scale"
            )
        else:
            notes.append(f"{name!r}: looks like another {signal} of {where}, left out")
    if "time" not in content:
        content["time"] = {"sample_rate": 1000}
        notes.append("no clock found: 1000 rows per second is a placeholder, put the true rate")
    for number, channel in channels.items():
        speed = channel.get("speed")
        if isinstance(speed, dict) and UNITS[str(speed["unit"])].quantity == "linear speed":
            channel["actuator"] = "cylinder"
            notes.append(
                f"channel {number}: a linear speed, so taken for a cylinder; add its displacement (piston area)"
            )
        pressure = channel.get("pressure", {})
        if "actuator" not in channel and "minus" in pressure:
            # The sides of a motor are alike, so the load pressure follows from both lines.
            channel["pressure_b"] = pressure.pop("minus")
            channel["pressure_a"] = channel.pop("pressure")
        if "command" in channel and "speed" in channel:
            content[f"channel_{number}"] = channel
        elif channel:
            lacking = " and ".join(s for s in ("command", "speed") if s not in channel)
            notes.append(f"channel {number}: no {lacking} found, left out")
    return content


def _source(name: str, values: np.ndarray, signal: str, said: str | None) -> tuple[dict[str, Any], str]:
    """Column and unit of a signal, and where the unit is from; `said` is the unit that the file gives."""
    given = (_known(said, _QUANTITIES[signal]) if said else None) or _unit_of(name, _QUANTITIES[signal])
    chosen = given or _guessed_unit(signal, values)
    source: dict[str, Any] = {"column": name, "unit": chosen}
    why = "unit from the file" if given else "unit guessed from the size of the numbers"
    if UNITS[chosen].quantity == "fraction":
        source["full_scale"] = 10.0
        why += "; full_scale is a guess: the volts at 100 %"
    return source, why


def _tried(path: Path, content: dict[str, Any], notes: list[str]) -> Proposal:
    """The proposal with what it reads; what the gate finds surely wrong is corrected once."""
    if not any(f"channel_{n}" in content for n in (1, 2)):
        reason = "no channel with a command and a speed was found; name them by hand"
        return Proposal(_as_text(content), tuple(notes), None, reason)
    log: RigLog | None = None
    problem = ""
    for attempt in (1, 2):
        try:
            log = read_log(path, Mapping.model_validate(content))
        except (InputError, ValueError) as error:
            problem = str(error).splitlines()[0]
            break
        fixes = [f for f in log.findings if f.sure and f.fix]
        if attempt == 2 or not fixes:
            break
        for finding in fixes:
            _merge(content, finding.fix or {})
            notes.append(f"corrected in the proposal: {finding.text}")
    return Proposal(_as_text(content), tuple(notes), log, problem)


def _merge(content: dict[str, Any], fix: Table[str, Any]) -> None:
    for key, value in fix.items():
        if isinstance(value, dict):
            _merge(content.setdefault(key, {}), value)
        else:
            content[key] = value


def _as_text(content: dict[str, Any]) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _port(name: str) -> str:
    """The port (a, b) that a pressure's name gives, or nothing."""
    for word in _words(name):
        if word in ("a", "b", "pa", "pb"):
            return word[-1]
    return ""


def _known(text: str, quantities: tuple[str, ...]) -> str | None:
    try:
        found = unit(text)
    except InputError:
        return None
    return found.name if found.quantity in quantities else None


def shown(path: str | Path, mapping: str | Path | None = None) -> tuple[str, str]:
    """What would be read of a log, as text for a terminal, and the proposed mapping file ("" where one was given)."""
    if mapping is not None:
        proposal = Proposal("", (f"read with {mapping}",), read_log(path, load_mapping(mapping)), "")
    else:
        proposal = propose(path)
    lines = [str(path), *(f"  {note}" for note in proposal.notes)]
    log = proposal.log
    if log is None:
        return "\n".join([*lines, f"not readable yet: {proposal.problem}"]), proposal.text
    lines.append(
        f"{len(log)} rows, {log.time_s[0]:.6g} to {log.time_s[-1]:.6g} s at {1.0 / log.period:.6g} Hz"
        + ("" if log.uniform else ", unevenly spaced: it would be put on an even grid")
    )
    numbers = [0, 1, len(log) // 2]
    rows = "".join(f"{f'at {log.time_s[n]:.3g} s':>13}" for n in numbers)
    lines.append(f"  {'signal':<14}{'unit':<7}{'least':>11}{'median':>11}{'most':>11}{rows}")
    for signal in log.signals:
        values = log.get(signal)
        assert values is not None
        for c in log.channels if values.ndim == 2 else (None,):
            if c is not None and not log.has(signal, c):
                continue
            name = _shown_unit(signal, log, c)
            one = values if c is None else values[:, c]
            offset, scale = UNITS[name].offset, UNITS[name].scale
            quantiles = [(np.nanquantile(one, q) - offset) / scale for q in (0.0, 0.5, 1.0)]
            examples = "".join(f"{(one[n] - offset) / scale:13.4g}" for n in numbers)
            text = "".join(f"{v:11.4g}" for v in quantiles) + examples
            lines.append(f"  {signal + ('' if c is None else f' {c + 1}'):<14}{name:<7}{text}")
    lines += [f"  {'wrong' if f.sure else 'note'}: {f.text}" for f in log.findings]
    if not log.findings:
        lines.append("  nothing suspicious found")
    return "\n".join(lines), proposal.text


def _shown_unit(signal: str, log: RigLog, channel: int | None) -> str:
    quantities = _QUANTITIES[signal]
    linear = log.kinds[log.channels[0] if channel is None else channel] == "cylinder"
    return _SHOWN[quantities[1] if linear and len(quantities) == 2 and signal != "command" else quantities[0]]
