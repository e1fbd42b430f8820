"""The shaft alone, driven by the measured pressure: a filter, because its equation is linear."""

from __future__ import annotations

import numpy as np

from .filters import one_pole

__all__ = ["shaft_speed"]

#: Least viscous friction, N m s/rad, so that the filter has a time constant.
LEAST_FRICTION = 1e-6


def shaft_speed(
    pressure: np.ndarray, load: np.ndarray, period: float, *, displacement: float, inertia: float, friction: float
) -> np.ndarray:  # fmt: skip
    """Speed (T,) in rad/s of J dw/dt = D p - B w - load from rest; pressure (Pa) and load (N m) are held for a `period`."""
    friction = max(friction, LEAST_FRICTION)
    keep = float(np.exp(-period * friction / inertia))
    torque = np.concatenate([[0.0], (displacement * pressure - load)[:-1]])
    return one_pole((1.0 - keep) / friction * torque, keep)
