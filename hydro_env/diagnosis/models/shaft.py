"""The shaft alone, driven by the measured pressure: a filter, because its equation is linear."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

__all__ = ["shaft_speed"]

#: Least viscous friction, N m s/rad, so that the filter has a time constant.
MIN_FRICTION = 1e-6


def shaft_speed(
    pressure: np.ndarray, load: np.ndarray, period: float, *, displacement: float, inertia: float, friction: float
) -> np.ndarray:  # fmt: skip
    """Speed (T,) in rad/s of J dw/dt = D p - B w - load from rest. The load (N m) is held for a `period`; between two samples of
    the pressure (Pa) stands their mean, as held it would come half a period late."""
    friction = max(friction, MIN_FRICTION)
    keep = float(np.exp(-period * friction / inertia))
    between = 0.5 * (pressure[1:] + pressure[:-1])
    torque = np.concatenate([[0.0], displacement * between - load[:-1]])
    return np.asarray(lfilter([(1.0 - keep) / friction], [1.0, -keep], torque))
