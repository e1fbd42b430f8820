"""The samples of one signal: missing, constant, stuck, clipped, coarse, and a sensor that is disturbed for a while.

Samples that are not measurements of the rig (a sensor that stuck, a converter at its end, a disturbed sensor) are given
back as spoilt; who reads the log leaves them out of every comparison.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_env.measured.finding import Finding
from hydro_env.units import BAR, LPM, MILLIMETRE, RPM

if TYPE_CHECKING:
    from hydro_env.measured.log import RigLog

__all__ = ["MEASURED", "check_samples", "standing_out"]

MEASURED = ("current", "pressure", "speed", "spool", "flow", "pressure_a", "pressure_b")
_STUCK_S = 0.25  # a sensor that repeats itself to the last digit for longer while the command moves is stuck
_MANY_STEPS = 200  # a signal resolved in fewer steps over its range is called coarse
_LEVEL_ROWS = 0.38  # share of second differences below half a step, if those of noise and rounding are normal
_SPIKE = 0.1  # a spike that the machine could do, but for no reason, stands out by this share of the signal's swing
_SPIKE_NEAR = 6.0  # ... by so many times what four of five rows nearby are off at most, some eight standard deviations of noise
_SPIKE_NOISE = 8.0  # ... by so many of the signal's median steps, again eight standard deviations
_SPIKE_PERIOD = 2e-3  # s, in slower logs only speeds are searched for spikes
_BURST_S = 0.5  # windows in which a disturbance is looked for
_BURST_RATIO = 6.0  # the fast part of a disturbed signal stands out of its usual one by more
_MOVES = 0.05  # a speed moves if no cubic explains this share of its standard deviation within a window
_SILENT_S = 3.0  # a pressure that is stuck in its noise is so for at least this long in all
_LEFT_OUT = "left out of every comparison"


def check_samples(
    log: RigLog, signal: str, channel: int, rows: np.ndarray, column: str
) -> tuple[list[Finding], np.ndarray]:
    """Findings about a signal of a channel (0, 1), and which samples (T,) are spoilt; `rows` (T,) are lines of the file."""
    values = log.get(signal)
    assert values is not None
    values = np.ascontiguousarray(values[:, channel])
    place: dict[str, Any] = {"signal": signal, "channel": channel + 1, "column": column}
    findings: list[Finding] = []
    spoilt = np.zeros(len(values), bool)
    missing = np.flatnonzero(~np.isfinite(values))
    if len(missing):
        message = f"{len(missing)} of {len(values)} cells of {column!r} hold no value, the first in row {rows[missing[0]]}"
        findings.append(Finding("missing_values", message, _LEFT_OUT, row=int(rows[missing[0]]), **place))
    finite = values[np.isfinite(values)]
    if not len(finite):
        return findings, spoilt
    if signal == "load":
        return [*findings, *_load_at_limit(log, values, rows, place)], spoilt
    low, high = float(finite.min()), float(finite.max())
    if high == low:
        if len(finite) > 10:
            message = f"{column!r} is constant ({_cell(high, place)})"
            hint = "a log says nothing about what does not move: excite the rig, or look at the sensor"
            command = log.command_V[:, channel]
            driven = log.has("command", channel) and np.nanmax(command) > np.nanmin(command)
            if signal in MEASURED and signal != "speed" and driven:
                hint = "no sensor is so quiet while the command moves: taken as absent"
                spoilt[:] = True
            findings.append(
                Finding("constant", message, hint, sure=signal == "speed" and bool(driven), **place)
            )
        return findings, spoilt
    if signal not in MEASURED:
        return findings, spoilt
    command = log.command_V[:, channel]
    driven = log.has("command", channel) and np.nanmax(command) > np.nanmin(command)
    if signal != "speed" and driven and len(finite) > 500 and _is_white(finite):
        message = f"{column!r} shows nothing but noise about {_cell(float(finite.mean()), place)} while the command moves"
        hint = "the sensor does not measure: taken as absent"
        spoilt[:] = True
        return [*findings, Finding("constant", message, hint, **place)], spoilt
    for finding, bad in _spikes(log, values, signal, channel, rows, place):
        findings.append(finding)
        spoilt |= bad
    values = np.where(spoilt, np.nan, values)  # a spike is no limit that a sensor runs into
    starts, lengths = _runs(values)
    for check in (_stuck, _clipped):
        for finding, bad in check(log, values, channel, rows, starts, lengths, place):
            findings.append(finding)
            spoilt |= bad
    if signal == "pressure":
        for finding, bad in _silent(log, values, channel, rows, place):
            findings.append(finding)
            spoilt |= bad
    if signal == "speed":
        for finding, bad in _disturbed(log, np.where(spoilt, np.nan, values), channel, rows, place):
            findings.append(finding)
            spoilt |= bad
    return [*findings, *_coarse(finite, place)], spoilt


def _coarse(finite: np.ndarray, place: dict[str, Any]) -> Iterator[Finding]:
    """Few levels over many rows: the steps of the converter show. A clean signal has nearly as many values as rows."""
    some = finite[:: 1 + len(finite) // 10_000]  # as many levels in a part settle it without sorting an hour
    span = float(np.ptp(finite))
    # Values that differ by rounding alone are one level.
    if len(finite) <= 500 or len(np.unique(np.round(some / span, 9))) >= _MANY_STEPS:
        return
    levels = np.unique(np.round(finite / span, 9))
    step = float(np.min(np.diff(levels)))
    # Noise as large as the error of rounding makes a mean of rows finer than a step; fewer second differences are then 0.
    dithered = np.mean(np.abs(np.diff(finite, 2)) < 0.5 * step * span) < _LEVEL_ROWS
    if len(levels) < _MANY_STEPS and len(levels) < len(finite) / 10 and not dithered:
        message = (
            f"{place['column']!r} has only {len(levels)} different values (step {step:.2%} of its range)"
        )
        hint = "record with finer resolution where possible"
        if place["signal"] == "speed":
            hint += "; encoder counts within a window are also half a window late, which a diagnosis may call sensor lag"
        yield Finding("coarse", message, hint, **place)


def _spikes(
    log: RigLog, values: np.ndarray, signal: str, channel: int, rows: np.ndarray, place: dict[str, Any]
) -> Iterator[tuple[Finding, np.ndarray]]:
    """Up to three rows far from all rows around them: a dropped bit or a loose plug.

    Far is beyond the noise, and beyond what the machine does. A shaft has inertia: there and back again takes twice the steepest
    change that the speed shows anywhere, without its spikes; in a slow log, or of another signal, nothing may ask for it either.
    A pressure or a current may do that for ten milliseconds, so that these are looked at in fast logs only.
    """
    known = np.flatnonzero(np.isfinite(values))
    if signal != "speed" and log.period > _SPIKE_PERIOD:
        return
    found, reach = standing_out(values[known])
    bad = np.zeros(len(values), bool)
    least = _SPIKE * float(np.ptp(np.quantile(values[known], (0.01, 0.99))))
    for start, end, height, nearby in found:
        asked = _command_near(log, channel, int(known[start]), 20) >= 0.05
        if signal == "speed":
            # A shaft that sticks and slips may stir for a row or two.
            possible = min(reach, max(least, 3.0 * nearby if asked else nearby))
        else:
            possible = np.inf if asked else max(reach, least)
        if height > possible:
            bad[known[start:end]] = True
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        message = (
            f"{place['column']!r} jumps for a row or two and back, {int(bad.sum())} rows in all, first to "
            f"{_cell(values[first], place)} in row {rows[first]}"
        )
        hint = f"no machine moves so; a loose plug or a lost bit: {_LEFT_OUT}"
        yield Finding("spikes", message, hint, row=int(rows[first]), **place), bad


def standing_out(values: np.ndarray) -> tuple[list[tuple[int, int, float, float]], float]:
    """Up to three rows of a signal (n,) without holes that stand out of those around them by more than the noise: the first, the
    row behind the last, by how much, and the largest change within three rows nearby. Then twice the largest change anywhere."""
    if len(values) < 50:
        return [], 0.0
    usual = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(values, 4, mode="edge"), 9), axis=1)
    off = np.abs(values - usual)
    steps = np.abs(np.diff(values))
    least = max(
        _SPIKE_NOISE * float(np.median(steps)), 4.0 * float(np.min(steps[steps > 0.0], initial=np.inf))
    )
    change = np.abs(usual[3:] - usual[:-3])
    reach = 2.0 * float(change.max())
    if not (off > least).any():
        return [], reach
    # What is usual nearby: spikes are too few to move a quantile.
    around = np.lib.stride_tricks.sliding_window_view(np.pad(off, 20, mode="reflect"), 41)
    far = off > least
    far[far] = off[far] > _SPIKE_NEAR * np.quantile(around[far], 0.8, axis=1)
    starts, lengths = _runs(far.astype(float))
    found = []
    for start, length in zip(starts.tolist(), lengths.tolist(), strict=True):
        end = start + length
        if not far[start] or length > 3 or start == 0 or end == len(values):
            continue
        height = float(np.abs(values[start:end] - 0.5 * (values[start - 1] + values[end])).min())
        nearby = float(change[max(start - 11, 0) : end + 10].max(initial=0.0))
        back = abs(values[end] - values[start - 1]) < 0.25 * height + 0.5 * nearby
        if back and height > least:
            found.append((start, end, height, nearby))
    return found, reach


def _command_near(log: RigLog, channel: int, row: int, rows: int) -> float:
    """How far the command of a channel moves within so many rows of a row, as a share of its swing in the log."""
    command = log.command_V[:, channel]
    if not log.has("command", channel) or not np.nanmax(command) > np.nanmin(command):
        return 0.0
    near = command[max(0, row - rows) : row + rows]
    return float((np.nanmax(near) - np.nanmin(near)) / (np.nanmax(command) - np.nanmin(command)))


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
) -> Iterator[tuple[Finding, np.ndarray]]:
    """Runs of one value: of a noisy signal any, else where the command moves and the same commands move it elsewhere."""
    command = log.command_V[:, channel]
    swing = float(np.nanmax(command) - np.nanmin(command)) if log.has("command", channel) else 0.0
    least = max(20, int(_STUCK_S / log.period))
    long = lengths >= least
    if swing == 0.0 or not long.any():
        return
    repeated = np.zeros(len(values), bool)
    for start, length in zip(starts[long], lengths[long], strict=True):
        repeated[start : start + length] = True
    low, high = np.nanmin(values), np.nanmax(values)
    noisy = _is_noisy(values[~repeated])
    usual = _by_command(command[~repeated], values[~repeated], swing)
    bad, first, longest = np.zeros(len(values), bool), -1, 0
    for start, length in zip(starts[long], lengths[long], strict=True):
        run = slice(start, start + length)
        if noisy and values[start] not in (0.0, low, high):  # noise never repeats itself
            bad[run] = True
            if length > longest:
                first, longest = int(start), int(length)
            continue
        early = command[start : start + length * 2 // 3]
        if np.nanmax(early) - np.nanmin(early) <= 0.1 * swing:
            continue
        elsewhere = usual(command[run])
        known = np.isfinite(elsewhere)
        if known.mean() > 0.2:
            is_stuck = np.median(np.abs(elsewhere[known] - values[start])) > 0.1 * (high - low)
        else:  # nothing to compare with: a plateau at full scale, or a computed zero, is no fault
            is_stuck = values[start] not in (0.0, low, high)
        if is_stuck:
            bad[run] = True
            if length > longest:
                first, longest = int(start), int(length)
    if first >= 0:
        message = (
            f"{place['column']!r} repeats the value {_cell(values[first], place)} for {longest * log.period:.3g} s "
            f"from {log.time_s[first]:.6g} s (row {rows[first]})"
        )
        if bad.sum() > longest:
            message += f", and more such stretches: {bad.sum() * log.period:.3g} s in all"
        hint = f"a stuck sensor or a frozen recorder: {_LEFT_OUT}"
        yield Finding("stuck", message, hint, row=int(rows[first]), **place), bad


def _silent(
    log: RigLog, values: np.ndarray, channel: int, rows: np.ndarray, place: dict[str, Any]
) -> Iterator[tuple[Finding, np.ndarray]]:
    """Stretches of a pressure that are white noise while the shaft changes its speed to and fro: that takes torque."""
    width = round(2.0 * _BURST_S / log.period)
    if width < 50 or len(values) < 3 * width:
        return
    count = len(values) // width
    pieces = values[: count * width].reshape(count, width)
    speed = log.speed[:, channel]
    turns = np.sqrt(np.mean(_fast(speed, width) ** 2, axis=1)) > _MOVES * np.nanstd(speed)
    size = np.var(pieces, axis=1)
    white = np.mean(np.diff(pieces, axis=1) ** 2, axis=1) > 1.6 * size
    quiet = white & (size < 0.01 * np.nanvar(values))
    # Of exchanged pressures one may rest for a while: they are for the model to tell.
    if np.sum(quiet & turns) * width * log.period < _SILENT_S:
        return
    bad = np.zeros(len(values), bool)
    bad[: count * width] = np.repeat(quiet & turns, width)
    first = int(np.argmax(bad))
    message = (
        f"{place['column']!r} shows nothing but noise for {bad.sum() * log.period:.3g} s, first from {log.time_s[first]:.6g} s "
        f"(row {rows[first]}), while the speed changes to and fro"
    )
    yield Finding("stuck", message, f"a stuck sensor: {_LEFT_OUT}", row=int(rows[first]), **place), bad


def _load_at_limit(
    log: RigLog, values: np.ndarray, rows: np.ndarray, place: dict[str, Any]
) -> Iterator[Finding]:
    """A measured load that repeats its largest or smallest value: noise never does. A computed load may rest anywhere."""
    starts, lengths = _runs(values)
    least = max(20, int(_STUCK_S / log.period))
    for limit, name in ((np.nanmin(values), "smallest"), (np.nanmax(values), "largest")):
        long = (lengths >= least) & (values[starts] == limit)
        if limit == 0.0 or not long.any():
            continue
        elsewhere = values[np.repeat(lengths < least, lengths)]
        steps = np.abs(np.diff(elsewhere))
        # Noise within one step of the converter does repeat itself.
        resolution = np.min(steps[steps > 0.0], initial=np.inf)
        if not _is_noisy(elsewhere) or np.median(steps) < 3.0 * resolution:
            continue
        first = starts[long][0]
        unit = "N" if log.kinds[place["channel"] - 1] == "cylinder" else "N m"
        message = (
            f"{place['column']!r} stays at its {name} value, {limit:.4g} {unit}, for {lengths[long].sum() * log.period:.3g} s, "
            f"first in row {rows[first]}, though it is noisy elsewhere: the sensor was at its limit"
        )
        hint = "the true load is larger there and is taken as logged; widen the sensor's range"
        yield Finding("clipped", message, hint, row=int(rows[first]), **place)


def _is_white(values: np.ndarray) -> bool:
    """Whether a signal is white noise alone: its steps are as large as of independent rows (von Neumann 1941,
    doi:10.1214/aoms/1177731677)."""
    return float(np.mean(np.diff(values) ** 2)) > 1.9 * float(np.var(values))


def _is_noisy(values: np.ndarray) -> bool:
    """Whether a signal turns as often as noise does (two rows of three), not as seldom as a smooth curve."""
    steps = np.diff(values[np.isfinite(values)])
    steps = steps[steps != 0.0]
    return len(steps) > 100 and float(np.mean(steps[1:] * steps[:-1] < 0.0)) > 0.3


def _cell(value: float, place: dict[str, Any]) -> str:
    sizes = {
        "speed": (RPM, "rpm"), "pressure": (BAR, "bar"), "current": (1.0, "A"), "command": (1.0, "V"),
        "pressure_a": (BAR, "bar"), "pressure_b": (BAR, "bar"), "spool": (MILLIMETRE, "mm"), "flow": (LPM, "l/min"),
    }  # fmt: skip
    size, unit = sizes.get(place["signal"], (1.0, "in SI"))
    return f"{value / size:.4g} {unit}"


def _by_command(command: np.ndarray, values: np.ndarray, swing: float) -> Any:
    """A function that gives, for commands, the median of the values at the same command (within 2.5 % of the swing)."""
    low = np.nanmin(command) if len(command) else 0.0
    width = 0.05 * swing
    number = np.where(np.isfinite(command), (command - low) / width, -1.0).astype(int)
    medians = np.full(int(number.max(initial=0)) + 2, np.nan)
    for n in np.unique(number[number >= 0]):
        here = values[(number == n) & np.isfinite(values)]
        if len(here) >= 10:
            medians[n] = np.median(here)

    def at(wanted: np.ndarray) -> np.ndarray:
        place = np.where(np.isfinite(wanted), (wanted - low) / width, -1.0).astype(int)
        return np.where(
            (place >= 0) & (place < len(medians)), medians[np.clip(place, 0, len(medians) - 1)], np.nan
        )

    return at


def _clipped(
    log: RigLog,
    values: np.ndarray,
    channel: int,
    rows: np.ndarray,
    starts: np.ndarray,
    lengths: np.ndarray,
    place: dict[str, Any],
) -> Iterator[tuple[Finding, np.ndarray]]:
    """Runs at the largest or smallest value that the signal reached while it was moving."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
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
            bad = np.zeros(len(values), bool)
            for start, length in zip(starts[long], lengths[long], strict=True):
                bad[start : start + length] = True
            message = (
                f"{place['column']!r} stays at its {name} value, {_cell(limit, place)}, in {share:.1%} of the rows, "
                f"first in row {rows[entries[0]]}"
            )
            hint = f"a sensor or converter at its limit: {_LEFT_OUT}; widen its range"
            yield Finding("clipped", message, hint, row=int(rows[entries[0]]), **place), bad


