"""Long logs are looked at in windows that begin at rest and say most."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.input.parts import overlap, read_parts
from hydro_env.diagnosis.input.windows import choose, rest_starts
from hydro_env.errors import InputError
from hydro_env.measured import RigLog, read_log, write_log


@pytest.fixture(scope="module")
def long_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five minutes at 50 Hz: idling, with two lively stretches after a rest at 100 s and 220 s."""
    t = np.arange(15000) * 0.02
    command = np.where((t % 20.0) < 15.0, 5.0, 0.0)
    for start in (100.0, 220.0):
        rows = (t >= start) & (t < start + 12.0)
        command[rows] = 40.0 * np.sign(np.sin(2.0 * np.pi * 0.5 * (t[rows] - start)))
        command[(t >= start - 2.0) & (t < start)] = 0.0
    speed = 2.0 * np.concatenate([[0.0], command[:-1]])
    pair = np.column_stack([command, -command])
    log = RigLog(time_s=t, command_V=pair, speed=np.column_stack([speed, -speed]), name="long", sha256="")
    path = tmp_path_factory.mktemp("long") / "long.csv"
    write_log(path, log)
    return path


def test_the_liveliest_windows_are_found_and_begin_at_rest(long_log: Path) -> None:
    found = choose(read_log(long_log), 0.0, 300.0)
    assert [round(start) for start, _, _ in found] == pytest.approx([100, 220], abs=1)
    assert all(at_rest for _, _, at_rest in found)
    parts = read_parts([long_log], None)
    assert len(parts) == 2 and all(p.seconds == pytest.approx(12.0, abs=0.1) for p in parts)
    assert "300 s are too long" in parts[0].note and parts[1].note == ""
    assert all(len(p.log) < 800 for p in parts)  # nothing before the window is simulated


def test_named_windows_of_a_long_log_are_runs_of_their_own(long_log: Path) -> None:
    fit, sealed = read_parts([f"{long_log}@100:106"], None), read_parts([f"{long_log}@106:112"], None)
    assert fit[0].seconds == pytest.approx(6.0, abs=0.05) and sealed[0].seconds == pytest.approx(
        6.0, abs=0.05
    )
    overlap(fit, sealed)
    with pytest.raises(InputError, match="shares rows"):
        overlap(fit, read_parts([f"{long_log}@105:111"], None))


def test_without_rest_the_beginning_does_not_count(long_log: Path, tmp_path: Path) -> None:
    log = read_log(long_log)
    restless = replace(log, command_V=log.command_V + 3.0, speed=log.speed + 6.0)
    assert rest_starts(restless).size == 0
    path = tmp_path / "restless.csv"
    write_log(path, restless)
    parts = read_parts([f"{path}@200:210"], None)
    assert parts[0].seconds == pytest.approx(9.0, abs=0.05)
    assert "nothing rests before 200 s" in parts[0].note
