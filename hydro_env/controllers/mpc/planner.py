"""Plans the next commands of a pair of valves so that both motors keep together, on a model of spools, valves and motors.

A plan holds the commands of the next few control periods. The model of a channel is small: a coil that lags by `COIL`, a
spool with mass, spring and Coulomb friction between stops, a valve with a dead zone and one gain, a motor that follows its
flow by (1) and (2). Positions and commands are shares of the rated command, flows of the rated flow. A plan is improved by
steps of Gauss and Newton on a cost that adds up

* the speed differences at the control instants squared, beyond `corner` more than squared
* how far the mean of both speeds is from its aim, squared
* the moves of the commands squared
* what is left of the spool's swing about the last command, squared

so that a spool that has the longer way to its edge sets out first, and one that would ring is caught in time. Each rig is
worked on by itself: a row of a batch gets bit for bit what it would get alone.
"""

from __future__ import annotations

from math import exp
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.jit import compiled
from hydro_env.units import RPM

__all__ = [
    "COIL",
    "Response",
    "Weights",
    "follow",
    "improve_plans",
    "lead_to",
    "responses",
    "throw_to",
    "wait_out",
]

Floats = NDArray[np.floating[Any]]

COIL = 1e-3
"""Time constant of the coil, s: inductance over resistance."""
PRESSURE = 5e-4
"""Time constant with which the pressure follows the valve's flow, s: compliance of the volume over leakage, V / (beta Km)."""
STOP = 1.16
"""Where the end stops of the nominal spool are."""
CLOSED = 0.3
"""What a closed valve is taken to react like, as a share of an open one: it may be open when the plan has changed."""
TRIES, SMALLER = 3, 0.35
"""How often a step is tried, and by how much smaller each time."""
STUCK, AWAY = 0.6, 10.0 * RPM
"""A plan that leaves this share of a larger distance from the aim begins once more with the plain way to the aim."""


class Weights(NamedTuple):
    """Of the difference, the distance from the aim, the moves, the swing at the end; `corner`: speed difference from which
    on its cost grows faster than its square, rad/s; `turns` of improvement."""

    apart: float
    aim: float
    moves: float
    swing: float
    corner: float
    turns: int


class Response(NamedTuple):
    """The modelled channel: substeps of `step` s, `steps` a period; spool and motor as in `follow`."""

    steps: int
    step: float
    rate: float
    decay: float
    grip: float
    held: float  # share of a change of command that the coil has yet to follow after a substep
    mean: float  # and on the mean of a substep
    per_speed: float
    per_torque: float
    per_acceleration: float
    fresh: float  # share of the flow at its end, not at its beginning, that turns the motor in a substep
    travel: NDArray[
        np.float64
    ]  # of a spool after a command of 1 that lasts a period, by substep: (horizon steps,)
    swing: NDArray[np.float64]  # its speed over `rate`


def responses(
    period: float,
    steps: int,
    horizon: int,
    rate: float,
    damping: float,
    friction: float,
    flow: tuple[float, float, float],
) -> Response:
    """The channel's model for a control period in s; `flow`: per speed, torque and acceleration (`flow_view.Motor`)."""
    step = period / steps
    held = exp(-step / COIL)
    mean = (1.0 - held) * COIL / step
    decay = exp(-2.0 * damping * rate * step)
    travel, swing = [], []
    position = speed = late = 0.0
    for substep in range(horizon * steps):
        command = 1.0 if substep < steps else 0.0
        position += 0.5 * step * speed
        speed = decay * speed + step * rate * rate * (command + mean * (late - command) - position)
        position += 0.5 * step * speed
        late = command + held * (late - command)
        travel.append(position)
        swing.append(speed / rate)
    grip = step * rate * rate * friction
    # the mean over a substep of a ramp from 0 to 1 that passes the pressure's lag
    fresh = 0.5 - PRESSURE / step * (1.0 - PRESSURE / step * (1.0 - exp(-step / PRESSURE)))
    return Response(
        steps, step, rate, decay, grip, held, mean, *flow, fresh, travel=np.array(travel), swing=np.array(swing),
    )  # fmt: skip


@compiled
def _substep(position, speed, late, command, r):
    """One substep of a spool: position, speed and the coil's command after it."""
    gap = late - command
    position += 0.5 * r.step * speed
    speed = r.decay * speed + r.step * r.rate * r.rate * (command + r.mean * gap - position)
    if speed > r.grip:
        speed -= r.grip
    elif speed < -r.grip:
        speed += r.grip
    else:
        speed = 0.0
    position += 0.5 * r.step * speed
    if position > STOP:
        position, speed = STOP, min(speed, 0.0)
    elif position < -STOP:
        position, speed = -STOP, max(speed, 0.0)
    return position, speed, command + r.held * gap


