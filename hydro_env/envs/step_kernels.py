"""The compiled part of a step around the plant: commands in; sensors, reward and true signals out.

The functions work row by row on any number of rigs, with the same arithmetic in the same order for each, so that a row of a
batch is bit for bit the same as that row alone.
"""

from functools import partial
from math import isfinite

import numpy as np

from ..jit import compiled
from ..streams import block, normal
from ..units import BAR, DEGREE, RPM
from .observation import LIMIT

#: What is kept of each row from step to step.
STATE = np.dtype(
    [
        ("step", np.int64),  # control periods since the reset
        ("last", np.int64),  # the step that ends the episode
        ("profile", np.int64),  # number of its set-point and load profile
        ("segment", np.int64),  # of the profile, in force
        ("next", np.int64),  # the step with which the next segment begins
        ("setpoint", np.float64),  # in force from now on, rad/s
        ("setpoint_before", np.float64),  # in force during the last period, rad/s
        ("load", np.float64, 2),  # from now on, N m
        ("rated", np.float64, 2),  # commands, V
        ("fraction", np.float64, 2),  # the command in force, fraction of the rated one
        ("moved", np.float64),  # mean absolute change of that fraction
        ("noise_key", np.uint64, 2),  # of the stream of the sensors' noise
        ("noise_counter", np.uint64, 4),
        ("noise", np.float64, 6),  # of speeds, currents and pressures, scaled like the observation
        ("noise_factor", np.float64, 2),  # on the noise of the speed sensors
        ("stuck_from", np.int64, 2),  # the step from which on a speed sensor is stuck
        ("shown", np.float64, 2),  # speeds that the sensors showed last, scaled like the observation
        ("turned", np.float64, 2),  # angles that are summed up here, see `wind`, rad
    ]
)
#: A step that no episode has.
NEVER = np.iinfo(np.int64).max

#: Signals of the plant's memory that `observe` reads, in the order of its argument `where`.
SIGNALS = (
    "speed",
    "angle",
    "measured_speed",
    "current",
    "pressure",
    "diverged",
    "mean_line_pressure",
    "peak_difference",
)

#: Columns of the table of true signals that `observe` fills.
COLUMNS: dict[str, slice | int] = {
    "speed_rpm": slice(0, 2), "setpoint_rpm": 2, "speed_difference_rpm": 3, "command_V": slice(4, 6),
    "angle_difference_deg": 6, "reward_tracking": 7, "reward_difference": 8, "reward_variation": 9,
    "cost_difference": 10, "cost_travel": 11, "lowest_line_pressure_bar": 12, "peak_difference_rpm": 13,
}  # fmt: skip
TRUE = 14
_TO_RPM = 1.0 / RPM
_TO_DEG = 1.0 / DEGREE
_TO_BAR = 1.0 / BAR


_threaded = partial(compiled, nogil=True)


@_threaded
def apply(actions, state, command, load):
    """Turns actions (N, 2) into commands (V) and loads (N m), (N, 2), of the period that begins; False if one is not finite."""
    for i in range(actions.shape[0]):
        if not (isfinite(actions[i, 0]) and isfinite(actions[i, 1])):
            return False
    for i in range(actions.shape[0]):
        row = state[i]
        row.step += 1
        row.moved = 0.0
        for c in range(2):
            action = actions[i, c]
            action = action if action < 1.0 else 1.0
            action = action if action > -1.0 else -1.0
            row.moved += 0.5 * abs(action - row.fraction[c])
            row.fraction[c] = action
            command[i, c] = action * row.rated[c]
            load[i, c] = row.load[c]
    return True


@_threaded
def take_inputs(rows, state, starts, levels, deviation):
    """What comes from outside to some rows at their present step: set-points and loads from `Profiles`, and the sensors' noise.

    Once an episode is over, its last set-point and loads stay. deviation (N, 6): of the noise, scaled like the observation.
    """
    noisy = deviation.any()
    for i in rows:
        row = state[i]
        if row.step == 0:
            row.segment, row.next = -1, 0
        if row.step <= row.last:
            row.setpoint_before = row.setpoint
            if row.step == row.next:
                row.segment += 1
                row.setpoint = levels[row.profile, row.segment, 0]
                row.load[0] = levels[row.profile, row.segment, 1]
                row.load[1] = levels[row.profile, row.segment, 2]
                row.next = starts[row.profile, row.segment + 1]
            if row.step == 0:
                row.setpoint_before = row.setpoint
        if noisy:
            words = block(row.noise_key, row.noise_counter, row.step + 1)
            for j in range(6):
                row.noise[j] = deviation[i, j] * normal(words, j)