def _disturbed(
    log: RigLog, values: np.ndarray, channel: int, rows: np.ndarray, place: dict[str, Any]
) -> Iterator[tuple[Finding, np.ndarray]]:
    """Stretches in which the speed shakes much faster and wider than usual though nothing asks for it.

    A machine that truly shook would need the pressure for it. Where the pressure is logged and stays as quiet as usual, the
    stretch is the sensor's doing and spoilt; where the pressure shakes too, it is the machine and nothing is said.
    """
    width = round(_BURST_S / log.period)
    if width < 20 or len(values) < 12 * width or not log.has("command", channel):
        return
    fast = _fast(values, width)
    size = np.sqrt(np.mean(fast**2, axis=1))
    if not np.isfinite(size).any():
        return
    usual = float(np.nanmedian(size))
    command = log.command_V[: len(fast) * width, channel]
    swing = float(np.nanmax(command) - np.nanmin(command))
    if not usual > 0.0 or swing == 0.0:
        return
    quiet_command = np.ptp(np.nan_to_num(command.reshape(len(fast), width)), axis=1) < 0.1 * swing
    turns = np.sum(np.diff(np.sign(np.nan_to_num(fast)), axis=1) != 0, axis=1)
    much = (size > _BURST_RATIO * usual) & quiet_command & (turns >= 8)
    pressure = log.pressure[:, channel] if log.pressure is not None and log.has("pressure", channel) else None
    if pressure is not None:
        shakes = np.sqrt(np.mean(_fast(pressure, width) ** 2, axis=1))
        # Against the ordinary shaking of the pressure where the command rests as well.
        calm = shakes[quiet_command & np.isfinite(shakes)]
        if much.any() and calm.size and np.mean(shakes[much] > 0.5 * _BURST_RATIO * np.median(calm)) > 0.3:
            return
    if much.sum() * _BURST_S < 2.0:
        return
    # What lies next to such a stretch and is half as strong belongs to it.
    wide = much.copy()
    for _ in range(8):
        near = np.zeros_like(wide)
        near[1:] |= wide[:-1]
        near[:-1] |= wide[1:]
        wide |= near & (size > 0.4 * _BURST_RATIO * usual)
    wide |= _between(wide)
    bad = np.zeros(len(values), bool)
    bad[: len(fast) * width] = np.repeat(wide, width)
    first, last = np.flatnonzero(bad)[[0, -1]]
    worst = int(np.argmax(np.where(wide, size, 0.0)))
    rate = float(turns[worst]) / (2.0 * _BURST_S)
    linear = log.kinds[channel] == "cylinder"
    shown = f"{size[worst] / MILLIMETRE:.3g} mm/s" if linear else f"{size[worst] / RPM:.3g} rpm"
    message = (
        f"{place['column']!r} shakes at about {rate:.0f} Hz from {log.time_s[first]:.4g} to {log.time_s[last]:.4g} s "
        f"(rows {rows[first]} to {rows[last]}; up to {shown} RMS, {size[worst] / usual:.0f} times its usual noise) while "
        "the command hardly moves"
    )
    if pressure is None:
        hint = "without a pressure signal it is unknown whether the machine shook or its sensor; the stretch counts"
        yield Finding("disturbed", message, hint, row=int(rows[first]), **place), np.zeros(len(values), bool)
        return
    hint = f"the pressure stays quiet, so the sensor is disturbed, not the machine: {_LEFT_OUT}"
    yield Finding("disturbed", message, hint, row=int(rows[first]), **place), bad


def _fast(values: np.ndarray, width: int) -> np.ndarray:
    """What no cubic explains in windows of `width` rows, (windows, width); NaN where a window has holes."""
    count = len(values) // width
    pieces = values[: count * width].reshape(count, width)
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))
    return pieces - pieces @ basis @ basis.T


def _between(marks: np.ndarray) -> np.ndarray:
    """Single unmarked windows between marked ones."""
    out = np.zeros_like(marks)
    out[1:-1] = ~marks[1:-1] & marks[:-2] & marks[2:]
    return out
