"""What becomes of a candidate."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.stages.candidates import is_neutral
from hydro_env.plant import CATALOGUE
from hydro_env.plant.scales import PAPER
from hydro_env.practice.generate import make_practice


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


def test_twins_that_no_usual_log_parts_are_both_named(tmp_path: Path) -> None:
    """The refit of one of them may end in a local minimum: it is fitted again from where the other one ended."""
    make_practice(["line_loss:1"], seed=650020, duration=4.0, rate=200.0, base_error=0.1).write(tmp_path)
    logs = [tmp_path / "fit_1.csv", tmp_path / "fit_2.csv"]
    found = diagnose(logs, [tmp_path / "sealed.csv"], model=tmp_path / "model.yaml")
    (named,) = found.effects
    assert {named.name, *named.indistinguishable_from} == {"line_loss", "quadratic_drag"}
    assert named.probability < 0.51
