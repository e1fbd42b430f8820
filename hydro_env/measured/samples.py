"""The samples of one signal: missing, constant, stuck, clipped, coarse, and a sensor that is disturbed for a while.

Samples that are not measurements of the rig (a sensor that stuck, a converter at its end, a disturbed sensor) are invalid; who
reads the log leaves them out of every comparison.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.ndimage import binary_dilation, find_objects, label, median_filter

from hydro_env.measured.finding import Finding
from hydro_env.measured.log import RigLog
from hydro_env.measured.mapping import USUAL_UNITS, Mapped, quantity_of
from hydro_env.units import from_si, with_unit

MEASURED = ("current", "pressure", "speed", "spool", "flow", "pressure_a", "pressure_b", "motor_pressure")
_STUCK_S = 0.25  # a sensor that repeats itself to the last digit for longer while the command moves is stuck
_MANY_STEPS = 200  # a signal resolved in fewer steps over its range is called coarse
_LEVEL_ROWS = 0.38  # share of second differences below half a step, if those of noise and rounding are normal
_SPIKE = 0.1  # a spike that the machine could do, but for no reason, stands out by this share of the signal's swing
_SPIKE_NEAR = 6.0  # ... by this many times what four of five rows nearby are off at most, some eight standard deviations of noise
_SPIKE_NOISE = 8.0  # ... by this many of the signal's median steps, again eight standard deviations
_SPIKE_PERIOD = 2e-3  # s, in slower logs only speeds are searched for spikes
_BURST_S = 0.5  # windows in which a disturbance is looked for
_BURST_RATIO = 6.0  # the fast part of a disturbed signal stands out of its usual one by more
_MOVES = 0.05  # a speed moves if no cubic explains this share of its standard deviation within a window
_SILENT_S = 3.0  # a pressure that is stuck in its noise is so for at least this long in all
_LEFT_OUT = "left out of every comparison"


@dataclass
class Checked:
    """A signal of a channel while it is looked at: its values (T,), NaN where there is none, the lines `rows` (T,) of the file
    that hold them, what was found and which samples (T,) are invalid."""

    log: RigLog
    mapped: Mapped
    rows: np.ndarray
    findings: list[Finding] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.name, self.channel = self.mapped.signal, self.mapped.channel or 0
        self.period = self.log.period  # s
        self.values = np.array(self.log.of(self.name, self.channel))
        self.invalid = np.zeros(len(self.values), bool)
        self.command = self.log.command_V[:, self.channel]

    @cached_property
    def swing(self) -> float:
        """How far the command moves, V; 0 where there is none."""
        known = self.log.has("command", self.channel)
        return float(np.nanmax(self.command) - np.nanmin(self.command)) if known else 0.0

    @cached_property
    def runs(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts and lengths of the runs of equal values."""
        starts = np.concatenate([[0], np.flatnonzero(self.values[1:] != self.values[:-1]) + 1])
        return starts, np.diff(np.concatenate([starts, [len(self.values)]]))

    @property
    def least_stuck(self) -> int:
        """Rows from which on a repeated value is suspicious."""
        return max(20, int(_STUCK_S / self.period))

    def tell(self, code: str, message: str, hint: str, row: int | None = None, sure: bool = False) -> None:
        """Notes a finding about the column, which the message goes on from; `row` counts from 0."""
        line = None if row is None else int(self.rows[row])
        self.findings.append(self.mapped.finding(code, f"{self.mapped.column!r} {message}", hint, line, sure))

    def leave_out(self, bad: np.ndarray, code: str, message: str, hint: str, row: int) -> None:
        """Notes that samples (T,) are no measurements; `row` is where it is seen."""
        self.tell(code, message, f"{hint}: {_LEFT_OUT}", row)
        self.invalid |= bad

    def shown(self, value: float) -> str:
        """A value as text, in the usual unit."""
        name = USUAL_UNITS[quantity_of(self.name, self.log.kinds[self.channel])]
        return with_unit(from_si(value, name), name, 4)


