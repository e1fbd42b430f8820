"""The planner's steps for many rigs: `improve_plans` with rigs side by side, so that a vector of the processor holds several.

Every rig gets bit for bit what it gets by itself: each operation is that of `planner_steps`, in the same order. Rigs that need
another try, or another step, are collected and laid side by side again, so that none waits for others. The loops over rigs
are innermost. Where they go over many signals, these lie in one array at distances that the compiler knows, without which it
would not use vectors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.spool import substep, valve_flow
from hydro_env.controllers.mpc.planner_steps import (
    AWAY,
    CLOSED,
    COMMANDS,
    HORIZON,
    SMALLER,
    STUCK,
    TRIES,
    copy_plan,
)
from hydro_env.jit import compiled

__all__ = ["LANES", "improve_together"]

LANES = 64
"""Rigs side by side. (With 32 LLVM unrolls the loops over them and finds no vectors in what is left.)"""
BOTH = 2 * LANES
"""Channels side by side: those of number 1, then those of number 2."""
# Where in `Tile.signals` each begins: the state of a channel in a plan, and what it moves under.
SPOOL, PACE, COIL, SPEED, FLOW = 0 * BOTH, 1 * BOTH, 2 * BOTH, 3 * BOTH, 4 * BOTH
COMMAND, POSITIVE, NEGATIVE, GAIN, DRAG = 5 * BOTH, 6 * BOTH, 7 * BOTH, 8 * BOTH, 9 * BOTH
TURNED, RISEN, PUSH = 10 * BOTH, 11 * BOTH, 12 * BOTH
SIGNALS = 13 * BOTH


class Tile(NamedTuple):
    """What `Scene` and `Work` hold of one rig, for LANES rigs, in the last axis; both channels of it where that is BOTH.

    rig (LANES,): which. begin (4, BOTH): spools, their speeds, coils, and speeds of the motors. moves (LANES,): weight of moves.
    plan, tried (H, BOTH). cost, reached (LANES,): of a plan before a step, and of the one that was looked at last.
    weight (LANES,): of the squared difference at an instant.
    """

    rig: NDArray[np.int64]
    signals: Floats
    begin: Floats
    sent: Floats
    aim: Floats
    moves: Floats
    plan: Floats
    tried: Floats
    speeds: Floats
    ends: Floats
    opened: Floats
    change: Floats
    square: Floats
    slope: Floats
    move: Floats
    weight: Floats
    cost: Floats
    reached: Floats


class Known(NamedTuple):
    """What is kept of every rig: cost (N,) and move (N, 2 H) of the present step, and `ended` (N,), the mean speed at the end of
    the plan that was looked at last."""

    cost: Floats
    move: Floats
    ended: Floats


@compiled
def _room(steps):
    """A `Tile` to be filled; `steps`: substeps of a period."""
    n, plan = LANES, (HORIZON, BOTH)
    return Tile(
        np.empty(n, np.int64), np.empty(SIGNALS), np.empty((4, BOTH)), np.empty(BOTH), np.empty((HORIZON + 1, n)), np.empty(n),
        np.empty(plan), np.empty(plan), np.empty((HORIZON + 1, BOTH)), np.empty((2, BOTH)), np.empty((HORIZON * steps, BOTH)),
        np.empty((HORIZON + 1, COMMANDS, n)), np.empty((COMMANDS, COMMANDS, n)), np.empty((COMMANDS, n)),
        np.empty((COMMANDS, n)), np.empty(n), np.empty(n), np.empty(n),
    )  # fmt: skip


@compiled
def _gather(rows, s, w, m, t):
    """Lays the first of `rows` side by side; where there are fewer the last one fills their lanes, too."""
    r = t.signals
    for lane in range(LANES):
        i = rows[min(lane, rows.size - 1)]
        t.rig[lane], t.moves[lane] = i, w.moves * s.heavier[i]
        for k in range(HORIZON + 1):
            t.aim[k, lane] = s.aim[i, k]
        for c in range(2):
            at = c * LANES + lane
            for k in range(3):
                t.begin[k, at] = s.place[k, i, c]
            t.begin[3, at], t.sent[at] = s.motor[i, c], s.sent[i, c]
            r[POSITIVE + at], r[NEGATIVE + at] = s.edge[i, c, 0], s.edge[i, c, 1]
            r[GAIN + at], r[DRAG + at] = s.gain[i, c], m.per_torque * s.load[i, c]


@compiled
def _costs(plan, w, m, t):
    """The costs `reached` of plans (H, BOTH); fills `speeds`, `ends` and `opened`."""
    r, push = t.signals, m.step / m.per_acceleration
    for lane in range(BOTH):
        r[SPOOL + lane], r[PACE + lane], r[COIL + lane] = t.begin[0, lane], t.begin[1, lane], t.begin[2, lane]
        r[SPEED + lane] = t.speeds[0, lane] = t.begin[3, lane]
        flow, _ = valve_flow(r[SPOOL + lane], r[POSITIVE + lane], r[NEGATIVE + lane], r[GAIN + lane])
        r[FLOW + lane] = flow
    t.reached[:] = 0.0
    for k in range(HORIZON):
        for lane in range(BOTH):
            r[COMMAND + lane] = plan[k, lane]
        for n in range(k * m.steps, (k + 1) * m.steps):
            for lane in range(BOTH):
                x, v, coil = substep(r[SPOOL + lane], r[PACE + lane], r[COIL + lane], r[COMMAND + lane], m)
                flow, is_open = valve_flow(x, r[POSITIVE + lane], r[NEGATIVE + lane], r[GAIN + lane])
                speed, last = r[SPEED + lane], r[FLOW + lane]
                r[SPEED + lane] = speed + push * (
                    last + m.fresh * (flow - last) - m.per_speed * speed - r[DRAG + lane]
                )
                r[SPOOL + lane], r[PACE + lane], r[COIL + lane], r[FLOW + lane] = x, v, coil, flow
                t.opened[n, lane] = 1.0 if is_open else CLOSED
        for lane in range(BOTH):
            t.speeds[k + 1, lane] = r[SPEED + lane]
        before = t.sent if k == 0 else plan[k - 1]
        for lane in range(LANES):
            first, second = plan[k, lane] - before[lane], plan[k, LANES + lane] - before[LANES + lane]
            t.reached[lane] += t.moves[lane] * (first**2 + second**2)
    for lane in range(BOTH):
        t.ends[0, lane], t.ends[1, lane] = r[SPOOL + lane] - r[COMMAND + lane], r[PACE + lane] / m.rate
    for lane in range(LANES):
        other = LANES + lane
        t.reached[lane] += w.swing * (
            t.ends[0, lane] ** 2 + t.ends[1, lane] ** 2 + t.ends[0, other] ** 2 + t.ends[1, other] ** 2
        )
    for k in range(1, HORIZON + 1):
        for lane in range(LANES):
            one, two = t.speeds[k, lane], t.speeds[k, LANES + lane]
            apart, off = one - two, 0.5 * (one + two) - t.aim[k, lane]
            square = apart * apart
            t.reached[lane] += (
                w.apart * square * (1.0 + 0.5 * square / (w.corner * w.corner)) + 2.0 * w.aim * off * off
            )


@compiled
def _sensitivity(m, t):
    """How speeds at the control instants change with each command, `change` (H + 1, 2 H, LANES)."""
    r, push = t.signals, m.step / m.per_acceleration
    keep, fresh = 1.0 - push * m.per_speed, m.fresh
    for lane in range(BOTH):
        r[PUSH + lane] = push * r[GAIN + lane]
    for j in range(HORIZON):
        for lane in range(BOTH):
            r[TURNED + lane] = r[RISEN + lane] = 0.0
        for k in range(j, HORIZON):
            for n in range(k * m.steps, (k + 1) * m.steps):
                travel = m.travel[n - j * m.steps]
                for lane in range(BOTH):
                    now, risen = r[PUSH + lane] * t.opened[n, lane] * travel, r[RISEN + lane]
                    r[TURNED + lane] = keep * r[TURNED + lane] + risen + fresh * (now - risen)
                    r[RISEN + lane] = now
            for lane in range(LANES):
                t.change[k + 1, j, lane] = r[TURNED + lane]
                t.change[k + 1, HORIZON + j, lane] = r[TURNED + LANES + lane]


@compiled
def _of_speeds(w, t):
    """The costs' halved slopes (2 H, LANES) and the lower triangles of the matrices of Gauss and Newton, as far as speeds at the
    control instants go."""
    t.square[:] = 0.0
    t.slope[:] = 0.0
    mean = 0.5 * w.aim
    for k in range(1, HORIZON + 1):
        for b in range(COMMANDS):
            c, j = b // HORIZON, b % HORIZON
            if j >= k:  # too late to act
                continue
            sign = 1.0 - 2.0 * c
            for lane in range(LANES):
                one, two = t.speeds[k, lane], t.speeds[k, LANES + lane]
                apart, off = one - two, 0.5 * (one + two) - t.aim[k, lane]
                weight = w.apart * (1.0 + apart * apart / (w.corner * w.corner))
                t.weight[lane] = weight
                t.slope[b, lane] += (weight * apart * sign + w.aim * off) * t.change[k, b, lane]
            for q in range(b + 1):
                if q % HORIZON >= k:
                    continue
                side = 1.0 if q // HORIZON == c else -1.0
                for lane in range(LANES):
                    both = (side * t.weight[lane] + mean) * t.change[k, b, lane]
                    t.square[b, q, lane] += both * t.change[k, q, lane]


@compiled
def _of_commands(swing, m, t):
    """Adds the moves of the commands, and the swing they leave."""
    square, slope, moves = t.square, t.slope, t.moves
    for at in range(COMMANDS):
        c, j = at // HORIZON, at % HORIZON
        channel, before = c * LANES, t.sent if j == 0 else t.plan[j - 1]
        last = (HORIZON - j) * m.steps - 1
        x, v = m.travel[last] - (1.0 if j == HORIZON - 1 else 0.0), m.swing[last]
        for lane in range(LANES):
            square[at, at, lane] += moves[lane]
        if j > 0:
            for lane in range(LANES):
                square[at - 1, at - 1, lane] += moves[lane]
                square[at, at - 1, lane] -= moves[lane]
        for lane in range(LANES):
            move = t.plan[j, channel + lane] - before[channel + lane]
            slope[at, lane] += moves[lane] * move
            slope[at, lane] += swing * (t.ends[0, channel + lane] * x + t.ends[1, channel + lane] * v)
            if j > 0:
                slope[at - 1, lane] -= moves[lane] * move
        for n in range(j + 1):
            last = (HORIZON - n) * m.steps - 1
            y = m.travel[last] - (1.0 if n == HORIZON - 1 else 0.0)
            more = swing * (x * y + v * m.swing[last])
            for lane in range(LANES):
                square[at, c * HORIZON + n, lane] += more


@compiled
def _hold(t):
    """A command at its limit that would go beyond stays there."""
    for j in range(HORIZON):
        for at in range(BOTH):
            if abs(t.plan[j, at]) >= 1.0:
                k, lane = at // LANES * HORIZON + j, at % LANES
                if t.plan[j, at] * t.slope[k, lane] < 0.0:
                    for n in range(COMMANDS):
                        t.square[k, n, lane] = t.square[n, k, lane] = 0.0
                    t.square[k, k, lane], t.slope[k, lane] = 1.0, 0.0


@compiled
def _solve(square, slope, move):
    """move = -square^-1 slope, by Cholesky in place; of `square` (2 H, 2 H, LANES) the lower triangle is read."""
    for p in range(COMMANDS):
        for q in range(p + 1):
            for k in range(q):
                for lane in range(LANES):
                    square[p, q, lane] -= square[p, k, lane] * square[q, k, lane]
            for lane in range(LANES):
                if p == q:
                    square[p, q, lane] = np.sqrt(max(square[p, q, lane], 1e-12))
                else:
                    square[p, q, lane] /= square[q, q, lane]
    for p in range(COMMANDS):
        for lane in range(LANES):
            move[p, lane] = -slope[p, lane]
        for k in range(p):
            for lane in range(LANES):
                move[p, lane] -= square[p, k, lane] * move[k, lane]
        for lane in range(LANES):
            move[p, lane] /= square[p, p, lane]
    for p in range(COMMANDS - 1, -1, -1):
        for k in range(p + 1, COMMANDS):
            for lane in range(LANES):
                move[p, lane] -= square[k, p, lane] * move[k, lane]
        for lane in range(LANES):
            move[p, lane] /= square[p, p, lane]


@compiled
def _lay(source, t, plan):
    """Lays plans (N, 2, H) of the tile's rigs side by side, (H, BOTH)."""
    for lane in range(LANES):
        i = t.rig[lane]
        for k in range(HORIZON):
            plan[k, lane], plan[k, LANES + lane] = source[i, 0, k], source[i, 1, k]


