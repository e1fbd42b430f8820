"""The paper's experiments come out as published, and the shipped preset is what the calibration finds."""

from __future__ import annotations

import pytest

from hydro_env.experiments.reproduce import Reproduction, reproduce
from hydro_env.plant import load_model


@pytest.fixture(scope="module")
def result() -> Reproduction:
    return reproduce(progress=False)


def test_the_tables_alone_give_a_tenth_of_what_is_published(result: Reproduction) -> None:
    assert result.numbers["setpoint_steps"]["tables_only_rpm"] == pytest.approx(13.2, abs=0.5)


def test_the_calibrated_dead_zone_gives_what_is_published(result: Reproduction) -> None:
    assert result.numbers["setpoint_steps"]["with_dead_zone_rpm"] == pytest.approx(175, abs=1)
    assert result.numbers["load_step"]["simulated_rpm"] == pytest.approx(12, abs=0.5)


def test_the_shipped_preset_is_the_calibrated_one(result: Reproduction) -> None:
    shipped = load_model("paper_dead_zone")
    assert result.model.values.keys() == shipped.values.keys()
    for name, pair in shipped.values.items():
        assert result.model.pair(name) == pytest.approx(pair, rel=1e-3), name
