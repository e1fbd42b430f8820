"""The page of measured machines: what is absent is said in a line, and tables hold what was found."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from docs.evidence.measured_machines import MAPPINGS, RUNS, crane_table, run
from hydro_env.errors import InputError


def test_without_recordings_one_line_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither crane_two_axes nor servovalve is there") as problem:
        run(tmp_path, tmp_path / "out")
    assert "\n" not in str(problem.value) and not (tmp_path / "out").exists()


def test_mappings_are_there_and_no_held_out_window_is_fitted() -> None:
    for each in RUNS:
        assert (MAPPINGS / f"{each.mapping}.yaml").exists()
        windows = [
            [float(x or "inf") for x in w.split(":")] for w in (each.fit + "," + each.held_out).split(",")
        ]
        ordered = sorted(windows)
        assert all(a[1] <= b[0] for a, b in itertools.pairwise(ordered))


def test_a_run_without_overlap_has_a_row_as_well() -> None:
    errors = {"before": 2.0, "calibrated": 1.0, "after": 1.0, "placebo": 1.5, "noise": 0.5}
    row = {"run": "Main", "verdict": "calibration", "names": [], "overlap": {}, "errors_mm_per_s": errors}
    assert "| Main | `calibration` | - | - | 2.00, 1.00, 1.00, 1.50 (0.50) |" in crane_table([row])