@compiled
def _note_costs(t):
    for lane in range(LANES):  # for `[:] =` of an array Numba compiles texts of errors for seconds
        t.cost[lane] = t.reached[lane]


@compiled
def _begin(plans, plain, rows, s, w, m, t):
    """Begins with the plain plan where that is better."""
    for first in range(0, rows.size, LANES):
        _gather(rows[first:], s, w, m, t)
        _lay(plain, t, t.tried)
        _lay(plans, t, t.plan)
        _costs(t.tried, w, m, t)
        _note_costs(t)
        _costs(t.plan, w, m, t)
        for lane in range(min(LANES, rows.size - first)):
            if t.cost[lane] < t.reached[lane]:
                copy_plan(plain[t.rig[lane]], plans[t.rig[lane]])


@compiled
def _try(size, t):
    """Plans `tried`: moved by `size` of what was asked for."""
    for c in range(2):
        for j in range(HORIZON):
            for lane in range(LANES):
                moved = t.plan[j, c * LANES + lane] + size * t.move[c * HORIZON + j, lane]
                t.tried[j, c * LANES + lane] = min(1.0, max(-1.0, moved))


@compiled
def _step(plans, active, s, w, m, known, t):
    """One step of Gauss and Newton on the plans of the rigs `active`, shortened until it helps; the rigs that it did help."""
    left, count, size = active + 0, active.size, 1.0
    helped = np.zeros(plans.shape[0], np.bool_)
    for attempt in range(TRIES):
        still = 0
        for first in range(0, count, LANES):
            _gather(left[first:count], s, w, m, t)
            _lay(plans, t, t.plan)
            if attempt == 0:
                _costs(t.plan, w, m, t)
                _note_costs(t)
                _sensitivity(m, t)
                _of_speeds(w, t)
                _of_commands(w.swing, m, t)
                _hold(t)
                _solve(t.square, t.slope, t.move)
            else:
                _recall(known, t)
            _try(size, t)
            _costs(t.tried, w, m, t)
            for lane in range(min(LANES, count - first)):
                i = t.rig[lane]
                known.ended[i] = 0.5 * (t.speeds[HORIZON, lane] + t.speeds[HORIZON, LANES + lane])
                if t.reached[lane] < t.cost[lane]:
                    helped[i] = True
                    for j in range(HORIZON):
                        plans[i, 0, j], plans[i, 1, j] = t.tried[j, lane], t.tried[j, LANES + lane]
                else:
                    left[still], known.cost[i] = i, t.cost[lane]
                    still += 1
                    for k in range(COMMANDS):
                        known.move[i, k] = t.move[k, lane]
        count = still
        size *= SMALLER
    return _chosen(active, helped)


