"""The minimum of a quadratic function inside bounds."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear

__all__ = ["minimum_in_box"]


def minimum_in_box(matrix: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The x (k,) with low <= x <= high at which x' matrix x / 2 - side' x is least.

    `matrix` (k, k) is symmetric and positive definite, `side`, `low` and `high` are (k,). As bounded least squares: with the
    Cholesky factor, matrix = U' U, it is the least |U x - U'^-1 side|.
    """
    size = 1.0 / np.sqrt(np.diag(matrix))  # unknowns in units of their own, so that one tolerance serves all
    upper = cholesky(matrix * np.outer(size, size))
    right = solve_triangular(upper, side * size, trans="T")
    found = lsq_linear(
        upper, right, (low / size, high / size), method="bvls", tol=1e-12, max_iter=10 * len(side)
    )
    return np.asarray(found.x * size)
