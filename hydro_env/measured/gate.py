"""The data gate: what is suspicious about a log before any model is compared with it.

What makes a log unusable is an `InputError`; everything else is a `Finding` for the report. The tests are
deliberately blunt: each looks for one mistake that recordings really have (a sensor that stuck, kPa called bar,
two plugs swapped) and stays silent on a clean log.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from hydro_env.measured.channels import check_channels, check_lines, check_sizes
from hydro_env.measured.finding import Finding
from hydro_env.measured.log import RigLog
from hydro_env.measured.mapping import Mapping, Time
from hydro_env.measured.names import unit_of
from hydro_env.measured.samples import check_samples
from hydro_env.measured.table import Table
from hydro_env.units import to_si, unit

LARGEST = 1e18  # in SI; the squares of larger ones leave single precision, in which logs are fitted
_RESOLUTION_S = 1e-6  # clocks are read to the microsecond, and no rig is recorded faster
_MIN_PERIOD_S, _MAX_PERIOD_S = 1e-4, 0.5  # between the rows of usual logs of such rigs
_FASTEST_S = 4e-5  # faster than 25 kHz only oscilloscopes record
SETTLE_S = 1.0  # after a gap the state of a simulation is a guess for so long


def check_clock(table: Table, clock: Time) -> tuple[np.ndarray, np.ndarray | slice]:
    """The clock of a table as its mapping says it: time in s (K,) and the rows to keep, as an index.

    `InputError` where a time is missing or runs backwards, where the stamps are too coarse to order the rows or nearer to
    each other than a microsecond; a few repeated stamps are dropped with a finding, gaps and an uneven rate are findings.
    """
    if clock.sample_rate is not None:
        return np.arange(len(table.lines)) / clock.sample_rate, slice(None)
    findings, column = table.findings, clock.column or ""
    with np.errstate(all="ignore"):
        time = to_si(table.columns[column], clock.unit)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise table.refused(column, "no time; every row needs one, so delete the row", bad[0])
    check_numbers(table, column, time)
    if abs(time[0]) > 1e6 or any(f.code == "time_stamps" for f in findings):
        message = f"time starts at {time[0]:.0f} s; counted from the first row"
        findings.append(Finding("epoch_time", message, column=column))
        # Seconds since 1970 have about seven digits after the point: enough for a clock in microseconds.
        time = np.round(time - time[0], 6)
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        first = back[0] + 1
        told = f"time runs backwards ({time[first - 1]:.6g} s, then {time[first]:.6g} s)"
        raise table.refused(column, f"{told}; time must increase, so split the log there", first)
    keep: np.ndarray | slice = slice(None)
    same = np.flatnonzero(steps == 0)
    if len(same):
        row = table.row(same[0] + 1)
        pairs = [(values[same], values[same + 1]) for values in table.columns.values()]
        copies = all(np.array_equal(one, next_one, equal_nan=True) for one, next_one in pairs)
        if len(same) > 0.01 * len(time) + 1 and not copies:
            told = f"{len(same)} rows repeat the time of the row before with other values"
            hint = "write more digits, or give `time: {sample_rate: ...}` in a mapping"
            raise table.refused(column, f"{told}; {hint}", same[0] + 1)
        what = "are copies of the row before" if copies else "repeat the time of the row before"
        message = f"{len(same)} rows {what}, the first is row {row}; the later ones are dropped"
        findings.append(Finding("duplicate_time", message, "one row per instant", column=column, row=row))
        keep = np.flatnonzero(np.concatenate([[True], steps > 0]))
        time = time[keep]
        if len(time) < 2:
            raise table.refused(column, "all rows have the same time; a log needs at least two")
        steps = np.diff(time)
    if float(np.median(steps)) < _RESOLUTION_S:
        told = f"rows come every {np.median(steps):.3g} s; a clock is read to {_RESOLUTION_S:g} s"
        raise table.refused(column, f"{told}, so give its right unit in a mapping")
    findings.extend(_rate(steps, time, table.lines[keep], column, clock.unit))
    return time, keep


def _clock_unit(column: str, time: np.ndarray, median: float, unit: str) -> Iterator[Finding]:
    """A clock whose rows come as seldom or as often as no recorder's: everybody would choose its rate in another unit."""
    period, hint = float(time[-1] - time[0]) / (len(time) - 1), "give the right unit in a mapping"
    for longer in ("min", "h") if unit == "s" and not _is_chosen(period) else ():
        other = to_si(period, longer)
        if _MIN_PERIOD_S <= other < _MAX_PERIOD_S and _is_chosen(other):
            rate = f"{period:.3g} s ({1.0 / period:,.0f} a second)"
            message = f"rows come every {rate}: is {column!r} in {longer}, every {other:.3g} s?"
            right, sure = {"time": {"unit": longer}}, period < _FASTEST_S
            hint += f" (`time: {{column: ..., unit: {longer}}}`)"
            yield Finding("time_unit", message, hint, column=column, sure=sure, fix=right)
            return
    if median >= _MAX_PERIOD_S:
        message, right = f"rows come every {median:.6g} s: is {column!r} in ms?", {"time": {"unit": "ms"}}
        hint = f"time_s is in s; {hint} (`time: {{column: ..., unit: ms}}`)"
        yield Finding("time_unit", message, hint, column=column, sure=True, fix=right)
    elif median < _FASTEST_S:
        rate = f"{median:.3g} s ({1.0 / median:,.0f} a second)"
        yield Finding("time_unit", f"rows come every {rate}: is the unit of {column!r} right?", column=column)


