"""Long logs are looked at in the windows that say most."""

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.input.parts import overlap, read_parts
from hydro_env.errors import InputError
from hydro_env.measured import RigLog, write_log


@pytest.fixture(scope="module")
def long_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five minutes at 50 Hz: idling, with two lively stretches at 100 s and 220 s."""
    t = np.arange(15000) * 0.02
    command = np.where((t % 20.0) < 15.0, 5.0, 0.0)
    for start in (100.0, 220.0):
        rows = (t >= start) & (t < start + 12.0)
        command[rows] = 40.0 * np.sign(np.sin(2.0 * np.pi * 0.5 * (t[rows] - start)))
    speed = 2.0 * np.concatenate([[0.0], command[:-1]])
    pair = np.column_stack([command, -command])
    log = RigLog(time_s=t, command_V=pair, speed=np.column_stack([speed, -speed]), name="long", sha256="")
    path = tmp_path_factory.mktemp("long") / "long.csv"
    write_log(path, log)
    return path


def test_the_liveliest_windows_are_found(long_log: Path) -> None:
    parts = read_parts([long_log], None)
    starts = [p.log.time_s[p.inside][0] for p in parts]
    assert starts == pytest.approx([100.0, 220.0], abs=1.0)
    assert all(p.seconds == pytest.approx(12.0, abs=0.1) for p in parts)
    assert "300 s are too long" in parts[0].note and parts[1].note == ""


def test_named_windows_of_a_long_log_are_runs_of_their_own(long_log: Path) -> None:
    """Each is simulated from shortly before, so that all its rows count."""
    fit, sealed = (read_parts([f"{long_log}@{part}"], None) for part in ("220:226", "226:232"))
    for (part,), start in ((fit, 220.0), (sealed, 226.0)):
        assert part.seconds == pytest.approx(6.0, abs=0.05)
        assert part.log.time_s[0] == pytest.approx(start - 2.0, abs=0.05)
    overlap(fit, sealed)
    with pytest.raises(InputError, match="shares rows"):
        overlap(fit, read_parts([f"{long_log}@225:231"], None))
