"""The nominal spool: where a command moves it, and the filter that does not set its lightly damped mode ringing."""

from __future__ import annotations

from math import cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from hydro_env.plant import PARAMETERS

__all__ = ["Spool", "shaper"]


class Spool:
    """Where the nominal spool stands (share of its rated travel): mass, spring, damping, sampled exactly."""

    def __init__(self, position: NDArray[np.float64], period: float, damping: float = 0.15) -> None:
        rate = sqrt(PARAMETERS["k"].nominal / PARAMETERS["m"].nominal)
        continuous = np.array(
            [[0.0, 1.0, 0.0], [-rate * rate, -2.0 * damping * rate, rate * rate], [0.0, 0.0, 0.0]]
        )
        self._held = expm(continuous * period)
        self.position, self.speed = np.array(position, dtype=float), np.zeros_like(position, dtype=float)

    def step(self, command: NDArray[np.float64]) -> None:
        """Moves on by one period under a held command."""
        (a, b, c), (d, e, f), _ = self._held
        self.position, self.speed = (
            a * self.position + b * self.speed + c * command,
            d * self.position + e * self.speed + f * command,
        )


def shaper(period: float) -> tuple[int, float]:
    """Spacing (samples) and outer weight of the filter a, 1 - 2a, a that leaves the spool's mode at rest.

    The filter's response at the mode's angle per spacing phi is 2 a cos(phi) + 1 - 2a, which
    a = 1 / (2 (1 - cos phi)) makes zero; phi near 120 degrees gives three equal weights. Without a usable
    spacing (slow sampling) no filter.
    """
    rate = sqrt(PARAMETERS["k"].nominal / PARAMETERS["m"].nominal)
    spacing = max(1, round(2.0 * pi / 3.0 / rate / period))
    phi = rate * period * spacing
    weight = 0.5 / (1.0 - cos(phi)) if cos(phi) < 0.0 and phi < 1.5 * pi else 0.0
    return spacing, weight
