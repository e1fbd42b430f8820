"""Steady flow curves of valves as the valve bench finds them, for controllers that had each pair there beforehand; units as in
`estimation.nominal`."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from hydro_env.controllers.base import Controller, Floats, Measurements
from hydro_env.controllers.estimation.nominal import RATED_FLOW
from hydro_env.errors import InputError
from hydro_env.plant import Plant
from hydro_env.valve_bench import Curve, loop_of, record_rigs, sides_of

#: Edge and gain that a valve is taken to have where the bench cannot read its curve: about the mean of its type.
UNREAD = 0.1, 0.8


@dataclass
class ValveMap:
    """Steady flow curve: in direction s, flow = s gain_s max(0, s command - edge_s).

    `edge` and `gain` have the shape (num_rigs, 2 channels, 2 directions), the positive direction first.
    """

    edge: Floats
    gain: Floats

    def command(self, flow: Floats, blend: float | Floats = 1e-3) -> Floats:
        """The command for a flow, both (num_rigs, 2). Below `blend` (a flow) the jump over the dead zone is
        a ramp.
        """
        negative = (flow < 0.0).astype(int)[..., None]
        edge = np.take_along_axis(self.edge, negative, axis=2)[..., 0]
        gain = np.take_along_axis(self.gain, negative, axis=2)[..., 0]
        sign = np.where(flow < 0.0, -1.0, 1.0)
        beyond = sign * (edge + np.abs(flow) / gain)
        middle = 0.5 * (self.edge[..., 0] - self.edge[..., 1])
        return middle + np.clip(np.abs(flow) / blend, 0.0, 1.0) * (beyond - middle)


class FromTheBench(Controller):
    """A controller that had the valves on a bench beforehand: `valves` are a slow sweep of each, its dead zones and normal flow
    gains as `hydro-env valve-test` reports them. Nothing else of the plant is looked at."""

    needs = "bench"
    valves: ValveMap

    def prepare(self, plant: Plant) -> None:
        """The state of the plant is used up."""
        key = plant.model.name, plant.effects, plant.tolerance, plant.memory.tobytes()
        found = _measured(_Rigs(plant, key), self.scales.flow)
        self.valves = ValveMap(edge=found[..., 0].copy(), gain=found[..., 1].copy())

    def start(self, measured: Measurements) -> None:
        if not hasattr(self, "valves"):
            raise RuntimeError(f"{self.name} needs prepare(plant) before the episode: its valves on a bench")
        super().start(measured)


@dataclass(frozen=True)
class _Rigs:
    """A plant that equals another one of the same model, parameters and state, which are the `key`."""

    plant: Plant = field(compare=False)
    key: tuple[object, ...]


@lru_cache(maxsize=8)  # the same pairs come back in every scenario of a suite, for every controller
def _measured(rigs: _Rigs, flow: float) -> Floats:
    """Edge and gain, (num_rigs, 2 channels, 2 sides, 2)."""
    return np.array([[_read(curve, flow * RATED_FLOW) for curve in pair] for pair in record_rigs(rigs.plant)])


def _read(curve: Curve, rated_flow: float) -> tuple[tuple[float, float], ...]:
    """Edge and gain of a valve each way, as shares of its rated command and of the rated flow over that."""
    try:
        found = sides_of(curve, loop_of(curve))
    except InputError:
        return UNREAD, UNREAD
    return tuple(
        UNREAD if side is None else (side.dead_zone / curve.rated, side.gain * curve.rated / rated_flow)
        for side in (found[1], found[-1])
    )