def check_samples(log: RigLog, mapped: Mapped, rows: np.ndarray) -> Checked:
    """Looks at a signal of a channel; `rows` (T,) are lines of the file."""
    one = Checked(log, mapped, rows)
    missing = np.flatnonzero(~np.isfinite(one.values))
    if len(missing):
        message = f"{len(missing)} of {len(one.values)} cells, the first in row {one.rows[missing[0]]}"
        one.tell("missing_values", f"holds no value in {message}", _LEFT_OUT, missing[0])
    finite = one.values[np.isfinite(one.values)]
    sensor = one.name in MEASURED and one.name != "speed" and one.swing > 0.0
    if one.name == "load" and len(finite):
        _load_at_limit(one)
    elif len(finite) <= 10 and len(np.unique(finite)) < 2:
        pass  # too little to call it constant
    elif np.ptp(finite) == 0.0:
        _constant(one, finite)
    elif sensor and len(finite) > 500 and _is_white(finite):
        message = f"shows nothing but noise about {one.shown(float(finite.mean()))}"
        hint = "the sensor does not measure: taken as absent"
        one.tell("constant", f"{message} while the command moves", hint)
        one.invalid[:] = True
    elif one.name in MEASURED:
        _spikes(one)
        one.values[one.invalid] = np.nan  # a spike is no limit that a sensor runs into
        _stuck(one)
        _clipped(one)
        if one.name == "pressure":
            _silent(one)
        if one.name == "speed":
            one.values[one.invalid] = np.nan
            _disturbed(one)
        _coarse(one, finite)
    return one


def _constant(one: Checked, finite: np.ndarray) -> None:
    hint = "a log says nothing about what does not move: excite the rig, or look at the sensor"
    driven = one.swing > 0.0
    if one.name in MEASURED and one.name != "speed" and driven:
        hint = "no sensor is so quiet while the command moves: taken as absent"
        one.invalid[:] = True
    one.tell("constant", f"is constant ({one.shown(finite[0])})", hint, sure=one.name == "speed" and driven)


def _coarse(one: Checked, finite: np.ndarray) -> None:
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
        hint = "record with finer resolution where possible"
        if one.name == "speed":
            hint += "; encoder counts within a window are also half a window late, which a diagnosis may call sensor lag"
        one.tell("coarse", f"has only {len(levels)} different values (step {step:.2%} of its range)", hint)


def _spikes(one: Checked) -> None:
    """Up to three rows far from all rows around them: a dropped bit or a loose plug.

    Far is beyond the noise, and beyond what the machine does. A shaft has inertia: there and back again takes twice the steepest
    change that the speed shows anywhere, without its spikes; in a slow log, or of another signal, nothing may ask for it either.
    A pressure or a current may do that for ten milliseconds, so that these are looked at in fast logs only.
    """
    if one.name != "speed" and one.period > _SPIKE_PERIOD:
        return
    known = np.flatnonzero(np.isfinite(one.values))
    found, reach = standing_out(one.values[known])
    least = _SPIKE * float(np.ptp(np.quantile(one.values[known], (0.01, 0.99))))
    bad = np.zeros(len(one.values), bool)
    for start, end, height, nearby in found:
        near = one.command[max(0, known[start] - 20) : known[start] + 20]
        asked = one.swing > 0.0 and np.nanmax(near) - np.nanmin(near) >= 0.05 * one.swing
        if one.name == "speed":
            # A shaft that sticks and slips may stir for a row or two.
            possible = min(reach, max(least, 3.0 * nearby if asked else nearby))
        else:
            possible = np.inf if asked else max(reach, least)
        bad[known[start:end]] |= height > possible
    if bad.any():
        first = int(np.argmax(bad))
        seen = f"{one.shown(one.values[first])} in row {one.rows[first]}"
        message = f"jumps for a row or two and back, {int(bad.sum())} rows in all, first to {seen}"
        one.leave_out(bad, "spikes", message, "no machine moves so; a loose plug or a lost bit", first)


