"""A law that plans: `flow_view` with its commands planned on a model of the spools instead of averaged.

`FlowView` turns the flow that it asks for into a command by the valve's static curve, and averages three commands so that
the spool's lightly damped mode stays at rest. Two spools with different ways to their edges then begin to flow at different
times, which parts the motors at every start and every crossing of standstill. Here the next `HORIZON` commands of both
valves are planned together (`spool_plan`), in every period anew, from where the modelled spools stand and swing. What else
the law does, estimation, the reference, the watch over sensors, stays, with six differences:

* The modelled spool hears its commands through the coil, and knows its stops; the pressure follows the flow with a lag.
* Speeds and loads come from a `MotorFilter`, to which the modelled flow tells how the torque went between two samples.
* Sweeps go where they are wanted in two periods, so that they are steady from the beginning. A sweep that may have found flow
  stands still for a sample until that is sure; one that has found it is thrown back, so that little flows on the way. The
  gains are told from the start itself, which is as slow as they are unsure; no pulses.
* Edges that are not visited are slowly forgotten.
* Commands that come late are planned for as well, from where those on their way will have brought spools and motors.
* A pair that hunts is calmed: the more the flow differs from the model's in steady running, the dearer moves are.

Where a speed sensor is poor, while edges are looked for on the way, and at control periods other than 10 ms, the law beneath
commands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.estimation.motor_filter import MotorFilter
from hydro_env.controllers.estimation.valve_estimate import FLOWING, SpoolModel, ValveEstimate
from hydro_env.controllers.mpc.flow_controller import FRICTION, RATED_FLOW, TUNED_PERIOD, FlowView
from hydro_env.controllers.mpc.flow_law import NOMINAL, SPOOL_RATE
from hydro_env.controllers.mpc.planner import (
    PRESSURE,
    Weights,
    follow,
    improve_plans,
    lead_to,
    responses,
    throw_to,
    wait_out,
)
from hydro_env.envs.observation import Measurements
from hydro_env.units import RPM

__all__ = ["PlanningView"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

HORIZON, STEPS, TURNS = 4, 8, 4
"""Control periods that are planned, substeps of a period, turns of improvement."""
BEND = RATED_FLOW / NOMINAL["Km"] * NOMINAL["D"]
"""Torque of the rated flow through the leakage, N m."""
AMISS, TAKEN, WORST, HEAVIEST = 2e-4, 0.1, 0.02, 6.0
"""What makes moves dearer while the reference is steady: mean square of what the flow is beside the model's at which they cost
twice as much, the share of a new square in the mean, the most that one counts, the most that they cost."""
NOISIEST = 4.0
"""Noise of a speed sensor, in multiples of the usual, up to which commands are planned."""
SIDES = np.array([1.0, -1.0])
SMOOTH = 25.0 * RPM
"""Change of the set-point in a period up to which it is taken to go on, rad/s."""


class LaggedSpool(SpoolModel):
    """A `SpoolModel` behind a coil and between stops, on valves as they are estimated. `bend` (num_rigs, 2): see
    `spool_plan.follow`."""

    late_by = PRESSURE

    def __init__(self, num_rigs: int, response: Any) -> None:
        super().__init__(num_rigs, response.step * response.steps, response.rate, 0.0, 0.0)
        self.response = response
        self.late, self.bend = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2))
        self.valves: ValveEstimate | None = None

    def place(self, rows: Rows, position: Floats) -> None:
        super().place(rows, position)
        self.late[rows], self.bend[rows] = position, 0.0

    def move(self, command: Floats) -> None:
        assert self.valves is not None
        held = np.ascontiguousarray(command, dtype=float)
        follow(
            self.position, self.speed, self.late, self.ringing, self.bend, held, self.valves.edge, self.valves.gain,
            self.response,
        )  # fmt: skip


class PlanningView(FlowView):
    """See the module's text.

    Args:
        apart, moves, swing: weights of the plan beside a weight of 1 for the squared distance from the aim (`spool_plan`).
        corner: speed difference from which on its cost grows faster than its square, rpm.
        behind: how long after the reference the speeds are to follow it, periods.
        ahead: no farther than this are the speeds asked to move at once, rpm.
        wander, wander_apart, turned, twice: of the `MotorFilter`.
        moved: swing of a spool, in rated travels, from which on its edges and gain wander at full pace (`ValveEstimate`).
        begin, back: how far sweeps are to be after two periods, in periods of their pace, at first and after a turn.
        idle, unused: share of that pace at which they wander in any case; how an edge on the other side of the dead zone does,
            per root second.
        hold, again: flow at which a sweep stands still for one sample, and that in the next sample ends it.
        least, clear: a spool that has found its first edge is behind it by so much a period later, or by this share of its
            way from rest, where that is more; `home`: at its second edge, by this share of the dead zone.
        patience: set-point below which probing goes on while that moves smoothly, rpm.
        onward: by how many reference times a smoothly moving set-point is foreseen.
        others: settings of `FlowView`; some of them have other values here.
    """

    cautious = True

    def __init__(
        self,
        apart: float = 300.0,
        moves: float = 650.0,
        swing: float = 3000.0,
        corner: float = 14.0,
        behind: float = 1.95,
        ahead: float = 30.0,
        wander: float = 0.006,
        wander_apart: float = 0.0005,
        turned: float = 0.06,
        twice: float = 8.0,
        moved: float = 0.1,
        idle: float = 0.05,
        unused: float = 0.02,
        begin: float = 2.5,
        back: float = 1.4,
        hold: float = 0.0042,
        again: float = 0.006,
        least: float = 0.04,
        clear: float = 0.5,
        home: float = 0.42,
        patience: float = 250.0,
        onward: float = 1.0,
        rate: float = 42.0,
        slew: float = 28.0,
        most: float = 0.94,
        friction: float = 0.85,
        gain_drift: float = 0.004,
        doubt: float = 5.5,
        still: float = 0.0165,
        moving: float = 0.06,
        sweep: float = 2.65,
        detect: float = 0.008,
        pulse: float = 0.0,
        **others: float,
    ) -> None:
        super().__init__(
            rate=rate, slew=slew, most=most, friction=friction, gain_drift=gain_drift, doubt=doubt, still=still,
            moving=moving, sweep=sweep, detect=detect, pulse=pulse, **others,
        )  # fmt: skip
        own = {
            "apart": apart, "moves": moves, "swing": swing, "corner": corner, "behind": behind, "ahead": ahead,
            "wander": wander, "wander_apart": wander_apart, "turned": turned, "twice": twice, "moved": moved, "idle": idle,
            "unused": unused, "begin": begin, "back": back, "hold": hold, "again": again, "least": least, "clear": clear,
            "home": home, "patience": patience, "onward": onward,
        }  # fmt: skip
        self._given |= {name: float(value) for name, value in own.items()}
        self._weights = Weights(float(apart), 1.0, float(moves), float(swing), corner * RPM, TURNS)
        self._behind_by, self._ahead = float(behind), ahead * RPM
        self._filtered = (float(wander), float(wander_apart)), float(turned), float(twice)
        self.moved, self.idle, self.unused = moved, idle, unused
        self.begin, self.back, self.hold, self.again = begin, back, hold, again
        self.least, self.clear, self.home = least, clear, home
        self.patience, self.onward = patience * RPM, float(onward)

    def settings(self) -> dict[str, Any]:
        return {**super().settings(), "kind": "plan"}

    # ---- memory ---------------------------------------------------------------------------------------------------
    def start(self, observation: Floats, period: float) -> Floats:
        n = len(observation)
        self._plans = abs(period - TUNED_PERIOD) < 1e-6
        motor = self.motor
        self._response = responses(
            period, max(1, round(STEPS * period / TUNED_PERIOD)), HORIZON, SPOOL_RATE, self.damping, self.friction * FRICTION,
            (motor.per_speed, motor.per_torque, motor.per_acceleration),
        )  # fmt: skip
        self.plan = np.zeros((n, 2, HORIZON))
        self._amiss = np.zeros(n)
        self._asked_then, self._slope, self._still = np.zeros(n), np.zeros(n), np.zeros(n, bool)
        self._last: Floats = np.zeros((n, 2))
        # spools that stand still in their sweep; that have just found their first and their second edge
        self._waits = np.zeros((n, 2), bool)
        self._turns = self._waits, self._waits
        inputs = super().start(observation, period)
        self._lagged.valves = self._prompt.valves = self.valves
        return inputs

    def _make_models(self, n: int) -> None:
        super()._make_models(n)
        self.spool = self._lagged = LaggedSpool(n, self._response)
        self.prompt = self._prompt = LaggedSpool(n, self._response)
        self.loads = self._filter = MotorFilter(n, self.period, *self._filtered)

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        inputs = super().restart(rows, observation)
        self._last[rows], self._waits[rows], self._amiss[rows] = self.sent[rows], False, 0.0
        self.plan[rows] = self.sent[rows][..., None]
        self._asked_then[rows], self._slope[rows] = self._setpoint[rows], 0.0
        return inputs

    def _unload(self, rows: Rows, seen: Measurements) -> None:
        self._filter.forget(rows, seen.speed, seen.pressure)

    def _weigh(self, seen: Measurements) -> None:
        bend = BEND * self._lagged.bend
        self._filter.step(seen.speed, seen.pressure, bend, self.sensors.noise, self.sensors.unsound)

    # ---- the law --------------------------------------------------------------------------------------------------
    def _think(self, seen: Measurements) -> None:
        super()._think(replace(seen, setpoint=self._foreseen(seen.setpoint)))

    def _foreseen(self, setpoint: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where a smoothly moving set-point will be when the motors can be there, (num_rigs,)."""
        slope = setpoint - self._asked_then
        smooth = (np.abs(slope) < SMOOTH) & (np.abs(slope - self._slope) < 0.2 * SMOOTH)
        self._asked_then, self._slope = setpoint, slope
        self._still = (np.abs(slope) < SMOOTH) & (np.abs(setpoint) < self.patience)
        periods = self.onward * (1.0 / (self.rate * self.period) + self._behind_by)
        foreseen: NDArray[np.float64] = setpoint + np.where(smooth, periods * slope, 0.0)
        return foreseen

    def _least(self) -> Floats:
        return np.where(self._waits, self.again, FLOWING) * self.noisier

    def _found(self, flow: Floats) -> NDArray[np.bool_]:
        found: NDArray[np.bool_] = flow > np.where(self._waits, self.again, self.detect) * self.noisier
        doubtful = (flow > self.hold * self.noisier) & ~found & ~self._waits
        self._waits = doubtful & (self.sides < 2) & self.probing[:, None] & self._plans
        return found

    def _probe(self) -> None:
        if not self.probing.any():
            return
        sides, setpoint = self.sides, self._setpoint
        self._setpoint = np.where(self._still, 0.0, setpoint)
        super()._probe()
        self._setpoint = setpoint
        turns = (self.sides != sides) & self.probing[:, None]
        self._turns = turns & (sides == 0), turns & (sides == 1)
        # an edge that has shown itself before is not looked for
        self.sides = np.where(self._turns[0] & ~self.valves.unknown[..., 1], 2, self.sides)
        self.swept = self.swept - np.where(self._waits, self.sweep * self.period, 0.0)

    # ---- commands -------------------------------------------------------------------------------------------------
    def command(self, outputs: Floats) -> Floats:
        averaged = self._sweep(super().command(outputs))
        if not self._plans:
            return averaged
        poor = np.any(self.sensors.unsound | (self.sensors.noise > NOISIEST), axis=1)
        planned = ~(self.crossing | self.probing | poor)
        rows = np.flatnonzero(planned)
        plain = np.empty_like(self.plan)
        last, final = self._last, self.asked[-1]
        plain[..., 0] = averaged
        plain[..., 1] = averaged + (1.0 - 2.0 * self._outer) * (final - last)
        plain[..., 2:] = final[..., None]
        np.clip(plain, -1.0, 1.0, out=plain)
        self.plan[..., :-1] = self.plan[..., 1:].copy()
        self.plan[~planned] = averaged[~planned][..., None]
        # what the network adds, as what the model has wrong: flow that a load takes, an opening that is shifted
        given = self._effect[:, None, None] * np.asarray(outputs, dtype=float).reshape(
            -1, 2, self.num_actions
        )
        load = self.loads.torque + self.reach / self.motor.per_torque * given[..., 0]
        edge = self.valves.edge + self.shift * given[..., 1, None] * SIDES
        place = np.stack([self.spool.position, self.spool.speed, self._lagged.late])
        motor = self._filter.speed.copy()
        if self.delays.periods.any():
            wait_out(
                self.delays.periods, self._sent, place, motor, load, edge, self.valves.gain, self._response
            )
        improve_plans(
            self.plan, plain, rows, place, motor, load, edge, self.valves.gain, last, self._aim(motor), self._dearer(),
            self._weights, self._response,
        )  # fmt: skip
        self.sent = np.where(planned[:, None], self.plan[..., 0], averaged)
        # what the average goes on from
        self.asked[:] = np.where(planned[:, None], self.sent, self.asked)
        self._last = self.sent.copy()
        return self.sent.copy()

    def _dearer(self) -> Floats:
        """By how much moves of the commands cost more, (num_rigs,): pairs that friction unlike the model's makes hunt are
        calmed."""
        square = np.max((self.valves.surprise / self.noisier) ** 2, axis=1)
        self._amiss += TAKEN * (np.minimum(square, WORST) - self._amiss)
        steady = np.abs(self.acceleration) < 1.0
        dearer: Floats = np.where(steady, np.minimum(1.0 + self._amiss / AMISS, HEAVIEST), 1.0)
        return dearer

    def _sweep(self, sent: Floats) -> Floats:
        """The commands `sent` (num_rigs, 2), for spools that sweep those that bring them along, and home when both edges are
        found. Not at long control periods, in which a spool swings too far."""
        if self.period > 1.5 * TUNED_PERIOD or not self.probing.any():
            return sent
        swings = self.probing[:, None] & ((self.sides < 2) | (self.pulsed == 0)[:, None])
        sign = np.where(self.sides == 0, 1.0, -1.0)
        on = np.where(self.sides == 0, self.begin, self.back) * self.sweep * self.period
        home, edge = self.sides == 2, self.valves.edge
        goal = np.where(home, self.valves.middle, sign * (self.swept + on))
        spools = self.spool.position, self.spool.speed, self._lagged.late
        lead_to(sent, swings, *spools, goal, np.where(home, 0.0, sign * self.sweep), self._response)
        if self._plans:
            # a spool that stands still, and those that go back from where they let flow pass
            throw_to(sent, swings & self._waits, *spools, self.spool.position, self._response)
            goal = edge[..., 0] - np.maximum(self.least, self.clear * edge[..., 0])
            goal = np.where(home, np.maximum(goal, self.valves.middle), goal)
            throw_to(sent, swings & self._turns[0], *spools, goal, self._response)
            goal = self.home * edge[..., 0] - (1.0 - self.home) * edge[..., 1]
            throw_to(sent, swings & self._turns[1], *spools, goal, self._response)
        self.asked[:] = np.where(swings, sent, self.asked)
        self.sent = sent.copy()
        return sent

    def _aim(self, motor: Floats) -> Floats:
        """Speeds to be at in the next control instants, (num_rigs, HORIZON + 1): the reference `behind` periods before.
        `motor`: the speeds at which the plan begins."""
        aim = np.empty((len(self.speed), HORIZON + 1))
        for k in range(HORIZON + 1):
            back = self._behind_by - k
            if back >= 0.0:
                whole, part = int(back), back - int(back)
                aim[:, k] = (1.0 - part) * self.before[whole] + part * self.before[whole + 1]
            else:
                aim[:, k] = self.speed - self.acceleration * back * self.period
        off = aim[:, 0] - np.mean(motor, axis=1)
        return aim - (off - np.clip(off, -self._ahead, self._ahead))[:, None]
