"""What becomes of a candidate."""

from dataclasses import replace

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.stages.candidates import is_neutral
from hydro_env.plant import CATALOGUE
from hydro_env.plant.scales import PAPER


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


def test_what_has_vanished_follows_the_size_of_the_rig() -> None:
    """On a motor ten times as large, ten times the load is as much or as little."""
    large = replace(PAPER, displacement=10.0).effect(CATALOGUE["load_bias"])
    for bias, neutral in ((0.05, True), (0.12, False)):
        assert (
            is_neutral(Estimate(0, [], np.zeros(0)).with_effect(large, {"bias": bias}), "load_bias")
            == neutral
        )
