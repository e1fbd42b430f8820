"""The planned flow control of `probing_flow` for valves that were on a bench: it begins with what the bench found.

Nothing is probed at rest, so the shafts stand still until the set-point moves. Edges and gains go on being estimated, since
friction moves an edge by more than a bench can tell, and since valves change.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Controller, Floats, Gain
from hydro_env.controllers.compensated import on_the_bench
from hydro_env.controllers.planning_view import PlanningView
from hydro_env.controllers.valve_map import ValveMap
from hydro_env.plant import Plant

__all__ = ["BenchFlow"]

SURE = 0.015, 0.06
"""Standard deviations that an edge and a gain from the bench are given, as shares of rated command and rated gain. The bench
reads both far better, but friction shifts an edge from one reversal to the next; with less doubt the worst pairs part."""


class BenchFlow(Controller):
    """See the module's text. The paper's motor is known to it."""

    needs = "bench"
    GAINS = (
        Gain(
            "rate",
            "1/s",
            5.0,
            60.0,
            default=40.0,
            summary="rate at which the reference runs to the set-point",
        ),
        Gain("rise", "1/s", 3.0, 60.0, default=12.0, summary="rated flows a second by which flow may rise"),
        Gain("fall", "1", 1.0, 10.0, default=4.0, summary="how many times as fast it may fall"),
    )
    valves: ValveMap | None = None

    def prepare(self, plant: Plant) -> None:
        self.valves = on_the_bench(plant)

    def reset(self, num_rigs: int, control_period: float) -> None:
        super().reset(num_rigs, control_period)
        gains = {name: float(value) for name, value in self.gains.items()}
        self._view = PlanningView(slew=gains.pop("rise"), probe=0.0, **gains)
        self._outputs = np.zeros((num_rigs * self._view.rows_per_rig, self._view.num_actions))

    def act(self, observation: NDArray[np.floating]) -> Floats:
        if self.valves is None:
            raise RuntimeError(
                f"{self.name} needs prepare(plant) before the episode: it identifies the valves on a bench"
            )
        if len(observation) != self._num_rigs:
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got {len(observation)} observations"
            )
        if self._started:
            self._view.take_in(observation)
        else:
            self._view.start(observation, self.period)
            self._view.valves.told(self.valves.edge, self.valves.gain.mean(axis=-1), *SURE)
            self._started = True
        self.sent = np.asarray(self._view.command(self._outputs), dtype=float)
        return self.sent
