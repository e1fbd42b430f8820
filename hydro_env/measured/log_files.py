"""Rig logs from files and to files: by the rig log's own header or through a mapping, with what the data gate says."""

import gzip
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import InputError, located, nearest
from ..files import replacing, sha256_of
from ..units import REVOLUTION, from_si, unit
from .finding import Finding
from .formats import read_table
from .gate import SETTLE_S, check_clock, check_log, check_numbers, check_units, long_gap
from .log import HELD, RigLog, field_of
from .mapping import Mapped, Mapping, contract_columns, contract_mapping, load_mapping
from .samples import MEASURED
from .table import Table

#: The slope of a position is taken over at most so long, s: what the dynamics of such rigs leave.
_SLOPE_S = 0.04
#: Noise of a speed, as a share of its range, that is worth no longer a slope.
_SLOPE_NOISE = 0.003

Signals = dict[str, np.ndarray]


def read_log(path: str | Path, mapping: Mapping | str | Path | None = None) -> RigLog:
    """Reads a log file, by the rig log's own header or through a mapping; `.findings` holds the data gate's warnings.

    `InputError` (one line: file, row, column, what would be right) where the log cannot be used.
    """
    path = Path(path)
    given = mapping if mapping is None or isinstance(mapping, Mapping) else load_mapping(mapping)
    chosen: list[Mapping] = []

    def choose(names: tuple[str, ...]) -> tuple[str, ...]:
        chosen[:] = [given or contract_mapping(names)]  # a second reading may see another header
        return chosen[0].columns()

    table = read_table(path, choose, given.table if given else None)
    if given is None:
        table.findings.extend(_unknown_columns(table))
    with located(path):
        log = _log_of(table, chosen[0])
    return replace(log, name=path.name, sha256=sha256_of(path))


def _unknown_columns(table: Table) -> Iterator[Finding]:
    known = contract_columns()
    for name in table.names:
        if name and name not in known:
            near = nearest(name, known)
            hint = f"; is {near!r} meant?" if near else ""
            yield Finding("unknown_column", f"column {name!r} is unknown and ignored{hint}", column=name)


def _log_of(table: Table, mapping: Mapping) -> RigLog:
    """The log in SI, with what is not measured or not known left out, and all that was noticed on the way."""
    findings = table.findings
    if len(table.lines) < 2:
        raise InputError("only 1 row; a log needs at least two samples")
    time_s, keep = check_clock(table, mapping.time)
    rows = table.lines[keep]
    signals = _signals(table, mapping, keep, time_s)
    table.columns.clear()  # an hour of them is half the memory
    start, end, unknown = _hold(mapping, signals, time_s, rows, findings)
    if end - start < 2:
        raise InputError("no two rows hold a command; a log needs at least two samples")
    part = slice(start, end)
    one, two = mapping.channels
    of_channels = [each for each in mapping.sources() if each.number]
    log = RigLog(
        time_s=time_s[part],
        kinds=(one.actuator if one else "motor", two.actuator if two else "motor"),
        displacement=(one.size if one else None, two.size if two else None),
        read_as={f"{each.signal}_{each.number}": (each.column, each.source.unit) for each in of_channels},
        **{name: values[part] for name, values in signals.items()},  # type: ignore[arg-type]
    )
    findings += check_units(table, mapping)
    findings += check_log(log, mapping, rows[part])
    late = _unknown(log.time_s, np.ones(len(log), bool))[1]  # behind gaps of the clock
    late &= late.mean() < 0.5  # or most of the log would be left out
    late |= unknown[part]
    return _with_load_pressure(replace(_without(log, late), findings=tuple(findings)))


def _signals(table: Table, mapping: Mapping, keep: np.ndarray | slice, time_s: np.ndarray) -> Signals:
    """The arrays of a `RigLog` in SI: (T, 2) of the channels, NaN where one lacks the signal, and (T,) of the rig."""
    signals: Signals = {}
    for each in mapping.sources():
        if np.isnan(table.columns[each.column]).all():
            if each.signal in ("command", "speed"):
                raise InputError(f"column {each.column!r} is empty; the {each.signal} is required")
            told = f"column {each.column!r} holds no value"
            table.findings.append(Finding("empty_column", told, "taken as absent", column=each.column))
            continue
        values = _si(table, each)[keep]
        if each.signal == "speed" and unit(each.source.unit).quantity in ("angle", "length"):
            values, finding = _slope(values, time_s, each)
            table.findings.append(finding)
        if each.channel is None:
            signals[each.signal] = values
        else:
            both = signals.setdefault(field_of(each.signal), np.full((len(values), 2), np.nan))
            both[:, each.channel] = values
    return signals


def _si(table: Table, mapped: Mapped) -> np.ndarray:
    """A signal in SI (T,)."""
    values = []
    for part in mapped.source.parts:
        with np.errstate(all="ignore"):
            values.append(np.asarray(part.si(table.columns[part.column])))
        check_numbers(table, part.column, values[-1])
    return values[0] if len(values) == 1 else np.asarray(values[0] - values[1])


