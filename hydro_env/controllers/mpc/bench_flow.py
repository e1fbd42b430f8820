"""The planned flow control of `probing_flow` for valves that were on a bench: it begins with what the bench found.

Nothing is probed at rest, so the shafts stand still until the set-point moves. Edges and gains go on being estimated, since
friction moves an edge by more than a bench can tell, and since valves change.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.estimation.bench_map import on_the_bench
from hydro_env.controllers.estimation.valve_map import ValveMap
from hydro_env.controllers.mpc.probing_flow import ProbingFlow
from hydro_env.plant import Plant

__all__ = ["BenchFlow"]

SURE = 0.015, 0.06
"""Standard deviations that an edge and a gain from the bench are given, as shares of rated command and rated gain. The bench
reads both far better, but friction shifts an edge from one reversal to the next; with less doubt the worst pairs part."""


class BenchFlow(ProbingFlow):
    """See the module's text. The paper's motor is known to it."""

    needs = "bench"
    GAINS = tuple(gain for gain in ProbingFlow.GAINS if gain.name in ("rate", "rise", "fall"))
    probe = 0.0
    valves: ValveMap | None = None

    def prepare(self, plant: Plant) -> None:
        self.valves = on_the_bench(plant)

    def _begin(self, observation: NDArray[np.floating[Any]]) -> None:
        if self.valves is None:
            raise RuntimeError(
                f"{self.name} needs prepare(plant) before the episode: it identifies the valves on a bench"
            )
        super()._begin(observation)
        self._view.valves.told(self.valves.edge, self.valves.gain.mean(axis=-1), *SURE)
