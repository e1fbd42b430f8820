"""The oracle: model-predictive control with the plant itself as its model. What it leaves is what no knowledge removes.

It has all privileged information that a controller on a rig has to do without: the parameters of both valves and motors, the
true state, and the loads, now and to come. It may not foresee the set-point, which it sees as everyone does; where that
changes smoothly it expects it to go on as it does. So it bounds what can be gained by knowing valves, state and loads,
at this control period and with these valves; a controller that has learnt by heart when a set-point will step is not
bounded in its tracking.

In each control period copies of the rigs drive the plan of the next `HORIZON` periods, and the plan is improved by what
they show (`hydro_env.controllers.mpc.shooting`), some more times where the set-point has just stepped. Then its first
command is sent. The state needs no measurement: a twin of the plant, given the same commands and loads, is in the same
state bit for bit, as the noise is in the sensors alone.
"""

import numpy as np
from scipy.linalg import expm

from hydro_env.arrays import Floats, Integers
from hydro_env.controllers.base import Controller, Gain, Measurements
from hydro_env.controllers.linear_channel import linear_rates
from hydro_env.controllers.mpc.shooting import END, HORIZON, HUBER, MIN_DAMPING, SAMPLES, Task, cost, improve
from hydro_env.plant import CATALOGUE, PARAMETERS, Plant
from hydro_env.units import RPM

#: How often a plan is driven, and then improved, in every period, and when the set-point has just stepped.
TURNS, AFTER_A_STEP = 3, 30
#: Share of the turns in which a plan is taken whatever it costs.
FREE = 0.6
#: Change of the set-point from one period to the next that is a step, rad/s.
STEP = 50.0 * RPM
#: Speed difference in a plan from which on another is looked for, rad/s.
APART = 4.0 * RPM
#: Turns of those other plans, one after the other.
RETRIES = (6, 30)
#: A plan of which no command would move by more than this share of the rated one is left as it is.
SETTLED = 1e-4
#: Error of a speed by which the simulation of plans chooses its steps, rad/s.
TOLERANCE = 1.0 * RPM
#: Shares of the stroke: where the largest command lets a spool rest, and how far it should swing.
TRAVEL, MARGIN = 0.95, 0.96


