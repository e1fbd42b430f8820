"""The rig log: what was commanded and measured on a rig, in SI, and how it is read from and written to files."""

from __future__ import annotations

import gzip
import os
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, nearest, suggestion
from hydro_env.measured.csv_file import CsvStyle, read_csv
from hydro_env.measured.finding import Finding
from hydro_env.measured.formats import BINARY, read_binary
from hydro_env.measured.gate import Spoilt, after_gaps, check_clock, check_log, check_units
from hydro_env.measured.mapping import (
    CHANNEL_SIGNALS,
    CONTRACT,
    CONTRACT_RIG,
    RIG_SIGNALS,
    Mapping,
    Source,
    contract_columns,
    contract_mapping,
    load_mapping,
)
from hydro_env.measured.samples import MEASURED
from hydro_env.measured.table import Table, digest
from hydro_env.units import from_si

__all__ = ["RigLog", "read_log", "write_log"]

_FIELD = {"command": "command_V"}  # every other signal is kept under its own name
_HELD = ("command", "load", "setpoint")  # held until the next row; everything else is sampled


@dataclass(frozen=True)
class RigLog:
    """A log of T rows: row n holds what was measured at `time_s[n]` and the command held until `time_s[n + 1]`.

    Channel signals are (T, 2), column 0 = channel 1; a channel that is not in the log is NaN there, a signal that no
    channel has is None. `setpoint`, `supply`, `temperature` are (T,) or None. Single missing samples are NaN.
    Units: s, V, A, Pa, m, m3/s, K; a motor's speed is rad/s and its load N m, a cylinder's m/s and N (`kinds`).
    """

    time_s: np.ndarray
    command_V: np.ndarray
    speed: np.ndarray
    current: np.ndarray | None = None
    pressure: np.ndarray | None = None
    load: np.ndarray | None = None
    spool: np.ndarray | None = None
    flow: np.ndarray | None = None
    setpoint: np.ndarray | None = None
    supply: np.ndarray | None = None
    temperature: np.ndarray | None = None
    name: str = ""
    sha256: str = ""
    kinds: tuple[str, str] = ("motor", "motor")
    displacement: tuple[float | None, float | None] = (
        None,
        None,
    )  # m3/rad, or m2 for a cylinder, where known
    findings: tuple[Finding, ...] = field(default=(), compare=False)
    #: (column, unit) that a signal was read from and as, by "speed_1", ...
    read_as: dict[str, tuple[str, str]] = field(default_factory=dict, compare=False)

    def __len__(self) -> int:
        return len(self.time_s)

    def get(self, signal: str) -> np.ndarray | None:
        """The array of `signal` ("command", "speed", ..., "setpoint"), or None."""
        return getattr(self, _FIELD.get(signal, signal))

    def has(self, signal: str, channel: int | None = None) -> bool:
        """Whether `signal` was recorded (of channel 0 or 1, where given)."""
        values = self.get(signal)
        if values is None or channel is None or values.ndim == 1:
            return values is not None
        return not bool(np.isnan(values[:, channel]).all())

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels in the log, counted from 0: those with a command and a speed."""
        return tuple(
            channel for channel in (0, 1) if self.has("command", channel) and self.has("speed", channel)
        )

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signals that at least one channel, or the rig, has."""
        return tuple(signal for signal in (*CHANNEL_SIGNALS, *RIG_SIGNALS) if self.has(signal))

    @property
    def period(self) -> float:
        """The sample period in s: the mean step of a uniform log, the median step of another."""
        return _period(self.time_s)

    @property
    def uniform(self) -> bool:
        """Whether all steps equal the period to 1 %."""
        steps = np.diff(self.time_s)
        return bool(np.all(np.abs(steps - np.median(steps)) <= 0.01 * np.median(steps) + 1e-9))

    def window(self, start: float, end: float) -> RigLog:
        """The rows with start <= time_s < end (s); ValueError where fewer than two are left."""
        keep = np.flatnonzero((self.time_s >= start) & (self.time_s < end))
        if len(keep) < 2:
            raise ValueError(f"fewer than two rows between {start:g} s and {end:g} s")
        return self._with_rows(lambda values, _: values[keep[0] : keep[-1] + 1])

    def first(self, rows: int) -> RigLog:
        """The first so many rows."""
        return self._with_rows(lambda values, _: values[:rows])

    def resample(self, period: float) -> RigLog:
        """The log on an even grid of `period` s: commands, loads and set-points held, measurements interpolated, and
        NaN inside gaps (steps of more than 1.75 median ones).

        No filter is applied: noise above the new rate folds back.
        """
        if not period > 0.0:
            raise ValueError("the period must be positive")
        span = self.time_s[-1] - self.time_s[0]
        grid = self.time_s[0] + period * np.arange(int(np.floor(span / period + 1e-6)) + 1)
        # A grid point that misses a row by rounding alone must see that row's command.
        held = np.searchsorted(self.time_s, grid + 1e-6 * period, side="right") - 1
        steps = np.diff(self.time_s)
        wide = np.append(steps > 1.75 * float(np.median(steps)), False)
        gap = wide[held] & (grid > self.time_s[held] + 1e-6 * period)

        def put(values: np.ndarray, signal: str) -> np.ndarray:
            if signal == "time":
                return grid
            if signal in _HELD:
                return values[held]
            if values.ndim == 1:
                return np.interp(grid, self.time_s, values)
            columns = np.column_stack([np.interp(grid, self.time_s, column) for column in values.T])
            columns[gap] = np.nan
            return columns

        return self._with_rows(put)

    def _with_rows(self, put: Any) -> RigLog:
        changed: dict[str, Any] = {"time_s": put(self.time_s, "time")}
        for signal in (*CHANNEL_SIGNALS, *RIG_SIGNALS):
            values = self.get(signal)
            if values is not None:
                changed[_FIELD.get(signal, signal)] = put(values, signal)
        return replace(self, **changed)


