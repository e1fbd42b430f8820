"""What becomes of a candidate."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import Estimate
from hydro_env.diagnosis.stages.candidates import is_neutral


@pytest.mark.parametrize(
    ("effect", "parameter", "value", "neutral"),
    [
        ("load_bias", "bias", 0.001, True),
        ("load_bias", "bias", -0.1, False),
        ("driver_saturation", "voltage_limit", 72.8, True),  # of 73 V at most
        ("driver_saturation", "voltage_limit", 70.0, False),
        ("flow_saturation", "opening_limit", 8.55e-4, True),
    ],
)
def test_what_is_next_to_neutral_has_vanished(
    effect: str, parameter: str, value: float, neutral: bool
) -> None:
    assert is_neutral(Estimate(0, [], np.zeros(0)).with_effect(effect, {parameter: value}), effect) == neutral
