"""Run-length encoded set-point and load profiles of a batch."""

import numpy as np

from ..arrays import Floats, Integers
from ..tasks.scenarios import Reference

#: Where a profile has no further segment.
NEVER = np.iinfo(np.int32).max
#: Segments by which the room for them grows.
_STEP = 8


class Profiles:
    """Set-points (rad/s) and loads (N m): segment p of profile k holds `levels` (K, P, 3) from the period `starts` (K, P + 1) on.

    Profile 0 is one that all rows of a batch have in common, profile i + 1 that of row i alone.
    """

    def __init__(self, num_rows: int) -> None:
        self.num_rows = num_rows
        self.share(np.full((1, 1), NEVER, np.int32), np.zeros((1, 0, 3)))

    def share(self, starts: Integers, levels: Floats) -> None:
        """All rows have the same, an `encode`d one."""
        self.starts, self.levels = starts, levels

    def put(self, rows: Integers, starts: Integers, levels: Floats) -> None:
        """Rows have `encode`d profiles of their own, or one for all of them."""
        count, have, _ = self.levels.shape
        more = -(-max(levels.shape[1] - have, 0) // _STEP) * _STEP
        if more or count == 1:
            grown = (0, self.num_rows + 1 - count), (0, more)
            self.starts = np.pad(self.starts, grown, constant_values=NEVER)
            self.levels = np.pad(self.levels, (*grown, (0, 0)))
        self.starts[rows + 1] = NEVER
        self.starts[rows + 1, : starts.shape[1]] = starts
        self.levels[rows + 1, : levels.shape[1]] = levels

    def bytes_with(self, segments: int) -> float:
        """Bytes of the tables if each row has a profile of its own with at most this number of segments."""
        return (self.num_rows + 1) * (28.0 * max(segments, self.levels.shape[1]) + 4.0)

    def decoded(self, number: int, periods: int) -> Reference:
        """The first `periods` of a profile."""
        segment = np.searchsorted(self.starts[number], np.arange(periods), side="right") - 1
        levels = self.levels[number, segment]
        return Reference(levels[:, 0], levels[:, 1:])


def encode(setpoint: Floats, load: Floats) -> tuple[Integers, Floats]:
    """Starts (n, P + 1) and levels (n, P, 3) of the segments of set-points (n, T) in rad/s and loads (n, T, 2) in N m.

    Segments that a profile has fewer than P start at `NEVER`, as the one after the last does.
    """
    begins = np.zeros(setpoint.shape, np.bool_)
    begins[:, 0] = True
    for values in (setpoint, load[..., 0], load[..., 1]):
        bits = values.view(np.int64)  # 0.0 and -0.0 are not the same
        begins[:, 1:] |= bits[:, 1:] != bits[:, :-1]
    count = begins.sum(axis=1)
    row, period = np.nonzero(begins)
    place = np.arange(row.size) - (np.cumsum(count) - count)[row]
    width = int(count.max())
    starts, levels = np.full((count.size, width + 1), NEVER, np.int32), np.zeros((count.size, width, 3))
    starts[row, place] = period
    levels[row, place, 0], levels[row, place, 1:] = setpoint[row, period], load[row, period]
    return starts, levels
