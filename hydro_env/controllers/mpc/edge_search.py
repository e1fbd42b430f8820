"""Looking for the edges of the dead zones: probing at rest, and crossing.

Probing: while the set-point is zero and edges are unknown, both spools sweep slowly through their dead zones, first to
the positive side, then to the negative one, and turn back at the first sign of flow. The shafts move by a few rpm; all ends at
once when the set-point moves.

Where the spool model is to be relied on (`led`), the commands of a sweep bring the spool where it is wanted in two periods, so
that sweeps are steady from the beginning. One that may have found flow stands still for a sample until that is sure; one that
has found it goes back within a period, so that little flows on the way.

Crossing a dead zone whose far edge is unknown: both spools creep up to their edges, and the first to flow waits there for the
other, while the reference coasts as a motor without flow does.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import TUNED, Bools, Floats
from hydro_env.controllers.estimation.nominal import FLOWING, TUNED_PERIOD
from hydro_env.controllers.estimation.spool import Channel, SpoolModel, deadbeat_position, deadbeat_state
from hydro_env.controllers.estimation.valve_estimator import ValveEstimator, ValveState
from hydro_env.jit import compiled
from hydro_env.units import RPM

#: Set-point up to which the rig counts as at rest, rad/s.
AT_REST = 5.0 * RPM
#: Where a sweep begins, on the other side of the middle.
FROM = -0.02
#: Where one ends that has seen no flow; Fig. 2 shows an edge at 0.4.
FARTHEST = 0.5
#: Samples for the spools to come home.
SETTLE = 2


class ProbingSettings(NamedTuple):
    """How valves are probed at rest."""

    active: Annotated[bool, "", "whether they are; a shaft that must not move at rest forbids it"] = True
    led: Annotated[bool, "", "whether sweeps follow the spool model, which has to fit the valves"] = True
    sweep: Annotated[float, "1/s", "pace of the spools, rated commands a second", TUNED] = 2.65
    detect: Annotated[float, "1", "flow that ends a sweep", "four standard deviations of its noise"] = 0.008
    hold: Annotated[float, "1", "flow at which a led sweep stands still for a sample", TUNED] = 0.0042
    again: Annotated[float, "1", "flow that then ends it", TUNED] = 0.006
    begin: Annotated[float, "periods", "how far a led sweep is to be after two periods", TUNED] = 2.5
    back: Annotated[float, "periods", "the same after it has turned", TUNED] = 1.4
    least: Annotated[float, "1", "distance behind its first edge a period after it", TUNED] = 0.04
    clear: Annotated[float, "1", "or this share of its way from rest, where that is more", TUNED] = 0.5
    home: Annotated[float, "1", "and at its second edge, as a share of the dead zone", TUNED] = 0.42
    patience: Annotated[float, "rpm", "smoothly moving set-point below which probing goes on", TUNED] = 250.0


class Probing:
    """`active` (num_rigs,): rigs that probe. `sides` (num_rigs, 2): sides each spool has done."""

    def __init__(self, settings: ProbingSettings, num_rigs: int, period: float) -> None:
        self.settings, self._period = settings, period
        # at longer periods a spool swings too far for its model
        self._led = settings.led and period <= 1.5 * TUNED_PERIOD
        self._precise = self._led and abs(period - TUNED_PERIOD) < 1e-6
        pair = (num_rigs, 2)
        self.active, self.sides = np.full(num_rigs, settings.active, bool), np.zeros(pair, int)
        self._swept, self._settled = np.full(pair, FROM), np.zeros(num_rigs, int)
        # spools that stand still in their sweep; that have just found their first and their second edge
        self._waits, self._first, self._second = np.zeros((3, *pair), bool)

    @property
    def flowing(self) -> Floats:
        """What counts as flow where its noise is usual, (num_rigs, 2)."""
        return np.where(self._waits, self.settings.again, FLOWING)

    def update(self, setpoint: Floats, smooth: Bools, flow: Floats, noise: Floats, unknown: Bools) -> None:
        """Sweeps go on; a spool at whose motor flow shows turns to the other side.

        Args:
            setpoint: (num_rigs,), rad/s, and whether it moves smoothly.
            flow: measured, (num_rigs, 2), and its noise as a multiple of the usual.
            unknown: edges at which no flow was seen yet, (num_rigs, 2, 2).
        """
        if not self.active.any():
            return
        s, step = self.settings, self.settings.sweep * self._period
        still = smooth & (np.abs(setpoint) < s.patience * RPM)
        self.active &= np.abs(np.where(still, 0.0, setpoint)) < AT_REST
        active = self.active[:, None]
        away = np.where(self.sides == 0, 1.0, -1.0) * flow
        found = away > np.where(self._waits, s.again, s.detect) * noise
        doubtful = (away > s.hold * noise) & ~found & ~self._waits
        self._waits = doubtful & (self.sides < 2) & active & self._precise
        turns = (found | (self._swept > FARTHEST)) & (self.sides < 2) & active
        self._first, self._second = turns & (self.sides == 0), turns & (self.sides == 1)
        self.sides = self.sides + turns
        self._swept = np.where(turns, FROM, self._swept + step)
        ready = self.active & np.all(self.sides == 2, axis=1)
        self._settled = np.where(ready, self._settled + 1, self._settled)
        self.active &= ~(ready & (self._settled > SETTLE))
        if s.led:  # an edge that has shown itself before is not looked for
            self.sides = np.where(self._first & ~unknown[..., 1], 2, self.sides)
        self._swept = self._swept - np.where(self._waits, step, 0.0)

    def steer(self, command: Floats, middle: Floats) -> None:
        """Replaces the commands (num_rigs, 2) of rigs that probe, in place; `middle` of the dead zones is home."""
        sweeps = np.where(self.sides == 0, self._swept, -self._swept)
        np.copyto(command, np.where(self.sides < 2, sweeps, middle), where=self.active[:, None])

    def lead(self, sent: Floats, spool: SpoolModel, valves: ValveEstimator, channel: Channel) -> Bools:
        """Replaces the commands `sent` (num_rigs, 2), in place, by those that bring spools along their sweep, and home when
        both edges are found; returns where."""
        swings = self.active[:, None] & ((self.sides < 2) | (self._settled == 0)[:, None])
        if not self._led or not self.active.any():
            return np.zeros_like(swings)
        s, edge = self.settings, valves.state.edge
        sign, home = np.where(self.sides == 0, 1.0, -1.0), self.sides == 2
        on = np.where(self.sides == 0, s.begin, s.back) * s.sweep * self._period
        place = spool.position, spool.speed, spool.coil
        goal = np.where(home, valves.middle, sign * (self._swept + on))
        deadbeat_state(sent, swings, *place, goal, np.where(home, 0.0, sign * s.sweep), channel)
        if self._precise:
            deadbeat_position(sent, swings & self._waits, *place, spool.position, channel)
            goal = edge[..., 0] - np.maximum(s.least, s.clear * edge[..., 0])
            goal = np.where(home, np.maximum(goal, valves.middle), goal)
            deadbeat_position(sent, swings & self._first, *place, goal, channel)
            goal = s.home * edge[..., 0] - (1.0 - s.home) * edge[..., 1]
            deadbeat_position(sent, swings & self._second, *place, goal, channel)
        return swings


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
