"""Which residual is worth a further effect."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import could_pay
from tests.linear_rig import NOISE, logged, time_of

ROWS = 4000


@pytest.mark.parametrize(("size", "pays"), [(1.1, False), (3.0, True)])
def test_a_residual_that_goes_on_for_long_is_looked_into_where_it_would_stay_unexplained(
    size: float, pays: bool
) -> None:
    slow = {"line_loss.coefficient": np.cos(0.4 * np.pi * time_of(ROWS))}
    fit, base = logged(slow, {"line_loss.coefficient": size * NOISE[0, "speed"]}, ROWS)
    assert could_pay(fit, base, 0) == pays
