"""A law that plans: `flow_view` with its commands planned on a model of the spools instead of averaged.

`FlowView` turns the flow that it asks for into a command by the valve's static curve, and averages three commands so that
the spool's lightly damped mode stays at rest. Two spools with different ways to their edges then begin to flow at different
times, which parts the motors at every start and every crossing of standstill. Here the next `HORIZON` commands of both
valves are planned together (`spool_plan`), in every period anew, from where the modelled spools stand and swing. What else
the law does, probing, estimation, the reference, the watch over sensors, stays, with three differences:

* The modelled spool hears its commands through the coil, and knows its stops.
* The mean pressure of a period, from which the loads are told, takes in how the flow went between two samples.
* A sweep that has found flow turns at once by `turn`, not through the average.

Where commands come late or a speed sensor is poor, while edges are looked for, and at control periods other than 10 ms,
the law beneath commands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.flow_law import NOMINAL, SPOOL_RATE
from hydro_env.controllers.flow_view import FRICTION, RATED_FLOW, TUNED_PERIOD, FlowView
from hydro_env.controllers.spool_plan import Weights, follow, improve_plans, responses
from hydro_env.controllers.valve_estimate import LoadEstimate, SpoolModel, ValveEstimate
from hydro_env.envs.observation import Measurements
from hydro_env.units import RPM

__all__ = ["PlanningView"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

HORIZON, STEPS, TURNS = 4, 8, 2
"""Control periods that are planned, substeps of a period, turns of improvement."""
BEND = RATED_FLOW / NOMINAL["Km"] * NOMINAL["D"]
"""Torque of the rated flow through the leakage, N m."""
NOISIEST = 4.0
"""Noise of a speed sensor, in multiples of the usual, up to which commands are planned."""
SIDES = np.array([1.0, -1.0])
SMOOTH = 25.0 * RPM
"""Change of the set-point in a period up to which it is taken to go on, rad/s."""


class LaggedSpool(SpoolModel):
    """A `SpoolModel` behind a coil and between stops, on valves as they are estimated. `bend` (num_rigs, 2): see
    `spool_plan.follow`."""

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


class BentLoadEstimate(LoadEstimate):
    """A `LoadEstimate` that knows what the samples miss of the mean torque, by the modelled `spool`."""

    def __init__(self, *given: Any, spool: LaggedSpool, trend: float) -> None:
        super().__init__(*given)
        self.spool, self._trend = spool, trend
        self.slope = np.zeros_like(self.torque)

    def forget(self, rows: Rows, speed: Floats, shaft: Floats) -> None:
        super().forget(rows, speed, shaft)
        self.slope[rows] = 0.0

    @property
    def bend(self) -> Floats:
        """That torque, N m, (num_rigs, 2)."""
        return BEND * self.spool.bend

    def step(self, speed: Floats, shaft: Floats, noisier: Floats | float = 1.0, blind: Any = False) -> None:
        bend = self.bend
        load = 0.5 * (shaft + self._shaft) + bend - self._per_speed * (speed - self._speed)
        self.miss = np.where(blind, 0.0, load - self.torque - self.slope)
        # a jump has to stand out from what the model may have wrong of it
        jump = self._jump * noisier + 0.5 * np.abs(bend)
        jumps = np.clip((np.abs(self.miss) - jump) / (0.7 * jump), 0.0, 1.0)
        share = self._share / noisier
        torque = self.torque + self.slope + (share + (1.0 - share) * jumps) * self.miss
        self.torque = np.where(blind, self.torque, torque)
        # a jump is no trend
        slope = (1.0 - jumps) * (self.slope + self._trend / noisier * np.clip(self.miss, -jump, jump))
        self.slope = np.where(blind, 0.0, slope)
        self._speed, self._shaft = np.array(speed, dtype=float), np.array(shaft)


class PlanningView(FlowView):
    """See the module's text.

    Args:
        apart, moves, swing: weights of the plan beside a weight of 1 for the squared distance from the aim (`spool_plan`).
        corner: speed difference from which on its cost grows faster than its square, rpm.
        trend: share of a load's miss that its slope takes in.
        behind: how long after the reference the speeds are to follow it, periods.
        ahead: no farther than this are the speeds asked to move at once, rpm.
        trust: share of a reading of the speed that corrects what the torque gave.
        turn: by how much a sweep turns at once.
        patience: set-point below which probing goes on while that moves smoothly, rpm.
        onward: by how many reference times a smoothly moving set-point is foreseen.
        others: settings of `FlowView`; four of them have other values here.
    """

    def __init__(
        self,
        apart: float = 300.0,
        moves: float = 1000.0,
        swing: float = 1000.0,
        corner: float = 20.0,
        trend: float = 0.015,
        behind: float = 1.6,
        ahead: float = 30.0,
        trust: float = 0.4,
        turn: float = 0.05,
        patience: float = 250.0,
        onward: float = 1.0,
        most: float = 0.92,
        friction: float = 0.85,
        share: float = 0.15,
        gain_drift: float = 0.004,
        **others: float,
    ) -> None:
        super().__init__(most=most, friction=friction, share=share, gain_drift=gain_drift, **others)
        own = {
            "apart": apart, "moves": moves, "swing": swing, "corner": corner, "trend": trend, "behind": behind,
            "ahead": ahead, "trust": trust, "turn": turn, "patience": patience, "onward": onward,
        }  # fmt: skip
        self._given |= {name: float(value) for name, value in own.items()}
        self._weights = Weights(float(apart), 1.0, float(moves), float(swing), corner * RPM, TURNS)
        self._behind_by, self._ahead, self.trust = float(behind), ahead * RPM, float(trust)
        self.trend = float(trend)
        self.turn, self.patience, self.onward = float(turn), patience * RPM, float(onward)

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
        self.turning, self._turn_to = np.zeros((n, 2), bool), np.zeros((n, 2))
        self._motors, self._torque_then = np.zeros((n, 2)), np.zeros((n, 2))
        self._asked_then, self._slope, self._still = np.zeros(n), np.zeros(n), np.zeros(n, bool)
        self._last = np.zeros((n, 2))
        inputs = super().start(observation, period)
        self._lagged.valves = self.valves
        return inputs

    def _make_models(self, n: int) -> None:
        super()._make_models(n)
        self.spool = self._lagged = LaggedSpool(n, self._response)
        self.loads = self._bent = BentLoadEstimate(
            n, self.period, NOMINAL["J"], self.share, self._jump, spool=self._lagged, trend=self.trend
        )

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        inputs = super().restart(rows, observation)
        self._motors[rows] = self.speed[rows, None]
        self._last[rows] = self.sent[rows]
        self.plan[rows] = self.sent[rows][..., None]
        self.turning[rows] = False
        self._torque_then[rows] = 0.0
        self._asked_then[rows], self._slope[rows] = self._setpoint[rows], 0.0
        return inputs

    # ---- the law --------------------------------------------------------------------------------------------------
    def _think(self, seen: Measurements) -> None:
        self._know_motors(seen)
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

    def _know_motors(self, seen: Measurements) -> None:
        """Speeds from the torque of the last period (eq. 2), corrected by the readings; the readings where a load jumped."""
        torque = NOMINAL["D"] * seen.pressure
        mean = 0.5 * (torque + self._torque_then) + self._bent.bend
        gained = self.period / NOMINAL["J"] * (mean - NOMINAL["B"] * self._motors - self.loads.torque)
        ahead = self._motors + gained
        jumped = np.abs(self.loads.miss) > self._jump
        self._motors = np.where(
            jumped, seen.speed, ahead + self.trust / self.sensors.noise * (seen.speed - ahead)
        )
        self._torque_then = torque

    def _probe(self) -> None:
        sides, swept, setpoint = self.sides.copy(), self.swept.copy(), self._setpoint
        self._setpoint = np.where(self._still, 0.0, setpoint)
        super()._probe()
        self._setpoint = setpoint
        self.turning = (self.sides != sides) & self.probing[:, None]
        self._turn_to = np.where(sides == 0, 1.0, -1.0) * (swept - self.turn)

    # ---- commands -------------------------------------------------------------------------------------------------
    def command(self, outputs: Floats) -> Floats:
        if self.turn:
            self.asked[:] = np.where(self.turning, self._turn_to, self.asked)
        averaged = super().command(outputs)
        if not self._plans:
            return averaged
        poor = np.any(self.sensors.unsound | (self.sensors.noise > NOISIEST), axis=1)
        planned = ~(self.crossing | self.probing | poor) & (self.delays.periods == 0)
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
        load = self.loads.torque + self._bent.slope + self.reach / self.motor.per_torque * given[..., 0]
        edge = self.valves.edge + self.shift * given[..., 1, None] * SIDES
        improve_plans(
            self.plan, plain, rows, np.stack([self.spool.position, self.spool.speed, self._lagged.late]), self._motors,
            load, edge, self.valves.gain, last, self._aim(), self._weights, self._response,
        )  # fmt: skip
        self.sent = np.where(planned[:, None], self.plan[..., 0], averaged)
        # what the average goes on from
        self.asked[:] = np.where(planned[:, None], self.sent, self.asked)
        self._last = self.sent.copy()
        return self.sent.copy()

    def _aim(self) -> Floats:
        """Speeds to be at in the next control instants, (num_rigs, HORIZON + 1): the reference `behind` periods before."""
        aim = np.empty((len(self.speed), HORIZON + 1))
        for k in range(HORIZON + 1):
            back = self._behind_by - k
            if back >= 0.0:
                whole, part = int(back), back - int(back)
                aim[:, k] = (1.0 - part) * self.before[whole] + part * self.before[whole + 1]
            else:
                aim[:, k] = self.speed - self.acceleration * back * self.period
        off = aim[:, 0] - np.mean(self._motors, axis=1)
        return aim - (off - np.clip(off, -self._ahead, self._ahead))[:, None]
