"""Filters of signals: one pole, and a local parabola.

SciPy has both; to import it takes half a second of every diagnosis.
"""

from __future__ import annotations

import numpy as np

__all__ = ["local_parabola", "one_pole"]


def one_pole(values: np.ndarray, keep: float) -> np.ndarray:
    """y (T,) of y[n] = keep y[n - 1] + values[n] from rest, for 0 <= keep < 1.

    By doubling (Hillis and Steele 1986, doi:10.1145/7902.7903): y is the sum over the last 1, 2, 4, ... values.
    """
    found, reach = np.array(values, dtype=float), 1
    while reach < found.size and keep > 0.0:
        found[reach:] += keep * found[:-reach]
        keep, reach = keep * keep, 2 * reach
    return found


def local_parabola(values: np.ndarray, width: int, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Value and slope (T,) per second of the parabola through `width` (odd) values about each one, by least squares.

    Near an end they are those of the parabola through the last `width` values there (Savitzky and Golay 1964,
    doi:10.1021/ac60214a047). ValueError if there are fewer values than that.
    """
    half = width // 2
    if len(values) < width:
        raise ValueError(f"{len(values)} values are fewer than the width {width}")
    step = np.arange(-half, half + 1.0)
    rows = np.linalg.pinv(np.vander(step, 3, increasing=True))
    found = np.empty((2, len(values)))
    for out, row in zip(found, rows, strict=False):
        out[half : len(values) - half] = np.correlate(values, row, "valid")
    for own, at, ends in (
        (slice(width), step[:half], slice(half)),
        (slice(-width, None), step[-half:], slice(-half, None)),
    ):
        level, slope, curve = rows @ values[own]
        found[:, ends] = level + slope * at + curve * at**2, slope + 2.0 * curve * at
    return found[0], found[1] / period
