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

import numpy as np

from hydro_env.jit import compiled

__all__ = ["DAMPING", "improve", "keep", "minimise_in_box"]

CORNER = 2.0
"""Tracking error from which on its cost grows no faster than in proportion, rad/s."""
BETWEEN = 100.0
"""Weight of a squared speed difference between the control instants."""
DAMPING = 1.0
"""Least weight of the squared change of the plan, which keeps it where nothing else says what is better."""
CLOSED = 0.3
"""What a closed valve is taken to react like, as a share of an open one: it may be open when the plan has changed."""
LONGEST = 60
"""Most changes of the set of commands at their limits."""


@compiled
def minimise_in_box(square, slope, low, high, x):
    """Moves x (n,) from a feasible start to the minimum of x'square x / 2 + slope'x with low <= x <= high.

    Primal active-set method (Nocedal and Wright, Numerical Optimization, 16.5) with a Cholesky factor of the free part;
    `square` (n, n) has to be positive definite.
    """
    n = slope.size
    side = np.zeros(n, np.int64)  # -1: held at low, 1: at high, 0: free
    rate = slope + 0.0
    for j in range(n):
        for i in range(n):
            rate[j] += square[j, i] * x[i]
    for j in range(n):
        if x[j] <= low[j] and rate[j] > 0.0:
            side[j] = -1
        elif x[j] >= high[j] and rate[j] < 0.0:
            side[j] = 1
    free = np.empty(n, np.int64)
    factor = np.empty((n, n))
    move = np.empty(n)
    for _ in range(LONGEST):
        count = 0
        for j in range(n):
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
        for j in range(n):
            rate[j] = slope[j]
            for i in range(n):
                rate[j] += square[j, i] * x[i]
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
def cost(plan, sent, setpoint, speed, spool, fine, margin, difference, smooth, stops):
    """The cost (N,) of plans (N, H, 2), from the motion they lead to; arguments as for `improve`."""
    total = np.zeros(plan.shape[0])
    for s in range(1, plan.shape[1] * fine + 1):
        instant = s % fine == 0
        for i in range(plan.shape[0]):
            apart = speed[s, i, 0] - speed[s, i, 1]
            total[i] += 0.5 * (difference[i] if instant else BETWEEN) * apart * apart
            for c in range(2):
                past = max(0.0, abs(spool[s, i, c]) - margin[i, c])
                total[i] += 0.5e6 * stops[i] * past * past
                if instant:
                    error = (speed[s, i, c] - setpoint[i, s // fine]) / CORNER
                    total[i] += CORNER * CORNER * (np.sqrt(1.0 + error * error) - 1.0)
    for i in range(plan.shape[0]):
        for c in range(2):
            for j in range(plan.shape[1]):
                move = plan[i, j, c] - (sent[i, c] if j == 0 else plan[i, j - 1, c])
                total[i] += 0.5 * smooth[i] * move * move
    return total


@compiled
def keep(
    plan, free, best, lowest, damping, kept, seen, sent, setpoint, fine, margin, difference, smooth, stops
):
    """Keeps the plans (N, H, 2) that cost less than the lowest yet (N,), or all where `free`, in `best`, `lowest` and
    `kept`, their motion, of which `seen` (3, H fine + 1, N, 2) has the new one: speed, flow, spool. The damping (N,) gets
    less where a plan was kept and more where not. The rest as for `improve`.
    """
    reached = cost(plan, sent, setpoint, seen[0], seen[2], fine, margin, difference, smooth, stops)
    better = (reached < lowest) | free
    for i in range(plan.shape[0]):
        if better[i]:
            damping[i] = max(DAMPING, damping[i] / 4.0)
            lowest[i] = reached[i]
            best[i] = plan[i]
        else:
            damping[i] *= 8.0
    for signal in range(seen.shape[0]):
        for s in range(seen.shape[1]):
            for i in range(plan.shape[0]):
                if better[i]:
                    kept[signal, s, i, 0], kept[signal, s, i, 1] = (
                        seen[signal, s, i, 0],
                        seen[signal, s, i, 1],
                    )


@compiled
def improve(
    plan, damping, most, sent, setpoint, speed, flow, spool, travel, motor, fine, margin, difference, smooth, stops,
):  # fmt: skip
    """Improves plans (N, H, 2), fractions of the rated command, in place.

    damping (N,): weight of the squared change of the plan. most (N, 2): largest command; sent (N, 2): the command in
    force; setpoint (N, H + 1) in rad/s at the control instants. speed, flow, spool (H fine + 1, N, 2): what the plans
    lead to, `fine` samples a period; travel (N, 2, H fine + 1): a spool's travel in m after a command of 1 over the first
    period; motor (N, 2, 2, 3): pressure and speed after a sample from those before it and the mean travel; margin (N, 2)
    in m. difference, smooth, stops (N,): weights of speed differences, moves, and travel in mm beyond the margin.
    """
    horizon = plan.shape[1]
    samples = horizon * fine
    n = 2 * horizon
    change, apart_by = np.empty((2, horizon, samples + 1)), np.zeros((samples + 1, n))
    square, slope = np.empty((n, n)), np.empty(n)
    x, low, high = np.empty(n), np.empty(n), np.empty(n)
    for i in range(plan.shape[0]):
        # How speeds change with each command of the plan: the spool's travel, where the valve is open, is integrated.
        for c in range(2):
            for j in range(horizon):
                pressed, turned, before = 0.0, 0.0, 0.0
                for s in range(j * fine + 1, samples + 1):
                    now = travel[i, c, s - j * fine]
                    if flow[s, i, c] == 0.0:
                        now *= CLOSED
                    mean, before = 0.5 * (before + now), now
                    was = pressed
                    pressed = motor[i, c, 0, 0] * was + motor[i, c, 0, 1] * turned + motor[i, c, 0, 2] * mean
                    turned = motor[i, c, 1, 0] * was + motor[i, c, 1, 1] * turned + motor[i, c, 1, 2] * mean
                    change[c, j, s] = turned
                    apart_by[s, c * horizon + j] = turned if c == 0 else -turned
        square[:] = 0.0
        slope[:] = 0.0
        for s in range(1, samples + 1):
            top = (s - 1) // fine + 1  # commands that have begun to act
            instant = s % fine == 0
            for c in range(2):
                base = c * horizon
                past = abs(spool[s, i, c]) - margin[i, c]
                if past > 0.0:
                    sign = 1.0 if spool[s, i, c] > 0.0 else -1.0
                    for j in range(top):
                        a = 1e6 * stops[i] * travel[i, c, s - j * fine]
                        slope[base + j] += a * sign * past
                        for k in range(top):
                            square[base + j, base + k] += a * travel[i, c, s - k * fine]
                if instant:
                    error = speed[s, i, c] - setpoint[i, s // fine]
                    weight = 1.0 / np.sqrt(1.0 + (error / CORNER) ** 2)
                    for j in range(top):
                        a = weight * change[c, j, s]
                        slope[base + j] += a * error
                        for k in range(top):
                            square[base + j, base + k] += a * change[c, k, s]
            apart = speed[s, i, 0] - speed[s, i, 1]
            weight = difference[i] if instant else BETWEEN
            for c in range(2):
                for b in range(c * horizon, c * horizon + top):
                    a = weight * apart_by[s, b]
                    slope[b] += a * apart
                    for k in range(n):
                        square[b, k] += a * apart_by[s, k]
        for c in range(2):
            for j in range(horizon):
                b = c * horizon + j
                square[b, b] += damping[i] + smooth[i]
                move = plan[i, j, c] - (sent[i, c] if j == 0 else plan[i, j - 1, c])
                slope[b] += smooth[i] * move
                if j > 0:
                    slope[b - 1] -= smooth[i] * move
                    square[b - 1, b - 1] += smooth[i]
                    square[b, b - 1] -= smooth[i]
                    square[b - 1, b] -= smooth[i]
                x[b] = 0.0
                low[b] = min(0.0, -most[i, c] - plan[i, j, c])
                high[b] = max(0.0, most[i, c] - plan[i, j, c])
        minimise_in_box(square, slope, low, high, x)
        for b in range(n):
            plan[i, b % horizon, b // horizon] += x[b]
