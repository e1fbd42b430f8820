"""What the episodes of many rows drive, kept as pieces between changes: all periods would take ten times the room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..tasks.scenarios import Reference

__all__ = ["Courses", "pieces"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

NEVER = np.iinfo(np.int32).max
"""A piece that begins then is none."""
#: Room for pieces grows by so many.
_STEP = 8


class Courses:
    """Set-points (rad/s) and loads (N m) of N rows: piece p of course k holds `levels` (K, P, 3) from the control period `starts`
    (K, P + 1) on. Row i drives course `of[i]`: 0 is one that rows have in common, i + 1 its own."""

    def __init__(self, num_rows: int) -> None:
        self.of = np.zeros(num_rows, np.int64)
        self.starts, self.levels = np.full((1, 1), NEVER, np.int32), np.zeros((1, 0, 3))

    def share(self, starts: Integers, levels: Floats) -> None:
        """All rows drive the same: `pieces` of one course."""
        self.starts, self.levels = starts, levels
        self.of[:] = 0

    def put(self, rows: NDArray[np.int64], starts: Integers, levels: Floats) -> None:
        """Rows drive `pieces` of their own from the first period on, or one course for all of them."""
        self._make_room(levels.shape[1])
        self.of[rows] = rows + 1
        self.starts[rows + 1] = NEVER
        self.starts[rows + 1, : starts.shape[1]] = starts
        self.levels[rows + 1, : levels.shape[1]] = levels

    def room(self, most: int) -> float:
        """Bytes that the tables take where rows have courses of their own with at most so many pieces."""
        return (self.of.size + 1) * (28.0 * max(most, self.levels.shape[1]) + 4.0)

    def _make_room(self, most: int) -> None:
        courses, have, _ = self.levels.shape
        more = -(-max(most - have, 0) // _STEP) * _STEP
        if more or courses == 1:
            grown = (0, self.of.size + 1 - courses), (0, more)
            self.starts = np.pad(self.starts, grown, constant_values=NEVER)
            self.levels = np.pad(self.levels, (*grown, (0, 0)))

    def course(self, row: int, periods: int) -> Reference:
        """The first `periods` of what a row drives."""
        starts, levels = self.starts[self.of[row]], self.levels[self.of[row]]
        piece = np.searchsorted(starts, np.arange(periods), side="right") - 1
        return Reference(levels[piece, 0], levels[piece, 1:])


def pieces(setpoint: Floats, load: Floats) -> tuple[Integers, Floats]:
    """Beginnings (n, P + 1) and levels (n, P, 3) of the pieces of set-points (n, T) in rad/s and loads (n, T, 2) in N m; what a
    course has fewer than P begins at `NEVER`, as the piece after the last one does."""
    values = np.concatenate([setpoint[..., None], load], axis=2)
    bits = values.view(np.int64)  # 0.0 and -0.0 are not the same
    begins = np.ones(values.shape[:2], np.bool_)
    begins[:, 1:] = (bits[:, 1:] != bits[:, :-1]).any(axis=2)
    count = begins.sum(axis=1)
    row, period = np.nonzero(begins)
    place = np.arange(row.size) - (np.cumsum(count) - count)[row]
    most = int(count.max())
    starts, levels = np.full((len(values), most + 1), NEVER, np.int32), np.zeros((len(values), most, 3))
    starts[row, place], levels[row, place] = period, values[row, period]
    return starts, levels
