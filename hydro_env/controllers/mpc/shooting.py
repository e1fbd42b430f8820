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
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.mpc.planner import CLOSED
from hydro_env.jit import compiled

__all__ = ["DAMPING", "END", "HORIZON", "SAMPLES", "Best", "Course", "improve", "keep", "minimise_in_box"]

HORIZON, SAMPLES = 5, 10
"""Control periods that are planned, and samples of a period at which the planned motion is looked at."""
COMMANDS, END = 2 * HORIZON, HORIZON * SAMPLES
"""Commands of a plan, channel by channel, and its last sample. (Known to the compiler, which unrolls loops over them.)"""
LANES = 64
"""Rigs that are worked on side by side. (With 32 and less LLVM unrolls loops over them and finds no vectors in what is left.)"""
CORNER = 2.0
"""Tracking error from which on its cost grows no faster than in proportion, rad/s: 20 rpm."""
EVERY, BETWEEN = 2, 200.0
"""Every how many samples a speed difference counts between the control instants, and the weight of its square; set by hand. (The
bound is the same with every sample and half the weight, and takes 4 % more time.)"""
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


class Tile(NamedTuple):
    """Some plans and what they lead to, rigs in the last axis, so that a vector of the processor holds the same number of each.

    rig (LANES,): which rigs. travel (2, END + 1, LANES), motor, setpoint, margin, difference, smooth, stops, damping: as in
    `Course` and `Best`. plan (2, H + 1, LANES) begins with the command in force. At one sample: speed, open, spool (2, LANES),
    `open` is CLOSED where a valve is; how travel now and before, pressures and speeds change with each command, `risen`,
    `pressed`, `turned` (COMMANDS, LANES). square (COMMANDS, COMMANDS, LANES), of which the lower triangle is filled, and slope
    (COMMANDS, LANES): normal equations. To these are added errors (LANES,) that count by `weight` and change by `change`
    (COMMANDS, LANES) with the commands; `weighted`: weight times change of one command.
    """

    rig: NDArray[np.int64]
    travel: Floats
    motor: Floats
    setpoint: Floats
    margin: Floats
    difference: Floats
    smooth: Floats
    stops: Floats
    damping: Floats
    plan: Floats
    speed: Floats
    open: Floats
    spool: Floats
    risen: Floats
    pressed: Floats
    turned: Floats
    square: Floats
    slope: Floats
    error: Floats
    weight: Floats
    change: Floats
    weighted: Floats


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
def _cost(rigs, plan, motion, course):
    """The cost (n,) of the plans of some rigs (n,), from the motion (3, END + 1, n, 2) they lead to."""
    speed, spool = motion[0], motion[2]
    total = np.zeros(rigs.size)
    for s in range(1, END + 1):
        instant = s % SAMPLES == 0
        for n, i in enumerate(rigs):
            if s % EVERY == 0:
                apart = speed[s, n, 0] - speed[s, n, 1]
                total[n] += 0.5 * (course.difference[i] if instant else BETWEEN) * apart * apart
            for c in range(2):
                past = max(0.0, abs(spool[s, n, c]) - course.margin[i, c])
                total[n] += 0.5e6 * course.stops[i] * past * past
                if instant:
                    error = (speed[s, n, c] - course.setpoint[i, s // SAMPLES]) / CORNER
                    total[n] += CORNER * CORNER * (np.sqrt(1.0 + error * error) - 1.0)
    for n, i in enumerate(rigs):
        for c in range(2):
            for j in range(HORIZON):
                move = plan[i, j, c] - (course.sent[i, c] if j == 0 else plan[i, j - 1, c])
                total[n] += 0.5 * course.smooth[i] * move * move
    return total


@compiled
def keep(rigs, plan, free, motion, course, best):
    """Keeps the plans (N, H, 2) of `rigs` (n,) that cost less than the best yet, or all where `free`, with the motion
    (3, END + 1, n, 2) they lead to. The damping gets less where a plan was kept and more where not."""
    reached = _cost(rigs, plan, motion, course)
    better = (reached < best.cost[rigs]) | free
    for n, i in enumerate(rigs):
        if better[n]:
            best.damping[i] = max(DAMPING, best.damping[i] / 4.0)
            best.cost[i] = reached[n]
            for j in range(HORIZON):
                best.plan[i, j, 0], best.plan[i, j, 1] = plan[i, j, 0], plan[i, j, 1]
        else:
            best.damping[i] *= 8.0
    for signal in range(motion.shape[0]):
        for s in range(motion.shape[1]):
            for n, i in enumerate(rigs):
                if better[n]:
                    for c in range(2):
                        best.motion[signal, s, i, c] = motion[signal, s, n, c]


@compiled
def improve(rigs, plan, course, best):
    """Improves the best plans of `rigs` (n,), in `plan` (N, HORIZON, 2), fractions of the rated command; how far each moves (n,),
    its command that moves most."""
    tile, moved = _room(), np.zeros(rigs.size)
    square, slope = np.empty((COMMANDS, COMMANDS)), np.empty(COMMANDS)
    x, low, high = np.empty(COMMANDS), np.empty(COMMANDS), np.empty(COMMANDS)
    for first in range(0, rigs.size, LANES):
        _gather(rigs[first:], best, course, tile)
        # Sample by sample, so that no command waits for another one's chain of sums, and little memory is in use.
        for sample in range(1, END + 1):
            _look(sample, best.motion, tile)
            _turn(sample, tile)
            _add_motion(sample, tile)
        _add_moves(tile)
        for lane in range(min(LANES, rigs.size - first)):
            i = rigs[first + lane]
            for b in range(COMMANDS):
                slope[b] = tile.slope[b, lane]
                for k in range(b + 1):
                    square[b, k] = square[k, b] = tile.square[b, k, lane]
            for c in range(2):
                for j in range(HORIZON):
                    b = c * HORIZON + j
                    x[b] = 0.0
                    low[b] = min(0.0, -course.most[i, c] - best.plan[i, j, c])
                    high[b] = max(0.0, course.most[i, c] - best.plan[i, j, c])
            minimise_in_box(square, slope, low, high, x)
            for b in range(COMMANDS):
                plan[i, b % HORIZON, b // HORIZON] = best.plan[i, b % HORIZON, b // HORIZON] + x[b]
                moved[first + lane] = max(moved[first + lane], abs(x[b]))
    return moved


@compiled
def _room():
    """A `Tile` to be filled."""
    n, pair, commands = LANES, (2, LANES), (COMMANDS, LANES)
    return Tile(
        np.empty(n, np.int64), np.empty((2, END + 1, n)), np.empty((2, 2, 3, n)), np.empty((HORIZON + 1, n)), np.empty(pair),
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty((2, HORIZON + 1, n)),
        np.empty(pair), np.empty(pair), np.empty(pair), np.empty(commands), np.empty(commands), np.empty(commands),
        np.empty((COMMANDS, COMMANDS, n)), np.empty(commands), np.empty(n), np.empty(n), np.empty(commands), np.empty(n),
    )  # fmt: skip


@compiled
def _gather(rigs, best, course, tile):
    """Lays the first of `rigs` side by side; where there are fewer the last one fills their lanes, too."""
    for lane in range(LANES):
        tile.rig[lane] = rigs[min(lane, rigs.size - 1)]
    for lane in range(LANES):
        i = tile.rig[lane]
        tile.difference[lane], tile.smooth[lane] = course.difference[i], course.smooth[i]
        tile.stops[lane], tile.damping[lane] = 1e6 * course.stops[i], best.damping[i]
    for k in range(HORIZON + 1):
        for lane in range(LANES):
            tile.setpoint[k, lane] = course.setpoint[tile.rig[lane], k]
    for c in range(2):
        for lane in range(LANES):
            tile.margin[c, lane] = course.margin[tile.rig[lane], c]
            tile.plan[c, 0, lane] = course.sent[tile.rig[lane], c]
        for k in range(HORIZON):
            for lane in range(LANES):
                tile.plan[c, k + 1, lane] = best.plan[tile.rig[lane], k, c]
        for k in range(6):
            for lane in range(LANES):
                tile.motor[c, k // 3, k % 3, lane] = course.motor[tile.rig[lane], c, k // 3, k % 3]
        for s in range(END + 1):
            for lane in range(LANES):
                tile.travel[c, s, lane] = course.travel[tile.rig[lane], c, s]
    tile.risen[:] = 0.0
    tile.pressed[:] = 0.0
    tile.turned[:] = 0.0
    tile.square[:] = 0.0
    tile.slope[:] = 0.0


@compiled
def _look(s, motion, tile):
    """What the plans lead to at a sample."""
    for c in range(2):
        for lane in range(LANES):
            i = tile.rig[lane]
            tile.speed[c, lane] = motion[0, s, i, c]
            tile.open[c, lane] = CLOSED if motion[1, s, i, c] == 0.0 else 1.0
            tile.spool[c, lane] = motion[2, s, i, c]


@compiled
def _turn(s, tile):
    """How speeds change with each command, from the sample before to this one: the spool's travel, where the valve is open, is
    integrated."""
    for c in range(2):
        motor = tile.motor[c]
        for j in range((s - 1) // SAMPLES + 1):  # commands that have begun to act
            b = c * HORIZON + j
            for lane in range(LANES):
                now = tile.travel[c, s - j * SAMPLES, lane] * tile.open[c, lane]
                mean = 0.5 * (tile.risen[b, lane] + now)
                tile.risen[b, lane] = now
                was, speed = tile.pressed[b, lane], tile.turned[b, lane]
                tile.pressed[b, lane] = (
                    motor[0, 0, lane] * was + motor[0, 1, lane] * speed + motor[0, 2, lane] * mean
                )
                tile.turned[b, lane] = (
                    motor[1, 0, lane] * was + motor[1, 1, lane] * speed + motor[1, 2, lane] * mean
                )


@compiled
def _add_motion(s, tile):
    """Adds travel beyond the margin, tracking errors and the speed difference at a sample to the normal equations."""
    begun = (s - 1) // SAMPLES + 1  # commands that have begun to act
    for c in range(2):
        if _beyond(c, tile):
            for j in range(begun):
                for lane in range(LANES):
                    tile.change[c * HORIZON + j, lane] = tile.travel[c, s - j * SAMPLES, lane]
            _add_squares(c, c + 1, begun, tile)
        if s % SAMPLES == 0:
            for lane in range(LANES):
                error = tile.speed[c, lane] - tile.setpoint[s // SAMPLES, lane]
                tile.weight[lane] = 1.0 / np.sqrt(1.0 + (error / CORNER) ** 2)
                tile.error[lane] = error
            for j in range(begun):
                for lane in range(LANES):
                    tile.change[c * HORIZON + j, lane] = tile.turned[c * HORIZON + j, lane]
            _add_squares(c, c + 1, begun, tile)
    if s % EVERY != 0:
        return
    for lane in range(LANES):
        tile.weight[lane] = tile.difference[lane] if s % SAMPLES == 0 else BETWEEN
        tile.error[lane] = tile.speed[0, lane] - tile.speed[1, lane]
    for c in range(2):
        sign = 1.0 - 2.0 * c
        for j in range(begun):
            for lane in range(LANES):
                tile.change[c * HORIZON + j, lane] = sign * tile.turned[c * HORIZON + j, lane]
    _add_squares(0, 2, begun, tile)


@compiled
def _beyond(c, tile):
    """Whether a spool is beyond its margin, the weight where it is, and how far."""
    beyond = 0.0
    for lane in range(LANES):
        spool = tile.spool[c, lane]
        past = max(0.0, abs(spool) - tile.margin[c, lane])
        beyond = max(beyond, past)
        tile.weight[lane] = tile.stops[lane] if past > 0.0 else 0.0
        tile.error[lane] = past if spool > 0.0 else -past
    return beyond > 0.0


@compiled
def _add_squares(first, last, begun, tile):
    """Adds errors that count by `weight` and change by `change` with the commands of channels from `first` to before `last` to
    the normal equations."""
    for c in range(first, last):
        for j in range(begun):
            b = c * HORIZON + j
            for lane in range(LANES):
                a = tile.weight[lane] * tile.change[b, lane]
                tile.weighted[lane] = a
                tile.slope[b, lane] += a * tile.error[lane]
            for d in range(first, c + 1):
                for k in range(j + 1 if d == c else begun):
                    for lane in range(LANES):
                        tile.square[b, d * HORIZON + k, lane] += (
                            tile.weighted[lane] * tile.change[d * HORIZON + k, lane]
                        )


@compiled
def _add_moves(tile):
    """Adds the moves of the commands, and their changes, to the normal equations."""
    for c in range(2):
        for j in range(HORIZON):
            b = c * HORIZON + j
            for lane in range(LANES):
                smooth, move = tile.smooth[lane], tile.plan[c, j + 1, lane] - tile.plan[c, j, lane]
                tile.square[b, b, lane] += tile.damping[lane] + smooth
                tile.slope[b, lane] += smooth * move
            if j > 0:
                for lane in range(LANES):
                    smooth, move = tile.smooth[lane], tile.plan[c, j + 1, lane] - tile.plan[c, j, lane]
                    tile.slope[b - 1, lane] -= smooth * move
                    tile.square[b - 1, b - 1, lane] += smooth
                    tile.square[b, b - 1, lane] -= smooth
