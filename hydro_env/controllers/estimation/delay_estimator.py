"""By how many control periods commands come late: how the flow changed is compared with how the modelled spool moved now, one
and two periods ago. A spool that sticks looks late too, but not both spools at once."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import HAND, Bools, Floats
from hydro_env.jit import compiled

MAX_DELAY = 2
"""Longest delay that is recognised, periods."""


class DelaySettings(NamedTuple):
    """When a delay is accepted. A planner needs more certainty than a filter does."""

    certain: Annotated[float, "1", "by how much the squares of both valves' misses have to differ", HAND] = (
        20.0
    )
    each: Annotated[float, "1", "and those of each valve", HAND] = 3.0
    most: Annotated[float, "1", "most that one sample counts: a spool that sticks once is no delay", HAND] = (
        9.0
    )
    model: Annotated[float, "1", "error of the modelled spool in a period, standard deviation", HAND] = 0.02
    loose: Annotated[float, "1", "and what share of its way it may have wrong", HAND] = 0.15


class DelayEstimator:
    """Whole control periods by which the commands come late, `periods` (num_rigs,)."""

    def __init__(self, settings: DelaySettings, position: Floats, flow: Floats) -> None:
        """Spools and flows (num_rigs, 2) as they are now."""
        self._settings = settings
        self.periods = np.zeros(len(position), int)
        self._position, self._flow = np.stack([position] * (MAX_DELAY + 2)), flow
        self._misses = np.zeros((MAX_DELAY + 1, *position.shape))

    def update(self, position: Floats, flow: Floats, gain: Floats, flowing: Floats, noise: Floats) -> Bools:
        """Takes in where a modelled spool is without any delay, and the flow; returns the rigs whose delay is now seen
        to be another one. `flowing`: what counts as flow, `noise`: standard deviation of the flow, both (num_rigs, 2).
        """
        self._position = np.concatenate([position[None], self._position[:-1]])
        change = np.empty(len(self.periods), bool)
        _compare(
            self._settings, self._position, self._flow, flow, gain, flowing, noise, self._misses, self.periods, change,
        )  # fmt: skip
        self._flow = flow
        return change


@compiled
def _compare(s, position, before, flow, gain, flowing, noise, misses, periods, change):
    together = np.empty(misses.shape[0])
    for i in range(periods.size):
        together[:] = 0.0
        for c in range(2):
            least = min(abs(flow[i, c]), abs(before[i, c]))
            both = least > flowing[i, c] and flow[i, c] * before[i, c] > 0.0
            for late in range(together.size):
                if both:
                    moved = position[late, i, c] - position[late + 1, i, c]
                    miss = flow[i, c] - before[i, c] - gain[i, c] * moved
                    model = s.model**2 + (s.loose * moved) ** 2
                    misses[late, i, c] += min(miss**2 / (2.0 * noise[i, c] ** 2 + model), s.most)
                together[late] += misses[late, i, c]
        now, best = periods[i], np.argmin(together)
        if now < best - 1 and together[best - 1] - together[best] < s.certain:
            best -= 1  # one period is accepted before two
        each = min(misses[now, i, 0] - misses[best, i, 0], misses[now, i, 1] - misses[best, i, 1])
        gap = together[now] - together[best]
        change[i] = best != now and gap > s.certain and together[best] < 0.5 * together[now] and each > s.each
        if change[i]:
            periods[i] = best
