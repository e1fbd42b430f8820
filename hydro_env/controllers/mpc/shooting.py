"""Improves a plan of commands by one step of Gauss and Newton (direct single shooting, compiled).

A plan holds the commands of the next few control periods. What comes of it is simulated elsewhere; how that changes
with the plan is taken from the linear parts of valve and motor. A cost is to become small that adds up

* the tracking errors at the control instants, squared up to about `CORNER`, in proportion beyond: as the mean absolute
  error counts them
* the speed differences squared, at the control instants and, lighter (`BETWEEN`), between them: left alone there, commands
  that swing to and fro keep the motors in step at every instant and end at the stops
* the moves of the commands squared
* how far the spools go beyond a margin before their stops, squared: after a blow against a stop the linear parts say
  nothing true any more

Every rig is worked on by itself, so that a row of a batch gets bit for bit what it would get alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.controllers.mpc.planner import CLOSED
from hydro_env.jit import compiled

__all__ = ["DAMPING", "HORIZON", "SAMPLES", "Best", "Course", "improve", "keep", "minimise_in_box"]

HORIZON, SAMPLES = 5, 10
"""Control periods that are planned, and samples of a period at which the planned motion is looked at."""
COMMANDS, END = 2 * HORIZON, HORIZON * SAMPLES
"""Commands of a plan, channel by channel, and its last sample. (Known to the compiler, which unrolls loops over them.)"""
CORNER = 2.0
"""Tracking error from which on its cost grows no faster than in proportion, rad/s: 20 rpm."""
BETWEEN = 100.0
"""Weight of a squared speed difference between the control instants; set by hand."""
DAMPING = 1.0
"""Least weight of the squared change of the plan, which keeps it where nothing else says what is better."""
LONGEST = 60
"""Most changes of the set of commands at their limits: six times as many as there are commands. (Clamping the commands at
their limits instead, as the planner does, leaves the oracle 5.4 rpm of peak difference in `setpoint_steps` instead of 1.1.)"""


class Course(NamedTuple):
    """What plans of N rigs are to do, over H = HORIZON periods of SAMPLES samples.

    sent (N, 2): the command in force; setpoint (N, H + 1) in rad/s at the control instants; most (N, 2): largest command;
    margin (N, 2): travel of the spools in m from which on it costs; travel (N, 2, END + 1): a spool's travel in m after a
    command of 1 over the first period; motor (N, 2, 2, 3): pressure and speed after a sample from those before it and the
    mean travel. difference, smooth, stops (N,): weights of speed differences, moves, and travel in mm beyond the margin.
    """

    sent: Floats
    setpoint: Floats
    most: Floats
    margin: Floats
    travel: Floats
    motor: Floats
    difference: Floats
    smooth: Floats
    stops: Floats

    def of(self, rows: np.ndarray) -> Course:
        """That of some rigs."""
        return Course(*(np.ascontiguousarray(each[rows]) for each in self))


class Best(NamedTuple):
    """The best plans (N, H, 2) so far, their costs (N,), the motion (3, END + 1, N, 2) they lead to (speed, flow, spool),
    and the damping (N,): weight of the squared change of the plan."""

    plan: Floats
    cost: Floats
    motion: Floats
    damping: Floats


@compiled
def minimise_in_box(square, slope, low, high, x):
    """Moves x (n,) from a feasible start to the minimum of x'square x / 2 + slope'x with low <= x <= high.

    Primal active-set method (Nocedal and Wright, Numerical Optimization, 16.5) with a Cholesky factor of the free part;
    `square` (n, n) has to be positive definite.
    """
    n = slope.size
    side = np.zeros(n, np.int64)  # -1: held at low, 1: at high, 0: free
    rate = slope + 0.0
    _gradient(square, slope, x, rate)
    for j in range(n):
        if x[j] <= low[j] and rate[j] > 0.0:
            side[j] = -1
        elif x[j] >= high[j] and rate[j] < 0.0:
            side[j] = 1
    free = np.empty(n, np.int64)
    factor = np.empty((n, n))
    move = np.empty(n)
    for _ in range(LONGEST):
        count = _newton_step(square, rate, side, free, factor, move)
        share, blocking = 1.0, -1
        for a in range(count):
            j = free[a]
            if x[j] + move[a] > high[j]:
                limit = (high[j] - x[j]) / move[a]
            elif x[j] + move[a] < low[j]:
                limit = (low[j] - x[j]) / move[a]
            else:
                continue
            if limit < share:
                share, blocking = limit, a
        for a in range(count):
            x[free[a]] += share * move[a]
        _gradient(square, slope, x, rate)
        if blocking >= 0:
            j = free[blocking]
            side[j] = 1 if move[blocking] > 0.0 else -1
            x[j] = high[j] if side[j] > 0 else low[j]
            continue
        worst, released = 1e-9, -1
        for j in range(n):
            if side[j] * rate[j] > worst:
                worst, released = side[j] * rate[j], j
        if released < 0:
            return
        side[released] = 0


@compiled
def _gradient(square, slope, x, rate):
    for j in range(slope.size):
        rate[j] = slope[j]
        for i in range(slope.size):
            rate[j] += square[j, i] * x[i]


@compiled
def _newton_step(square, rate, side, free, factor, move):
    """The indices `free`, how many they are, and their move to the minimum with the others held."""
    count = 0
    for j in range(side.size):
        if side[j] == 0:
            free[count] = j
            count += 1
    for a in range(count):
        for b in range(a + 1):
            rest = square[free[a], free[b]]
            for c in range(b):
                rest -= factor[a, c] * factor[b, c]
            factor[a, b] = np.sqrt(rest) if a == b else rest / factor[b, b]
        rest = -rate[free[a]]
        for c in range(a):
            rest -= factor[a, c] * move[c]
        move[a] = rest / factor[a, a]
    for a in range(count - 1, -1, -1):
        rest = move[a]
        for c in range(a + 1, count):
            rest -= factor[c, a] * move[c]
        move[a] = rest / factor[a, a]
    return count


@compiled
def _cost(plan, motion, course):
    """The cost (N,) of plans (N, H, 2), from the motion they lead to."""
    speed, spool = motion[0], motion[2]
    total = np.zeros(plan.shape[0])
    for s in range(1, END + 1):
        instant = s % SAMPLES == 0
        for i in range(plan.shape[0]):
            apart = speed[s, i, 0] - speed[s, i, 1]
            total[i] += 0.5 * (course.difference[i] if instant else BETWEEN) * apart * apart
            for c in range(2):
                past = max(0.0, abs(spool[s, i, c]) - course.margin[i, c])
                total[i] += 0.5e6 * course.stops[i] * past * past
                if instant:
                    error = (speed[s, i, c] - course.setpoint[i, s // SAMPLES]) / CORNER
                    total[i] += CORNER * CORNER * (np.sqrt(1.0 + error * error) - 1.0)
    for i in range(plan.shape[0]):
        for c in range(2):
            for j in range(HORIZON):
                move = plan[i, j, c] - (course.sent[i, c] if j == 0 else plan[i, j - 1, c])
                total[i] += 0.5 * course.smooth[i] * move * move
    return total


@compiled
def keep(plan, free, motion, course, best):
    """Keeps the plans (N, H, 2) that cost less than the best yet, or all where `free`, with the motion they lead to. The damping
    gets less where a plan was kept and more where not."""
    reached = _cost(plan, motion, course)
    better = (reached < best.cost) | free
    for i in range(plan.shape[0]):
        if better[i]:
            best.damping[i] = max(DAMPING, best.damping[i] / 4.0)
            best.cost[i] = reached[i]
            for j in range(HORIZON):
                best.plan[i, j, 0], best.plan[i, j, 1] = plan[i, j, 0], plan[i, j, 1]
        else:
            best.damping[i] *= 8.0
    for signal in range(motion.shape[0]):
        for s in range(motion.shape[1]):
            for i in range(plan.shape[0]):
                if better[i]:
                    for c in range(2):
                        best.motion[signal, s, i, c] = motion[signal, s, i, c]


@compiled
def improve(plan, course, best):
    """Improves the best plans, in `plan` (N, HORIZON, 2), fractions of the rated command."""
    turned = np.zeros((END + 1, COMMANDS))
    square, slope = np.empty((COMMANDS, COMMANDS)), np.empty(COMMANDS)
    x, low, high = np.empty(COMMANDS), np.empty(COMMANDS), np.empty(COMMANDS)
    for i in range(plan.shape[0]):
        _sensitivity(i, best.motion[1], course, turned)
        square[:] = 0.0
        slope[:] = 0.0
        _add_motion(i, best.motion, course, turned, square, slope)
        for c in range(2):
            for j in range(HORIZON):
                b = c * HORIZON + j
                _add_move(plan, i, j, c, best.damping[i], course, square, slope)
                x[b] = 0.0
                low[b] = min(0.0, -course.most[i, c] - plan[i, j, c])
                high[b] = max(0.0, course.most[i, c] - plan[i, j, c])
        minimise_in_box(square, slope, low, high, x)
        for b in range(COMMANDS):
            plan[i, b % HORIZON, b // HORIZON] += x[b]


@compiled
def _sensitivity(i, flow, course, turned):
    """How speeds at every sample change with each command, `turned` (END + 1, COMMANDS): the spool's travel, where the valve is
    open, is integrated. Sample by sample, so that no command waits for another one's chain of sums."""
    pressed, before = np.zeros(COMMANDS), np.zeros(COMMANDS)
    for s in range(1, END + 1):
        begun = (s - 1) // SAMPLES + 1  # commands that have begun to act
        for c in range(2):
            travel, motor, closed = course.travel[i, c], course.motor[i, c], flow[s, i, c] == 0.0
            for j in range(begun):
                b = c * HORIZON + j
                now = travel[s - j * SAMPLES]
                if closed:
                    now *= CLOSED
                mean, before[b] = 0.5 * (before[b] + now), now
                was, speed = pressed[b], turned[s - 1, b]
                pressed[b] = motor[0, 0] * was + motor[0, 1] * speed + motor[0, 2] * mean
                turned[s, b] = motor[1, 0] * was + motor[1, 1] * speed + motor[1, 2] * mean


