"""`hydro-env speed` measures what it says; no test here depends on how fast the machine is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hydro_env.experiments import speed


def test_speed_writes_rates_and_the_error_at_that_speed(tmp_path: Path) -> None:
    result = speed.run(tmp_path, num_envs=[3], seconds=0.05, rows=40)
    assert json.loads((tmp_path / "speed.json").read_text()) == result
    row, single = result["batch"]
    assert (row["dtype"], single["dtype"]) == ("float64", "float32")
    assert row["num_envs"] == 3 and row["env_steps_per_s"] > 0
    assert 5 < row["steps_a_period"] < 100
    assert row["channel_substeps_per_s"] == pytest.approx(
        row["plant_steps_per_s"] * 2 * row["steps_a_period"]
    )
    assert row["times_real_time"] == pytest.approx(row["env_steps_per_s"] * 0.01)
    kinds = [(row["dtype"], row["plant"], row["kind"]) for row in result["commands"]]
    assert kinds == [(d, p, k) for d in ("float64", "float32") for p in speed.PLANTS for k in speed.KINDS]
    for row in result["commands"]:
        assert row["num_envs"] == 3 and row["env_steps_per_s"] > 0 and 0 < row["error_rpm"] < 0.1
    for key in ("error_rpm", "error_float32_rpm"):
        found = result[key]
        worst = max(error for plant in speed.PLANTS for error in found[plant].values())
        assert 0 < found["worst_against_reference"] == worst < 0.1
    assert 0 < result["effects"]["base_ns"] < result["effects"]["all_neutral_ns"]
    assert 0 < result["start"]["warm_s"] < result["start"]["cold_s"]
    assert "rpm" in speed.summary(result)
