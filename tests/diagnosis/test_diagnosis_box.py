"""The minimum inside bounds against that of scipy.optimize."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hydro_env.diagnosis.estimation.gauss_newton import minimum_in_box


@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 24), decades=st.floats(0.0, 6.0))
def test_the_minimum_is_that_of_bounded_least_squares(seed: int, size: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((size + 5, size)) * 10.0 ** rng.uniform(-decades / 2, decades / 2, size)
    target = rng.standard_normal(size + 5)
    low, high = -rng.uniform(1e-9, 2.0, size), rng.uniform(1e-9, 2.0, size)
    found = minimum_in_box(rows.T @ rows, rows.T @ target, low, high)
    assert (low - 1e-12 <= found).all() and (found <= high + 1e-12).all()
    best = lsq_linear(rows, target, (low, high), method="bvls", max_iter=1000, tol=1e-14).x
    assert np.sum((rows @ found - target) ** 2) <= np.sum((rows @ best - target) ** 2) * (1.0 + 1e-9)


def test_an_unknown_at_a_bound_comes_back_where_another_one_stops() -> None:
    """Clipped one by one, the first would stay at its bound; with the second held it belongs inside."""
    matrix = np.array([[1.0, 0.9], [0.9, 1.0]])
    side = matrix @ np.array([-1.0, 4.0])
    found = minimum_in_box(matrix, side, np.array([0.0, -1.0]), np.array([3.0, 1.0]))
    assert found == pytest.approx([side[0] - 0.9, 1.0])
