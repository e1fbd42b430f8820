"""The receding-horizon planner: the next commands of both valves, so that the motors keep together.

A plan holds the commands of the next few control periods and is improved in every period, by steps of Gauss and Newton on
a model of spools, valves and motors (direct single shooting; Diehl et al., Real-time optimization, J. Process Control 12, 2002).
The motor follows its flow by (1) and (2). The cost adds up

* the speed differences at the control instants squared, beyond `soft_limit` more than squared
* how far the mean of both speeds is from its aim, squared
* the moves of the commands squared
* what is left of the spool's swing about the last command, squared

so that a spool that has the longer way to its edge sets out first, and one that would ring is caught in time. Each rig is
worked on by itself: a row of a batch gets bit for bit what it would get alone.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import HAND, TUNED, Bools, Floats
from hydro_env.controllers.estimation.spool import Channel, substep, valve_flow
from hydro_env.controllers.mpc.reference import ReferenceState
from hydro_env.jit import compiled
from hydro_env.units import RPM

#: Control periods that are planned: longer than the spool's period of 30 ms.
HORIZON = 4
#: Commands of a plan, channel by channel. (Known to the compiler, which unrolls loops over them.)
COMMANDS = 2 * HORIZON
#: What a closed valve is taken to react like, as a share of an open one: it may be open when the plan has changed.
CLOSED = 0.3
#: How often a step is tried, and by how much smaller each time.
TRIES, SMALLER = 3, 0.35
#: A plan that leaves this share of a larger distance from the aim is restarted from the plan of the feedback.
STUCK, AWAY = 0.6, 10.0 * RPM


class PlannerSettings(NamedTuple):
    """Weights beside a weight of 1 for the squared distance from the aim (rad/s)."""

    apart: Annotated[float, "1", "of the squared speed difference", TUNED] = 300.0
    moves: Annotated[float, "rad2/s2", "of the squared moves of a command", TUNED] = 650.0
    swing: Annotated[float, "rad2/s2", "of the squared swing at the end", TUNED] = 3000.0
    soft_limit: Annotated[
        float, "rad/s", "speed difference beyond which its cost grows faster than its square", TUNED
    ] = 14.0 * RPM
    turns: Annotated[int, "1", "steps of Gauss and Newton a period", HAND] = 3
    behind: Annotated[float, "periods", "how long after the reference the speeds are to follow", TUNED] = 1.95
    ahead: Annotated[float, "rad/s", "no farther are the speeds asked to move at once", TUNED] = 30.0 * RPM
    wrong: Annotated[float, "1", "mean square innovation that doubles the moves' weight", TUNED] = 2e-4
    memory: Annotated[float, "1", "share of a new square in that mean", TUNED] = 0.1
    worst: Annotated[float, "1", "most that one square counts", TUNED] = 0.02
    heaviest: Annotated[float, "1", "largest factor on the moves' weight", TUNED] = 6.0
    noisiest: Annotated[float, "1", "noise of a speed up to which commands are planned, of usual", TUNED] = 4.0  # fmt: skip


class Scene(NamedTuple):
    """What plans begin with: positions, speeds and coils' commands of the spools (3, N, 2); the motors' speeds (rad/s) and loads
    (N m), (N, 2); edges (N, 2, 2) and gains (N, 2) of the valves; the last command (N, 2); the aim at the control instants
    (N, H + 1), rad/s; factors on the moves' weight (N,)."""

    place: Floats
    motor: Floats
    load: Floats
    edge: Floats
    gain: Floats
    sent: Floats
    aim: Floats
    heavier: Floats


class Work(NamedTuple):
    """Memory for one rig: what a plan leads to (`speeds` (2, H + 1), `ends` of the spools (2, 2), `opened` (2, H steps)), how
    speeds change with it, `change` (H + 1, 2 H), which is zero where a command comes too late, and the normal equations."""

    speeds: Floats
    ends: Floats
    opened: Floats
    change: Floats
    square: Floats
    slope: Floats
    move: Floats
    tried: Floats

    @classmethod
    def of(cls, steps: int) -> "Work":
        empty = np.empty
        return cls(
            empty((2, HORIZON + 1)), empty((2, 2)), empty((2, HORIZON * steps)), np.zeros((HORIZON + 1, COMMANDS)),
            empty((COMMANDS, COMMANDS)), empty(COMMANDS), empty(COMMANDS), empty((2, HORIZON)),
        )  # fmt: skip