def _is_chosen(period: float) -> bool:
    """Whether a period, s, or its rate is a number that recorders are set to: 1, 2, 2.5, 4, 5, 8 and tens of it, or 75 rows a
    second doubled some times."""
    doublings = np.log2(1.0 / (75.0 * period))
    digits = period / 10.0 ** np.floor(np.log10(period))
    usual = np.array([1.0, 2.0, 2.5, 4.0, 5.0, 8.0, 10.0])
    return bool(abs(doublings - round(doublings)) < 0.005 or (np.abs(digits / usual - 1.0) < 0.003).any())


def check_numbers(table: Table, column: str, values: np.ndarray) -> None:
    """InputError if a value (T,) in SI is larger than anything measured."""
    huge = np.flatnonzero(np.abs(values) > LARGEST)
    if len(huge):
        told = f"{table.columns[column][huge[0]]:.6g} is no measurement"
        raise table.refused(column, f"{told}; leave the cell empty where nothing was measured", huge[0])


def _rate(steps: np.ndarray, time: np.ndarray, rows: np.ndarray, column: str, unit: str) -> Iterator[Finding]:
    median = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.75 * median)
    jumps = np.flatnonzero(steps > jump_size(time))
    if len(jumps):
        at = jumps[0]
        message = f"the clock jumps by {steps[at]:.6g} s after {time[at]:.6g} s ({len(jumps)} such jumps)"
        hint = "the state is unknown after a jump: split the log there, or name parts on one side of it, LOG@FROM:TO"
        yield Finding("clock_jump", message, hint, column=column, row=int(rows[at + 1]), sure=True)
    elif 0 < len(gaps) <= 0.02 * len(steps) + 1 and len(steps) > 2:
        at = gaps[np.argmax(steps[gaps])]
        many = f"{len(gaps)} gaps" if len(gaps) > 1 else "1 gap"
        longest = f"the longest lasts {steps[at]:.6g} s after {time[at]:.6g} s (before row {rows[at + 1]};"
        message = f"{many} in {column!r}; {longest} rows every {median:.6g} s)"
        hint = "the gap counts for nothing, nor what depends on the time at which its commands changed"
        if steps[at] > long_gap(median):
            hint += f", nor does the {SETTLE_S:g} s after it"
        yield Finding("gap", message, hint, column=column, row=int(rows[at + 1]))
    ordinary = steps[steps <= 1.75 * median]
    spread = float(np.quantile(np.abs(ordinary - median), 0.95)) / median
    if spread > 0.05 or len(gaps) > 0.02 * len(steps) + 1:
        range_of = f"steps {steps.min():.6g} to {steps.max():.6g} s, median {median:.6g} s"
        message = f"rows are unevenly spaced: {range_of}"
        hint = "commands are held from their own times on, and the model is compared at the times of the rows"
        yield Finding("uneven_sampling", message, hint, column=column)
    yield from _clock_unit(column, time, median, unit)


def check_log(log: RigLog, mapping: Mapping, rows: np.ndarray) -> list[Finding]:
    """What is suspicious about the values of a log, whose rows (T,) are these lines of the file. Samples that are no measurements
    of the rig become NaN in the log's arrays, once all is looked at."""
    findings: list[Finding] = []
    invalid: list[tuple[Any, np.ndarray]] = []
    for each in mapping.sources():
        if each.channel is not None and log.has(each.signal, each.channel):
            one = check_samples(log, each, rows)
            findings += one.findings
            invalid.append((log.of(each.signal, each.channel), one.invalid))
    findings += check_sizes(log, mapping)
    findings += check_channels(log, mapping)
    findings += check_lines(log, mapping)
    for values, bad in invalid:
        values[bad] = np.nan
    return findings


def check_units(table: Table, mapping: Mapping) -> Iterator[Finding]:
    """Where the file itself gives a unit (a row of units, a unit in the binary file) and the mapping another one."""
    parts: list[tuple[Any, ...]] = [(mapping.time.column or "", mapping.time.unit, None, None)]
    for each in mapping.sources():
        parts += [(part.column, part.unit, each.signal, each.number) for part in each.source.parts]
    for column, read_as, signal, number in parts:
        said = table.units.get(column, "")
        if said and (known := unit_of(said)) and known != unit(read_as):
            message = f"the file says that {column!r} is in {said}, it is read as {read_as}"
            yield Finding("unit", message, "give the right unit in a mapping", signal, number, column)


def jump_size(time: np.ndarray) -> float:
    """Steps of a clock (T,) longer than this, s, are jumps: what the rig did meanwhile is unknown."""
    return max(10.0, 100.0 * float(np.median(np.diff(time))))


def long_gap(period: float) -> float:
    """Steps longer than this, s, are long beside the usual period: a simulation does not know the state behind them."""
    return max(10.0 * period, 0.05)
