"""What the signals of a log say about each other: sign, motors exchanged, one column twice, units by size and by set-point."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf

import numpy as np

from hydro_env.measured.finding import Finding
from hydro_env.measured.log import RigLog
from hydro_env.measured.mapping import LINES, USUAL_UNITS, Mapped, Mapping, quantity_of
from hydro_env.measured.samples import MEASURED
from hydro_env.reading import shipped_yaml
from hydro_env.units import BAR, RPM, from_si

_VACUUM = 1.5 * BAR  # no pressure is further below the atmosphere's, with half a bar for the sensor's zero
_LIKE = 0.3  # a load pressure is the difference of the lines if it differs by less than this share of its own swing
_CORRELATE = 20_000  # rows that suffice for a correlation
_IN_MAPPING = "give the right unit in a mapping"


@dataclass(frozen=True)
class _Size:
    """A peak (in the usual unit of the signal, of a cylinder's speed in m/s) that points to another unit, which is sure from
    some peak on; only if the signal was read as one of some units, or only while the axis moves. `right` is the unit that a
    mapping would have to say, by the one that it says."""

    signals: list[str]
    guess: str
    low: float = 0.0
    high: float = inf
    sure: float = inf
    read_as: Sequence[str] = ()
    moves: bool = False
    kind: str = ""
    right: dict[str, str] = field(default_factory=dict)


_SIZES = [_Size(**row) for row in shipped_yaml(__package__, "sizes.yaml")]


def check_sizes(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Magnitudes that point to a wrong unit."""
    for each in mapping.sources():
        values = log.of(each.signal, each.channel)
        finite = np.zeros(0) if values is None else values[np.isfinite(values)]
        peak = float(np.abs(finite).max(initial=0.0))
        if each.signal != "temperature":
            yield from _size(log, each, peak) if peak > 0.0 else ()
        elif len(finite) and not 230.0 < float(np.median(finite)) < 430.0:
            message = f"{each.column!r} peaks at {peak - 273.15:.4g} degC: is it in K or degF?"
            yield each.finding("unit", message, _IN_MAPPING)
    yield from _setpoint(log, mapping)
    yield from _supply(log, mapping)


def _size(log: RigLog, mapped: Mapped, peak: float) -> Iterator[Finding]:
    kind, given = log.kinds[mapped.channel or 0], mapped.source.unit
    name = USUAL_UNITS[quantity_of(mapped.signal, kind)].replace("mm/s", "m/s")
    peak = from_si(peak, name)
    driven = log.setpoint is not None and np.ptp(np.nan_to_num(log.setpoint)) > 0.0
    speed = log.speed[:, mapped.channel or 0]
    moves = np.nanmax(speed, initial=-inf) > np.nanmin(speed, initial=inf)
    for size in _SIZES:
        fits = mapped.signal in size.signals and size.low <= peak <= size.high and size.kind in ("", kind)
        if not fits or (size.read_as and given not in size.read_as) or (size.moves and not moves):
            continue
        if size.guess.endswith("slow") and driven:  # the set-point tells, see below
            continue
        moving = " though the axis moves" if size.moves else ""
        message = f"{mapped.column!r} peaks at {peak:.4g} {name}{moving}: is it {size.guess}?"
        right = {"unit": size.right[given]} if given in size.right else None
        yield mapped.finding("unit", message, _IN_MAPPING, sure=peak > size.sure, right=right)
        return


def _setpoint(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """A speed that follows the set-point in another unit."""
    if log.setpoint is None:
        return
    for channel in log.channels:
        speed, setpoint = _clean(log.speed[:, channel], log.setpoint)
        mapped = mapping.mapped("speed", channel)
        if mapped is None or log.kinds[channel] != "motor" or len(speed) < 20:
            continue
        if _correlation(speed, setpoint) < 0.9:  # it does not follow
            continue
        slope = float(np.std(speed) / np.std(setpoint))
        for factor, guess, right in (
            (RPM, "is the speed in rad/s", {"unit": "rad/s"}),
            (1.0 / RPM, "is the set-point in rad/s, or the speed in rpm", None),
            (6.0, "is the speed in deg/s", {"unit": "deg/s"}),
        ):
            if 0.75 < slope / factor < 1.33:
                told = f"the speed of channel {channel + 1} follows the set-point"
                message = f"{told} with a factor of {slope:.3g}: {guess}?"
                yield mapped.finding("unit", message, _IN_MAPPING, sure=True, right=right)


def _supply(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    for channel in log.channels:
        mapped = mapping.mapped("pressure", channel)
        if log.supply is None or log.pressure is None or mapped is None:
            continue
        pressure, supply = _clean(np.abs(log.pressure[:, channel]), log.supply)
        if len(pressure) and (high := np.quantile(pressure, 0.99) / max(np.median(supply), 1.0)) > 3.0:
            message = f"{mapped.column!r} is {high:.3g} times the supply pressure: another unit?"
            yield mapped.finding("unit", message, _IN_MAPPING)


def check_lines(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Line pressures beside each other and beside a load pressure: one that is missing, below vacuum, or of something else."""
    for channel in log.channels:
        named = [each for line in LINES if (each := mapping.mapped(line, channel))]
        if not named:
            continue
        if not all(log.has(line, channel) for line in LINES):
            here = named[0].column
            message = f"channel {channel + 1} has {here!r} and no pressure of its other line"
            hint = "record both lines; one alone is not used"
            yield Finding("one_line", message, hint, "pressure", channel + 1, here)
            continue
        for each in named:
            least = float(np.nanquantile(log.of(each.signal, channel), 0.01))  # type: ignore[arg-type]
            if least < -_VACUUM:
                message = f"{each.column!r} falls to {least / BAR:.4g} bar, no oil is below -1 bar"
                hint = "is it a load pressure, upside down, or in another unit? Line pressures are above the tank's"
                yield each.finding("line_pressure", message, hint, sure=True)
        if (load := mapping.mapped("pressure", channel)) and log.kinds[channel] == "motor":
            yield from _load_beside_lines(log, load)


def _load_beside_lines(log: RigLog, mapped: Mapped) -> Iterator[Finding]:
    """A load pressure that is not the difference of both lines."""
    a, b, pressure = (log.of(signal, mapped.channel) for signal in (*LINES, "pressure"))
    if a is None or b is None or pressure is None:
        return
    load, difference = _clean(pressure, a - b)
    swing = float(np.std(load)) if len(load) >= 20 else 0.0
    if swing == 0.0 or float(np.std(load - difference)) < _LIKE * swing:
        return
    scale = float(difference @ load) / max(float(difference @ difference), 1e-30)
    if float(np.std(load + difference)) < _LIKE * swing:
        hint = "exchange the columns of the two lines, or give `sign: -1` for the load pressure"
        message = f"{mapped.column!r} is pressure b less a"
    else:
        message = f"{mapped.column!r} is not pressure a less b: about {scale:.3g} times that"
        hint = "give the right columns and units in a mapping, or leave the load pressure out"
    yield mapped.finding("line_pressure", message, hint, sure=True)


def check_channels(log: RigLog, mapping: Mapping) -> Iterator[Finding]:
    """Sign of each channel, channels exchanged, the same data twice."""
    for channel in log.channels:
        yield from _sign(log, mapping, channel)
    if log.channels != (0, 1):
        return
    own = [follow(log.command_V[:, c], log.speed[:, c], log.period) ** 2 for c in (0, 1)]
    crossed = [follow(log.command_V[:, 1 - c], log.speed[:, c], log.period) ** 2 for c in (0, 1)]
    if all(crossed[c] > own[c] + 0.1 for c in (0, 1)):
        how = f"correlation {min(crossed) ** 0.5:.2f} or better"
        told = f"each speed follows the other channel's command ({how}) rather than its own"
        message = f"{told} ({max(own) ** 0.5:.2f} at best): are the motors swapped?"
        hint = "exchange the speed columns in a mapping"
        sure = min(crossed) > 0.6 and all(crossed[c] > own[c] + 0.3 for c in (0, 1))
        other = [each for c in (1, 0) if (each := mapping.mapped("speed", c))]
        fix = {f"channel_{c}": {"speed": {"column": each.column}} for c, each in enumerate(other, 1)}
        yield Finding("swapped", message, hint, "speed", sure=sure, fix=fix)
    for signal in MEASURED:
        values = log.get(signal)
        both = [each for c in (0, 1) if (each := mapping.mapped(signal, c))]
        if values is None or len(both) < 2:
            continue
        first, second = _clean(values[:, 0], values[:, 1])
        if len(first) > 10 and np.ptp(first) > 0 and np.array_equal(first, second):
            # Two simulated channels may really agree; then their commands do, too.
            cause = log.command_V if signal == "speed" else log.speed
            if not np.array_equal(cause[:, 0], cause[:, 1], equal_nan=True):
                message = f"{both[0].column!r} and {both[1].column!r} hold the same values"
                hint = "record each channel's own sensor"
                yield Finding("duplicate_column", message, hint, signal, column=both[1].column)


def _sign(log: RigLog, mapping: Mapping, channel: int) -> Iterator[Finding]:
    """A speed or a current that falls when its command rises."""
    falls = {
        signal: -follow(log.command_V[:, channel], log.get(signal)[:, channel], log.period)  # type: ignore[index]
        for signal in ("speed", "current")
        if log.has(signal, channel)
    }
    speed, current = (falls.get(signal, 0.0) for signal in ("speed", "current"))
    alone = "the speed" if "current" in falls else "the speed or the command"
    here = f"of channel {channel + 1}"
    found = [
        ("speed", f"the speed {here} falls", speed, 0.4, 0.7, alone),
        ("current", f"the current {here} falls", current, 0.6, 0.8, "the current"),
    ]
    if speed > 0.4 and current > 0.8:  # both at once: it is the command that is upside down
        found = [("command", f"current and speed {here} fall", speed, 0.4, 0.4, "the command")]
    for signal, what, size, least, sure, which in found:
        if size > least and (mapped := mapping.mapped(signal, channel)):
            message = f"{what} when its command rises (correlation {-size:.2f})"
            other = -mapped.source.sign
            hint = f"give `sign: {other}` for {which} in a mapping"
            yield mapped.finding("sign", message, hint, sure=size > sure, right={"sign": other})


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
    size = [0.0, *map(abs, found), 0.0]
    peaks = (n for n in range(len(found)) if size[n] <= size[n + 1] >= max(size[n + 2], 0.75 * max(size)))
    return next((found[n] for n in peaks), 0.0)
