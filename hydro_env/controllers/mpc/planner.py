"""The planner: the next commands of both valves, so that the motors keep together.

A plan holds the commands of the next few control periods and is improved in every period anew
(`hydro_env.controllers.mpc.planner_steps`): what it weighs, what it aims at, and which rigs are planned for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.nominal import TUNED_PERIOD
from hydro_env.controllers.estimation.spool import Channel
from hydro_env.controllers.mpc.planner_lanes import LANES, improve_together
from hydro_env.controllers.mpc.planner_steps import HORIZON, Scene, Weights, Work, improve_plans
from hydro_env.controllers.mpc.reference import ReferenceState
from hydro_env.controllers.settings import HAND, TUNED, setting
from hydro_env.units import RPM

__all__ = ["Planner", "PlannerSettings"]

Bools = NDArray[np.bool_]
Rows = NDArray[Any] | slice


@dataclass(frozen=True)
class PlannerSettings:
    """Weights beside a weight of 1 for the squared distance from the aim (rad/s)."""

    apart: float = setting(300.0, "1", "of the squared speed difference", TUNED)
    moves: float = setting(650.0, "rad2/s2", "of the squared moves of a command", TUNED)
    swing: float = setting(3000.0, "rad2/s2", "of the squared swing at the end", TUNED)
    corner: float = setting(
        14.0, "rpm", "difference from which on its cost grows faster than its square", TUNED
    )
    turns: int = setting(4, "1", "steps of Gauss and Newton a period", HAND)
    behind: float = setting(1.95, "periods", "how long after the reference the speeds are to follow", TUNED)
    ahead: float = setting(30.0, "rpm", "no farther are the speeds asked to move at once", TUNED)
    wrong: float = setting(
        2e-4, "1", "mean square of the flow's innovation that doubles the moves' weight", TUNED
    )
    memory: float = setting(0.1, "1", "share of a new square in that mean", TUNED)
    worst: float = setting(0.02, "1", "most that one square counts", TUNED)
    heaviest: float = setting(6.0, "1", "largest factor on the moves' weight", TUNED)
    noisiest: float = setting(
        4.0, "1", "multiple of a speed's usual noise up to which commands are planned", TUNED
    )


class Planner:
    """`plan` (num_rigs, 2, HORIZON): commands of the next periods. Only for the control period it was tuned at."""

    def __init__(self, settings: PlannerSettings, num_rigs: int, channel: Channel) -> None:
        s = self.settings = settings
        self._channel, self._work = channel, Work.of(channel.steps)
        self._together = num_rigs >= LANES
        self._weights = Weights(s.apart, 1.0, s.moves, s.swing, s.corner * RPM, s.turns)
        self.plan, self._mean = np.zeros((num_rigs, 2, HORIZON)), np.zeros(num_rigs)

    @staticmethod
    def fits(period: float) -> bool:
        """Whether commands are planned at this control period."""
        return abs(period - TUNED_PERIOD) < 1e-6

    def reset(self, rows: Rows, sent: Floats) -> None:
        """The command (n, 2) goes on."""
        self.plan[rows], self._mean[rows] = sent[..., None], 0.0

    def step(self, planned: Bools, plain: Floats, scene: Scene) -> Floats:
        """Commands (num_rigs, 2) of the rigs that are `planned` (num_rigs,); `plain` (num_rigs, 2, HORIZON) is a plan to begin
        with where it is better than what is left of the last one, and what the others do."""
        self.plan[..., :-1] = self.plan[..., 1:].copy()
        self.plan[~planned] = plain[~planned, :, :1]
        rows = np.flatnonzero(planned)
        if self._together:
            improve_together(self.plan, plain, rows, scene, self._weights, self._channel)
        else:
            improve_plans(self.plan, plain, rows, scene, self._weights, self._channel, self._work)
        return np.where(planned[:, None], self.plan[..., 0], plain[..., 0])

    def move_weights(self, innovation: Floats, acceleration: Floats) -> Floats:
        """Factors on the moves' weight, (num_rigs,): moves cost more for pairs that limit-cycle, as friction unlike the
        model's makes them, while the
        reference is steady. `innovation` (num_rigs, 2) of the flow, in units of its usual noise's."""
        s = self.settings
        square = np.max(innovation**2, axis=1)
        self._mean += s.memory * (np.minimum(square, s.worst) - self._mean)
        steady = np.abs(acceleration) < 1.0
        factors: Floats = np.where(steady, np.minimum(1.0 + self._mean / s.wrong, s.heaviest), 1.0)
        return factors

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
        return aim - (off - np.clip(off, -s.ahead * RPM, s.ahead * RPM))[:, None]
