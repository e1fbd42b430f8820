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
SUBSTEP = 1.25e-3
"""The spool model's own step, s; its period is 30 ms."""


class SpoolModel:
    """Positions (num_rigs, 2) of nominal spools. `rate` of the mode in 1/s, `friction` as a share of the rated command."""

    def __init__(self, num_rigs: int, period: float, rate: float, damping: float, friction: float) -> None:
        self._steps = max(1, round(period / SUBSTEP))
        step = period / self._steps
        self._push = step * rate * rate
        self._grip = self._push * friction
        self._decay = exp(-2.0 * damping * rate * step)
        self._step, self._rate = step, rate
        self.position, self.speed = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2))
        self.ringing = np.zeros((num_rigs, 2))

    def place(self, rows: Rows, position: Floats) -> None:
        """Puts spools to rest at a position."""
        self.position[rows], self.speed[rows], self.ringing[rows] = position, 0.0, 0.0

    def move(self, command: Floats) -> None:
        """One control period under held commands; `ringing` is the squared amplitude of the swing about the last one."""
        position, speed = self.position, self.speed
        for _ in range(self._steps):
            speed = self._decay * speed + self._push * (command - position)
            speed = np.sign(speed) * np.maximum(np.abs(speed) - self._grip, 0.0)
            position = position + self._step * speed
        self.position, self.speed = position, speed
        self.ringing = (position - command) ** 2 + (speed / self._rate) ** 2


