"""What the signals of a log say about each other: sign, motors exchanged, one column twice, units by size and by set-point."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import LINES, ChannelMapping, Mapping, Source
from hydro_env.measured.samples import MEASURED
from hydro_env.units import BAR, RPM

if TYPE_CHECKING:
    from hydro_env.measured.log import RigLog

__all__ = ["check_channels", "check_lines", "check_sizes", "follow"]

_RATED = (
    420 * BAR
)  # valves to ISO 4401 are rated for 350 bar, the strongest pumps and motors in common use for 420 bar at most
_VACUUM = 1.5 * BAR  # no pressure is further below the atmosphere's, with half a bar for the sensor's zero
_LIKE = 0.3  # a load pressure is the difference of the lines if it differs by less than this share of its own swing
_CORRELATE = 20_000  # rows that suffice for a correlation
_SIZED = ("command", "current", "pressure", "speed", "supply", "temperature", *LINES)
_IN_MAPPING = "give the right unit in a mapping"


def check_sizes(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Magnitudes that point to a wrong unit."""
    for signal, channel, source in mapping.sources():
        values = log.get(signal)
        if signal in _SIZED and values is not None and log.has(signal, channel):
            one = values if channel is None else values[:, channel]
            finite = one[np.isfinite(one)]
            if len(finite) and finite.any():
                yield from _size(log, signal, channel, source, finite)
    yield from _setpoint(log, mapping)
    yield from _supply(log, mapping)


def _size(
    log: RigLog, signal: str, channel: int | None, source: Source, finite: np.ndarray
) -> Iterator[Finding]:
    peak, unit = float(np.max(np.abs(finite))), source.unit
    moves = channel is not None and _moves(log, channel)
    seen, guess, sure, right = (
        "",
        "",
        False,
        "",
    )  # what the peak is, what may be wrong, whether it is, the right unit
    if signal in ("pressure", "supply", *LINES):
        seen = f"{peak / BAR:.4g} bar"
        if peak > _RATED:
            guess, sure, right = (
                "in kPa, psi or Pa",
                peak > 2000 * BAR,
                "kPa" if peak < 60_000.0 * BAR else "Pa",
            )
        elif signal == "supply" and peak < 5 * BAR:
            guess, right = "in MPa", "MPa"
        elif signal == "pressure" and peak < 0.7 * BAR and moves:
            seen = f"{peak / BAR:.3g} bar though the axis moves"
            guess = "in bar" if unit in ("kPa", "mbar", "Pa") else "in MPa or 1000 psi"
        right = right if unit == "bar" else ""
    elif signal == "speed" and log.kinds[channel or 0] == "cylinder":
        seen = f"{peak:.4g} m/s"
        if peak > 5.0:
            guess, sure, right = "in mm/s", peak > 50.0, "mm/s" if unit == "m/s" else ""
    elif signal == "speed":
        seen = f"{peak / RPM:.4g} rpm"
        if peak > 6000 * RPM:
            guess = "in rpm" if unit in ("rad/s", "Hz") else "in deg/s"
        elif peak < 80 * RPM and (log.setpoint is None or not np.ptp(np.nan_to_num(log.setpoint)) > 0.0):
            guess = f"slow motion, or {peak / RPM:.3g} rad/s"
    elif signal == "command":
        seen = f"{peak:.4g} V"
        if peak > 200.0:
            guess, sure, right = "in mV", peak > 2000.0, "mV" if unit == "V" else ""
        elif unit == "V" and 99.5 < peak < 100.5:
            guess = "in percent of full scale"
        elif unit == "V" and peak <= 1.05:
            guess = "a fraction of full scale"
    elif signal == "current":
        seen = f"{peak:.4g} A"
        if peak > 20.0:
            guess, sure, right = "in mA", peak > 100.0, "mA" if unit == "A" else ""
        elif peak < 0.005 and moves:
            seen, guess, right = (
                f"{1e3 * peak:.3g} mA though the axis moves",
                "in A",
                "A" if unit == "mA" else "",
            )
    elif not 230.0 < float(np.median(finite)) < 430.0:
        seen, guess = f"{peak - 273.15:.4g} degC", "in K or degF"
    if guess:
        question = guess if guess.startswith("slow") else f"is it {guess}"
        fix: dict[str, Any] = {signal: {"unit": right}}
        if channel is not None:
            fix = {f"channel_{channel + 1}": fix}
        message = f"{source.column!r} peaks at {seen}: {question}?"
        place = (signal, None if channel is None else channel + 1, source.column)
        yield Finding("unit", message, _IN_MAPPING, *place, sure=sure, fix=fix if right else None)


