"""What can be known of a pair of valves while they are driven: where the spools stand, edges, gains, loads.

Everything has one row per rig and one column per channel; directions (positive, negative) are a third axis. Flows are
shares of the nominal rated flow, commands and spool positions shares of the rated command (so that the coil's unknown
resistance is part of edge and gain). The flow into a motor is seen from its pressure and speed (eq. 1).

`SpoolModel`     where the nominal spool goes under the commands: mass, spring, damping and Coulomb friction.
`ValveEstimate`  per valve one flow gain and two edges. An edge that no flow was seen at yet is known to lie beyond every
                 position the spool has visited (a uniform distribution); the first flow pins it down, an extended Kalman
                 filter refines it. Both directions share the gain, as one spool has one set of notches.
`LoadEstimate`   torque on each shaft; a jump is taken in at once, noise is averaged.
"""

from __future__ import annotations

from math import exp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.jit import compiled

__all__ = ["FLOWING", "LoadEstimate", "SpoolModel", "ValveEstimate"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any] | slice

FLOWING = 0.008
"""Share of the rated flow that counts as flow: four standard deviations of the measured flow's noise."""
NOISE = 0.002
"""Standard deviation of the measured flow."""
NEAREST_EDGE, FARTHEST_EDGE = -0.04, 0.26
"""Where an edge lies that nothing is known of: dead zones of 0-200 um, offsets of +-30 um. Flow may still show up later."""
GAIN, GAIN_SCATTER = 0.82, 0.12
"""Flow gain of valves of this type and its standard deviation."""
STALE = 0.02
"""Standard deviation up to which an edge that is not visited is forgotten."""
SUBSTEP = 1.25e-3
"""The spool model's own step, s; its period is 30 ms."""


class SpoolModel:
    """Positions (num_rigs, 2) of nominal spools. `rate` of the mode in 1/s, `friction` as a share of the rated command."""

    late_by = 0.0
    """Time by which the measured flow is behind the spools, s."""

    def __init__(self, num_rigs: int, period: float, rate: float, damping: float, friction: float) -> None:
        self._steps = max(1, round(period / SUBSTEP))
        step = period / self._steps
        self._push = step * rate * rate
        self._grip = self._push * friction
        self._decay = exp(-2.0 * damping * rate * step)
        self._step, self._rate = step, rate
        self.position, self.speed = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2))
        self.ringing = np.zeros((num_rigs, 2))

    @property
    def shown(self) -> Floats:
        """Positions (num_rigs, 2) that the measured flow tells of."""
        return self.position - self.late_by * self.speed

    def place(self, rows: Rows, position: Floats) -> None:
        """Puts spools to rest at a position."""
        self.position[rows], self.speed[rows], self.ringing[rows] = position, 0.0, 0.0

    def move(self, command: Floats) -> None:
        """One control period under held commands; `ringing` is the squared amplitude of the swing about the last one."""
        _move(
            self.position, self.speed, self.ringing, np.ascontiguousarray(command), self._steps, self._decay, self._push,
            self._grip, self._step, self._rate,
        )  # fmt: skip


@compiled
def _move(position, speed, ringing, command, steps, decay, push, grip, step, rate):
    for i in range(position.shape[0]):
        for c in range(2):
            x, v, u = position[i, c], speed[i, c], command[i, c]
            for _ in range(steps):
                v = decay * v + push * (u - x)
                v = np.sign(v) * max(abs(v) - grip, 0.0)
                x = x + step * v
            position[i, c], speed[i, c] = x, v
            ringing[i, c] = (x - u) ** 2 + (v / rate) ** 2