class Planner:
    """`plan` (num_rigs, 2, HORIZON): commands of the next periods. Only for the control period that it was tuned at."""

    def __init__(self, settings: PlannerSettings, sent: Floats, channel: Channel) -> None:
        """The command `sent` (num_rigs, 2) goes on at first."""
        self.settings, self._channel, self._work = settings, channel, Work.of(channel.steps)
        self.plan, self._mean = np.stack([sent] * HORIZON, axis=-1), np.zeros(len(sent))

    def step(self, planned: Bools, plain: Floats, scene: Scene) -> Floats:
        """Commands (num_rigs, 2) of the rigs that are `planned` (num_rigs,); `plain` (num_rigs, 2, HORIZON) is a plan to begin
        with where it is better than what is left of the last one, and what the others do."""
        self.plan[..., :-1] = self.plan[..., 1:].copy()
        self.plan[~planned] = plain[~planned, :, :1]
        rows = np.flatnonzero(planned)
        improve_plans(self.plan, plain, rows, scene, self.settings, self._channel, self._work)
        return np.where(planned[:, None], self.plan[..., 0], plain[..., 0])

    def move_weights(self, innovation: Floats, acceleration: Floats) -> Floats:
        """Factors on the moves' weight, (num_rigs,): moves cost more for pairs that limit-cycle, as friction unlike the
        model's makes them, while the
        reference is steady. `innovation` (num_rigs, 2) of the flow, in units of its usual noise's."""
        s = self.settings
        square = np.max(innovation**2, axis=1)
        self._mean += s.memory * (np.minimum(square, s.worst) - self._mean)
        steady = np.abs(acceleration) < 1.0
        return np.where(steady, np.minimum(1.0 + self._mean / s.wrong, s.heaviest), 1.0)

    def aim(self, reference: ReferenceState, motor: Floats, period: float) -> Floats:
        """Speeds to be at in the next control instants, (num_rigs, HORIZON + 1): the reference `behind` periods before.
        `motor` (num_rigs, 2): the speeds at which the plan begins."""
        s = self.settings
        aim = np.empty((len(motor), HORIZON + 1))
        for k in range(HORIZON + 1):
            back = s.behind - k
            if back >= 0.0:
                whole, part = int(back), back - int(back)
                aim[:, k] = (1.0 - part) * reference.history[whole] + part * reference.history[whole + 1]
            else:
                aim[:, k] = reference.speed - reference.acceleration * back * period
        off = aim[:, 0] - np.mean(motor, axis=1)
        return aim - (off - np.clip(off, -s.ahead, s.ahead))[:, None]


@compiled
def predict_delayed(late, sent, place, motor, load, edge, gain, m):
    """Spools `place` (3, N, 2) and speeds `motor` (N, 2), in place, after the commands that are on their way: the `late` (N,)
    newest ones of `sent` (periods, N, 2), newest first."""
    for i in range(late.size):
        for c in range(2):
            x, v, coil, speed = place[0, i, c], place[1, i, c], place[2, i, c], motor[i, c]
            valve, each, drag = edge[i, c], gain[i, c], m.per_torque * load[i, c]
            flow, _ = valve_flow(x, valve[0], valve[1], each)
            for k in range(late[i] - 1, -1, -1):
                for _ in range(m.steps):
                    x, v, coil, speed, flow, _ = _move(
                        x, v, coil, speed, flow, sent[k, i, c], valve, each, drag, m
                    )
            place[0, i, c], place[1, i, c], place[2, i, c], motor[i, c] = x, v, coil, speed


@compiled
def _move(x, v, coil, speed, flow, command, edge, gain, drag, m):
    """A channel after a substep: spool, coil, speed of the motor, flow, and whether the valve is open. `drag`: the flow that the
    load takes."""
    x, v, coil = substep(x, v, coil, command, m)
    after, opened = valve_flow(x, edge[0], edge[1], gain)
    push = m.step / m.per_acceleration
    speed += push * (flow + m.fresh * (after - flow) - m.per_speed * speed - drag)
    return x, v, coil, speed, after, 1.0 if opened else CLOSED


@compiled
def _begin(s, i, c, m):
    """A channel as a plan begins with it: spool, coil, speed of the motor, flow, and the flow that the load takes."""
    x, edge = s.place[0, i, c], s.edge[i, c]
    flow, _ = valve_flow(x, edge[0], edge[1], s.gain[i, c])
    return x, s.place[1, i, c], s.place[2, i, c], s.motor[i, c], flow, m.per_torque * s.load[i, c]


