"""Test signals that simulated experiments share."""

import numpy as np

from hydro_env.arrays import AnyArray, Reals


def triangle(phase: Reals) -> AnyArray:
    """A triangle wave between -1 and 1 over `phase` in cycles: 0 at phase 0, rising, 1 at a quarter, -1 at three quarters."""
    return np.abs((4.0 * phase + 3.0) % 4.0 - 2.0) - 1.0
