"""Small dense systems, compiled. (Numba's own need a BLAS, which an exported controller does not have.)"""

from __future__ import annotations

import numpy as np

from hydro_env.jit import compiled


@compiled
def solve_positive_definite(matrix, x, n):
    """Replaces x (n,), the right-hand side, by the solution, and the lower triangle of the matrix (n, n), which alone is read, by
    its Cholesky factor. A pivot of 1e-12 takes the place of one that is not positive."""
    for p in range(n):
        for q in range(p + 1):
            rest = matrix[p, q]
            for k in range(q):
                rest -= matrix[p, k] * matrix[q, k]
            matrix[p, q] = np.sqrt(max(rest, 1e-12)) if p == q else rest / matrix[q, q]
    for p in range(n):
        rest = x[p]
        for k in range(p):
            rest -= matrix[p, k] * x[k]
        x[p] = rest / matrix[p, p]
    for p in range(n - 1, -1, -1):
        rest = x[p]
        for k in range(p + 1, n):
            rest -= matrix[k, p] * x[k]
        x[p] = rest / matrix[p, p]