class ValveEstimate:
    """Edges (num_rigs, 2, 2) and gains (num_rigs, 2) with their covariance.

    Args:
        drift, gain_drift: random walk of edge and gain per root second, which keeps the estimate awake to friction.
        doubt: standard deviation of the modelled spool position at rest, and per amplitude of its swing.
        first: standard deviation of an edge at which flow was seen for the first time.
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
    ) -> None:
        self._walk = np.array([gain_drift, drift]) ** 2 * period
        self._doubt, self._first = doubt, first
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

    @property
    def edge_deviation(self) -> Floats:
        """Standard deviations of the edges, (num_rigs, 2, 2)."""
        return np.sqrt(self.edge_variance)

    @property
    def middle(self) -> Floats:
        """The middle of each dead zone, (num_rigs, 2)."""
        middle: Floats = 0.5 * (self.edge[..., 0] - self.edge[..., 1])
        return middle

    def capacity(self) -> Floats:
        """Flow at the rated command, (num_rigs, 2, 2)."""
        return self.gain[..., None] * np.maximum(1.0 - self.edge, 0.1)

    def command(self, flow: Floats, blend: float) -> Floats:
        """Commands for flows (num_rigs, 2). Below `blend` the jump over the dead zone is a ramp."""
        negative = flow < 0.0
        edge = np.where(negative, self.edge[..., 1], self.edge[..., 0])
        beyond = np.where(negative, -1.0, 1.0) * (edge + np.abs(flow) / self.gain)
        middle = self.middle
        command: Floats = middle + np.minimum(np.abs(flow) / blend, 1.0) * (beyond - middle)
        return command

    def learn(self, spool: SpoolModel, flow: Floats, noisier: Floats | float = 1.0) -> None:
        """Takes in the measured flows (num_rigs, 2) with the spools where the model has them.

        `noisier`: their noise as a multiple of `NOISE`, (num_rigs, 2).
        """
        flowing = FLOWING * noisier
        # where flow tells nothing, the side of the dead zone's middle on which the spool stands
        negative = np.where(np.abs(flow) > flowing, flow < 0.0, spool.position < self.middle)
        sign = np.where(negative, -1.0, 1.0)
        here = np.stack([~negative, negative], axis=-1)  # the direction in which each spool stands
        position, seen = sign * spool.position, sign * flow
        flows = seen > flowing
        unknown = np.any(self.unknown & here, axis=-1)
        self._search(here & unknown[..., None], position, seen, flows)

        edge = np.where(negative, self.edge[..., 1], self.edge[..., 0])
        active = ~unknown & ((position > edge) | flows)
        walk = np.where(active, 1.0, 0.0)
        self.gain_variance = self.gain_variance + walk * self._walk[0]
        self.edge_variance = self.edge_variance + np.where(here, walk[..., None] * self._walk[1], 0.0)
        # measured = gain * beyond: derivatives by gain and by the edge of this direction
        beyond, by_edge = np.maximum(position - edge, 0.0), -self.gain
        variance = np.where(negative, self.edge_variance[..., 1], self.edge_variance[..., 0])
        shared = np.where(negative, self.shared[..., 1], self.shared[..., 0])
        other = np.where(negative, self.shared[..., 0], self.shared[..., 1])
        along_gain = beyond * self.gain_variance + by_edge * shared
        along_edge = beyond * shared + by_edge * variance
        along_other = beyond * other + by_edge * self.between
        still, moving = self._doubt
        misplaced = still**2 + moving**2 * spool.ringing
        noise = (NOISE * noisier) ** 2 + self.gain**2 * misplaced
        total = beyond * along_gain + by_edge * along_edge + noise
        miss = np.where(active, seen - self.gain * beyond, 0.0)
        weight = np.where(active, 1.0 / total, 0.0)
        self.surprise = sign * miss
        spool.position = spool.position + weight * self.gain * misplaced * self.surprise
        self.gain = np.clip(self.gain + weight * along_gain * miss, 0.3, 1.6)
        along = np.where(here, along_edge[..., None], along_other[..., None])
        self.edge = np.clip(self.edge + (weight * miss)[..., None] * along, -0.15, 0.6)
        self.gain_variance = self.gain_variance - weight * along_gain**2
        self.edge_variance = np.maximum(self.edge_variance - weight[..., None] * along**2, 1e-8)
        self.shared = self.shared - (weight * along_gain)[..., None] * along
        self.between = self.between - weight * along_edge * along_other

    def _search(
        self, here: NDArray[np.bool_], position: Floats, seen: Floats, flows: NDArray[np.bool_]
    ) -> None:
        """Edges not found yet, in the directions `here`: no flow rules out what the spool has passed, flow ends it."""
        if not here.any():
            return
        passed = np.minimum(position - 0.01, 0.5)[..., None]
        dry = here & ~flows[..., None]
        self.nearest = np.where(dry, np.maximum(self.nearest, passed), self.nearest)
        farthest = np.maximum(FARTHEST_EDGE, self.nearest + 0.04)
        self.edge = np.where(dry, 0.5 * (self.nearest + farthest), self.edge)
        self.edge_variance = np.where(dry, (farthest - self.nearest) ** 2 / 12.0, self.edge_variance)
        found = here & flows[..., None]
        self.edge = np.where(found, (position - seen / self.gain)[..., None], self.edge)
        self.edge_variance = np.where(
            found, self._first**2 + (0.15 * seen[..., None]) ** 2, self.edge_variance
        )
        self.unknown = self.unknown & ~found


class LoadEstimate:
    """Torque on each shaft, N m, (num_rigs, 2): what the pressure gives less what accelerates the shaft.

    Args:
        share: of a new value that enters the mean while nothing jumps.
        jump: the difference from which on a new value counts as a jump and is taken in whole, N m.
    """

    def __init__(self, num_rigs: int, period: float, inertia: float, share: float, jump: float) -> None:
        self._share, self._jump, self._per_speed = share, jump, inertia / period
        self.torque = np.zeros((num_rigs, 2))
        self.miss = np.zeros((num_rigs, 2))
        self._speed, self._shaft = np.zeros((num_rigs, 2)), np.zeros((num_rigs, 2))

    def forget(self, rows: Rows, speed: Floats, shaft: Floats) -> None:
        """No load; `speed` and torque of the `shaft` as they are now."""
        self.torque[rows], self.miss[rows] = 0.0, 0.0
        self._speed[rows], self._shaft[rows] = speed, shaft

    def step(self, speed: Floats, shaft: Floats, noisier: Floats | float = 1.0, blind: Any = False) -> None:
        """Takes in the speeds (rad/s) and what the shafts give after friction (N m).

        `noisier`: the speeds' noise as a multiple of the usual. Where `blind`, the torque stays as it is.
        """
        load = 0.5 * (shaft + self._shaft) - self._per_speed * (speed - self._speed)
        self.miss = np.where(blind, 0.0, load - self.torque)
        jump = self._jump * noisier
        jumps = np.clip((np.abs(self.miss) - jump) / (0.7 * jump), 0.0, 1.0)
        self.torque = self.torque + (self._share + (1.0 - self._share) * jumps) * self.miss
        self._speed, self._shaft = np.array(speed, dtype=float), np.array(shaft)
