"""Improves plans of commands by one step of Gauss and Newton (direct single shooting).

A plan holds the commands of the next few control periods. What comes of it is simulated elsewhere; how that changes
with the plan is taken from the linear parts of valve and motor. A cost is to become small that adds up

* the tracking errors at the control instants, squared up to about `HUBER`, in proportion beyond: as the mean absolute
  error counts them
* the speed differences squared, at the control instants and, lighter (`BETWEEN`), between them: left alone there, commands
  that swing to and fro keep the motors in step at every instant and end at the stops
* the moves of the commands squared
* how far the spools go beyond a margin before their stops, squared: after a blow against a stop the linear parts say
  nothing true any more

A row of a batch gets bit for bit what it would get alone.
"""

from typing import NamedTuple

import numpy as np

from hydro_env.arrays import Floats, Integers
from hydro_env.controllers.mpc.planner import CLOSED, solve_positive_definite
from hydro_env.jit import compiled

#: Control periods that are planned, and samples of a period at which the planned motion is looked at.
HORIZON, SAMPLES = 5, 10
#: Last sample of a plan.
END = HORIZON * SAMPLES
#: Tracking error from which on its cost grows no faster than in proportion, rad/s: 20 rpm, on a rig with the paper's speeds.
HUBER = 2.0
#: Every how many samples a speed difference counts between the control instants, and the weight of its square; set by hand.
EVERY, BETWEEN = 2, 200.0
#: Least weight of the squared change of the plan, which keeps it where nothing else says what is better.
MIN_DAMPING = 1.0
#: Most changes of the set of commands at their limits: six times as many as there are commands.
MAX_CHANGES = 60

#: The control instants among the samples, ...
_INSTANTS = slice(SAMPLES, None, SAMPLES)
#: ... and the samples at which speeds are compared.
_COMPARED = slice(EVERY, None, EVERY)