class Oracle(Controller):
    """See the module's text. `prepare` and `foresee` have to be called before the episode.

    Gains and thresholds are those for the paper's rig; on another one they are scaled with its speeds and travels.
    """

    needs = "everything"
    GAINS = (
        Gain("difference", "1", 30.0, 3000.0, summary="weight of the squared speed difference"),
        Gain("smooth", "rad2/s2", 30.0, 1000.0, summary="weight of the squared moves of a command"),
        Gain("stops", "rad2/(s2 mm2)", 100.0, 1e4, summary="weight of the squared travel beyond the margin"),
    )
    _twin: Plant
    _load: Floats

    def prepare(self, plant: Plant) -> None:
        self._twin = plant

    def foresee(self, load: Floats) -> None:
        self._load = load

    def start(self, measured: Measurements) -> None:
        if not (hasattr(self, "_twin") and hasattr(self, "_load")):
            raise RuntimeError(f"{self.name} needs prepare(plant) and foresee(load) before the episode")
        twin, n = self._twin, len(measured.speed)
        get = twin.get
        self._rated = get("u_rated")
        speed, travel = self.rig.speed, self.rig.travel
        sizes = {"difference": 1.0, "smooth": speed**2, "stops": (speed / travel) ** 2}
        weights = [size * np.ravel(self.gains[gain]) for gain, size in sizes.items()]
        self._weights = [np.broadcast_to(each, (n,)).copy() for each in (*weights, np.array(speed * HUBER))]
        self._plan = np.zeros((n, HORIZON, 2))
        self._sent = np.zeros((n, 2))
        self._row = 0
        self._setpoint = measured.setpoint
        self._step = self.period / SAMPLES
        self._travel = _travel(twin, self.period)
        self._motor = _motor(twin, self._step)
        self._copies = _copies(twin, np.arange(n), speed * TOLERANCE)
        stroke = get("x_max")
        self._margin = MARGIN * stroke
        self._most = np.minimum(1.0, TRAVEL * stroke * get("k") * get("R") / (get("alpha") * self._rated))

    def command(self, measured: Measurements) -> Floats:
        change = measured.setpoint - self._setpoint
        self._setpoint = measured.setpoint
        stepped = np.abs(change) > self.rig.speed * STEP
        slope = np.where(stepped, 0.0, change)
        ahead = measured.setpoint[:, None] + slope[:, None] * np.arange(HORIZON + 1)
        # The last load stays, as the samples after the last period do.
        rows = np.minimum(np.arange(self._row, self._row + HORIZON + 1), len(self._load) - 1)
        load = np.repeat(self._load[rows], SAMPLES, axis=0)[: END + 1]
        self._search(np.where(stepped | (self._row == 0), AFTER_A_STEP, TURNS), ahead, load)
        sent = self._plan[:, 0].astype(np.float32).astype(float)  # as actions are passed on
        self._twin.step(sent * self._rated, self._load[rows[0]], self.period)
        self._sent = sent
        self._row += 1
        self._plan[:, :-1] = self._plan[:, 1:].copy()
        return sent

    def _search(self, turns: Integers, ahead: Floats, load: Floats) -> None:
        """Improves every plan for its `turns` (N,); one that would still let the motors fall apart is restarted, for
        longer: the way of a single descent is at times blocked by a stop or a spool that sticks.
        """
        task = Task(self._sent, ahead, self._most, self._margin, self._travel, self._motor, *self._weights)
        start = self._plan
        found, lowest = start.copy(), np.empty(len(start))
        speed, near = np.empty((HORIZON, len(start), 2)), self.rig.speed * APART
        for count in np.unique(turns):
            rows = np.flatnonzero(turns == count)
            found[rows], lowest[rows], speed[:, rows] = self._descend(rows, count, start, task, load)
        for attempt in RETRIES:
            poor = np.flatnonzero(np.abs(speed[:2, :, 0] - speed[:2, :, 1]).max(axis=0) > near)
            if not len(poor):
                break
            other, reached, instead = self._descend(poor, attempt, start, task, load)
            # Motors that stay at rest are in step too but get nowhere.
            late, later = (np.abs(e[-1] - ahead[poor, -1:]).sum(axis=1) for e in (speed[:, poor], instead))
            better = (reached < lowest[poor]) & (later < late + near)
            rows = poor[better]
            found[rows], lowest[rows], speed[:, rows] = other[better], reached[better], instead[:, better]
        self._plan = found

    def _descend(
        self, rows: Integers, turns: int, start: Floats, task: Task, load: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Plans (n, HORIZON, 2) of the n rigs `rows`, their costs (n,) and the speeds (HORIZON, n, 2) they lead to at control
        instants, after at most `turns` of Levenberg and Marquardt: copies of the rigs drive the plan, and a change that did not
        help is taken back and tried smaller.
        """
        plan, load, task = start[rows], np.take(load, rows, 1), task.of(rows)
        n = len(rows)
        every, going = n == len(start), np.arange(n)
        copies = self._copies if every else self._copies.select(rows)
        signals = np.array([copies.row_of(name) for name in ("speed", "flow", "spool")])
        best, lowest, motion = plan.copy(), np.full(n, np.inf), np.empty((3, END + 1, n, 2))
        least = self.rig.speed**2 * MIN_DAMPING
        damping = np.full(n, least)
        for turn in range(turns):
            copies.take_state(self._twin, None if every and len(going) == n else rows[going])
            volts = np.repeat(plan[going] * self._rated[rows[going], None], SAMPLES, axis=1)
            volts = np.append(volts, volts[:, -1:], axis=1)  # what follows the last sample is not looked at
            seen = np.empty((3, END + 1, len(going), 2))
            copies.run_into(seen, volts.transpose(1, 0, 2), load, self._step, signals)
            reached = cost(plan[going], seen, task.of(going))
            # The cost is not convex at standstill: at first a plan need not be better than the one before.
            better = (reached < lowest[going]) | (turn < FREE * turns)
            damping[going] *= np.where(better, 0.25, 8.0)
            np.maximum(damping, least, out=damping)
            kept = going[better]
            best[kept], lowest[kept], motion[:, :, kept] = plan[kept], reached[better], seen[:, :, better]
            if turn == turns - 1:
                break
            plan[going] = improve(best[going], motion[:, :, going], damping[going], task.of(going))
            moved = np.abs(plan[going] - best[going]).max(axis=(1, 2))
            settled, moving = going[moved <= SETTLED], np.flatnonzero(moved > SETTLED)
            best[settled] = plan[settled]
            if not len(moving):
                break
            if len(moving) < len(going):
                going, load, copies = going[moving], np.take(load, moving, 1), copies.select(moving)
        return best, lowest, motion[0][SAMPLES::SAMPLES].copy()


def _copies(plant: Plant, rows: Integers, tolerance: float) -> Plant:
    """Rigs with the parameters of the plant's rigs `rows`, simulated as coarsely as plans need."""
    tolerance = max(tolerance, plant.tolerance)
    copies = Plant(plant.model, len(rows), effects=plant.effects, tolerance=tolerance, dtype=np.float32)
    for name in (*PARAMETERS, *(f"{e}.{p.name}" for e in plant.effects for p in CATALOGUE[e].parameters)):
        copies.set(name, plant.get(name)[rows])
    return copies


def _travel(plant: Plant, period: float) -> Floats:
    """Travel of every spool in m, (N, 2, HORIZON SAMPLES + 1), at the samples after a command of 1 that lasts one period:
    coil, back-EMF, mass and spring, (5) and (6), without friction and stops.
    """
    rates = np.zeros((plant.num_rigs, 2, 4, 4))  # current, travel, speed, command
    rates[..., :3, :3] = linear_rates(plant.get)[..., :3, :3]
    rates[..., 0, 3] = plant.get("u_rated") / plant.get("L")
    held = expm(rates * (period / SAMPLES))
    state = np.zeros((plant.num_rigs, 2, 4))
    state[..., 3] = 1.0
    travel = np.zeros((plant.num_rigs, 2, END + 1))
    for sample in range(1, travel.shape[2]):
        state = np.sum(held * state[..., None, :], axis=-1)
        if sample == SAMPLES:
            state[..., 3] = 0.0
        travel[..., sample] = state[..., 1]
    return travel


def _motor(plant: Plant, step: float) -> Floats:
    """Pressure and speed of every motor a step later, (N, 2, 2, 3): from pressure, speed and the travel of the spool, (1),
    (2) and (8), without what effects add.
    """
    rates = np.zeros((plant.num_rigs, 2, 3, 3))
    rates[..., :2, :] = linear_rates(plant.get)[..., 3:, [3, 4, 1]]
    return np.ascontiguousarray(expm(rates * step)[..., :2, :])