def standing_out(values: np.ndarray) -> tuple[list[tuple[int, int, float, float]], float]:
    """Up to three rows of a signal (n,) without holes that stand out of those around them by more than the noise: the first, the
    row behind the last, by how much, and the largest change within three rows nearby. Then twice the largest change anywhere."""
    if len(values) < 50:
        return [], 0.0
    usual = median_filter(values, 9, mode="nearest")
    off = np.abs(values - usual)
    steps = np.abs(np.diff(values))
    resolution = float(np.min(steps[steps > 0.0], initial=np.inf))
    least = max(_SPIKE_NOISE * float(np.median(steps)), 4.0 * resolution)
    change = np.abs(usual[3:] - usual[:-3])
    reach = 2.0 * float(change.max())
    if not (off > least).any():
        return [], reach
    # What is usual nearby: spikes are too few to move a quantile.
    around = np.lib.stride_tricks.sliding_window_view(np.pad(off, 20, mode="reflect"), 41)
    far = off > least
    far[far] = off[far] > _SPIKE_NEAR * np.quantile(around[far], 0.8, axis=1)
    found = []
    for (run,) in find_objects(label(far)[0]):
        start, end = run.start, run.stop
        if end - start > 3 or start == 0 or end == len(values):
            continue
        height = float(np.abs(values[start:end] - 0.5 * (values[start - 1] + values[end])).min())
        nearby = float(change[max(start - 11, 0) : end + 10].max(initial=0.0))
        back = abs(values[end] - values[start - 1]) < 0.25 * height + 0.5 * nearby
        if back and height > least:
            found.append((start, end, height, nearby))
    return found, reach


