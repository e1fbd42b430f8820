"""How well the two motors kept together and followed the set-point: scores of recorded episodes.

Every metric is computed from true signals (no sensor noise), for all rigs of a batch at once. Rows n = 0 ... T - 1 of a
trace lie at n * period; row 0 is the rest state in which the episode starts.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats
from ..errors import check_known

#: The motors of the paper's rig count as in step while their speeds differ by no more than this, rpm.
SETTLED_RPM = 10.0
#: A change of direction of the command counts from this way on, fraction of the rated command: less than cheap valves resolve.
REVERSAL = 0.01
#: For so long (s) they have to, or they were not back in step: three periods of the spools' mode, so that passing through
#: zero while ringing does not count.
SETTLED_S = 0.1
#: Of the tracking error of motors that stand still: beyond it a controller counts as idle, and is ranked last. Half of it is the
#: error of one motor that follows alone; this is halfway between.
IDLE = 0.75


@dataclass(frozen=True)
class Trace:
    """Episodes of N rigs with T rows, in the units in which scores are read.

    period: control period in s
    setpoint_rpm: (T, N)
    speed_rpm: (T, N, 2)
    angle_difference_deg: (T, N), shaft 1 ahead of shaft 2 is positive
    command: (T, N, 2), fraction of the rated command, row n in force from row n on (a last row without effect may be
        missing: (T - 1, N, 2))
    peak_difference_rpm: (T, N), the largest absolute difference of the speeds since the row before, on a grid of 1 ms or finer
    settled_rpm: while the speeds differ by no more than this, the motors count as in step
    returns: (N,), sums of the environment's default reward; empty where nothing gave a reward
    """

    period: float
    setpoint_rpm: Floats
    speed_rpm: Floats
    angle_difference_deg: Floats
    command: Floats
    peak_difference_rpm: Floats
    settled_rpm: float = SETTLED_RPM
    returns: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def difference_rpm(self) -> Floats:
        """Speed of motor 1 less that of motor 2, (T, N)."""
        return self.speed_rpm[..., 0] - self.speed_rpm[..., 1]

    @cached_property
    def longest_apart(self) -> tuple[Floats, Bools]:
        """The longest time out of step in s, (N,), and whether the episode ended in it, (N,)."""
        apart = np.abs(self.difference_rpm) > self.settled_rpm
        enough = max(1, round(SETTLED_S / self.period))  # rows together that end a time out of step
        row, none = np.arange(len(apart), dtype=np.int32)[:, None], np.int32(-enough - 1)
        # Up to each row: the last row with the motors apart, and the row in which that time out of step began.
        last = np.maximum.accumulate(np.where(apart, row, none), axis=0)
        before = np.concatenate([np.full_like(last[:1], none), last[:-1]])
        first = np.maximum.accumulate(np.where(apart & (row - before > enough), row, np.int32(0)), axis=0)
        long = np.where(apart, row + 1 - first, np.int32(0))
        longest = long.max(axis=0)
        end = np.where(longest > 0, long.argmax(axis=0), none)  # last row of the longest one
        return longest * self.period, len(apart) - 1 - end < enough


@dataclass(frozen=True)
class Metric:
    """One score. `title` is what it is called in words. `of(trace)` -> (N,). Lower is better, unless `more` is."""

    name: str
    title: str
    unit: str
    definition: str
    of: Callable[[Trace], Floats]
    more: bool = False


def never_settled(trace: Trace) -> Bools:
    """(N,), whether the longest time out of step was still running when the episode ended: `sync_settling_time_s` is then only a
    lower bound, set by the length of the episode."""
    return trace.longest_apart[1]


def _travel(trace: Trace) -> Floats:
    moves = np.abs(np.diff(trace.command, axis=0, prepend=np.zeros_like(trace.command[:1])))
    return moves.mean(axis=(0, 2)) / trace.period


def _reversals(trace: Trace) -> Floats:
    extreme = way = turns = np.zeros_like(trace.command[0])
    for command in trace.command:
        extreme = way * np.maximum(way * extreme, way * command)
        back = np.abs(command - extreme) >= REVERSAL
        turns = turns + (back & (way != 0.0))
        way = np.where(back, np.sign(command - extreme), way)
        extreme = np.where(back, command, extreme)
    return turns.mean(axis=1) / (len(trace.command) * trace.period)


#: The metrics by name.
METRICS: dict[str, Metric] = {metric.name: metric for metric in (
    Metric(
        "return", "return", "",
        "sum of the environment's reward with its default weights over the episode; more is better",
        lambda trace: trace.returns, more=True,
    ),
    Metric(
        "max_speed_difference_rpm", "peak synchronisation error", "rpm",
        "largest absolute difference of the two speeds in the episode, on a grid of 1 ms or finer whatever the control period",
        lambda trace: trace.peak_difference_rpm.max(axis=0),
    ),
    Metric(
        "rms_speed_difference_rpm", "RMS speed difference", "rpm",
        "root of the mean squared difference of the two speeds",
        lambda trace: np.sqrt(np.mean(trace.difference_rpm**2, axis=0)),
    ),
    Metric(
        "sync_settling_time_s", "settling time of the speed difference", "s",
        f"longest time out of step: from when the speeds differ by more than {SETTLED_RPM:g} rpm (on another rig in proportion "
        f"to its speed) until they differ by no more for at least {SETTLED_S:g} s, or the episode ends",
        lambda trace: trace.longest_apart[0],
    ),
    Metric(
        "shaft_angle_difference_deg", "largest shaft angle difference", "deg",
        "largest absolute difference of the angles turned since the start",
        lambda trace: np.abs(trace.angle_difference_deg).max(axis=0),
    ),
    Metric(
        "tracking_mae_rpm", "mean absolute tracking error", "rpm",
        "mean absolute difference between speed and set-point, over time and both motors",
        lambda trace: np.mean(np.abs(trace.speed_rpm - trace.setpoint_rpm[..., None]), axis=(0, 2)),
    ),
    Metric(
        "command_travel_per_s", "command travel", "1/s",
        "how far the command moves a second: sum of its absolute changes (fraction of the rated one; from zero at the start), "
        "mean of both valves. A controller that shakes its valves wears them",
        _travel,
    ),
    Metric(
        "valve_reversals_per_s", "valve reversals", "1/s",
        f"how often a second the command turns round by {100 * REVERSAL:g} % of the rated one or more, mean of both valves",
        _reversals,
    ),
    Metric("command_variation", "command variation", "1/s", "the same as `command_travel_per_s`", _travel),
)}  # fmt: skip


def compute(trace: Trace, names: Iterable[str] | None = None) -> dict[str, Floats]:
    """Metrics of a trace, each (N,); all that it has the signals for, or those named. InputError for an unknown name."""
    chosen = (
        [name for name in METRICS if name != "return" or trace.returns.size] if names is None else list(names)
    )
    check_known("unknown metric", chosen, METRICS)
    return {name: METRICS[name].of(trace) for name in chosen}
