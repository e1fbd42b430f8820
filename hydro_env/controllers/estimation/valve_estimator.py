"""Recursive estimation of a pair of valves while they are driven: dead-zone edges and flow gain of each.

Everything has one row per rig and one column per channel; directions (positive, negative) are a third axis. Flows are shares
of the nominal rated flow, commands and spool positions shares of the rated command, so that the coil's unknown resistance is
part of edge and gain. The flow into a motor is seen from its pressure and speed (eq. 1).

An edge at which no flow was seen yet lies beyond every position the spool has visited (a uniform distribution); the first flow
pins it down, and an extended Kalman filter refines it. Both directions share the gain, as one spool has one set of notches.
"""

from math import inf
from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Bools, Floats
from hydro_env.controllers.base import HAND, TUNED, Rows
from hydro_env.controllers.estimation.nominal import FLOW_NOISE, FLOWING
from hydro_env.controllers.estimation.spool import SpoolModel
from hydro_env.jit import compiled


class ValveSettings(NamedTuple):
    """Prior, random walks and noise of the estimate."""

    nearest: Annotated[float, "1", "most of an edge on the other side", "null offsets to 30 um"] = 0.04
    farthest: Annotated[float, "1", "and at most so far", "dead zones to 200 um, null offsets to 30 um"] = 0.26  # fmt: skip
    gain: Annotated[float, "1", "mean flow gain of this type", "Kq 0.65 to 1 of the nominal one"] = 0.82
    gain_scatter: Annotated[float, "1", "its standard deviation", "the same range, and that of R"] = 0.12
    drift: Annotated[float, "1/sqrt(s)", "random walk of the edge, which friction shifts", TUNED] = 0.03
    gain_drift: Annotated[float, "1/sqrt(s)", "random walk of the gain", TUNED] = 0.004
    still: Annotated[float, "1", "standard deviation of a resting spool's modelled position", TUNED] = 0.0165
    moving: Annotated[float, "1", "and per amplitude of its swing", TUNED] = 0.06
    first: Annotated[float, "1", "standard deviation of an edge at the first flow seen there", TUNED] = 0.0065
    moved: Annotated[float, "1", "swing at which the walks have full pace: friction shifts edges", TUNED] = 0.1  # fmt: skip
    idle: Annotated[float, "1", "share of that pace at which they go on while the spool rests", TUNED] = 0.05
    unused: Annotated[float, "1/sqrt(s)", "random walk of the edge of the other direction", TUNED] = 0.02
    stale: Annotated[float, "1", "standard deviation where forgetting that edge ends", "4 um of travel"] = 0.02  # fmt: skip
    before: Annotated[float, "1", "no flow is believed farther before an edge, or what passed", HAND] = inf
    noise: Annotated[float, "1", "standard deviation of the measured flow", "sensors, eq. (1)"] = FLOW_NOISE


class ValveState(NamedTuple):
    """Estimates and their covariance, (N, 2) or (N, 2, 2 directions)."""

    gain: Floats
    edge: Floats
    unknown: Bools  # no flow was seen at this edge yet
    passed: Floats  # an unknown edge lies beyond this position
    gain_variance: Floats
    edge_variance: Floats
    gain_edge: Floats  # covariances: of the gain with each edge, and of both edges (N, 2)
    edge_edge: Floats
    innovation: Floats  # signed flow that the last sample had beyond the expected


class ValveEstimator:
    """Holds a `ValveState` in `state`, whose arrays keep their place; at first what is known of any valve of this type."""

    def __init__(self, settings: ValveSettings, num_rigs: int, period: float) -> None:
        self.settings, self._period = settings, period
        prior, pair, each = settings, (num_rigs, 2), (num_rigs, 2, 2)
        span = prior.farthest + prior.nearest
        self.state = ValveState(
            gain=np.full(pair, prior.gain), edge=np.full(each, 0.5 * (prior.farthest - prior.nearest)),
            unknown=np.ones(each, bool), passed=np.full(each, -prior.nearest),
            gain_variance=np.full(pair, prior.gain_scatter**2), edge_variance=np.full(each, span**2 / 12.0),
            gain_edge=np.zeros(each), edge_edge=np.zeros(pair), innovation=np.zeros(pair),
        )  # fmt: skip

    def begin_with(self, edge: Floats, gain: Floats, edge_deviation: float, gain_deviation: float) -> None:
        """Takes edges (num_rigs, 2, 2) and gains (num_rigs, 2) from elsewhere, known with these standard deviations."""
        v = self.state
        v.edge[:], v.gain[:], v.unknown[:] = edge, gain, False
        v.edge_variance[:], v.gain_variance[:] = edge_deviation**2, gain_deviation**2
        v.gain_edge[:], v.edge_edge[:] = 0.0, 0.0

    @property
    def middle(self) -> Floats:
        """The middle of each dead zone, (num_rigs, 2)."""
        return 0.5 * (self.state.edge[..., 0] - self.state.edge[..., 1])

    def expected_flow(self, position: Floats) -> Floats:
        """What valves with their spools at `position` (num_rigs, 2) pass by the estimate."""
        sign, edge = np.sign(position - self.middle), self.state.edge
        facing = np.where(sign < 0.0, edge[..., 1], edge[..., 0])
        return sign * self.state.gain * np.maximum(sign * position - facing, 0.0)

    def shift_edges(self, rows: Rows, shift: Floats) -> None:
        """Brings the edges of rigs nearer by `shift` (n, 1, 1), half of which may be wrong."""
        self.state.edge[rows] -= shift
        self.state.passed[rows] -= shift
        self.state.edge_variance[rows] += (0.5 * shift) ** 2

    def update(self, spool: SpoolModel, flow: Floats, noise: Floats, flowing: Floats | None = None) -> None:
        """Takes in the measured flows (num_rigs, 2) with the spools where the model has them, and moves these to where the
        flow shows them.

        `noise`: the flows' noise as a multiple of the usual; `flowing`: what counts as flow, both (num_rigs, 2).
        """
        flowing = FLOWING * noise if flowing is None else flowing
        shown = spool.shown
        lag = spool.position - shown
        _update(self.settings, self._period, shown, spool.ringing, flow, noise, flowing, self.state)
        spool.position[:] = shown + lag