def _moves(log: RigLog, channel: int) -> bool:
    speed = log.speed[:, channel]
    return bool(np.isfinite(speed).any() and np.nanmax(speed) - np.nanmin(speed) > 0.0)


def _setpoint(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """A speed that follows the set-point in another unit."""
    if log.setpoint is None:
        return
    for channel in log.channels:
        speed, setpoint = _clean(log.speed[:, channel], log.setpoint)
        if len(speed) < 20 or np.std(speed) == 0 or np.std(setpoint) == 0:
            continue
        if np.corrcoef(speed, setpoint)[0, 1] < 0.9:  # it does not follow
            continue
        slope = float(np.std(speed) / np.std(setpoint))
        for factor, guess, unit in (
            (RPM, "is the speed in rad/s", "rad/s"),
            (1.0 / RPM, "is the set-point in rad/s, or the speed in rpm", ""),
            (6.0, "is the speed in deg/s", "deg/s"),
        ):
            if log.kinds[channel] == "motor" and 0.75 < slope / factor < 1.33:
                source = mapping.channels[channel]
                yield Finding(
                    "unit",
                    f"the speed of channel {channel + 1} follows the set-point with a factor of {slope:.3g}: {guess}?",
                    _IN_MAPPING,
                    "speed",
                    channel + 1,
                    source.speed.column if source else None,
                    sure=True,
                    fix={f"channel_{channel + 1}": {"speed": {"unit": unit}}} if unit else None,
                )


def _supply(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
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
            yield Finding("unit", message, _IN_MAPPING, *place)


def check_lines(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Line pressures beside each other and beside a load pressure: one that is missing, below vacuum, or of something else."""
    for channel in log.channels:
        source = mapping.channels[channel]
        named = [getattr(source, line) for line in LINES]
        if not any(named):
            continue
        present = [line for line in LINES if log.has(line, channel)]
        if len(present) < 2:
            here = next(part.column for part in named if part is not None)
            message = f"channel {channel + 1} has {here!r} and no pressure of its other line"
            hint = "record both lines; one alone is not used"
            yield Finding("one_line", message, hint, "pressure", channel + 1, here)
            continue
        a, b = (log.get(line)[:, channel] for line in LINES)  # type: ignore[index]
        for line, values, part in zip(LINES, (a, b), named, strict=True):
            least = float(np.nanquantile(values, 0.01))
            if least < -_VACUUM:
                message = f"{part.column!r} falls to {least / BAR:.4g} bar, no oil is below -1 bar"
                hint = "is it a load pressure, upside down, or in another unit? Line pressures are above the tank's"
                yield Finding("line_pressure", message, hint, line, channel + 1, part.column, sure=True)
        yield from _load_beside_lines(log, channel, source, a - b)


def _load_beside_lines(
    log: RigLog, channel: int, source: ChannelMapping | None, lines: np.ndarray
) -> Iterator[Finding]:
    """A load pressure that is not the difference of both lines."""
    if log.kinds[channel] != "motor" or not log.has("pressure", channel):
        return
    assert log.pressure is not None and source is not None and source.pressure is not None
    load, difference = _clean(log.pressure[:, channel], lines)
    swing = float(np.std(load))
    if len(load) < 20 or swing == 0.0:
        return
    if float(np.std(load - difference)) < _LIKE * swing:
        return
    column = source.pressure.column
    scale = float(difference @ load) / max(float(difference @ difference), 1e-30)
    if float(np.std(load + difference)) < _LIKE * swing:
        hint = "exchange the columns of the two lines, or give `sign: -1` for the load pressure"
        message = f"{column!r} is pressure b less a"
    else:
        message = f"{column!r} is not pressure a less b: about {scale:.3g} times that"
        hint = "give the right columns and units in a mapping, or leave the load pressure out"
    yield Finding("line_pressure", message, hint, "pressure", channel + 1, column, sure=True)


def check_channels(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Sign of each channel, channels exchanged, the same data twice."""
    both = [mapping.channels[channel] for channel in (0, 1)]
    for channel in log.channels:
        source = both[channel]
        if source is not None:
            yield from _sign(log, channel, source)
    if log.channels != (0, 1):
        return
    own = [follow(log.command_V[:, c], log.speed[:, c], log.period) ** 2 for c in (0, 1)]
    crossed = [follow(log.command_V[:, 1 - c], log.speed[:, c], log.period) ** 2 for c in (0, 1)]
    if all(crossed[c] > own[c] + 0.1 for c in (0, 1)):
        message = (
            f"each speed follows the other channel's command (correlation {min(crossed) ** 0.5:.2f} or better) "
            f"rather than its own ({max(own) ** 0.5:.2f} at best): are the motors swapped?"
        )
        sure = min(crossed) > 0.6 and all(crossed[c] > own[c] + 0.3 for c in (0, 1))
        fix = None
        if both[0] is not None and both[1] is not None:
            fix = {f"channel_{c + 1}": {"speed": {"column": both[1 - c].speed.column}} for c in (0, 1)}  # type: ignore[union-attr]
        yield Finding(
            "swapped", message, "exchange the speed columns in a mapping", "speed", sure=sure, fix=fix
        )
    for signal in MEASURED:
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


def _sign(log: RigLog, channel: int, source: ChannelMapping) -> Iterator[Finding]:
    """A speed or a current that falls when its command rises."""
    key = f"channel_{channel + 1}"
    command = log.command_V[:, channel]
    current = None
    if log.current is not None and source.current is not None and log.has("current", channel):
        current = follow(command, log.current[:, channel], log.period)
    speed = follow(command, log.speed[:, channel], log.period)
    if speed < -0.4 and current is not None and current < -0.8:
        # Both at once: it is the command that is upside down.
        message = f"current and speed of channel {channel + 1} fall when its command rises (correlation {speed:.2f})"
        hint = f"give `sign: {-source.command.sign}` for the command in a mapping"
        fix = {key: {"command": {"sign": -source.command.sign}}}
        yield Finding(
            "sign", message, hint, "command", channel + 1, source.command.column, sure=True, fix=fix
        )
        return
    if speed < -0.4:
        message = f"the speed of channel {channel + 1} falls when its command rises (correlation {speed:.2f})"
        which = "the speed" if current is not None else "the speed or the command"
        hint = f"give `sign: {-source.speed.sign}` for {which} in a mapping"
        fix = {key: {"speed": {"sign": -source.speed.sign}}}
        place = ("speed", channel + 1, source.speed.column)
        yield Finding("sign", message, hint, *place, sure=speed < -0.7, fix=fix)
    if current is not None and source.current is not None and current < -0.6:
        message = (
            f"the current of channel {channel + 1} falls when its command rises (correlation {current:.2f})"
        )
        hint = f"give `sign: {-source.current.sign}` for the current in a mapping"
        fix = {key: {"current": {"sign": -source.current.sign}}}
        place = ("current", channel + 1, source.current.column)
        yield Finding("sign", message, hint, *place, sure=current < -0.8, fix=fix)


def _clean(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    keep = np.isfinite(first) & np.isfinite(second)
    return first[keep], second[keep]


def _correlation(first: np.ndarray, second: np.ndarray) -> float:
    """The correlation of two signals (n,), 0 where one is constant; `np.corrcoef` takes twice as long."""
    first, second = first - first.mean(), second - second.mean()
    size = float(first @ first) * float(second @ second)
    return float(first @ second) / size**0.5 if size > 0.0 else 0.0


def follow(command: np.ndarray, values: np.ndarray, period: float) -> float:
    """The correlation of a signal (T,) with a command (T,) at the shortest lag (0 to 0.5 s) at which it is near its
    strongest: of a fast sine the next extreme has the other sign. 0 where undefined."""
    lags = np.unique(np.round(np.linspace(0.0, 0.5, 26) / period).astype(int))
    stride = max(1, len(values) // _CORRELATE)
    found = []
    for lag in lags:
        if len(values) - lag < 50:
            break
        before = command[: len(command) - lag : stride]
        after = values[lag::stride]
        before, after = _clean(before[: len(after)], after[: len(before)])
        found.append(_correlation(before, after) if len(before) >= 50 else 0.0)
    if not found:
        return 0.0
    size = np.abs(found)
    for n, value in enumerate(found):
        peak = (n == 0 or size[n] >= size[n - 1]) and (n + 1 == len(found) or size[n] >= size[n + 1])
        if peak and size[n] >= 0.75 * size.max():
            return value
    return found[int(np.argmax(size))]
