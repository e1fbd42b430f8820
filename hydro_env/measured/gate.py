"""The data gate: what is suspicious about a log before any model is compared with it.

What makes a log unusable is an `InputError`; everything else is a `Finding` for the report. The tests are
deliberately blunt: each looks for one mistake that recordings really have (a sensor that stuck, kPa called bar,
two plugs swapped) and stays silent on a clean log.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_env.errors import InputError
from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import CHANNEL_SIGNALS, Mapping
from hydro_env.measured.table import Table
from hydro_env.units import BAR, RPM, to_si

if TYPE_CHECKING:
    from hydro_env.measured.log import RigLog

__all__ = ["check_clock", "check_log"]

_MEASURED = ("current", "pressure", "speed", "spool", "flow")
_STUCK_S = (
    0.25  # a sensor that repeats itself to the last digit for longer, while the command moves, is stuck
)
_MANY_STEPS = 200  # a signal resolved in fewer steps over its range is called coarse
_CORRELATE = 20_000  # rows that suffice for a correlation


def check_clock(
    table: Table, column: str, unit: str, findings: list[Finding]
) -> tuple[np.ndarray, np.ndarray | None]:
    """The clock of a table: time in s (K,) and the indices (K,) of the rows to keep (None = all).

    `InputError` where a time is missing or runs backwards, or where the stamps are too coarse to order the rows;
    a few repeated stamps are dropped with a finding, gaps and an uneven rate are findings.
    """
    time = to_si(table.columns[column], unit)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise InputError(
            f"{table.path}: row {table.row(bad[0])}, column {column!r}: no time; every row needs one, so delete the row"
        )
    if abs(time[0]) > 1e6:
        findings.append(
            Finding(
                "epoch_time", f"time starts at {time[0]:.0f} s; counted from the first row", column=column
            )
        )
        time = time - time[0]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        first = back[0] + 1
        raise InputError(
            f"{table.path}: row {table.row(first)}, column {column!r}: time runs backwards "
            f"({time[first - 1]:.6g} s, then {time[first]:.6g} s); time must increase, so split the log there"
        )
    keep = None
    same = np.flatnonzero(steps == 0)
    if len(same):
        row = table.row(same[0] + 1)
        if len(same) > 0.01 * len(time) + 1:
            raise InputError(
                f"{table.path}: row {row}, column {column!r}: {len(same)} rows repeat the time of the row before; "
                "write more digits, or give `time: {sample_rate: ...}` in a mapping"
            )
        message = f"{len(same)} rows repeat the time of the row before; the later ones are dropped"
        findings.append(Finding("duplicate_time", message, "one row per instant", column=column, row=row))
        keep = np.flatnonzero(np.concatenate([[True], steps > 0]))
        time = time[keep]
        if len(time) < 2:
            raise InputError(
                f"{table.path}: column {column!r}: all rows have the same time; a log needs at least two"
            )
        steps = np.diff(time)
    rows = table.lines if keep is None else table.lines[keep]
    findings.extend(_rate(steps, time, rows, column))
    return time, keep


def _rate(steps: np.ndarray, time: np.ndarray, rows: np.ndarray, column: str) -> Iterator[Finding]:
    median = float(np.median(steps))
    gaps = np.flatnonzero(steps > 1.75 * median)
    jumps = gaps[steps[gaps] > max(10.0, 100.0 * median)]
    if len(jumps):
        at = jumps[0]
        yield Finding(
            "clock_jump",
            f"the clock jumps by {steps[at]:.6g} s after {time[at]:.6g} s ({len(jumps)} such jumps)",
            "split the log there: the state is unknown after the jump",
            column=column,
            row=int(rows[at + 1]),
        )
    elif 0 < len(gaps) <= 0.02 * len(steps) + 1 and len(steps) > 2:
        at = gaps[np.argmax(steps[gaps])]
        yield Finding(
            "gap",
            f"{len(gaps)} gaps; the longest lasts {steps[at]:.6g} s after {time[at]:.6g} s (rows every {median:.6g} s)",
            "the last command before a gap is taken as held through it",
            column=column,
            row=int(rows[at + 1]),
        )
    ordinary = steps[steps <= 1.75 * median]
    spread = float(np.quantile(np.abs(ordinary - median), 0.95)) / median
    if spread > 0.05 or len(gaps) > 0.02 * len(steps) + 1:
        message = (
            f"rows are unevenly spaced: steps {steps.min():.6g} to {steps.max():.6g} s, median {median:.6g} s"
        )
        yield Finding(
            "uneven_sampling", message, "record at a fixed rate, or resample the log", column=column
        )
    if median >= 0.5:
        yield Finding(
            "time_unit",
            f"rows come every {median:.6g} s; is {column!r} in ms?",
            "time is in s",
            column=column,
        )
    elif median < 1e-5:
        yield Finding(
            "time_unit", f"rows come every {median:.3g} s; is the unit of {column!r} right?", column=column
        )


def check_log(log: RigLog, mapping: Mapping, rows: np.ndarray) -> list[Finding]:
    """What is suspicious about the values of a log; `rows` (T,) are the lines of the file that hold its samples."""
    findings: list[Finding] = []
    for signal in CHANNEL_SIGNALS:
        values = log.get(signal)
        for channel in (0, 1):
            source = getattr(mapping.channels[channel], signal, None)
            if values is None or source is None or not log.has(signal, channel):
                continue
            place = {"signal": signal, "channel": channel + 1, "column": source.column}
            findings.extend(_check_signal(log, values[:, channel], channel, rows, place))
            findings.extend(_check_size(values[:, channel], log, channel, place))
    if log.supply is not None and mapping.supply is not None:
        findings.extend(
            _check_size(log.supply, log, 0, {"signal": "supply", "column": mapping.supply.column})
        )
    if log.temperature is not None and mapping.temperature is not None:
        place = {"signal": "temperature", "column": mapping.temperature.column}
        findings.extend(_check_size(log.temperature, log, 0, place))
    findings.extend(_check_setpoint(log, mapping))
    findings.extend(_check_supply(log, mapping))
    findings.extend(_check_channels(log, mapping))
    return findings


def _check_signal(
    log: RigLog, values: np.ndarray, channel: int, rows: np.ndarray, place: dict[str, Any]
) -> Iterator[Finding]:
    """Missing, constant, stuck, clipped and coarse values of one signal (T,)."""
    signal, column = place["signal"], place["column"]
    missing = np.flatnonzero(~np.isfinite(values))
    if len(missing):
        yield Finding(
            "missing_values",
            f"{len(missing)} of {len(values)} cells of {column!r} hold no value",
            "missing samples are left out of every comparison"
            if signal in _MEASURED
            else "commands and loads should have no holes",
            row=int(rows[missing[0]]),
            **place,
        )
    finite = values[np.isfinite(values)]
    if not len(finite) or signal == "load":
        return
    low, high = float(finite.min()), float(finite.max())
    if high == low:
        if len(finite) > 10:
            message = f"{column!r} is constant"
            yield Finding(
                "constant", message, "a log says nothing about what does not move: excite the rig", **place
            )
        return
    if signal not in _MEASURED:
        return
    starts, lengths = _runs(values)
    yield from _stuck(log, values, channel, rows, starts, lengths, place)
    yield from _clipped(values, low, high, starts, lengths, place)
    levels = np.unique(finite)
    step = float(np.min(np.diff(levels))) if len(levels) > 1 else 0.0
    # Few levels over many rows: the steps of the converter show. A clean signal has nearly as many values as rows.
    if (
        len(finite) > 500
        and len(levels) < _MANY_STEPS
        and len(levels) < len(finite) / 10
        and step > 1e-9 * (high - low)
    ):
        message = f"{column!r} has only {len(levels)} different values (step {step / (high - low):.2%} of its range)"
        yield Finding("coarse", message, "record with finer resolution where possible", **place)


def _runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and lengths of the runs of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))


def _stuck(
    log: RigLog,
    values: np.ndarray,
    channel: int,
    rows: np.ndarray,
    starts: np.ndarray,
    lengths: np.ndarray,
    place: dict[str, Any],
) -> Iterator[Finding]:
    command = log.command_V[:, channel]
    swing = float(np.nanmax(command) - np.nanmin(command)) if log.has("command", channel) else 0.0
    if swing == 0.0:
        return
    least = max(20, int(_STUCK_S / log.period))
    for start, length in zip(starts[lengths >= least], lengths[lengths >= least], strict=True):
        if values[start] == 0.0:  # at rest, a computed speed is exactly zero
            continue
        # The command must have moved well before the run ends, and the run must not be a plateau at full scale.
        early = command[start : start + length * 2 // 3]
        at_end = values[start] in (np.nanmin(values), np.nanmax(values))
        if not at_end and np.nanmax(early) - np.nanmin(early) > 0.1 * swing:
            yield Finding(
                "stuck",
                f"{place['column']!r} repeats one value for {length * log.period:.3g} s from {log.time_s[start]:.6g} s "
                "while the command moves",
                "a stuck sensor or a frozen recorder: leave this stretch out",
                row=int(rows[start]),
                **place,
            )
            return


def _clipped(
    values: np.ndarray,
    low: float,
    high: float,
    starts: np.ndarray,
    lengths: np.ndarray,
    place: dict[str, Any],
) -> Iterator[Finding]:
    typical = float(np.median(lengths))
    for limit, name in ((low, "smallest"), (high, "largest")):
        if limit == 0.0:
            continue
        long = (values[starts] == limit) & (lengths >= max(5.0, 5.0 * typical))
        share = float(lengths[long].sum()) / len(values)
        if not long.any() or share < 0.002:
            continue
        # A limit is run into: the signal still moves when it gets there, unlike one that settles at a steady value.
        entries = starts[long]
        entries = entries[entries > 0]
        if len(entries) == 0:
            continue
        arrival = np.abs(values[entries] - values[entries - 1])
        if np.median(arrival) > 2e-4 * (high - low):
            message = f"{place['column']!r} stays at its {name} value in {share:.1%} of the rows"
            yield Finding("clipped", message, "a sensor or converter at its limit: widen its range", **place)


def _check_size(values: np.ndarray, log: RigLog, channel: int, place: dict[str, Any]) -> Iterator[Finding]:
    """Magnitudes that point to a wrong unit."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    peak = float(np.max(np.abs(finite)))
    signal, column = place["signal"], place["column"]

    def odd(seen: str, guess: str) -> Finding:
        return Finding(
            "unit", f"{column!r} peaks at {seen}: {guess}?", "give the right unit in a mapping", **place
        )

    if signal in ("pressure", "supply"):
        if peak > 700 * BAR:
            yield odd(f"{peak / BAR:.4g} bar", "is it in kPa, psi or Pa")
        elif signal == "supply" and peak < 5 * BAR:
            yield odd(f"{peak / BAR:.4g} bar", "is it in MPa")
    elif signal == "speed" and peak > 0.0:
        if log.kinds[channel] == "motor":
            if peak > 6000 * RPM:
                yield odd(f"{peak / RPM:.4g} rpm", "is it in deg/s")
            elif peak < 80 * RPM and log.setpoint is None:
                yield odd(f"{peak / RPM:.4g} rpm", f"slow motion, or {peak / RPM:.3g} rad/s")
        elif peak > 5.0:
            yield odd(f"{peak:.4g} m/s", "is it in mm/s")
    elif signal == "command" and peak > 200.0:
        yield odd(f"{peak:.4g} V", "is it in mV")
    elif signal == "command" and 0.0 < peak <= 1.0 and column.endswith("_V"):
        yield odd(f"{peak:.4g} V", "is it a fraction of full scale")
    elif signal == "current" and peak > 20.0:
        yield odd(f"{peak:.4g} A", "is it in mA")
    elif signal == "temperature" and not 230.0 < float(np.median(finite)) < 430.0:
        yield odd(f"{peak - 273.15:.4g} degC", "is it in K or degF")


