"""Rig logs from files and to files: by the rig log's own header or through a mapping, with what the data gate says."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, nearest
from ..files import replacing
from ..units import from_si, unit
from . import gate
from .finding import Finding
from .formats import read_table
from .log import HELD, RigLog, field_of
from .mapping import (
    CONTRACT,
    CONTRACT_RIG,
    Mapping,
    Part,
    Source,
    contract_columns,
    contract_mapping,
    load_mapping,
)
from .positions import slope
from .samples import MEASURED
from .table import Table, digest

__all__ = ["read_log", "write_log"]


def read_log(path: str | Path, mapping: Mapping | str | Path | None = None) -> RigLog:
    """Reads a log file, by the rig log's own header or through a mapping; `.findings` holds the data gate's warnings.

    `InputError` (one line: file, row, column, what would be right) where the log cannot be used.
    """
    path = Path(path)
    if mapping is not None and not isinstance(mapping, Mapping):
        mapping = load_mapping(mapping)
    chosen: list[Mapping] = []

    def choose(names: tuple[str, ...]) -> tuple[str, ...]:
        chosen[:] = [mapping or contract_mapping(names, path)]  # a second reading may see another header
        return chosen[0].columns()

    table = read_table(path, choose, mapping.table if mapping else None)
    if mapping is None:
        table.findings.extend(_unknown_columns(table))
    return _from_table(table, chosen[0])


def _unknown_columns(table: Table) -> Iterator[Finding]:
    known = set(contract_columns())
    for name in table.names:
        if name and name not in known:
            near = nearest(name, known)
            hint = f"; is {near!r} meant?" if near else ""
            yield Finding("unknown_column", f"column {name!r} is unknown and ignored{hint}", column=name)


def _from_table(table: Table, mapping: Mapping) -> RigLog:
    findings = list(table.findings)
    count = len(table.lines)
    if count < 2:
        raise InputError(f"{table.path}: only {count} row; a log needs at least two samples")
    if mapping.time.column is None:
        assert mapping.time.sample_rate is not None
        time_s, keep = np.arange(count) / mapping.time.sample_rate, None
    else:
        time_s, keep = gate.check_clock(table, mapping.time.column, mapping.time.unit, findings)
    signals = _signals(table, mapping, keep, findings)
    for channel, source in enumerate(each.speed if each else None for each in mapping.channels):
        if source and unit(source.unit).quantity in ("angle", "length"):
            speed = signals["speed"]
            assert speed is not None
            speed[:, channel], finding = slope(speed[:, channel], time_s, source, channel + 1)
            findings.append(finding)
    table.columns.clear()  # an hour of them is half the memory
    rows = table.lines if keep is None else table.lines[keep]
    start, end, unknown = _hold(mapping, signals, time_s, rows, findings)
    log = RigLog(
        time_s=time_s[start:end],
        name=table.path.name,
        sha256=digest(table.path),
        kinds=tuple(channel.actuator if channel else "motor" for channel in mapping.channels),  # type: ignore[arg-type]
        displacement=tuple(  # type: ignore[arg-type]
            channel.displacement.si if channel and channel.displacement else None
            for channel in mapping.channels
        ),
        read_as={
            f"{signal}_{channel + 1}": (source.column, source.unit)
            for signal, channel, source in mapping.sources()
            if channel is not None
        },
        **{name: None if values is None else values[start:end] for name, values in signals.items()},  # type: ignore[arg-type]
    )
    if len(log) < 2:
        raise InputError(f"{table.path}: no two rows hold a command; a log needs at least two samples")
    findings += gate.check_units(table, mapping)
    found, invalid = gate.check_log(log, mapping, rows[start:end])
    log = replace(_without(log, invalid, unknown[start:end]), findings=(*findings, *found))
    return _with_load_pressure(log)


def _signals(
    table: Table, mapping: Mapping, keep: np.ndarray | None, findings: list[Finding]
) -> dict[str, np.ndarray | None]:
    """The arrays of a `RigLog` in SI: (T, 2) of the channels, NaN where one lacks the signal, and (T,) of the rig."""
    signals: dict[str, np.ndarray | None] = {}
    for signal, channel, source in mapping.sources():
        values, name = _values(table, source, keep, findings), field_of(signal)
        if channel is None:
            signals[name] = values
        elif values is not None:
            both = signals.get(name)
            if both is None:
                both = signals[name] = np.full((len(values), 2), np.nan)
            both[:, channel] = values
        elif signal in ("command", "speed"):
            told = f"column {source.column!r} is empty; {signal} is required of every channel"
            raise InputError(f"{table.path}: {told}")
    return signals


def _values(
    table: Table, source: Source, keep: np.ndarray | None, findings: list[Finding]
) -> np.ndarray | None:
    """One signal in SI (T,), or None where its column is empty."""
    cells = table.columns[source.column]
    if np.isnan(cells).all():
        message = f"column {source.column!r} holds no value"
        findings.append(Finding("empty_column", message, "taken as absent", column=source.column))
        return None
    result = _si(table, source)
    if source.minus is not None:
        result = result - _si(table, source.minus)
    return np.asarray(result if keep is None else result[keep])


def _si(table: Table, part: Part) -> np.ndarray:
    with np.errstate(all="ignore"):
        values = np.asarray(part.si(table.columns[part.column]))
    gate.check_numbers(table, part.column, values)
    return values


def _hold(
    mapping: Mapping, signals: dict[str, np.ndarray | None], time_s: np.ndarray, rows: np.ndarray,
    findings: list[Finding],
) -> tuple[int, int, np.ndarray]:  # fmt: skip
    """Fills holes of commands, loads and set-points (in place) with the last value. A load before its first value is zero, and a
    set-point its first value.

    Returns the first row in which all commands are known, the row behind the last, and the rows (T,) within long holes of a
    command, or soon behind them: what the valve was told there is not known.
    """
    begin, end, unknown = 0, len(rows), np.zeros(len(rows), bool)
    for signal, channel, source in mapping.sources():
        values = signals.get(field_of(signal))
        if signal not in HELD or values is None:
            continue
        one = values if channel is None else values[:, channel]
        known = np.isfinite(one)
        if known.all() or not known.any():
            continue
        last = np.maximum.accumulate(np.where(known, np.arange(len(one)), -1))
        first = int(np.argmax(known))
        one[:] = np.where(last >= 0, one[np.maximum(last, 0)], 0.0 if signal == "load" else one[first])
        hint = "the value before is held"
        if signal == "command":
            final, long = _unknown(time_s, known)
            unknown |= long
            if long[first:final].any():
                hint += "; long holes, and the second after each, count for nothing"
            if first > 0:
                begin = max(begin, first)
                hint += f", and the log begins with row {rows[first]}, the first that holds one"
            if final < len(one):
                end = min(end, final)
                hint += f", and the log ends with row {rows[final - 1]}: no command follows"
        hole = int(np.argmax(~known))
        message = f"{source.column!r} holds no value in {np.sum(~known)} of {len(one)} cells, the first in row {rows[hole]}"
        number, row = None if channel is None else channel + 1, int(rows[hole])
        findings.append(Finding("missing_values", message, hint, signal, number, source.column, row))
    return begin, end, unknown


def _unknown(time_s: np.ndarray, known: np.ndarray) -> tuple[int, np.ndarray]:
    """The row behind the last whose command is `known` (T,) or may be held, and the rows (T,) in long holes and after them.

    A recorder may write each command once only: a hole is long beside the time from one command to the next.
    """
    at = np.flatnonzero(known)
    steps = np.diff(time_s[at])
    usual = float(np.median(steps)) if len(steps) else 0.0
    found = np.zeros(len(known), bool)
    for n in np.flatnonzero(steps > gate.long_gap(usual)):
        # Also what follows: the state is a guess for so long.
        found[at[n] + 1 : np.searchsorted(time_s, time_s[at[n + 1]] + gate.SETTLE_S)] = True
    end = int(at[-1]) + 1
    if time_s[-1] - time_s[at[-1]] <= gate.long_gap(usual):
        end = len(known)
    return end, found


def _without(log: RigLog, invalid: gate.InvalidSamples, unknown: np.ndarray) -> RigLog:
    """The log with NaN in place of invalid samples, of rows (T,) whose commands are `unknown`, and of what follows a long gap
    unless that were most of the log."""
    late = gate.after_gaps(log.time_s)
    late &= late.mean() < 0.5
    late |= unknown
    changed: dict[str, np.ndarray | None] = {}
    for signal in MEASURED:
        values = log.get(signal)
        if values is None or not (late.any() or any(name == signal for name, _ in invalid)):
            continue
        values = values.copy()
        values[late] = np.nan
        for channel in (0, 1):
            if (signal, channel) in invalid:
                values[invalid[signal, channel], channel] = np.nan
        changed[field_of(signal)] = None if signal != "speed" and np.isnan(values).all() else values
    return replace(log, **changed) if changed else log  # type: ignore[arg-type]


def _with_load_pressure(log: RigLog) -> RigLog:
    """The log with the difference of both line pressures in the place of a load pressure that is not there.

    The areas of a cylinder differ, so its mapping has to say what its load pressure is.
    """
    if log.pressure_a is None or log.pressure_b is None:
        return log
    pressure = np.full(log.speed.shape, np.nan) if log.pressure is None else log.pressure.copy()
    for channel in log.channels:
        if log.kinds[channel] == "motor" and np.isnan(pressure[:, channel]).all():
            pressure[:, channel] = log.pressure_a[:, channel] - log.pressure_b[:, channel]
    return log if np.isnan(pressure).all() else replace(log, pressure=pressure)


def write_log(path: str | Path, log: RigLog) -> None:
    """Writes a rig log as CSV (gzipped for `.csv.gz`), with 12 significant digits; absent signals get no column."""
    path = Path(path)
    if "cylinder" in [log.kinds[channel] for channel in log.channels]:
        raise ValueError("the rig log's header knows rpm and N m only: it cannot hold a cylinder log")
    columns: dict[str, np.ndarray] = {"time_s": log.time_s}
    for signal, (column, symbol) in CONTRACT_RIG.items():
        values = log.get(signal)
        if values is not None:
            columns[column] = from_si(values, symbol)
    for signal, (ending, symbol) in CONTRACT.items():
        values = log.get(signal)
        for channel in log.channels:
            if values is not None and log.has(signal, channel):
                columns[f"{signal}_{channel + 1}_{ending}"] = from_si(values[:, channel], symbol)
    header = [name for name in contract_columns() if name in columns]
    rows = np.column_stack([columns[name] for name in header])
    with replacing(path) as raw:
        if path.suffix == ".gz":
            # No name and no time in the header: the same log gives the same bytes.
            with gzip.GzipFile(filename="", mode="wb", fileobj=raw, compresslevel=6, mtime=0) as packed:
                _write_rows(packed, header, rows)
        else:
            _write_rows(raw, header, rows)


def _write_rows(file: Any, header: list[str], rows: np.ndarray) -> None:
    file.write((",".join(header) + "\n").encode())
    line = ",".join(["%.12g"] * len(header)) + "\n"
    for start in range(0, len(rows), 10_000):
        text = "".join(line % tuple(row) for row in rows[start : start + 10_000].tolist())
        file.write(text.replace("nan", "").encode())