class ValveEstimate:
    """Edges (num_rigs, 2, 2) and gains (num_rigs, 2) with their covariance.

    Args:
        drift, gain_drift: random walk of edge and gain per root second, which keeps the estimate awake to friction.
        doubt: standard deviation of the modelled spool position at rest, and per amplitude of its swing.
        first: standard deviation of an edge at which flow was seen for the first time.
        moved: swing of a spool about its command, in rated travels, from which on the walk is at full pace; friction shifts
            an edge while the spool moves. 0: always.
        idle: share of that pace at which the walk goes on while the spool rests.
        unused: random walk of the edge on the other side of the dead zone, up to `STALE`.
    """

    def __init__(
        self,
        num_rigs: int,
        period: float,
        *,
        drift: float,
        gain_drift: float,
        doubt: tuple[float, float],
        first: float,
        moved: float = 0.0,
        idle: float = 0.0,
        unused: float = 0.0,
    ) -> None:
        self._walk = np.array([gain_drift, drift]) ** 2 * period
        self._doubt, self._first, self._moved = doubt, first, moved
        self._idle, self._unused = idle, unused**2 * period
        self.gain, self.edge = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2, 2))
        self.unknown, self.nearest = np.zeros((num_rigs, 2, 2), bool), np.zeros((num_rigs, 2, 2))
        # variances of gain and edges, and covariances: gain with edge, edge with edge
        self.gain_variance, self.edge_variance = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2, 2))
        self.shared, self.between = np.zeros((num_rigs, 2, 2)), np.zeros((num_rigs, 2))
        self.surprise = np.zeros((num_rigs, 2))

    def forget(self, rows: Rows) -> None:
        """Back to what is known of any valve."""
        self.gain[rows], self.edge[rows] = GAIN, 0.5 * (NEAREST_EDGE + FARTHEST_EDGE)
        self.unknown[rows], self.nearest[rows] = True, NEAREST_EDGE
        self.gain_variance[rows] = GAIN_SCATTER**2
        self.edge_variance[rows] = (FARTHEST_EDGE - NEAREST_EDGE) ** 2 / 12.0
        self.shared[rows], self.between[rows], self.surprise[rows] = 0.0, 0.0, 0.0

    def told(self, edge: Floats, gain: Floats, edge_doubt: float, gain_doubt: float) -> None:
        """Begins with edges (num_rigs, 2, 2) and gains (num_rigs, 2) from elsewhere, known with these standard deviations."""
        self.edge[:], self.gain[:] = edge, gain
        self.unknown[:] = False
        self.edge_variance[:], self.gain_variance[:] = edge_doubt**2, gain_doubt**2
        self.shared[:], self.between[:] = 0.0, 0.0

    @property
    def middle(self) -> Floats:
        """The middle of each dead zone, (num_rigs, 2)."""
        middle: Floats = 0.5 * (self.edge[..., 0] - self.edge[..., 1])
        return middle

    def learn(self, spool: SpoolModel, flow: Floats, noisier: Floats, least: Floats | None = None) -> None:
        """Takes in the measured flows (num_rigs, 2) with the spools where the model has them, and moves these to where the
        flow shows them.

        `noisier`: the flows' noise as a multiple of `NOISE`, (num_rigs, 2); `least`: what counts as flow, (num_rigs, 2),
        `FLOWING` where it is not given.
        """
        least = FLOWING * noisier if least is None else least
        shown = spool.shown
        late = spool.position - shown
        _learn(
            shown, spool.ringing, flow, noisier, least, self._walk[0], self._walk[1], *self._doubt, self._first,
            self._moved, self._idle, self._unused, self.gain, self.edge, self.unknown, self.nearest, self.gain_variance,
            self.edge_variance, self.shared, self.between, self.surprise,
        )  # fmt: skip
        spool.position[:] = shown + late


