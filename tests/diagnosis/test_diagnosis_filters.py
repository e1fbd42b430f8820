"""Filters against those of scipy.signal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter, savgol_filter

from hydro_env.diagnosis.models.filters import local_parabola, one_pole


@pytest.mark.parametrize("keep", [0.0, 0.5, 0.9999])
def test_one_pole_is_the_recursive_filter(keep: float) -> None:
    values = np.random.default_rng(0).standard_normal(5000)
    np.testing.assert_allclose(
        one_pole(values, keep), lfilter([1.0], [1.0, -keep], values), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("width", [5, 21])
@pytest.mark.parametrize("rows", [21, 400])
def test_a_local_parabola_is_the_filter_of_savitzky_and_golay(width: int, rows: int) -> None:
    values, period = np.random.default_rng(1).standard_normal(rows), 0.002
    level, slope = local_parabola(values, width, period)
    np.testing.assert_allclose(level, savgol_filter(values, width, 2), atol=1e-12)
    np.testing.assert_allclose(slope, savgol_filter(values, width, 2, deriv=1, delta=period), atol=1e-9)


def test_fewer_values_than_the_width_are_refused() -> None:
    with pytest.raises(ValueError, match="4 values are fewer than the width 5"):
        local_parabola(np.zeros(4), 5, 0.001)