@compiled
def _add_motion(i, motion, course, turned, square, slope):
    """Adds travel beyond the margin, tracking errors and speed differences at all samples to the normal equations; `turned`
    (END + 1, COMMANDS): how speeds change with each command."""
    speed, spool, apart_by = motion[0], motion[2], np.empty(COMMANDS)
    setpoint, difference, stops = course.setpoint[i], course.difference[i], 1e6 * course.stops[i]
    for s in range(1, END + 1):
        begun = (s - 1) // SAMPLES + 1  # commands that have begun to act
        instant = s % SAMPLES == 0
        for c in range(2):
            base = c * HORIZON
            past = abs(spool[s, i, c]) - course.margin[i, c]
            if past > 0.0:
                sign = 1.0 if spool[s, i, c] > 0.0 else -1.0
                for j in range(begun):
                    a = stops * course.travel[i, c, s - j * SAMPLES]
                    slope[base + j] += a * sign * past
                    for k in range(begun):
                        square[base + j, base + k] += a * course.travel[i, c, s - k * SAMPLES]
            if instant:
                error = speed[s, i, c] - setpoint[s // SAMPLES]
                weight = 1.0 / np.sqrt(1.0 + (error / CORNER) ** 2)
                for j in range(begun):
                    a = weight * turned[s, base + j]
                    slope[base + j] += a * error
                    for k in range(begun):
                        square[base + j, base + k] += a * turned[s, base + k]
        apart = speed[s, i, 0] - speed[s, i, 1]
        weight = difference if instant else BETWEEN
        for j in range(HORIZON):
            apart_by[j], apart_by[HORIZON + j] = turned[s, j], -turned[s, HORIZON + j]
        for b in range(COMMANDS):
            a = weight * apart_by[b]
            slope[b] += a * apart
            for k in range(COMMANDS):
                square[b, k] += a * apart_by[k]


@compiled
def _add_move(plan, i, j, c, damping, course, square, slope):
    """Adds the move of a command, and its change, to the normal equations."""
    b, smooth = c * HORIZON + j, course.smooth[i]
    square[b, b] += damping + smooth
    move = plan[i, j, c] - (course.sent[i, c] if j == 0 else plan[i, j - 1, c])
    slope[b] += smooth * move
    if j > 0:
        slope[b - 1] -= smooth * move
        square[b - 1, b - 1] += smooth
        square[b, b - 1] -= smooth
        square[b - 1, b] -= smooth