@compiled
def _recall(known, t):
    """Costs and moves of a step whose first try did not help."""
    for lane in range(LANES):
        i = t.rig[lane]
        t.cost[lane] = known.cost[i]
        for k in range(COMMANDS):
            t.move[k, lane] = known.move[i, k]


@compiled
def _chosen(rigs, marked):
    """Those of `rigs` that are marked (N,)."""
    found, count = np.empty(rigs.size, np.int64), 0
    for i in rigs:
        if marked[i]:
            found[count] = i
            count += 1
    return found[:count]


@compiled
def _behind(rows, s, ended):
    """Rigs whose plans stay behind the ridge over which the way out of standstill leads."""
    behind = np.zeros(ended.size, np.bool_)
    for i in rows:
        away = s.aim[i, HORIZON] - 0.5 * (s.motor[i, 0] + s.motor[i, 1])
        left = s.aim[i, HORIZON] - ended[i]
        behind[i] = not (abs(away) < AWAY or left * away < STUCK * away * away)
    return _chosen(rows, behind)


@compiled
def improve_together(plans, plain, rows, s, w, m):
    """`hydro_env.controllers.mpc.planner_steps.improve_plans`, with the same bits."""
    t, n = _room(m.steps), plans.shape[0]
    known = Known(np.empty(n), np.empty((n, COMMANDS)), np.empty(n))
    _begin(plans, plain, rows, s, w, m, t)
    going = rows
    for attempt in range(2):
        active = going
        for _ in range(w.turns):
            active = _step(plans, active, s, w, m, known, t)
            if active.size == 0:
                break
        if attempt == 1:
            break
        going = _behind(rows, s, known.ended)
        for i in going:
            copy_plan(plain[i], plans[i])
        if going.size == 0:
            break