@compiled
def _valve(position, positive, negative, gain):
    """Flow, and whether the valve is open."""
    if position > positive:
        return gain * (position - positive), True
    if position < -negative:
        return gain * (position + negative), True
    return 0.0, False


@compiled
def follow(position, speed, late, ringing, bend, command, edge, gain, r):
    """Spools (N, 2) under held commands for a period, in place.

    `ringing`: squared amplitude of the swing about the command. `bend`: mean of the flow over the period less the mean of
    what it is at begin and end, which is what samples miss.
    """
    for i in range(position.shape[0]):
        for c in range(2):
            x, v, late_c, u = position[i, c], speed[i, c], late[i, c], command[i, c]
            flow, _ = _valve(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
            first, total = flow, 0.5 * flow
            for _ in range(r.steps):
                x, v, late_c = _substep(x, v, late_c, u, r)
                flow, _ = _valve(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
                total += flow
            bend[i, c] = (total - 0.5 * flow) / r.steps - 0.5 * (first + flow)
            position[i, c], speed[i, c], late[i, c] = x, v, late_c
            ringing[i, c] = (x - u) ** 2 + (v / r.rate) ** 2


@compiled
def lead_to(sent, rows, position, speed, late, goal, pace, r):
    """Commands `sent` (N, 2), in place, that bring the spools marked in `rows` (N, 2) to the positions `goal` (N, 2) with the
    speeds `pace` (N, 2) in two periods."""
    first, last = 2 * r.steps - 1, r.steps - 1
    a, b, c, d = r.travel[first], r.travel[last], r.swing[first], r.swing[last]
    span = a * d - b * c
    for i in range(sent.shape[0]):
        for k in range(2):
            if not rows[i, k]:
                continue
            now = then = goal[i, k]
            for _ in range(3):
                x, v, held = position[i, k], speed[i, k], late[i, k]
                for _ in range(r.steps):
                    x, v, held = _substep(x, v, held, now, r)
                for _ in range(r.steps):
                    x, v, held = _substep(x, v, held, then, r)
                off, slow = goal[i, k] - x, (pace[i, k] - v) / r.rate
                now += (d * off - b * slow) / span
                then += (a * slow - c * off) / span
            sent[i, k] = min(max(now, -1.0), 1.0)


@compiled
def throw_to(sent, rows, position, speed, late, goal, r):
    """Commands `sent` (N, 2), in place, after a period of which the spools marked in `rows` (N, 2) pass the positions `goal`
    (N, 2), at whatever speed."""
    slope = r.travel[r.steps - 1]
    for i in range(sent.shape[0]):
        for k in range(2):
            if not rows[i, k]:
                continue
            command = goal[i, k]
            for _ in range(3):
                x, v, held = position[i, k], speed[i, k], late[i, k]
                for _ in range(r.steps):
                    x, v, held = _substep(x, v, held, command, r)
                command += (goal[i, k] - x) / slope
            sent[i, k] = min(max(command, -1.0), 1.0)


@compiled
def wait_out(late, sent, place, motor, load, edge, gain, r):
    """Spools `place` (3, N, 2) and speeds `motor` (N, 2), in place, after the commands that are on their way: the `late` (N,)
    newest ones of `sent` (periods, N, 2), newest first."""
    push = r.step / r.per_acceleration
    for i in range(late.size):
        for c in range(2):
            x, v, held, speed = place[0, i, c], place[1, i, c], place[2, i, c], motor[i, c]
            drag = r.per_torque * load[i, c]
            before, _ = _valve(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
            for k in range(late[i] - 1, -1, -1):
                for _ in range(r.steps):
                    x, v, held = _substep(x, v, held, sent[k, i, c], r)
                    flow, _ = _valve(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
                    speed += push * (before + r.fresh * (flow - before) - r.per_speed * speed - drag)
                    before = flow
            place[0, i, c], place[1, i, c], place[2, i, c], motor[i, c] = x, v, held, speed


@compiled
def _drive(plan, place, motor, load, edge, gain, sent, aim, w, r, speeds, ends, opened):
    """The cost of a plan (2, H) of one rig. Fills `speeds` (2, H + 1), `ends` (2, 2) of the spools, `opened` (2, H steps).

    `place` (3, 2): position, speed and the coil's command of each spool; `motor` (2,): speeds; `aim` (H + 1,).
    """
    # Both spools in one loop: one's next step does not wait for the other's.
    horizon = plan.shape[1]
    push = r.step / r.per_acceleration
    x0, v0, late0, speed0, drag0 = place[0, 0], place[1, 0], place[2, 0], motor[0], r.per_torque * load[0]
    x1, v1, late1, speed1, drag1 = place[0, 1], place[1, 1], place[2, 1], motor[1], r.per_torque * load[1]
    before0, before1 = sent[0], sent[1]
    speeds[0, 0], speeds[1, 0] = speed0, speed1
    last0, _ = _valve(x0, edge[0, 0], edge[0, 1], gain[0])
    last1, _ = _valve(x1, edge[1, 0], edge[1, 1], gain[1])
    total = 0.0
    for k in range(horizon):
        command0, command1 = plan[0, k], plan[1, k]
        for s in range(r.steps):
            x0, v0, late0 = _substep(x0, v0, late0, command0, r)
            x1, v1, late1 = _substep(x1, v1, late1, command1, r)
            flow0, open0 = _valve(x0, edge[0, 0], edge[0, 1], gain[0])
            flow1, open1 = _valve(x1, edge[1, 0], edge[1, 1], gain[1])
            speed0 += push * (last0 + r.fresh * (flow0 - last0) - r.per_speed * speed0 - drag0)
            speed1 += push * (last1 + r.fresh * (flow1 - last1) - r.per_speed * speed1 - drag1)
            last0, last1 = flow0, flow1
            opened[0, k * r.steps + s] = 1.0 if open0 else CLOSED
            opened[1, k * r.steps + s] = 1.0 if open1 else CLOSED
        speeds[0, k + 1], speeds[1, k + 1] = speed0, speed1
        total += w.moves * ((command0 - before0) ** 2 + (command1 - before1) ** 2)
        before0, before1 = command0, command1
    ends[0, 0], ends[0, 1] = x0 - before0, v0 / r.rate
    ends[1, 0], ends[1, 1] = x1 - before1, v1 / r.rate
    total += w.swing * (ends[0, 0] ** 2 + ends[0, 1] ** 2 + ends[1, 0] ** 2 + ends[1, 1] ** 2)
    for k in range(1, horizon + 1):
        apart, off = speeds[0, k] - speeds[1, k], 0.5 * (speeds[0, k] + speeds[1, k]) - aim[k]
        square = apart * apart
        total += w.apart * square * (1.0 + 0.5 * square / (w.corner * w.corner)) + 2.0 * w.aim * off * off
    return total


@compiled
def _normal(plan, gain, sent, aim, w, r, speeds, ends, opened, turned, risen, change, square, slope):
    """The cost's slope (2 H,) and the matrix (2 H, 2 H) of Gauss and Newton, each halved."""
    horizon = plan.shape[1]
    square[:] = 0.0
    slope[:] = 0.0
    push = r.step / r.per_acceleration
    keep = 1.0 - push * r.per_speed
    for c in range(2):
        turned[:] = 0.0
        risen[:] = 0.0
        for k in range(horizon):
            for s in range(r.steps):
                rise = push * gain[c] * opened[c, k * r.steps + s]
                for j in range(k + 1):
                    now = rise * r.travel[(k - j) * r.steps + s]
                    turned[j] = keep * turned[j] + risen[j] + r.fresh * (now - risen[j])
                    risen[j] = now
            for j in range(k + 1):
                change[c, j, k + 1] = turned[j]
    for k in range(1, horizon + 1):
        apart, off = speeds[0, k] - speeds[1, k], 0.5 * (speeds[0, k] + speeds[1, k]) - aim[k]
        weight = w.apart * (1.0 + apart * apart / (w.corner * w.corner))
        for c in range(2):
            sign = 1.0 - 2.0 * c
            for j in range(k):
                a = change[c, j, k]
                slope[c * horizon + j] += (weight * apart * sign + w.aim * off) * a
                for d in range(2):
                    both = weight if d == c else -weight
                    for i in range(k):
                        square[c * horizon + j, d * horizon + i] += (both + 0.5 * w.aim) * a * change[d, i, k]
    for c in range(2):
        for j in range(horizon):
            at = c * horizon + j
            move = plan[c, j] - (sent[c] if j == 0 else plan[c, j - 1])
            square[at, at] += w.moves
            slope[at] += w.moves * move
            if j > 0:
                square[at - 1, at - 1] += w.moves
                square[at, at - 1] -= w.moves
                square[at - 1, at] -= w.moves
                slope[at - 1] -= w.moves * move
            last = (horizon - j) * r.steps - 1
            x, v = r.travel[last] - (1.0 if j == horizon - 1 else 0.0), r.swing[last]
            slope[at] += w.swing * (ends[c, 0] * x + ends[c, 1] * v)
            for i in range(horizon):
                last = (horizon - i) * r.steps - 1
                y = r.travel[last] - (1.0 if i == horizon - 1 else 0.0)
                square[at, c * horizon + i] += w.swing * (x * y + v * r.swing[last])


@compiled
def _solve(square, slope, move):
    """move = -square^-1 slope, by Cholesky in place."""
    n = slope.size
    for p in range(n):
        for q in range(p + 1):
            rest = square[p, q]
            for m in range(q):
                rest -= square[p, m] * square[q, m]
            square[p, q] = np.sqrt(max(rest, 1e-12)) if p == q else rest / square[q, q]
    for p in range(n):
        rest = -slope[p]
        for m in range(p):
            rest -= square[p, m] * move[m]
        move[p] = rest / square[p, p]
    for p in range(n - 1, -1, -1):
        rest = move[p]
        for m in range(p + 1, n):
            rest -= square[m, p] * move[m]
        move[p] = rest / square[p, p]


@compiled
def improve_plans(plans, plain, rows, place, motor, load, edge, gain, sent, aim, dearer, w, r):
    """Improves the plans (N, 2, H) of the rigs `rows`, in place.

    plain (N, 2, H): another plan to begin with, where it is better. place (3, N, 2): positions, speeds and coils' commands of
    the spools. motor (N, 2): speeds in rad/s; load (N, 2) in N m; edge (N, 2, 2); gain, sent (N, 2), the last command; aim
    (N, H + 1) in rad/s at the control instants. dearer (N,): factors of the moves' weight. w: `Weights`, r: `Response`.
    """
    horizon = plans.shape[2]
    n = 2 * horizon
    speeds, ends, opened = np.empty((2, horizon + 1)), np.empty((2, 2)), np.empty((2, horizon * r.steps))
    change, turned, risen = np.empty((2, horizon, horizon + 1)), np.empty(horizon), np.empty(horizon)
    square, slope, move, tried = np.empty((n, n)), np.empty(n), np.empty(n), np.empty((2, horizon))
    for i in rows:
        plan, at = plans[i], place[:, i]
        own = Weights(w.apart, w.aim, w.moves * dearer[i], w.swing, w.corner, w.turns)
        given = (at, motor[i], load[i], edge[i], gain[i], sent[i], aim[i], own, r, speeds, ends, opened)
        other = _drive(plain[i], *given)
        cost = _drive(plan, *given)
        if other < cost:
            plan[:] = plain[i]
            cost = _drive(plan, *given)
        for attempt in range(2):
            if attempt == 1:
                cost = _drive(plan, *given)
            for _ in range(w.turns):
                _normal(
                    plan, gain[i], sent[i], aim[i], own, r, speeds, ends, opened, turned, risen, change, square, slope,
                )  # fmt: skip
                # a command at its limit that would go beyond stays there
                for c in range(2):
                    for j in range(horizon):
                        k = c * horizon + j
                        if plan[c, j] * slope[k] < 0.0 and abs(plan[c, j]) >= 1.0:
                            square[k, :] = 0.0
                            square[:, k] = 0.0
                            square[k, k], slope[k] = 1.0, 0.0
                _solve(square, slope, move)
                size, better = 1.0, False
                for _ in range(TRIES):
                    for c in range(2):
                        for j in range(horizon):
                            tried[c, j] = min(1.0, max(-1.0, plan[c, j] + size * move[c * horizon + j]))
                    reached = _drive(tried, *given)
                    if reached < cost:
                        better = True
                        break
                    size *= SMALLER
                if not better:
                    break
                cost = reached
                plan[:] = tried
            # out of standstill the way leads over a ridge: a plan that stays behind it begins once more beyond
            away = aim[i, horizon] - 0.5 * (motor[i, 0] + motor[i, 1])
            left = aim[i, horizon] - 0.5 * (speeds[0, horizon] + speeds[1, horizon])
            if attempt == 1 or abs(away) < AWAY or left * away < STUCK * away * away:
                break
            plan[:] = plain[i]