@compiled
def cost_of(plan, i, s, w, m, work):
    """The cost of a plan (2, H) of rig i; fills `speeds`, `ends` and `opened` of `work`."""
    # Both channels in one loop: one's next step does not wait for the other's.
    a, b, gain, opened = s.edge[i, 0], s.edge[i, 1], s.gain[i], work.opened
    x0, v0, coil0, speed0, flow0, drag0 = _begin(s, i, 0, m)
    x1, v1, coil1, speed1, flow1, drag1 = _begin(s, i, 1, m)
    work.speeds[0, 0], work.speeds[1, 0] = speed0, speed1
    total, weight = 0.0, w.moves * s.heavier[i]
    for k in range(HORIZON):
        for n in range(k * m.steps, (k + 1) * m.steps):
            x0, v0, coil0, speed0, flow0, open0 = _move(
                x0, v0, coil0, speed0, flow0, plan[0, k], a, gain[0], drag0, m
            )
            x1, v1, coil1, speed1, flow1, open1 = _move(
                x1, v1, coil1, speed1, flow1, plan[1, k], b, gain[1], drag1, m
            )
            opened[0, n], opened[1, n] = open0, open1
        work.speeds[0, k + 1], work.speeds[1, k + 1] = speed0, speed1
        moves = 0.0
        for c in range(2):
            moves += (plan[c, k] - (s.sent[i, c] if k == 0 else plan[c, k - 1])) ** 2
        total += weight * moves
    ends, last = work.ends, HORIZON - 1
    ends[0, 0], ends[0, 1] = x0 - plan[0, last], v0 / m.rate
    ends[1, 0], ends[1, 1] = x1 - plan[1, last], v1 / m.rate
    total += w.swing * (ends[0, 0] ** 2 + ends[0, 1] ** 2 + ends[1, 0] ** 2 + ends[1, 1] ** 2)
    for k in range(1, HORIZON + 1):
        one, two = work.speeds[0, k], work.speeds[1, k]
        apart, off = one - two, 0.5 * (one + two) - s.aim[i, k]
        square = apart * apart
        total += w.apart * square * (1.0 + 0.5 * square / (w.soft_limit * w.soft_limit)) + 2.0 * off * off
    return total


@compiled
def normal_equations(plan, i, s, w, m, work):
    """The cost's slope (2 H,) and the lower triangle of the matrix (2 H, 2 H) of Gauss and Newton, each halved, into `work`."""
    change, square, slope = work.change, work.square, work.slope
    square[:] = 0.0
    slope[:] = 0.0
    _sensitivity(s.gain[i], m, work)
    for k in range(1, HORIZON + 1):
        apart = work.speeds[0, k] - work.speeds[1, k]
        off = 0.5 * (work.speeds[0, k] + work.speeds[1, k]) - s.aim[i, k]
        weight = w.apart * (1.0 + apart * apart / (w.soft_limit * w.soft_limit))
        for c in range(2):
            sign = 1.0 - 2.0 * c
            for j in range(k):
                b, a = c * HORIZON + j, change[k, c * HORIZON + j]
                slope[b] += (weight * apart * sign + off) * a
                for d in range(c + 1):
                    both = ((weight if d == c else -weight) + 0.5) * a
                    for n in range(HORIZON):
                        square[b, d * HORIZON + n] += both * change[k, d * HORIZON + n]
    for c in range(2):
        _of_commands(plan, c, s.sent[i, c], w.moves * s.heavier[i], w.swing, m, work)


@compiled
def _sensitivity(gain, m, work):
    """How speeds at the control instants change with each command: the spool's travel, where the valve is open, integrated."""
    push, change, opened = m.step / m.per_acceleration, work.change, work.opened
    keep = 1.0 - push * m.per_speed
    # Both motors in one loop: one's next substep does not wait for the other's.
    for j in range(HORIZON):
        turned0 = turned1 = risen0 = risen1 = 0.0
        for k in range(j, HORIZON):
            for n in range(k * m.steps, (k + 1) * m.steps):
                travel = m.travel[n - j * m.steps]
                now0, now1 = push * gain[0] * opened[0, n] * travel, push * gain[1] * opened[1, n] * travel
                turned0 = keep * turned0 + risen0 + m.fresh * (now0 - risen0)
                turned1 = keep * turned1 + risen1 + m.fresh * (now1 - risen1)
                risen0, risen1 = now0, now1
            change[k + 1, j], change[k + 1, HORIZON + j] = turned0, turned1


