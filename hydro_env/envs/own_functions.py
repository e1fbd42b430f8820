"""Functions of the user's that take the place of the reward or the observation, and what users give the environment."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..arrays import AnyArray, Floats, Singles
from ..errors import InputError, shown

#: True signals (N, ...) by their names in `info`, read-only.
Signals = Mapping[str, AnyArray]
OwnReward = Callable[[Signals], AnyArray]
OwnObservation = Callable[[Singles, Signals], AnyArray]


def checked_rows(said: str, given: Any, shape: tuple[int | None, ...], finite: bool = True) -> Floats:
    """What a function returned or a user gave, as an array. InputError, which begins with what is `said` of it ("act returned"),
    unless it holds finite real numbers of this shape, None for any length."""
    try:
        array = np.asarray(given)
    except ValueError:  # rows of different lengths
        array = np.empty(())
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if array.dtype.kind not in "fiub" or not fits:
        found = f"{array.dtype} of the shape {array.shape}" if isinstance(given, np.ndarray) else shown(given)
    elif finite and not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        found = f"{shown(array[row].tolist())} in row {row}"
    else:
        return np.ascontiguousarray(array, np.float64)
    wanted = f"finite numbers of the shape {shape}".replace("None", "n")
    raise InputError(f"{said} {found}, expected {wanted}")
