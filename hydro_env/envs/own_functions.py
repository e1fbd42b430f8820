"""Functions of the user's that take the place of the reward or the observation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, shown

#: True signals (N, ...) by their names in `info`, read-only.
Signals = Mapping[str, NDArray[Any]]
OwnReward = Callable[[Signals], NDArray[Any]]
OwnObservation = Callable[[NDArray[np.float32], Signals], NDArray[Any]]


def checked_rows(
    name: str, returned: Any, shape: tuple[int | None, ...], finite: bool = True
) -> NDArray[np.float64]:
    """What a function returned, as an array. InputError unless it holds finite numbers of this shape, None for any length."""
    try:
        array = np.asarray(returned, np.float64)
    except (TypeError, ValueError):
        array = np.empty(())
    wanted = f"finite numbers of the shape {shape}".replace("None", "n")
    if len(shape) != array.ndim or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        found = f"numbers of the shape {array.shape}" if array.ndim else shown(returned)
        raise InputError(f"{name}: the function returned {found}, expected {wanted}")
    if finite and not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        raise InputError(
            f"{name}: the function returned {shown(array[row].tolist())} in row {row}, expected {wanted}"
        )
    return array
