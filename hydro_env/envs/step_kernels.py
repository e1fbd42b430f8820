"""The compiled part of a step around the plant: commands in; sensors, reward and true signals out.

The functions work row by row on arrays of any number of rigs, with the same arithmetic in the same order for each,
so that a row of a batch is bit for bit the same as that row alone.
"""

from __future__ import annotations

from math import isfinite

from ..jit import compiled
from ..units import BAR, DEGREE, RPM

__all__ = ["COLUMNS", "SIGNALS", "apply", "drive", "look", "wind"]

#: Signals of the plant's memory that `look` reads, in the order of its argument `where`.
SIGNALS = ("speed", "angle", "measured_speed", "current", "pressure", "diverged", "mean_line_pressure")

#: Columns of the table of true signals that `look` fills.
COLUMNS: dict[str, slice | int] = {
    "speed_rpm": slice(0, 2),
    "setpoint_rpm": 2,
    "speed_difference_rpm": 3,
    "command_V": slice(4, 6),
    "angle_difference_deg": 6,
    "reward_tracking": 7,
    "reward_difference": 8,
    "reward_variation": 9,
    "cost_difference": 10,
    "cost_travel": 11,
    "lowest_line_pressure_bar": 12,
}
TRUE = 13
#: Speed difference, rpm, beyond which `cost_difference` counts; what good controllers stay below once the motors run.
COST_BOUND_RPM = 20.0

_TO_RPM = 1.0 / RPM
_TO_DEG = 1.0 / DEGREE
_TO_BAR = 1.0 / BAR


def _threaded(function):
    return compiled(function, nogil=True)


@_threaded
def apply(actions, rated, driven, step, fraction, moved, command, load):
    """Turns actions (N, 2) into commands and loads (N, 2) of the period that begins; False if one is not finite.

    rated (N, 2) in V; driven (N, 4): see `drive`; step (N,): moved on by one; fraction (N, 2): the command in force,
    replaced; moved (N,): its mean absolute change.
    """
    for i in range(actions.shape[0]):
        if not (isfinite(actions[i, 0]) and isfinite(actions[i, 1])):
            return False
    for i in range(actions.shape[0]):
        step[i] += 1
        moved[i] = 0.0
        for c in range(2):
            action = actions[i, c]
            action = action if action < 1.0 else 1.0
            action = action if action > -1.0 else -1.0
            moved[i] += 0.5 * abs(action - fraction[i, c])
            fraction[i, c] = action
            command[i, c] = action * rated[i, c]
            load[i, c] = driven[i, 1 + c]
    return True


@_threaded
def drive(rows, step, last, of, starts, levels, place, driven):
    """What is driven by some rows at the instant `step` (N,) of their episodes; once one is over its last instant stays.

    of, starts, levels: see `Courses`; place (N, 2): the piece that is driven, and when the next begins. Filled is driven (N, 4):
    set-point in rad/s, loads in N m from now on, and the set-point that was in force.
    """
    for i in rows:
        now = step[i]
        if now > last[i]:
            continue
        if now == 0:
            place[i, 0], place[i, 1] = -1, 0
        driven[i, 3] = driven[i, 0]
        if now == place[i, 1]:
            piece = place[i, 0] + 1
            for j in range(3):
                driven[i, j] = levels[of[i], piece, j]
            place[i, 0], place[i, 1] = piece, starts[of[i], piece + 1]
        if now == 0:
            driven[i, 3] = driven[i, 0]


@_threaded
def look(
    rows, memory, half, where, step, last, driven, error, deviation, scales, limit, factor, stuck, held, fraction, moved, rated,
    weights, observation, true, reward, terminated, truncated,
):  # fmt: skip
    """Sensors, reward and true signals of some rows at the instant `step` (N,) of their episodes.

    rows: numbers of the rows. memory, half, where: the plant's memory and the rows of `SIGNALS` in it. driven (N, 4): see
    `drive`. error (N, 6): of the sensors, standard normal; its deviation (6,) and scales (9,) of the observation. factor, stuck,
    held (N, 2): noise factor of the speed sensors, row from which on one is stuck, and what it last showed.
    The last five are filled: observation (N, n), its last frame alone; true (N, TRUE), reward, terminated, truncated (N,).

    Every operation here costs a millisecond or two of the first start, in which all this is compiled.
    """
    newest = observation.shape[1] - scales.shape[0]
    for i in rows:
        block = i // half
        lane = i - block * half
        cells = memory[block]
        now, end = step[i], last[i]
        target = driven[i, 0]
        observation[i, newest] = target / scales[0]
        for j in range(6):
            c = j % 2
            added = error[i, j] * deviation[j]
            if j < 2:
                added *= factor[i, c]
            value = cells[where[2 + j // 2], lane + c * half] / scales[1 + j] + added
            if j < 2:
                if now >= stuck[i, c]:
                    value = held[i, c]
                held[i, c] = value
            observation[i, newest + 1 + j] = value
        observation[i, newest + 7], observation[i, newest + 8] = fraction[i, 0], fraction[i, 1]
        for j in range(newest, observation.shape[1]):
            value = observation[i, j] if observation[i, j] < limit else limit
            observation[i, j] = value if value > -limit else -limit

        one = cells[where[0], lane] * _TO_RPM
        two = cells[where[0], lane + half] * _TO_RPM
        aim = driven[i, 3] * _TO_RPM
        tracking = -weights[0] * 0.5 * (abs(one - aim) + abs(two - aim))
        difference, variation = -weights[1] * abs(one - two), -weights[2] * moved[i]
        lost = cells[where[5], lane] > 0.0 or cells[where[5], lane + half] > 0.0
        true[i, 0], true[i, 1], true[i, 2], true[i, 3] = one, two, target * _TO_RPM, one - two
        true[i, 4], true[i, 5] = fraction[i, 0] * rated[i, 0], fraction[i, 1] * rated[i, 1]
        true[i, 6] = (cells[where[1], lane] - cells[where[1], lane + half]) * _TO_DEG
        true[i, 7], true[i, 8], true[i, 9] = tracking, difference, variation
        beyond = abs(one - two) - COST_BOUND_RPM
        true[i, 10] = beyond if beyond > 0.0 else 0.0
        true[i, 11] = moved[i]
        first = cells[where[6], lane] - 0.5 * abs(cells[where[4], lane])
        second = cells[where[6], lane + half] - 0.5 * abs(cells[where[4], lane + half])
        true[i, 12] = (first if first < second else second) * _TO_BAR
        reward[i] = tracking + difference + variation - (weights[3] if lost else 0.0)
        terminated[i] = lost
        truncated[i] = now >= end


@_threaded
def wind(rows, memory, half, angle, turned, true):
    """Adds what the shafts of some rows have turned to `turned` (N, 2) in rad and puts their angles, a row of the memory, to
    zero: a sum of seven digits would be degrees off after some thousand small steps. Corrects true (N, TRUE)."""
    for i in rows:
        block = i // half
        lane = i - block * half
        cells = memory[block]
        for c in range(2):
            turned[i, c] += cells[angle, lane + c * half]
            cells[angle, lane + c * half] = 0.0
        true[i, 6] = (turned[i, 0] - turned[i, 1]) * _TO_DEG