def _period(time_s: np.ndarray) -> float:
    steps = np.diff(time_s)
    median = float(np.median(steps))
    mean = float(time_s[-1] - time_s[0]) / len(steps)
    period = mean if abs(mean - median) < 0.01 * median else median
    # Time stamps carry rounding; a period that is a whole number of microseconds but for that is meant to be one.
    whole = round(period * 1e6) / 1e6
    return whole if whole > 0 and abs(whole - period) <= 1e-6 * period else period


def read_log(path: str | Path, mapping: Mapping | str | Path | None = None) -> RigLog:
    """Reads a log file, by the rig log's own header or through a mapping; `.findings` holds the data gate's warnings.

    `InputError` (one line: file, row, column, what would be right) where the log cannot be used.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a log")
    if mapping is not None and not isinstance(mapping, Mapping):
        mapping = load_mapping(mapping)
    chosen: list[Mapping] = []

    def choose(names: tuple[str, ...]) -> tuple[str, ...]:
        chosen.append(mapping or contract_mapping(names, path))
        for column in chosen[0].columns():
            if column not in names:
                raise InputError(
                    f"{path}: column {column!r} that the mapping names is not in the header; {suggestion(column, names)}"
                )
        return chosen[0].columns()

    suffix = path.with_suffix("").suffix if path.suffix == ".gz" else path.suffix
    if suffix.lower() in BINARY:
        table = read_binary(path, choose)
    else:
        style = CsvStyle(**mapping.table.model_dump()) if mapping else None
        table = read_csv(path, choose, style)
    return _from_table(table, chosen[0], native=mapping is None)


def _from_table(table: Table, mapping: Mapping, native: bool) -> RigLog:
    findings = list(table.findings)
    count = len(table.lines)
    if count < 2:
        raise InputError(f"{table.path}: only {count} row; a log needs at least two samples")
    if mapping.time.column is None:
        assert mapping.time.sample_rate is not None
        time_s, keep = np.arange(count) / mapping.time.sample_rate, None
    else:
        time_s, keep = check_clock(table, mapping.time.column, mapping.time.unit, findings)

    def values(source: Source) -> np.ndarray | None:
        cells = table.columns[source.column]
        if np.isnan(cells).all():
            findings.append(
                Finding(
                    "empty_column",
                    f"column {source.column!r} holds no value",
                    "taken as absent",
                    column=source.column,
                )
            )
            return None
        result = source.si(cells)
        if source.minus is not None:
            result = result - source.minus.si(table.columns[source.minus.column])
        return result if keep is None else result[keep]

    signals: dict[str, Any] = {}
    for signal in CHANNEL_SIGNALS:
        columns: list[np.ndarray | None] = [None, None]
        for index, channel in enumerate(mapping.channels):
            source = getattr(channel, signal) if channel else None
            columns[index] = values(source) if source else None
            if source and columns[index] is None and signal in ("command", "speed"):
                raise InputError(
                    f"{table.path}: column {source.column!r} is empty; {signal} is required of every channel"
                )
        if any(column is not None for column in columns):
            absent = np.full(len(time_s), np.nan)
            signals[_FIELD.get(signal, signal)] = np.column_stack(
                [absent if c is None else c for c in columns]
            )
    for signal in RIG_SIGNALS:
        source = getattr(mapping, signal)
        if source is not None:
            signals[signal] = values(source)
    if native:
        known = set(contract_columns())
        for name in table.names:
            if name and name not in known:
                near = nearest(name, known)
                hint = f"; is {near!r} meant?" if near else ""
                findings.append(
                    Finding(
                        "unknown_column", f"column {name!r} is not understood and ignored{hint}", column=name
                    )
                )
    rows = table.lines if keep is None else table.lines[keep]
    start = _hold(table, mapping, signals, rows, findings)
    log = RigLog(
        time_s=time_s[start:],
        name=table.path.name,
        sha256=digest(table.path),
        kinds=tuple(channel.actuator if channel else "motor" for channel in mapping.channels),  # type: ignore[arg-type]
        displacement=tuple(  # type: ignore[arg-type]
            channel.displacement.si if channel and channel.displacement else None
            for channel in mapping.channels
        ),
        read_as={
            f"{signal}_{number + 1}": (source.column, source.unit)
            for number, channel in enumerate(mapping.channels)
            if channel
            for signal in CHANNEL_SIGNALS
            if (source := getattr(channel, signal)) is not None
        },
        **{name: None if values is None else values[start:] for name, values in signals.items()},  # type: ignore[arg-type]
    )
    if len(log) < 2:
        raise InputError(f"{table.path}: no two rows hold a command; a log needs at least two samples")
    findings += check_units(table, mapping)
    found, spoilt = check_log(log, mapping, rows[start:])
    return replace(_without(log, spoilt), findings=(*findings, *found))


def _hold(
    table: Table, mapping: Mapping, signals: dict[str, Any], rows: np.ndarray, findings: list[Finding]
) -> int:
    """Fills holes of commands, loads and set-points (in place) with the last value; the first row in which all commands
    are known. A load before its first value is zero, and a set-point its first value."""
    start = 0
    for signal in _HELD:
        values = signals.get(_FIELD.get(signal, signal))
        if values is None:
            continue
        for channel in range(values.shape[1]) if values.ndim == 2 else (None,):
            one = values if channel is None else values[:, channel]
            known = np.isfinite(one)
            if known.all() or not known.any():
                continue
            named = mapping.channels[channel] if channel is not None else mapping
            column = getattr(named, signal).column
            last = np.maximum.accumulate(np.where(known, np.arange(len(one)), -1))
            first = int(np.argmax(known))
            one[:] = np.where(last >= 0, one[np.maximum(last, 0)], 0.0 if signal == "load" else one[first])
            hint = "the value before is held"
            if signal == "command" and first > 0:
                start = max(start, first)
                hint += f", and the log begins with row {rows[first]}, the first that holds one"
            hole = int(np.argmax(~known))
            message = f"{np.sum(~known)} of {len(one)} cells of {column!r} hold no value, the first in row {rows[hole]}"
            place = {"channel": None if channel is None else channel + 1, "column": column}
            findings.append(Finding("missing_values", message, hint, signal, row=int(rows[hole]), **place))  # type: ignore[arg-type]
    return start


def _without(log: RigLog, spoilt: Spoilt) -> RigLog:
    """The log with NaN in place of spoilt samples, and of what follows a long gap unless that were most of the log."""
    late = after_gaps(log.time_s)
    late &= late.mean() < 0.5
    changed: dict[str, np.ndarray | None] = {}
    for signal in MEASURED:
        values = log.get(signal)
        if values is None or not (late.any() or any(name == signal for name, _ in spoilt)):
            continue
        values = values.copy()
        values[late] = np.nan
        for channel in (0, 1):
            if (signal, channel) in spoilt:
                values[spoilt[signal, channel], channel] = np.nan
        changed[_FIELD.get(signal, signal)] = None if signal != "speed" and np.isnan(values).all() else values
    return replace(log, **changed) if changed else log  # type: ignore[arg-type]


def write_log(path: str | Path, log: RigLog) -> None:
    """Writes a rig log as CSV (gzipped for `.csv.gz`), with 12 significant digits; absent signals get no column."""
    path = Path(path)
    if "cylinder" in [log.kinds[channel] for channel in log.channels]:
        raise ValueError(
            "the rig log's header knows rpm and N m only; a cylinder log cannot be written with it"
        )
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
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as raw:
            if path.suffix == ".gz":
                # No name and no time in the header: the same log gives the same bytes.
                with gzip.GzipFile(filename="", mode="wb", fileobj=raw, compresslevel=6, mtime=0) as packed:
                    _write_rows(packed, header, rows)
            else:
                _write_rows(raw, header, rows)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _write_rows(file: Any, header: list[str], rows: np.ndarray) -> None:
    file.write((",".join(header) + "\n").encode())
    line = ",".join(["%.12g"] * len(header)) + "\n"
    for start in range(0, len(rows), 10_000):
        text = "".join(line % tuple(row) for row in rows[start : start + 10_000].tolist())
        file.write(text.replace("nan", "").encode())