def _check_setpoint(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """A speed that follows the set-point in another unit."""
    if log.setpoint is None:
        return
    for channel in log.channels:
        speed, setpoint = _clean(log.speed[:, channel], log.setpoint)
        if len(speed) < 20 or np.std(speed) == 0 or np.std(setpoint) == 0:
            continue
        if np.corrcoef(speed, setpoint)[0, 1] < 0.5:
            continue
        slope = float(np.std(speed) / np.std(setpoint))
        for factor, guess in (
            (RPM, "is the speed in rad/s"),
            (1.0 / RPM, "is the set-point in rad/s"),
            (6.0, "is the speed in deg/s"),
        ):
            if log.kinds[channel] == "motor" and 0.75 < slope / factor < 1.33:
                source = mapping.channels[channel]
                yield Finding(
                    "unit",
                    f"the speed of channel {channel + 1} follows the set-point with a factor of {slope:.3g}: {guess}?",
                    "give the right unit in a mapping",
                    "speed",
                    channel + 1,
                    source.speed.column if source else None,
                )


def _check_supply(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    if log.supply is None or log.pressure is None:
        return
    for channel in log.channels:
        source = mapping.channels[channel]
        if source is None or source.pressure is None or not log.has("pressure", channel):
            continue
        pressure, supply = _clean(np.abs(log.pressure[:, channel]), log.supply)
        if not len(pressure):
            continue
        ratio = float(np.quantile(pressure, 0.99) / max(float(np.median(supply)), 1.0))
        if ratio > 3.0:
            message = f"{source.pressure.column!r} is {ratio:.3g} times the supply pressure: another unit?"
            place = ("pressure", channel + 1, source.pressure.column)
            yield Finding("unit", message, "give the right unit in a mapping", *place)


def _check_channels(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Sign of each channel, channels exchanged, the same data twice."""
    both = [mapping.channels[channel] for channel in (0, 1)]
    for channel in log.channels:
        source = both[channel]
        best = _follow(log, channel, channel)
        if source is not None and best < -0.4:
            message = (
                f"the speed of channel {channel + 1} falls when its command rises (correlation {best:.2f})"
            )
            hint = "give `sign: -1` for the speed or the command in a mapping"
            yield Finding("sign", message, hint, "speed", channel + 1, source.speed.column)
    if log.channels != (0, 1):
        return
    own = [_follow(log, channel, channel) ** 2 for channel in (0, 1)]
    crossed = [_follow(log, 1 - channel, channel) ** 2 for channel in (0, 1)]
    if all(crossed[channel] > own[channel] + 0.1 for channel in (0, 1)):
        message = (
            "each speed follows the other channel's command better than its own: are the motors swapped?"
        )
        yield Finding("swapped", message, "exchange the speed columns in a mapping", "speed")
    for signal in _MEASURED:
        values = log.get(signal)
        sources = [getattr(source, signal) if source else None for source in both]
        if values is None or sources[0] is None or sources[1] is None:
            continue
        first, second = _clean(values[:, 0], values[:, 1])
        if len(first) > 10 and np.ptp(first) > 0 and np.array_equal(first, second):
            # Two simulated channels may really agree; then their commands do, too.
            if signal == "speed" and np.array_equal(log.command_V[:, 0], log.command_V[:, 1], equal_nan=True):
                continue
            if signal != "speed" and np.array_equal(log.speed[:, 0], log.speed[:, 1], equal_nan=True):
                continue
            message = f"{sources[0].column!r} and {sources[1].column!r} hold the same values"
            yield Finding(
                "duplicate_column",
                message,
                "record each channel's own sensor",
                signal,
                column=sources[1].column,
            )


def _clean(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    keep = np.isfinite(first) & np.isfinite(second)
    return first[keep], second[keep]


def _follow(log: RigLog, commanding: int, moving: int) -> float:
    """The correlation of a speed with a command, at the lag (0 to 0.5 s) where it is strongest; 0 where undefined."""
    best = 0.0
    lags = np.unique(np.round(np.linspace(0.0, 0.5, 11) / log.period).astype(int))
    stride = max(1, len(log) // _CORRELATE)
    for lag in lags:
        if len(log) - lag < 50:
            break
        command = log.command_V[: len(log) - lag : stride, commanding]
        speed = log.speed[lag::stride, moving]
        command, speed = _clean(command[: len(speed)], speed[: len(command)])
        if len(command) < 50 or np.std(command) == 0.0 or np.std(speed) == 0.0:
            continue
        value = float(np.corrcoef(command, speed)[0, 1])
        if abs(value) > abs(best):
            best = value
    return best
