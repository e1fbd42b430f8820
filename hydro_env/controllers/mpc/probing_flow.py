"""Flow control that probes the valves while the rig rests: the law beneath the learned agents, without a network.

`adaptive_flow` learns edges and gains where the drive happens to take it. This one looks for them beforehand, in the rest
before the set-point first moves, and goes on from there; `planning_view` and, beneath it, `flow_view` describe its parts.
Its constants were found by an evolution strategy and by hand on pairs of `train` (docs/explanation). Those that choose the
place on the front of speed difference over tracking error are left to the user: how fast the reference runs, and how fast
the spools look for their edges.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Controller, Floats, Gain
from hydro_env.controllers.mpc.planning_controller import PlanningView

__all__ = ["ProbingFlow"]


class ProbingFlow(Controller):
    """See the module's text. The drawn valves are unknown to it, the paper's motor is known."""

    GAINS: ClassVar[tuple[Gain, ...]] = (
        Gain(
            "rate",
            "1/s",
            5.0,
            60.0,
            default=42.0,
            summary="rate at which the reference runs to the set-point",
        ),
        Gain("rise", "1/s", 3.0, 60.0, default=28.0, summary="rated flows a second by which flow may rise"),
        Gain("fall", "1", 1.0, 10.0, default=4.0, summary="how many times as fast it may fall"),
        Gain(
            "sweep",
            "1/s",
            1.0,
            6.0,
            default=2.65,
            summary="pace of the spools when probing, commands a second",
        ),
        Gain("search", "1/s", 1.0, 20.0, default=9.3, summary="pace when an edge is looked for on the way"),
    )

    probe = 1.0
    """Whether the valves are probed at rest."""

    def reset(self, num_rigs: int, control_period: float) -> None:
        super().reset(num_rigs, control_period)
        gains = {name: float(value) for name, value in self.gains.items()}
        self._view = PlanningView(slew=gains.pop("rise"), probe=self.probe, **gains)
        self._outputs = np.zeros((num_rigs * self._view.rows_per_rig, self._view.num_actions))

    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        if len(observation) != self._num_rigs:
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got {len(observation)} observations"
            )
        if self._started:
            self._view.take_in(observation)
        else:
            self._begin(observation)
            self._started = True
        self.sent = np.asarray(self._view.command(self._outputs), dtype=float)
        return self.sent

    def _begin(self, observation: NDArray[np.floating[Any]]) -> None:
        self._view.start(observation, self.period)
