"""Speed from a measured position."""

from __future__ import annotations

import numpy as np

from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import Mapped
from hydro_env.units import REVOLUTION, unit

__all__ = ["slope"]

#: The slope is taken over at most so long, s: what the dynamics of such rigs leave.
MAX_WINDOW = 0.04
#: Noise of a speed, as a share of its range, that is worth no longer a slope.
NOISE = 0.003


def slope(position: np.ndarray, time: np.ndarray, mapped: Mapped) -> tuple[np.ndarray, Finding]:
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
    most = MAX_WINDOW / 2.0 / period
    while True:
        speed = _over(position, time, rows)
        low, high = np.nanquantile(speed, (0.01, 0.99)) if np.isfinite(speed).any() else (0.0, 0.0)
        if 2 * rows > most or noise * 2**0.5 <= NOISE * (high - low) * 2 * rows * period:
            break
        rows *= 2
    message = f"the speed of channel {mapped.number} is the slope of {mapped.column!r} over {2 * rows} rows"
    return speed, mapped.finding("from_position", message)


def _over(position: np.ndarray, time: np.ndarray, rows: int) -> np.ndarray:
    """The slope between `rows` before and after each row, over fewer at the ends."""
    here = np.arange(len(time))
    before, after = np.maximum(here - rows, 0), np.minimum(here + rows, len(time) - 1)
    return np.asarray((position[after] - position[before]) / (time[after] - time[before]))


def _unwound(angle: np.ndarray) -> np.ndarray:
    """The angle (T,) without its jumps by a revolution, if it is kept within one."""
    known = np.isfinite(angle)
    values = angle[known]
    if len(values) < 2 or np.ptp(values) > 1.001 * REVOLUTION:
        return angle
    if np.abs(np.diff(values)).max() < 0.5 * REVOLUTION:
        return angle
    angle = angle.copy()
    angle[known] = np.unwrap(values)
    return angle
