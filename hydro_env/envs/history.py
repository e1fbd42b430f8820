"""The last frames of every row: an observation with `history` holds more than the newest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .observation import FRAME

__all__ = ["History"]


class History:
    """`frames` (N, FRAME * length): what each row showed last, oldest first."""

    def __init__(self, num_rows: int, length: int) -> None:
        self.length = length
        self.frames = np.zeros((num_rows, FRAME * length), np.float32)

    def add(self, observation: NDArray[np.float32], rows: NDArray[np.int64], step: NDArray[np.int64]) -> None:
        """Completes observations (N, FRAME * length) of some rows, whose last frame is new.

        In front of it come the frames before it, or the new one again where `step` (N,) is 0.
        """
        if self.length > 1:
            new = rows[step[rows] == 0]
            observation[rows, :-FRAME] = self.frames[rows, FRAME:]
            observation[new, :-FRAME] = np.tile(observation[new, -FRAME:], self.length - 1)
        if rows.size == len(self.frames):  # copied faster
            self.frames[:] = observation
        else:
            self.frames[rows] = observation[rows]
