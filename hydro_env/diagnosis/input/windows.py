"""Windows of long logs: an hour is not simulated as a whole, but in a few stretches that say most.

How much a stretch says is judged by its commands: how far and how often they move, in both directions, on both channels, and how
much the load changes.
"""

from __future__ import annotations

import numpy as np

from ...measured import RigLog

__all__ = ["LONG_S", "WARM_S", "choose"]

#: Beyond this length a log is looked at in windows, s; length and number of the windows: two logs of that length are diagnosed in
#: a minute, and are as long as those of the blind trials.
LONG_S = 120.0
WINDOW_S, WINDOWS = 12.0, 2
#: How long before a window its simulation begins, at rest, s: ten times what the shaft remembers (see `duration`).
WARM_S = 2.0
#: Moves that count in a second, in standard deviations of the signal: ten steps from end to end.
MAX_MOVES = 20.0


def _worth(log: RigLog, step: int) -> np.ndarray:
    """How much each piece of `step` rows says, (n,), for a sum over pieces: how far the commands move in it and how widely, in
    units of their standard deviations, and the same of the loads."""
    count = len(log) // step
    total = np.zeros(count)
    for values in (log.command_V, *(() if log.load is None else (log.load,))):
        for c in log.channels:
            known = np.nan_to_num(values[: count * step, c])
            pieces = known.reshape(count, step) / max(float(np.std(known)), 1e-12)
            # More than this in a second is noise.
            total += np.minimum(np.abs(np.diff(pieces, axis=1)).sum(axis=1), MAX_MOVES) + pieces.std(axis=1)
    return total


def choose(log: RigLog, first: float, last: float) -> list[tuple[float, float]]:
    """The `WINDOWS` windows (from, to) in seconds between `first` and `last` that say most, earliest first and apart."""
    step = max(1, round(1.0 / log.period))
    sums = np.convolve(
        _worth(log, step), np.ones(round(WINDOW_S)), "valid"
    )  # of the window from each piece on
    starts = log.time_s[np.arange(sums.size) * step]
    score = np.where((starts >= first - 1e-9) & (starts + WINDOW_S <= last + 1e-9), sums, -np.inf)
    found = []
    for _ in range(WINDOWS):
        start = float(starts[np.argmax(score)])
        found.append((start, start + WINDOW_S))
        score[np.abs(starts - start) < WINDOW_S] = -np.inf
    return sorted(found)
