"""Windows of long logs: an hour is not simulated as a whole, but in a few stretches that say most.

A stretch may begin where the rig is at rest, because a simulation does; where there is no rest it begins anywhere and its
first second does not count. How much a stretch says is judged by its commands: how far and how often they move, in both
directions, on both channels, and how much the load changes.
"""

import numpy as np

from ...measured import RigLog

#: Beyond this length a log is looked at in windows, s; length and number of the windows: two logs of that length are diagnosed in
#: a minute, and are as long as those of the blind trials.
LONG_S = 120.0
WINDOW_S, WINDOWS = 12.0, 2
#: How long a rig must have been quiet to be at rest, s, and what does not count where it was not: more than the shaft remembers
#: (see `estimation.uncertainty`), and five times that.
QUIET_S, WARM_S = 0.3, 1.0

#: Moves that count in a second, in standard deviations of the signal: ten steps from end to end.
MAX_MOVES = 20.0


def rest_starts(log: RigLog) -> np.ndarray:
    """Rows (m,) before which the whole rig was quiet: no command and no speed for QUIET_S."""
    quiet = np.ones(len(log), bool)
    for c in log.channels:
        for values, share in ((log.command_V[:, c], 0.005), (log.speed[:, c], 0.02)):
            known = np.nan_to_num(values)
            quiet &= np.abs(known) <= share * max(float(np.quantile(np.abs(known), 0.999)), 1e-12)
    need = max(2, round(QUIET_S / log.period))
    run = np.concatenate([[0], np.cumsum(quiet)])
    rows = np.arange(need, len(log))
    return rows[run[rows] - run[rows - need] == need]


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


def choose(log: RigLog, first: float, last: float, count: int = WINDOWS) -> list[tuple[float, float, bool]]:
    """Up to `count` windows (from, to, begins at rest) in seconds between `first` and `last`, earliest first.

    They do not overlap. Those that begin at rest are preferred unless they say less than half as much.
    """
    step = max(1, round(1.0 / log.period))
    worth = _worth(log, step)
    time = log.time_s
    width = round(WINDOW_S)
    if worth.size <= width:
        return [(first, last, True)]
    sums = np.convolve(worth, np.ones(width), "valid")  # of the window that begins with each piece
    starts = np.arange(sums.size) * step
    usable = (time[starts] >= first - 1e-9) & (time[starts] + WINDOW_S <= last + 1e-9)
    score = np.where(usable, sums, -np.inf)
    begin, at_rest = starts.copy(), np.zeros(starts.size, bool)
    rows = rest_starts(log)[::-1]  # of several in a piece the first one counts
    rows = rows[rows < starts.size * step]
    begin[rows // step], at_rest[rows // step] = rows, True
    score = np.where(at_rest, 2.0 * score, score)
    found: list[tuple[float, float, bool]] = []
    for _ in range(count):
        best = int(np.argmax(score))
        if not np.isfinite(score[best]):
            break
        start = float(time[begin[best]])
        found.append((start, start + WINDOW_S, bool(at_rest[best])))
        score[np.abs(starts - starts[best]) * log.period < WINDOW_S + 1.0] = -np.inf
    return sorted(found)
