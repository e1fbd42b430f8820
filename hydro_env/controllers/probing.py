"""Flow control that probes the valves while the rig rests: the law beneath the learned agents, without a network.

`adaptive_flow` learns edges and gains where the drive happens to take it. This one looks for them beforehand, in the rest
before the set-point first moves, and goes on from there; `flow_view` describes its parts. Its constants were found by an
evolution strategy on pairs of `train` (docs/agents.md). Two of them are left to the user, because they choose the place on
the front of speed difference over tracking error.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Controller, Floats, Gain
from hydro_env.controllers.flow_view import FlowView

__all__ = ["ProbingFlow"]


class ProbingFlow(Controller):
    """See the module's text. The drawn valves are unknown to it, the paper's motor is known."""

    GAINS = (
        Gain(
            "rate",
            "1/s",
            5.0,
            60.0,
            default=40.0,
            summary="rate at which the reference runs to the set-point",
        ),
        Gain(
            "rise",
            "1/s",
            3.0,
            60.0,
            default=27.0,
            summary="rated flows per second by which the flow may rise",
        ),
    )

    def reset(self, num_rigs: int, control_period: float) -> None:
        super().reset(num_rigs, control_period)
        self._view = FlowView(rate=float(self.gains["rate"]), slew=float(self.gains["rise"]))
        self._outputs = np.zeros((num_rigs * self._view.rows_per_rig, self._view.num_actions))

    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        if len(observation) != self._num_rigs:
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got {len(observation)} observations"
            )
        if self._started:
            self._view.take_in(observation)
        else:
            self._view.start(observation, self.period)
            self._started = True
        self.sent = np.asarray(self._view.command(self._outputs), dtype=float)
        return self.sent