def _stuck(one: Checked) -> None:
    """Runs of one value: of a noisy signal any, else where the command moves and the same commands move it elsewhere."""
    values, command, (starts, lengths) = one.values, one.command, one.runs
    long = lengths >= one.least_stuck
    if one.swing == 0.0 or not long.any():
        return
    ordinary = ~np.repeat(long, lengths)
    low, high = np.nanmin(values), np.nanmax(values)
    noisy = _is_noisy(values[ordinary])
    usual = _by_command(one, ordinary)

    def is_stuck(start: int, length: int) -> bool:
        inside = values[start] not in (0.0, low, high)
        if noisy and inside:  # noise never repeats itself
            return True
        early = command[start : start + length * 2 // 3]
        if np.nanmax(early) - np.nanmin(early) <= 0.1 * one.swing:
            return False
        elsewhere = usual[start : start + length]
        known = np.isfinite(elsewhere)
        if known.mean() > 0.2:
            return bool(np.median(np.abs(elsewhere[known] - values[start])) > 0.1 * (high - low))
        return inside  # nothing to compare with: a plateau at full scale, or a computed zero, is no fault

    stuck = long.copy()
    for n in np.flatnonzero(long):
        stuck[n] = is_stuck(starts[n], lengths[n])
    if stuck.any():
        longest = int(np.argmax(np.where(stuck, lengths, 0)))
        first, length = starts[longest], lengths[longest]
        place = f"{one.log.time_s[first]:.6g} s (row {one.rows[first]})"
        message = f"repeats the value {one.shown(values[first])} for {length * one.period:.3g} s from {place}"
        if lengths[stuck].sum() > length:
            message += f", and more such stretches: {lengths[stuck].sum() * one.period:.3g} s in all"
        bad = np.repeat(stuck, lengths)
        one.leave_out(bad, "stuck", message, "a stuck sensor or a frozen recorder", first)


def _by_command(one: Checked, ordinary: np.ndarray) -> np.ndarray:
    """For each row the median of the values of the `ordinary` rows (T,) at the same command, within 2.5 % of its swing; NaN where
    there are too few."""
    low = np.nanmin(one.command[ordinary]) if ordinary.any() else 0.0
    known = np.isfinite(one.command)
    level = np.where(known, (one.command - low) / (0.05 * one.swing), -1.0).astype(int)
    medians = np.full(max(int(level.max(initial=0)), 0) + 1, np.nan)
    for n in np.unique(level[ordinary & (level >= 0)]):
        here = one.values[ordinary & (level == n) & np.isfinite(one.values)]
        if len(here) >= 10:
            medians[n] = np.median(here)
    return np.where(level >= 0, medians[np.maximum(level, 0)], np.nan)


def _silent(one: Checked) -> None:
    """Stretches of a pressure that are white noise while the shaft changes its speed to and fro: that takes torque."""
    width = round(2.0 * _BURST_S / one.period)
    if width < 50 or len(one.values) < 3 * width:
        return
    pieces = _windows(one.values, width)
    speed = one.log.speed[:, one.channel]
    turns = np.sqrt(np.mean(_fast(speed, width) ** 2, axis=1)) > _MOVES * np.nanstd(speed)
    size = np.var(pieces, axis=1)
    white = np.mean(np.diff(pieces, axis=1) ** 2, axis=1) > 1.6 * size
    silent = white & (size < 0.01 * np.nanvar(one.values)) & turns
    # Of exchanged pressures one may rest for a while: they are for the model to tell.
    if np.sum(silent) * width * one.period < _SILENT_S:
        return
    bad = _rows_of(silent, width, len(one.values))
    first = int(np.argmax(bad))
    place = f"first from {one.log.time_s[first]:.6g} s (row {one.rows[first]})"
    message = f"shows nothing but noise for {bad.sum() * one.period:.3g} s, {place}"
    one.leave_out(bad, "stuck", f"{message}, while the speed changes to and fro", "a stuck sensor", first)


def _at_limits(one: Checked, least: float) -> Iterator[tuple[str, float, np.ndarray]]:
    """The smallest and the largest value, if runs of at least `least` rows have it, and which runs these are."""
    starts, lengths = one.runs
    for limit, name in ((np.nanmin(one.values), "smallest"), (np.nanmax(one.values), "largest")):
        long = (one.values[starts] == limit) & (lengths >= least)
        if limit != 0.0 and long.any():
            yield name, limit, long


def _load_at_limit(one: Checked) -> None:
    """A measured load that repeats its largest or smallest value: noise never does. A computed load may rest anywhere."""
    starts, lengths = one.runs
    for name, limit, long in _at_limits(one, one.least_stuck):
        elsewhere = one.values[np.repeat(lengths < one.least_stuck, lengths)]
        steps = np.abs(np.diff(elsewhere))
        # Noise within one step of the converter does repeat itself.
        resolution = np.min(steps[steps > 0.0], initial=np.inf)
        if not _is_noisy(elsewhere) or np.median(steps) < 3.0 * resolution:
            continue
        first = starts[long][0]
        place = f"for {lengths[long].sum() * one.period:.3g} s, first in row {one.rows[first]}, though noisy elsewhere"
        message = f"stays at its {name} value, {one.shown(limit)}, {place}: the sensor was at its limit"
        hint = "the true load is larger there and is taken as logged; widen the sensor's range"
        one.tell("clipped", message, hint, first)


def _clipped(one: Checked) -> None:
    """Runs at the largest or smallest value that the signal reached while it was moving."""
    values, (starts, lengths) = one.values, one.runs
    for name, limit, long in _at_limits(one, max(5.0, 5.0 * float(np.median(lengths)))):
        share = float(lengths[long].sum()) / len(values)
        # A limit is run into: the signal still moves when it gets there, unlike one that settles at a steady value.
        entries = starts[long][starts[long] > 0]
        if share < 0.002 or len(entries) == 0:
            continue
        arrival = np.abs(values[entries] - values[entries - 1])
        if np.median(arrival) > 2e-4 * (np.nanmax(values) - np.nanmin(values)):
            place = f"in {share:.1%} of the rows, first in row {one.rows[entries[0]]}"
            message = f"stays at its {name} value, {one.shown(limit)}, {place}"
            hint = f"a sensor or converter at its limit: {_LEFT_OUT}; widen its range"
            one.tell("clipped", message, hint, entries[0])
            one.invalid |= np.repeat(long, lengths)


def _is_white(values: np.ndarray) -> bool:
    """Whether a signal is white noise alone: its steps are as large as of independent rows (von Neumann 1941,
    doi:10.1214/aoms/1177731677)."""
    return float(np.mean(np.diff(values) ** 2)) > 1.9 * float(np.var(values))


def _is_noisy(values: np.ndarray) -> bool:
    """Whether a signal turns as often as noise does (two rows of three), not as seldom as a smooth curve."""
    steps = np.diff(values[np.isfinite(values)])
    steps = steps[steps != 0.0]
    return len(steps) > 100 and float(np.mean(steps[1:] * steps[:-1] < 0.0)) > 0.3


def _disturbed(one: Checked) -> None:
    """Stretches in which the speed shakes much faster and wider than usual though nothing asks for it.

    A machine that truly shook would need the pressure for it. Where the pressure is logged and stays as quiet as usual, the
    stretch is the sensor's doing and invalid; where the pressure shakes too, it is the machine and nothing is said.
    """
    log, width = one.log, round(_BURST_S / one.period)
    if width < 20 or len(one.values) < 12 * width or one.swing == 0.0:
        return
    fast = _fast(one.values, width)
    size = np.sqrt(np.mean(fast**2, axis=1))
    usual = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    if not usual > 0.0:
        return
    quiet_command = np.ptp(np.nan_to_num(_windows(one.command, width)), axis=1) < 0.1 * one.swing
    turns = np.sum(np.diff(np.sign(np.nan_to_num(fast)), axis=1) != 0, axis=1)
    much = (size > _BURST_RATIO * usual) & quiet_command & (turns >= 8)
    if much.sum() * _BURST_S < 2.0:
        return
    pressure = log.of("pressure", one.channel) if log.has("pressure", one.channel) else None
    if pressure is not None:
        shakes = np.sqrt(np.mean(_fast(pressure, width) ** 2, axis=1))
        # Against the ordinary shaking of the pressure where the command rests as well.
        calm = shakes[quiet_command & np.isfinite(shakes)]
        if calm.size and np.mean(shakes[much] > 0.5 * _BURST_RATIO * np.median(calm)) > 0.3:
            return
    # Windows next to them that are half as strong, and single ones between.
    wide = binary_dilation(much, iterations=8, mask=size > 0.4 * _BURST_RATIO * usual)
    wide[1:-1] |= wide[:-2] & wide[2:]
    bad = _rows_of(wide, width, len(one.values))
    first, last = np.flatnonzero(bad)[[0, -1]]
    worst = int(np.argmax(np.where(wide, size, 0.0)))
    rate = float(turns[worst]) / (2.0 * _BURST_S)
    place = f"{log.time_s[first]:.4g} to {log.time_s[last]:.4g} s (rows {one.rows[first]} to {one.rows[last]}"
    noise = f"up to {one.shown(size[worst])} RMS, {size[worst] / usual:.0f} times its usual noise"
    message = f"shakes at about {rate:.0f} Hz from {place}; {noise}) while the command hardly moves"
    if pressure is not None:
        hint = "the pressure stays quiet, so the sensor is disturbed, not the machine"
        one.leave_out(bad, "disturbed", message, hint, first)
    else:
        hint = "without a pressure signal it is unknown whether the machine shook or its sensor; the stretch counts"
        one.tell("disturbed", message, hint, first)


def _windows(values: np.ndarray, width: int) -> np.ndarray:
    """The values in windows of `width` rows, (windows, width)."""
    return values[: len(values) // width * width].reshape(-1, width)


def _rows_of(windows: np.ndarray, width: int, count: int) -> np.ndarray:
    """The rows (count,) of the windows that are marked."""
    rows = np.zeros(count, bool)
    rows[: len(windows) * width] = np.repeat(windows, width)
    return rows


def _fast(values: np.ndarray, width: int) -> np.ndarray:
    """What no cubic explains in windows of `width` rows, (windows, width); NaN where a window has holes."""
    pieces = _windows(values, width)
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))
    return pieces - pieces @ basis @ basis.T
