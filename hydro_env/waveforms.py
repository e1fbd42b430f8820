"""Test signals that simulated experiments share."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def triangle(phase: NDArray[np.floating[Any]]) -> NDArray[Any]:
    """A triangle wave between -1 and 1 over `phase` in cycles: 0 at phase 0, rising, 1 at a quarter, -1 at three quarters."""
    return np.abs((4.0 * phase + 3.0) % 4.0 - 2.0) - 1.0
