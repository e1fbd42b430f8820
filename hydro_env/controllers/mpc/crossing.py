"""Crossing a dead zone whose far edge is unknown: both spools creep up to their edges, and the first to flow waits there for the
other, while the reference coasts as a motor without flow does."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import TUNED, Bools, Floats
from hydro_env.controllers.estimation.nominal import FLOWING, TUNED_PERIOD
from hydro_env.controllers.estimation.valve_estimator import ValveState
from hydro_env.jit import compiled


class CrossingSettings(NamedTuple):
    """When an edge is searched during a crossing, and how fast."""

    search: Annotated[float, "1/s", "pace of the spools, rated commands a second", TUNED] = 9.3
    known: Annotated[float, "1", "standard deviation of an edge that is not looked for", TUNED] = 0.0235


class CrossingState(NamedTuple):
    """Direction of the flow (N,), whether the rig crosses (N,), and where its spools have crept to (N, 2)."""

    direction: Floats
    active: Bools
    position: Floats


class Crossing:
    """Holds a `CrossingState` in `state`, whose arrays keep their place."""

    def __init__(self, settings: CrossingSettings, num_rigs: int, period: float) -> None:
        self._known = settings.known
        # at longer periods spools creep as far a sample as usual
        self._creep = settings.search * min(1.0, TUNED_PERIOD / period) * period
        self.state = CrossingState(np.zeros(num_rigs), np.zeros(num_rigs, bool), np.zeros((num_rigs, 2)))

    def update(self, demand: Floats, valves: ValveState, probing: Bools) -> None:
        """Begins a crossing where the flow that the reference takes (num_rigs,) changes its direction and an edge there is
        unknown."""
        _begin(self._known, demand, valves, probing, self.state)

    def steer(self, command: Floats, flow: Floats, flowing: Floats, valves: ValveState) -> None:
        """Replaces the commands (num_rigs, 2) of rigs that cross, in place. `flow`: measured, `flowing`: what counts as flow,
        both (num_rigs, 2)."""
        _creep(self._known, self._creep, command, flow, flowing, valves, self.state)


@compiled
def _begin(known, demand, valves, probing, x):
    for i in range(demand.size):
        if abs(demand[i]) > 2.0 * FLOWING and np.sign(demand[i]) != x.direction[i] and not probing[i]:
            x.direction[i] = np.sign(demand[i])
            d = 1 if x.direction[i] < 0.0 else 0
            x.active[i] = False
            for c in range(2):
                deviation = np.sqrt(valves.edge_variance[i, c, d])
                cautious = valves.edge[i, c, d] - 2.0 * deviation
                x.position[i, c] = valves.passed[i, c, d] if valves.unknown[i, c, d] else cautious
                if deviation > known:
                    x.active[i] = True


@compiled
def _creep(known, creep, command, flow, flowing, valves, x):
    there = np.empty(2, np.bool_)
    for i in range(command.shape[0]):
        d = 1 if x.direction[i] < 0.0 else 0
        for c in range(2):
            flows = x.direction[i] * flow[i, c] > flowing[i, c]
            # an edge too far away: no flow is seen, a sick sensor
            there[c] = flows or np.sqrt(valves.edge_variance[i, c, d]) < known or x.position[i, c] > 0.6
            if not there[c]:
                x.position[i, c] += creep
        x.active[i] = x.active[i] and not (there[0] and there[1])
        if x.active[i]:
            for c in range(2):
                waits = valves.edge[i, c, d] + FLOWING / valves.gain[i, c]
                command[i, c] = x.direction[i] * (waits if there[c] else x.position[i, c])
