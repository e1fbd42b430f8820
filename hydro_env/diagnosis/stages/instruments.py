"""What a model shows of the instruments: an encoder that sits off the centre of its shaft, and two clocks that run apart."""

import itertools
from collections.abc import Iterator

import numpy as np

from ...measured import Finding
from ..estimation.estimate import Estimates
from ..input.parts import filled
from ..models.base import RigModel, Segment
from .shaft import given_shaft, shaft_of

#: A line once per turn stands out if it is this many times the largest of the lines at these four other orders, which no part of
#: a motor has: of noise one in 24,000 does. Less than this share of a speed of 500 rpm is below its usual noise.
STANDS_OUT, ORDERS, MIN_LINE = 5.0, (0.61, 0.77, 1.29, 1.43), 0.002
#: Slower than this share of its peak a speed shows no line above its noise.
SLOW = 0.1
#: Lags are read in windows of this length, several times the rig's memory, up to this lag, a quarter of that memory, s.
WINDOW_S, MAX_LAG_S = 2.0, 0.1
#: Clocks run apart if the lag rises by this many s in a log, a control period, along a line that explains 96 % of it (misses it
#: by this share, RMS), and at rates that differ by at most this share between signals, channels and logs.
RISE_S, OFF_LINE, DIFFERENT = 0.01, 0.2, 0.3


def eccentric(rig: RigModel) -> Iterator[Finding]:
    """Speeds with a line once per turn, in proportion to the speed, that the pressure does not show: the shaft has inertia."""
    for channel in rig.channels:
        rows = [np.zeros((3, 0))]
        for part in rig.parts:
            shaft = shaft_of(part, channel)
            if shaft is None:
                return
            speed, period = shaft.speed, shaft.period
            used = shaft.used & (np.abs(speed) > SLOW * np.abs(speed).max())
            typical = float(np.median(np.abs(speed[used]))) if used.any() else np.inf
            # What is slower than the shaft turns is the model's error.
            width = round(2.0 * np.pi / max(typical, 1e-9) / period)
            if 3 <= width < speed.size:
                error = speed - shaft.driven(given_shaft(rig, channel))
                error -= np.convolve(error, np.full(width, 1.0 / width), "same")
                rows.append(np.array([error, np.cumsum(speed) * period, speed])[:, used])
        error, angle, speed = np.concatenate(rows, axis=1)
        if error.size < 1000:
            continue
        lines = [abs(2.0 * np.mean(error / speed * np.exp(-1j * order * angle))) for order in (1.0, *ORDERS)]
        if lines[0] > max(STANDS_OUT * max(lines[1:]), MIN_LINE):
            message = (
                f"the speed of channel {channel + 1} rises and falls by {lines[0]:.1%} once per turn, which its pressure does "
                "not show: its encoder is eccentric, the shaft does not turn so"
            )
            hint = "centre the encoder, or average over whole turns"
            yield Finding("eccentric", message, hint, "speed", channel + 1)


def runs_apart(rig: RigModel, given: Estimates) -> Iterator[Finding]:
    """Measurements that lag behind the commands more and more: two devices with clocks of their own."""
    compared = [s for c in rig.channels for s in rig.segments[c] if s.signal in ("current", "speed")]
    each = (_rate(s, given[s.channel].simulated[s.channel][s.place]) for s in compared)
    rates = [*itertools.takewhile(np.isfinite, each)]
    if len(rates) < max(2, len(compared)):
        return
    typical = float(np.median(rates))
    if np.ptp(rates) < DIFFERENT * abs(typical):
        how = "fall behind" if typical > 0.0 else "run ahead of"
        message = f"the measurements {how} the commands by {1e3 * abs(typical):.3g} ms more every second, in all signals alike"
        hint = f"two devices whose clocks differ by {abs(typical):.2%}: record both with one clock, or scale the time of one"
        yield Finding("clock_drift", message, hint, sure=True)


def _rate(s: Segment, simulated: np.ndarray) -> float:
    """How fast the lag of a signal behind its simulation grows, s/s; NaN if it does not grow along a line."""
    width, reach = round(WINDOW_S / s.period), round(MAX_LAG_S / s.period)
    times, lags = [], []
    for start in range(reach, s.rows.size - width - reach, width // 2):
        seen = np.where(s.used, s.filled, np.nan)[start : start + width]
        if np.isnan(seen).mean() > 0.1:
            continue
        seen = filled(seen) - np.nanmean(seen)
        around = simulated[start - reach : start + width + reach]
        many = np.lib.stride_tricks.sliding_window_view(around, width)
        many = many - many.mean(axis=1, keepdims=True)
        like = many @ seen / np.sqrt(np.maximum((many * many).sum(axis=1) * (seen @ seen), 1e-30))
        best = int(np.argmax(like))
        if like[best] > 0.9 and 0 < best < like.size - 1:
            a, b, c = like[best - 1 : best + 2]
            times.append((start + 0.5 * width) * s.period)
            lags.append((reach - best - 0.5 * (a - c) / (a - 2.0 * b + c)) * s.period)
    if len(times) < 5:
        return np.nan
    line = np.polyfit(times, lags, 1)
    rise = abs(line[0]) * (times[-1] - times[0])
    off = float(np.sqrt(np.mean((np.polyval(line, times) - lags) ** 2)))
    return float(line[0]) if rise > RISE_S and off < OFF_LINE * rise else np.nan