class Task(NamedTuple):
    """What plans of N rigs are to do, over H = HORIZON periods of SAMPLES samples.

    sent (N, 2): the command in force; setpoint (N, H + 1) in rad/s at the control instants; most (N, 2): largest command;
    margin (N, 2): travel of the spools in m from which on it costs; travel (N, 2, END + 1): a spool's travel in m after a
    command of 1 over the first period; motor (N, 2, 2, 3): pressure and speed after a sample from those before it and the
    mean travel. difference, smooth, stops (N,): weights of speed differences, moves, and travel in mm beyond the margin.
    huber_scale (N,): `HUBER` of the rig.
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
    huber_scale: Floats

    def of(self, rows: Integers) -> "Task":
        """That of some rigs."""
        return Task(*(each[rows] for each in self))


def cost(plan: Floats, motion: Floats, task: Task) -> Floats:
    """The cost (N,) of plans (N, H, 2), fractions of the rated command, from the motion (3, END + 1, N, 2) they lead to: speed
    (rad/s), flow, spool (m)."""
    beyond, tracking, apart, weight = _errors(motion, task)
    moves = np.diff(plan, axis=1, prepend=task.sent[:, None])
    total = 0.5e6 * task.stops * _sums(beyond**2)
    huber_scale = task.huber_scale[:, None, None]
    total += task.huber_scale**2 * _sums(np.sqrt(1.0 + (tracking / huber_scale) ** 2) - 1.0)
    total += 0.5 * _sums(weight * apart**2) + 0.5 * task.smooth * _sums(moves**2)
    return total


def improve(plan: Floats, motion: Floats, damping: Floats, task: Task) -> Floats:
    """Plans (N, H, 2) after a step of Gauss and Newton within the limits of the commands, `damping` (N,) being the weight of its
    square."""
    n = len(plan)
    travel, turned = _sensitivities(motion, task)
    beyond, tracking, apart, weight = _errors(motion, task)
    # Normal equations channel by channel, (N, 2, H, H), then those of the difference, which join the channels.
    square = np.zeros((n, 2, HORIZON, 2, HORIZON))
    slope = np.zeros((n, 2, HORIZON))
    stops = 1e6 * task.stops[:, None, None] * (beyond != 0.0)
    robust = 1.0 / np.sqrt(1.0 + (tracking / task.huber_scale[:, None, None]) ** 2)
    for errors, weights, changes in (
        (beyond, stops, travel[:, :, 1:]),
        (tracking, robust, turned[:, :, _INSTANTS]),
    ):
        for c in range(2):
            weighted = (weights[:, c, :, None] * changes[:, c]).transpose(0, 2, 1)
            square[:, c, :, c] += weighted @ changes[:, c]
            slope[:, c] += (weighted @ errors[:, c, :, None])[..., 0]
    change = np.concatenate([turned[:, 0, _COMPARED], -turned[:, 1, _COMPARED]], axis=-1)
    weighted = (weight[..., None] * change).transpose(0, 2, 1)
    square = square.reshape(n, 2 * HORIZON, 2 * HORIZON) + weighted @ change
    slope = slope.reshape(n, 2 * HORIZON) + (weighted @ apart[..., None])[..., 0]
    # The moves of the commands: second differences of the plan, channel by channel.
    moves = np.diff(plan, axis=1, prepend=task.sent[:, None])
    step = np.eye(HORIZON) - np.eye(HORIZON, k=-1)
    square += task.smooth[:, None, None] * np.kron(np.eye(2), step.T @ step)
    square += damping[:, None, None] * np.eye(2 * HORIZON)
    fall = np.concatenate([moves[:, 1:], np.zeros((n, 1, 2))], axis=1)
    slope += task.smooth[:, None] * _by_channel(moves - fall)
    start, most = _by_channel(plan), np.repeat(task.most, HORIZON, axis=1)
    change = np.zeros_like(slope)
    _minimise_all(square, slope, np.minimum(0.0, -most - start), np.maximum(0.0, most - start), change)
    return plan + change.reshape(n, 2, HORIZON).transpose(0, 2, 1)


def _by_channel(plan: Floats) -> Floats:
    """(N, H, 2) as (N, 2 H), the commands of the first channel first."""
    return plan.transpose(0, 2, 1).reshape(len(plan), -1)


def _sums(squares: Floats) -> Floats:
    return np.asarray(squares.reshape(len(squares), -1).sum(axis=1))


def _errors(motion: Floats, task: Task) -> tuple[Floats, Floats, Floats, Floats]:
    """Travel beyond the margin (N, 2, END), tracking errors at the control instants (N, 2, H), and speed differences with the
    weights of their squares (N, END / EVERY)."""
    speed, spool = (np.ascontiguousarray(motion[k].transpose(1, 2, 0)) for k in (0, 2))
    past = np.maximum(np.abs(spool[..., 1:]) - task.margin[..., None], 0.0)
    beyond = np.copysign(past, spool[..., 1:])
    tracking = speed[..., _INSTANTS] - task.setpoint[:, None, 1:]
    apart = np.ascontiguousarray(speed[:, 0, _COMPARED] - speed[:, 1, _COMPARED])
    weight = np.full_like(apart, BETWEEN)
    weight[:, SAMPLES // EVERY - 1 :: SAMPLES // EVERY] = task.difference[:, None]
    return beyond, tracking, apart, weight


def _sensitivities(motion: Floats, task: Task) -> tuple[Floats, Floats]:
    """How spool travel and speed change with each command, (N, 2, END + 1, H): the spool's travel, where the valve is open, is
    integrated."""
    n = len(task.travel)
    travel = np.zeros((n, 2, END + 1, HORIZON))
    for j in range(HORIZON):
        travel[:, :, j * SAMPLES :, j] = task.travel[:, :, : END + 1 - j * SAMPLES]
    flowing = np.where(motion[1].transpose(1, 2, 0) == 0.0, CLOSED, 1.0)
    opened = travel * flowing[..., None]
    turned = np.zeros_like(travel)
    _integrate(opened, task.motor, turned)
    return travel, turned


@compiled
def _integrate(opened, motor, turned):
    """Fills in the speeds `turned` (N, 2, END + 1, H) that follow from travels `opened` of the same shape."""
    for i in range(opened.shape[0]):
        for c in range(2):
            a, b = motor[i, c, 0], motor[i, c, 1]
            for j in range(HORIZON):
                pressure = speed = 0.0
                for s in range(j * SAMPLES, END):
                    driven = 0.5 * (opened[i, c, s, j] + opened[i, c, s + 1, j])
                    before = pressure
                    pressure = a[0] * before + a[1] * speed + a[2] * driven
                    speed = b[0] * before + b[1] * speed + b[2] * driven
                    turned[i, c, s + 1, j] = speed


@compiled
def _minimise_all(square, slope, low, high, x):
    for i in range(len(x)):
        minimise_in_box(square[i], slope[i], low[i], high[i], x[i])


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
    for _ in range(MAX_CHANGES):
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
        move[a] = -rate[free[a]]
        for b in range(a + 1):
            factor[a, b] = square[free[a], free[b]]
    solve_positive_definite(factor, move, count)
    return count