@compiled
def _update(s, period, position, ringing, flow, noise, flowing, v):
    for i in range(v.gain.shape[0]):
        for c in range(2):
            # where flow tells nothing, the side of the dead zone's middle on which the spool stands
            negative = position[i, c] < 0.5 * (v.edge[i, c, 0] - v.edge[i, c, 1])
            if abs(flow[i, c]) > flowing[i, c]:
                negative = flow[i, c] < 0.0
            here, sign = (1, -1.0) if negative else (0, 1.0)
            place, seen = sign * position[i, c], sign * flow[i, c]
            first = v.passed[i, c, here] if v.unknown[i, c, here] else v.edge[i, c, here]
            flows = seen > flowing[i, c] and place > first - s.before
            miss = 0.0
            if v.unknown[i, c, here]:
                _search(s, i, c, here, place, seen, flows, v)
            elif place > v.edge[i, c, here] or flows:
                stir = min(1.0, max(s.idle, ringing[i, c] / s.moved**2))
                v.gain_variance[i, c] += s.gain_drift**2 * period * stir
                v.edge_variance[i, c, here] += s.drift**2 * period * stir
                uncertain = s.still**2 + s.moving**2 * ringing[i, c]  # variance of the modelled position
                miss, gain = _correct(s, i, c, here, place, seen, uncertain, noise[i, c], v)
                position[i, c] += gain * (sign * miss)
            if v.edge_variance[i, c, 1 - here] < s.stale**2:
                v.edge_variance[i, c, 1 - here] += s.unused**2 * period
            v.innovation[i, c] = sign * miss
            for d in range(2):
                v.edge[i, c, d] = min(max(v.edge[i, c, d], -0.15), 0.6)


@compiled
def _search(s, i, c, here, place, seen, flows, v):
    """An edge not seen yet: no flow rules out what the spool has passed, flow ends the search."""
    if flows:
        v.unknown[i, c, here] = False
        v.edge[i, c, here] = place - seen / v.gain[i, c]
        v.edge_variance[i, c, here] = s.first**2 + (0.15 * seen) ** 2  # the gain may be wrong by 15 %
    else:
        v.passed[i, c, here] = max(v.passed[i, c, here], min(place - 0.01, 0.5))
        farthest = max(s.farthest, v.passed[i, c, here] + 0.04)
        v.edge[i, c, here] = 0.5 * (v.passed[i, c, here] + farthest)
        v.edge_variance[i, c, here] = (farthest - v.passed[i, c, here]) ** 2 / 12.0


@compiled
def _correct(s, i, c, here, place, seen, uncertain, noise, v):
    """Kalman update with flow = gain (place - edge); returns the innovation and the gain towards the spool's position."""
    there = 1 - here
    along = np.empty(2)
    # derivatives by gain and by the edge
    beyond, by_edge = max(place - v.edge[i, c, here], 0.0), -v.gain[i, c]
    along_gain = beyond * v.gain_variance[i, c] + by_edge * v.gain_edge[i, c, here]
    along[here] = beyond * v.gain_edge[i, c, here] + by_edge * v.edge_variance[i, c, here]
    along[there] = beyond * v.gain_edge[i, c, there] + by_edge * v.edge_edge[i, c]
    variance = (s.noise * noise) ** 2 + v.gain[i, c] ** 2 * uncertain
    miss = seen - v.gain[i, c] * beyond
    weight = 1.0 / (beyond * along_gain + by_edge * along[here] + variance)
    to_position = weight * v.gain[i, c] * uncertain
    v.gain[i, c] = min(max(v.gain[i, c] + weight * along_gain * miss, 0.3), 1.6)
    v.gain_variance[i, c] -= weight * along_gain**2
    v.edge_edge[i, c] -= weight * along[here] * along[there]
    for d in range(2):
        v.edge[i, c, d] += weight * miss * along[d]
        v.edge_variance[i, c, d] = max(v.edge_variance[i, c, d] - weight * along[d] ** 2, 1e-8)
        v.gain_edge[i, c, d] -= weight * along_gain * along[d]
    return miss, to_position