@compiled
def _of_commands(plan, c, sent, moves, swing, m, work):
    """Adds the moves of a channel's commands, and the swing they leave."""
    square, slope, ends = work.square, work.slope, work.ends
    for j in range(HORIZON):
        at = c * HORIZON + j
        move = plan[c, j] - (sent if j == 0 else plan[c, j - 1])
        square[at, at] += moves
        slope[at] += moves * move
        if j > 0:
            square[at - 1, at - 1] += moves
            square[at, at - 1] -= moves
            slope[at - 1] -= moves * move
        last = (HORIZON - j) * m.steps - 1
        x, v = m.travel[last] - (1.0 if j == HORIZON - 1 else 0.0), m.swing[last]
        slope[at] += swing * (ends[c, 0] * x + ends[c, 1] * v)
        for n in range(j + 1):
            last = (HORIZON - n) * m.steps - 1
            y = m.travel[last] - (1.0 if n == HORIZON - 1 else 0.0)
            square[at, c * HORIZON + n] += swing * (x * y + v * m.swing[last])


@compiled
def solve_positive_definite(matrix, x, n):
    """Replaces x (n,), the right-hand side, by the solution, and the lower triangle of the matrix (n, n), which alone is read, by
    its Cholesky factor. A pivot of 1e-12 takes the place of one that is not positive. (Numba's own solver needs a BLAS, which an
    exported controller does not have.)"""
    for p in range(n):
        for q in range(p + 1):
            rest = matrix[p, q]
            for k in range(q):
                rest -= matrix[p, k] * matrix[q, k]
            matrix[p, q] = np.sqrt(max(rest, 1e-12)) if p == q else rest / matrix[q, q]
    for p in range(n):
        rest = x[p]
        for k in range(p):
            rest -= matrix[p, k] * x[k]
        x[p] = rest / matrix[p, p]
    for p in range(n - 1, -1, -1):
        rest = x[p]
        for k in range(p + 1, n):
            rest -= matrix[k, p] * x[k]
        x[p] = rest / matrix[p, p]


@compiled
def _copy(source, plan):
    """Copies a plan (2, H) into another: one by one, since for `plan[:] = source` Numba compiles texts of errors for seconds."""
    for c in range(2):
        for j in range(HORIZON):
            plan[c, j] = source[c, j]


@compiled
def _improve(plan, i, cost, s, w, m, work):
    """One step of Gauss and Newton on the plan of rig i, shortened until it helps; the cost reached, or the old one."""
    normal_equations(plan, i, s, w, m, work)
    # a command at its limit that would go beyond stays there
    for c in range(2):
        for j in range(HORIZON):
            k = c * HORIZON + j
            if plan[c, j] * work.slope[k] < 0.0 and abs(plan[c, j]) >= 1.0:
                work.square[k, :] = 0.0
                work.square[:, k] = 0.0
                work.square[k, k], work.slope[k] = 1.0, 0.0
    for k in range(COMMANDS):
        work.move[k] = -work.slope[k]
    solve_positive_definite(work.square, work.move, COMMANDS)
    size = 1.0
    for _ in range(TRIES):
        for c in range(2):
            for j in range(HORIZON):
                moved = plan[c, j] + size * work.move[c * HORIZON + j]
                work.tried[c, j] = min(1.0, max(-1.0, moved))
        reached = cost_of(work.tried, i, s, w, m, work)
        if reached < cost:
            _copy(work.tried, plan)
            return reached
        size *= SMALLER
    return cost


@compiled
def improve_plans(plans, plain, rows, s, w, m, work):
    """Improves the plans (N, 2, H) of the rigs `rows`, in place. plain (N, 2, H): another plan to begin with, where it is better.
    s: `Scene`, w: `PlannerSettings`, m: `Channel`, work: `Work`."""
    for i in rows:
        plan, now = plans[i], 0.5 * (s.motor[i, 0] + s.motor[i, 1])
        other = cost_of(plain[i], i, s, w, m, work)
        cost = cost_of(plan, i, s, w, m, work)
        if other < cost:
            _copy(plain[i], plan)
            cost = cost_of(plan, i, s, w, m, work)
        for attempt in range(2):
            if attempt == 1:
                cost = cost_of(plan, i, s, w, m, work)
            for _ in range(w.turns):
                reached = _improve(plan, i, cost, s, w, m, work)
                if not reached < cost:
                    break
                cost = reached
            # the cost is not convex at standstill: a plan that stays there is restarted from the feedback's plan
            away = s.aim[i, HORIZON] - now
            left = s.aim[i, HORIZON] - 0.5 * (work.speeds[0, HORIZON] + work.speeds[1, HORIZON])
            if attempt == 1 or abs(away) < AWAY or left * away < STUCK * away * away:
                break
            _copy(plain[i], plan)
