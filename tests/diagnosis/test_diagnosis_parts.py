"""Parts of logs: windows in seconds, and that nothing is fitted and sealed at once."""

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.input.checks import read_logs
from hydro_env.diagnosis.input.parts import overlap, read_parts
from hydro_env.errors import InputError
from hydro_env.practice.generate import make_practice


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


def test_signals_need_not_be_in_every_log(tmp_path: Path) -> None:
    """One of a single fit log counts there; one of held-out logs alone has no known noise."""
    for name, more in (("plain", []), ("more", ["spool", "motor_pressure"])):
        record = ["current", "pressure", *more]
        make_practice([], duration=3.0, rate=100.0, record=record, runs=("fit_1", "sealed")).write(
            tmp_path / name
        )
    fit, rich, held_out = (
        tmp_path / path for path in ("plain/fit_1.csv", "more/fit_1.csv", "more/sealed.csv")
    )
    parts, proofs = read_logs([fit], [held_out], None)
    assert not proofs[0].log.has("spool", 0) and not proofs[0].log.has("motor_pressure", 1)
    assert "spool of channel 1 is in no fit log" in parts[0].note
    parts, proofs = read_logs([fit, rich], [held_out], None)
    assert not parts[0].log.has("spool") and parts[1].log.has("spool") and proofs[0].log.has("spool")