@compiled
def _learn(
    position, ringing, flow, noisier, least, gain_walk, edge_walk, still, moving, first, moved, idle, unused,
    gain, edge, unknown, nearest, gain_variance, edge_variance, shared, between, surprise,
):  # fmt: skip
    along = np.empty(2)
    for i in range(gain.shape[0]):
        for c in range(2):
            flowing = least[i, c]
            # where flow tells nothing, the side of the dead zone's middle on which the spool stands
            negative = position[i, c] < 0.5 * (edge[i, c, 0] - edge[i, c, 1])
            if abs(flow[i, c]) > flowing:
                negative = flow[i, c] < 0.0
            here, there, sign = (1, 0, -1.0) if negative else (0, 1, 1.0)
            place, seen = sign * position[i, c], sign * flow[i, c]
            flows = seen > flowing
            miss = 0.0
            if unknown[i, c, here]:
                # no flow rules out what the spool has passed, flow ends the search
                if flows:
                    unknown[i, c, here] = False
                    edge[i, c, here] = place - seen / gain[i, c]
                    edge_variance[i, c, here] = first**2 + (0.15 * seen) ** 2
                else:
                    nearest[i, c, here] = max(nearest[i, c, here], min(place - 0.01, 0.5))
                    farthest = max(FARTHEST_EDGE, nearest[i, c, here] + 0.04)
                    edge[i, c, here] = 0.5 * (nearest[i, c, here] + farthest)
                    edge_variance[i, c, here] = (farthest - nearest[i, c, here]) ** 2 / 12.0
            elif place > edge[i, c, here] or flows:
                stir = min(1.0, max(idle, ringing[i, c] / moved**2)) if moved > 0.0 else 1.0
                gain_variance[i, c] += gain_walk * stir
                edge_variance[i, c, here] += edge_walk * stir
                # measured = gain * beyond: derivatives by gain and by the edge of this direction
                beyond, by_edge = max(place - edge[i, c, here], 0.0), -gain[i, c]
                along_gain = beyond * gain_variance[i, c] + by_edge * shared[i, c, here]
                along[here] = beyond * shared[i, c, here] + by_edge * edge_variance[i, c, here]
                along[there] = beyond * shared[i, c, there] + by_edge * between[i, c]
                misplaced = still**2 + moving**2 * ringing[i, c]
                noise = (NOISE * noisier[i, c]) ** 2 + gain[i, c] ** 2 * misplaced
                miss = seen - gain[i, c] * beyond
                weight = 1.0 / (beyond * along_gain + by_edge * along[here] + noise)
                position[i, c] += weight * gain[i, c] * misplaced * (sign * miss)
                gain[i, c] = min(max(gain[i, c] + weight * along_gain * miss, 0.3), 1.6)
                gain_variance[i, c] -= weight * along_gain**2
                between[i, c] -= weight * along[here] * along[there]
                for d in range(2):
                    edge[i, c, d] += weight * miss * along[d]
                    edge_variance[i, c, d] = max(edge_variance[i, c, d] - weight * along[d] ** 2, 1e-8)
                    shared[i, c, d] -= weight * along_gain * along[d]
            if edge_variance[i, c, there] < STALE**2:
                edge_variance[i, c, there] += unused
            surprise[i, c] = sign * miss
            for d in range(2):
                edge[i, c, d] = min(max(edge[i, c, d], -0.15), 0.6)


class LoadEstimate:
    """Torque on each shaft, N m, (num_rigs, 2): what the pressure gives less what accelerates the shaft.

    Args:
        share: of a new value that enters the mean while nothing jumps.
        jump: the difference from which on a new value counts as a jump and is taken in whole, N m.
    """

    def __init__(self, num_rigs: int, period: float, inertia: float, share: float, jump: float) -> None:
        self._share, self._jump, self._per_speed = share, jump, inertia / period
        self.torque: Floats = np.zeros((num_rigs, 2))
        self.miss: Floats = np.zeros((num_rigs, 2))
        self._speed, self._shaft = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2))

    def forget(self, rows: Rows, speed: Floats, shaft: Floats) -> None:
        """No load; `speed` and torque of the `shaft` as they are now."""
        self.torque[rows], self.miss[rows] = 0.0, 0.0
        self._speed[rows], self._shaft[rows] = speed, shaft

    def step(self, speed: Floats, shaft: Floats, noisier: Floats, blind: NDArray[np.bool_]) -> None:
        """Takes in the speeds (rad/s) and what the shafts give after friction (N m).

        `noisier`: the speeds' noise as a multiple of the usual. Where `blind`, the torque stays as it is.
        """
        _weigh(
            self.torque, self.miss, self._speed, self._shaft, np.ascontiguousarray(speed), shaft, noisier, blind,
            self._share, self._jump, self._per_speed,
        )  # fmt: skip


@compiled
def _weigh(torque, miss, speed, shaft, new_speed, new_shaft, noisier, blind, share, jump, per_speed):
    for i in range(torque.shape[0]):
        for c in range(2):
            load = 0.5 * (new_shaft[i, c] + shaft[i, c]) - per_speed * (new_speed[i, c] - speed[i, c])
            miss[i, c] = 0.0 if blind[i, c] else load - torque[i, c]
            counts = jump * noisier[i, c]
            jumps = min(max((abs(miss[i, c]) - counts) / (0.7 * counts), 0.0), 1.0)
            torque[i, c] += (share + (1.0 - share) * jumps) * miss[i, c]
            speed[i, c], shaft[i, c] = new_speed[i, c], new_shaft[i, c]
