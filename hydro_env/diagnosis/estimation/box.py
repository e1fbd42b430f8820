"""The minimum of a quadratic function inside bounds.

`scipy.optimize.lsq_linear` finds the same; to import it takes a quarter of a second of every diagnosis.
"""

from __future__ import annotations

import numpy as np

__all__ = ["minimum_in_box"]

#: Gradient, as a share of the largest, up to which an unknown that lies at a bound is held there.
TOLERANCE = 1e-9


def minimum_in_box(matrix: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The x (k,) with low <= x <= high at which x' matrix x / 2 - side' x is least.

    `matrix` (k, k) is symmetric and positive definite, `side`, `low` and `high` are (k,). An active-set method as in bounded
    least squares (Stark and Parker 1995): unknowns at a bound are held, the others solved for, up to the first bound on the
    way there; one that is pulled inside again is let go, as long as there is one.
    """
    size = 1.0 / np.sqrt(np.diag(matrix))  # unknowns in units of their own, so that one tolerance serves all
    matrix, side, low, high = matrix * np.outer(size, size), side * size, low / size, high / size
    x = np.clip(np.linalg.solve(matrix, side), low, high)
    free = (low < x) & (x < high)
    for _ in range(10 * x.size):  # a few suffice; rounding could make the same unknown come and go
        _solve_free(matrix, side, low, high, x, free)
        pull = side - matrix @ x
        inward = np.where(free, 0.0, np.where(x <= low, pull, -pull))
        most = int(np.argmax(inward))
        if inward[most] <= TOLERANCE * np.abs(side).max():
            break
        free[most] = True
    return np.asarray(x * size)


def _solve_free(
    matrix: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray, x: np.ndarray, free: np.ndarray
) -> None:
    """Solves for the unknowns that are `free`, in place; those that meet a bound on the way are free no more."""
    while free.any():
        aim = x.copy()
        aim[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], side[free] - matrix[np.ix_(free, ~free)] @ x[~free]
        )
        out = np.flatnonzero((aim < low) | (aim > high))
        if not out.size:
            x[:] = aim
            return
        bound = np.where(aim < low, low, high)
        shares = (bound[out] - x[out]) / (aim[out] - x[out])
        first = out[np.argmin(shares)]
        x += shares.min() * (aim - x)
        x[first], free[first] = bound[first], False
