"""A small picture of a rig at work: speeds against the set-point, commands and spools. NumPy alone draws it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Recorder"]

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Control periods that the picture shows.
SHOWN = 280
HEIGHT, WIDTH = 240, 320
_WHITE, _GRID, _BLACK = (255, 255, 255), (222, 224, 228), (60, 60, 60)
_COLOURS = ((31, 119, 180), (255, 127, 14))  # motor or valve 1, 2
_SPEED_RPM, _SPOOL_M = 800.0, 1e-3


class Recorder:
    """The recent past of every rig: set-point and speeds in rpm, commands as fractions, spools in m."""

    def __init__(self, num_rigs: int) -> None:
        self._past = np.full((num_rigs, SHOWN, 7), np.nan)

    def clear(self, rows: NDArray[np.int64]) -> None:
        """Forgets the past of some rows."""
        self._past[rows] = np.nan

    def add(self, rows: NDArray[np.int64], true: Floats, fraction: Floats, spool: Floats) -> None:
        """Adds an instant of some rows."""
        self._past[rows] = np.roll(self._past[rows], -1, axis=1)
        now = np.column_stack([true[:, 2], true[:, 0:2], fraction, spool])
        self._past[rows, -1] = now[rows]

    def picture(self, row: int, period: float) -> Picture:
        """(HEIGHT, WIDTH, 3): speeds above, a bar per valve below.

        Speeds: +-800 rpm, set-point black, a line every 200 rpm and second. Bars: the command as an outline, the spool
        filled; full width is the rated command and 1 mm.
        """
        image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        image[:] = _WHITE
        past = self._past[row]
        top, bottom, left = 8, 176, 20
        for level in range(-800, 801, 200):
            image[_height(level, top, bottom), left : left + SHOWN] = _GRID if level else _BLACK
        for back in range(0, SHOWN, max(1, round(1.0 / period))):
            image[top : bottom + 1, left + SHOWN - 1 - back] = _GRID
        for column, colour in ((0, _BLACK), (1, _COLOURS[0]), (2, _COLOURS[1])):
            _curve(image, past[:, column], top, bottom, left, colour)
        middle, half = left + SHOWN // 2, SHOWN // 2
        for channel, colour in enumerate(_COLOURS):
            y = 188 + 24 * channel
            command, spool = np.clip(
                np.nan_to_num(past[-1, [3 + channel, 5 + channel]]) / (1.0, _SPOOL_M), -1.0, 1.0
            )
            ends = sorted((middle, middle + round(half * spool)))
            image[y + 5 : y + 12, ends[0] : ends[1] + 1] = colour
            ends = sorted((middle, middle + round(half * command)))
            image[[y, y + 17], ends[0] : ends[1] + 1] = colour
            image[y : y + 18, ends] = colour
            image[y - 2 : y + 20, middle] = _BLACK
        return image


def _height(speed: float, top: int, bottom: int) -> int:
    share = float(np.clip(speed / _SPEED_RPM, -1.0, 1.0))
    return round(0.5 * (top + bottom) - 0.5 * (bottom - top) * share)


def _curve(
    image: Picture, values: Floats, top: int, bottom: int, left: int, colour: tuple[int, int, int]
) -> None:
    before = None
    for x, value in enumerate(values):
        if np.isnan(value):
            continue
        y = _height(float(value), top, bottom)
        low, high = (y, y) if before is None else (min(before, y), max(before, y))
        image[low : high + 1, left + x] = colour
        before = y