@_threaded
def observe(rows, state, memory, where, sensing, observation, true, reward, terminated, truncated):
    """Sensors, reward and true signals of some rows at their present step.

    memory, where: the plant's memory and the rows of `SIGNALS` in it. sensing (14,): what 1.0 stands for in a frame; then the
    weights of the reward, and the speed difference, rpm, beyond which `cost_difference` counts. The last five are filled:
    observation (N, n), its last frame alone; true (N, TRUE), reward, terminated, truncated (N,).
    """
    scales, weights = sensing[:-5], sensing[-5:]
    newest = observation.shape[1] - scales.size
    half = memory.shape[2] // 2
    for i in rows:
        row, block = state[i], i // half
        cells, lane = memory[block], i - block * half
        observation[i, newest] = row.setpoint / scales[0]
        for j in range(6):
            c = j % 2
            value = cells[where[2 + j // 2], lane + c * half] / scales[1 + j]
            if j < 2:
                value += row.noise[j] * row.noise_factor[c]
                if row.step >= row.stuck_from[c]:
                    value = row.shown[c]
                row.shown[c] = value
            else:
                value += row.noise[j]
            observation[i, newest + 1 + j] = value
        observation[i, newest + 7], observation[i, newest + 8] = row.fraction[0], row.fraction[1]
        for j in range(newest, observation.shape[1]):
            value = observation[i, j] if observation[i, j] < LIMIT else LIMIT
            observation[i, j] = value if value > -LIMIT else -LIMIT

        one = cells[where[0], lane] * _TO_RPM
        two = cells[where[0], lane + half] * _TO_RPM
        aim = row.setpoint_before * _TO_RPM
        tracking = -weights[0] * 0.5 * (abs(one - aim) + abs(two - aim))
        difference, variation = -weights[1] * abs(one - two), -weights[2] * row.moved
        lost = cells[where[5], lane] > 0.0 or cells[where[5], lane + half] > 0.0
        true[i, 0], true[i, 1], true[i, 2], true[i, 3] = one, two, row.setpoint * _TO_RPM, one - two
        true[i, 4], true[i, 5] = row.fraction[0] * row.rated[0], row.fraction[1] * row.rated[1]
        true[i, 6] = (cells[where[1], lane] - cells[where[1], lane + half]) * _TO_DEG
        true[i, 7], true[i, 8], true[i, 9] = tracking, difference, variation
        beyond = abs(one - two) - weights[4]
        true[i, 10] = beyond if beyond > 0.0 else 0.0
        true[i, 11] = row.moved
        first = cells[where[6], lane] - 0.5 * abs(cells[where[4], lane])
        second = cells[where[6], lane + half] - 0.5 * abs(cells[where[4], lane + half])
        true[i, 12] = (first if first < second else second) * _TO_BAR
        peak = cells[where[7], lane] * _TO_RPM
        true[i, 13] = peak if peak > abs(one - two) and not lost else abs(one - two)
        reward[i] = tracking + difference + variation - (weights[3] if lost else 0.0)
        terminated[i] = lost
        truncated[i] = row.step >= row.last


@_threaded
def wind(rows, state, memory, angle, true):
    """Adds what the shafts of some rows have turned to `turned` and puts their angles, a row of the memory, to zero.

    A sum of seven digits would be degrees off after some thousand small steps. Corrects true (N, TRUE).
    """
    half = memory.shape[2] // 2
    for i in rows:
        row, block = state[i], i // half
        cells, lane = memory[block], i - block * half
        for c in range(2):
            row.turned[c] += cells[angle, lane + c * half]
            cells[angle, lane + c * half] = 0.0
        true[i, 6] = (row.turned[0] - row.turned[1]) * _TO_DEG