def _slope(position: np.ndarray, time: np.ndarray, mapped: Mapped) -> tuple[np.ndarray, Finding]:
    """The speed (T,) of a position (T,) in SI at times (T,): the difference over as few rows as its noise allows, centred.

    An angle that stays within one revolution is unwound first. Noise is that of differences of the second order, of which
    six times its variance is left (quantisation included).
    """
    if unit(mapped.source.unit).quantity == "angle":
        position = _unwound(position)
    second = np.diff(position, 2)
    second = second[np.isfinite(second)]
    noise = float(np.sqrt(np.mean(second**2) / 6.0)) if len(second) else 0.0
    rows, period = 1, float(np.median(np.diff(time)))
    most, here = _SLOPE_S / 2.0 / period, np.arange(len(time))
    while True:
        # Between `rows` before and after each row, over fewer at the ends.
        before, after = np.maximum(here - rows, 0), np.minimum(here + rows, len(time) - 1)
        speed = np.asarray((position[after] - position[before]) / (time[after] - time[before]))
        low, high = np.nanquantile(speed, (0.01, 0.99)) if np.isfinite(speed).any() else (0.0, 0.0)
        if 2 * rows > most or noise * 2**0.5 <= _SLOPE_NOISE * (high - low) * 2 * rows * period:
            break
        rows *= 2
    message = f"the speed of channel {mapped.number} is the slope of {mapped.column!r} over {2 * rows} rows"
    return speed, mapped.finding("from_position", message)


def _unwound(angle: np.ndarray) -> np.ndarray:
    """The angle (T,) without its jumps by a revolution, if it is kept within one."""
    known = np.isfinite(angle)
    if known.any() and np.ptp(angle[known]) <= 1.001 * REVOLUTION:
        angle = angle.copy()
        angle[known] = np.unwrap(angle[known])
    return angle


def _hold(
    mapping: Mapping, signals: Signals, time_s: np.ndarray, rows: np.ndarray, findings: list[Finding]
) -> tuple[int, int, np.ndarray]:
    """Fills holes of commands, loads and set-points (in place) with the last value. A load before its first value is zero, and a
    set-point its first value.

    Returns the first row in which all commands are known, the row behind the last, and the rows (T,) within long holes of a
    command, or soon behind them: what the valve was told there is not known.
    """
    begin, end, unknown = 0, len(rows), np.zeros(len(rows), bool)
    for each in mapping.sources():
        values = signals.get(field_of(each.signal))
        if each.signal not in HELD or values is None:
            continue
        one = values if each.channel is None else values[:, each.channel]
        known = np.isfinite(one)
        if known.all() or not known.any():
            continue
        last = np.maximum.accumulate(np.where(known, np.arange(len(one)), -1))
        first = int(np.argmax(known))
        one[:] = np.where(last >= 0, one[np.maximum(last, 0)], 0.0 if each.signal == "load" else one[first])
        hint = "the value before is held"
        if each.signal == "command":
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
        row = int(rows[np.argmin(known)])
        missing = f"holds no value in {np.sum(~known)} of {len(one)} cells, the first in row {row}"
        findings.append(each.finding("missing_values", f"{each.column!r} {missing}", hint, row))
    return begin, end, unknown


def _unknown(time_s: np.ndarray, known: np.ndarray) -> tuple[int, np.ndarray]:
    """The row behind the last whose command is `known` (T,) or may be held, and the rows (T,) in long holes and after them.

    A recorder may write each command once only: a hole is long beside the time from one command to the next.
    """
    at = np.flatnonzero(known)
    steps = np.diff(time_s[at])
    usual = float(np.median(steps)) if len(steps) else 0.0
    found = np.zeros(len(known), bool)
    for n in np.flatnonzero(steps > long_gap(usual)):
        # Also what follows: the state is a guess for so long.
        found[at[n] + 1 : np.searchsorted(time_s, time_s[at[n + 1]] + SETTLE_S)] = True
    end = int(at[-1]) + 1
    if time_s[-1] - time_s[at[-1]] <= long_gap(usual):
        end = len(known)
    return end, found


def _without(log: RigLog, late: np.ndarray) -> RigLog:
    """The log without what was measured in some rows (T,), and without signals of which nothing is left."""
    gone: dict[str, None] = {}
    for signal in MEASURED:
        values = log.get(signal)
        if values is not None:
            values[late] = np.nan
            if signal != "speed" and np.isnan(values).all():
                gone[signal] = None
    return replace(log, **gone) if gone else log  # type: ignore[arg-type]


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
    columns = {
        column: from_si(log.of(signal, channel), symbol)
        for column, (signal, channel, symbol) in contract_columns().items()
        if channel in (None, *log.channels) and log.has(signal, channel)
    }
    text = io.StringIO()
    rows = np.column_stack(list(columns.values()))
    np.savetxt(text, rows, "%.12g", ",", header=",".join(columns), comments="")
    content = text.getvalue().replace("nan", "").encode()
    with replacing(path) as file:
        # No time in the header of the gzip file: the same log gives the same bytes.
        file.write(gzip.compress(content, 6, mtime=0) if path.suffix == ".gz" else content)
