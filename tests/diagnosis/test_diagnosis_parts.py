"""Parts of logs: windows in seconds, and that nothing is fitted and sealed at once."""

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.input.parts import overlap, read_parts
from hydro_env.errors import InputError


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.csv"
    time = np.arange(400) * 0.01
    rows = np.column_stack([time, np.sin(time), np.cos(time)])
    np.savetxt(path, rows, delimiter=",", header="time_s,command_1_V,speed_1_rpm", comments="", fmt="%.6f")
    return path


def test_a_run_is_simulated_from_its_beginning_but_counts_in_its_windows(log: Path) -> None:
    part = read_parts([f"{log}@1:2,3:3.5"], None)[0]
    assert part.log.time_s[0] == 0.0
    assert part.seconds == pytest.approx(1.5)
    assert not part.inside[:100].any() and part.inside[100:200].all() and not part.inside[200:300].any()
    assert len(part.log) == 350  # what comes after the last window is not simulated


def test_open_windows(log: Path) -> None:
    assert read_parts([f"{log}@:1"], None)[0].seconds == pytest.approx(1.0)
    assert read_parts([f"{log}@3:"], None)[0].seconds == pytest.approx(1.0)
    assert read_parts([log], None)[0].seconds == pytest.approx(4.0)


@pytest.mark.parametrize("window", ["2", "2:1", "a:b", "1:2,"])
def test_a_bad_window_is_named(log: Path, window: str) -> None:
    with pytest.raises(InputError, match=r"window|rows"):
        read_parts([f"{log}@{window}"], None)


def test_a_window_outside_the_log_is_refused(log: Path) -> None:
    with pytest.raises(InputError, match=r"the log runs from 0 to 3\.99 s"):
        read_parts([f"{log}@10:20"], None)


def test_sealed_rows_must_not_be_fitted(log: Path) -> None:
    fit, sealed = read_parts([f"{log}@0:2"], None), read_parts([f"{log}@1.5:4"], None)
    with pytest.raises(InputError, match="sealed but shares rows"):
        overlap(fit, sealed)
    overlap(fit, read_parts([f"{log}@2:4"], None))
