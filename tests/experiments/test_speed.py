"""`hydro-env speed` measures what it says; no test here depends on how fast the machine is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hydro_env.experiments import near_limit, speed


def test_speed_writes_rates_and_the_error_at_that_speed(tmp_path: Path) -> None:
    result = speed.run(tmp_path, num_envs=[3], seconds=0.05, rows=40)
    assert json.loads((tmp_path / "speed.json").read_text()) == result
    row, single = result["batch"]
    assert (row["dtype"], single["dtype"]) == ("float64", "float32")
    assert row["num_envs"] == 3 and row["env_steps_per_s"] > 0
    assert row["channel_substeps_per_s"] == pytest.approx(
        row["plant_steps_per_s"] * 2 * 0.01 / result["substep_s"]
    )
    assert row["times_real_time"] == pytest.approx(row["env_steps_per_s"] * 0.01)
    assert 0 < result["error_rpm"]["worst_against_reference"] < 0.1
    assert 0 < result["error_float32_rpm"]["worst_against_reference"] < 0.1
    kinds = [(row["dtype"], row["kind"]) for row in result["commands"]]
    assert kinds == [(dtype, kind) for dtype in ("float64", "float32") for kind in speed.KINDS]
    for row in result["commands"]:
        assert row["num_envs"] == 3 and row["env_steps_per_s"] > 0 and 0 < row["error_rpm"] < 0.1
    assert 0 < result["effects"]["base_ns"] < result["effects"]["all_neutral_ns"]
    assert 0 < result["start"]["warm_s"] < result["start"]["cold_s"]
    assert "rpm" in speed.summary(result)


@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")
def test_the_kernel_in_cpp_gives_the_same_bits() -> None:
    twin = near_limit.measure_ratio(0.0)
    assert twin is not None and twin["largest_relative_difference"] == 0.0
    assert twin["ratio"] > 0.0


def test_arithmetic_is_counted_not_addresses() -> None:
    source = """
def line(x):
    return fma(x, 2.0, 1.0)

def begin(cells, h):
    for l in range(LANES):
        cells[3 * LANES + l] = line(cells[2 * LANES + l]) / h - 1.0

def finish(cells, h):
    for l in range(LANES):
        cells[l] = sqrt(cells[l] * h) if cells[l] > 0.0 else 0.0
"""
    assert near_limit.operations(source) == 4 + 2
