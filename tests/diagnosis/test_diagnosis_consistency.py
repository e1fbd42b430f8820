"""Do logs fit the model at all: what is a mistake in a recording, and what a missing effect."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import as_given
from hydro_env.diagnosis.stages.consistency import implausible
from hydro_env.measured import Finding
from hydro_env.plant import load_model, simulate
from hydro_env.units import BAR, RPM


def _found(folder: Path, columns: dict[str, np.ndarray]) -> list[Finding]:
    """Findings about a log with these columns."""
    path = folder / "log.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join(columns), comments=""
    )
    rig = DynamicRig(load_model("paper"), read_parts([path], None))
    return implausible(
        rig, as_given(Fit(rig, {(c, s.signal): 1e-9 for c in (0, 1) for s in rig.segments[c]}))
    )


def _findings(folder: Path, drag: float, unit: float = 1.0) -> list[Finding]:
    """Findings about 12 s of a rig with a drag of `drag` N m s2/rad2; the pressure is written `unit` times as large."""
    time = np.arange(6000) * 0.002
    command = np.repeat(40.0 * np.sin(0.5 * time)[:, None], 2, axis=1)
    values = {"quadratic_drag.coefficient": np.full((1, 2), drag)}
    seen = simulate("paper", command, None, 0.002, values=values, record=("speed", "pressure"))
    columns = {"time_s": time}
    for c in (0, 1):
        columns[f"command_{c + 1}_V"] = command[:, c]
        columns[f"speed_{c + 1}_rpm"] = seen["speed"][:, 0, c] / RPM
        columns[f"pressure_{c + 1}_bar"] = unit * seen["pressure"][:, 0, c] / BAR
    return _found(folder, columns)


def test_a_drag_many_times_the_friction_is_no_mistake_in_the_recording(tmp_path: Path) -> None:
    found = _findings(tmp_path, drag=6e-4)
    assert any("a large loss that the model lacks" in f.message for f in found)
    assert not any(f.sure for f in found)


@pytest.mark.parametrize("drag", [0.0, 2e-5])
def test_pressures_in_another_unit_are_a_mistake(tmp_path: Path, drag: float) -> None:
    found = _findings(tmp_path, drag, unit=0.1)
    assert [f.signal for f in found if f.sure] == ["pressure", "pressure"]
    assert all("MPa" in f.message for f in found if f.sure)


def _healthy(folder: Path, change: Callable[[dict[str, np.ndarray]], None]) -> list[Finding]:
    """Findings about 12 s of the model itself at 500 Hz, with noise, after a change of the recording."""
    rng, time = np.random.default_rng(8), np.arange(6000) * 0.002
    steps = np.repeat(rng.uniform(-50.0, 50.0, (24, 2)), 250, axis=0)
    seen = simulate("paper", steps, None, 0.002, record=("speed", "pressure"))
    columns = {"time_s": time}
    for c in (0, 1):
        columns[f"command_{c + 1}_V"] = steps[:, c]
        columns[f"speed_{c + 1}_rpm"] = seen["speed"][:, 0, c] / RPM + rng.normal(size=6000)
        columns[f"pressure_{c + 1}_bar"] = seen["pressure"][:, 0, c] / BAR + 0.05 * rng.normal(size=6000)
    change(columns)
    return _found(folder, columns)


def _as_recorded(columns: dict[str, np.ndarray]) -> None:
    pass


def _off_centre(columns: dict[str, np.ndarray]) -> None:
    speed = columns["speed_1_rpm"]
    columns["speed_1_rpm"] = speed * (
        1.0 + 0.01 * np.cos(2.0 * np.pi * np.cumsum(speed) * 0.002 / 60.0 + 1.0)
    )


def _clocks_apart(columns: dict[str, np.ndarray]) -> None:
    time = columns["time_s"]
    for name in columns:
        if name.startswith(("speed", "pressure")):
            columns[name] = np.interp(0.995 * time, time, columns[name])


def _in_percent(columns: dict[str, np.ndarray]) -> None:
    for c in (1, 2):
        columns[f"command_{c}_V"] = columns[f"command_{c}_V"] * 100.0 / 50.0


@pytest.mark.parametrize(
    ("change", "codes", "words"),
    [
        (_as_recorded, [], ""),
        (_off_centre, ["eccentric"], "speed of channel 1 rises and falls by 0."),
        (_clocks_apart, ["clock_drift"], "fall behind the commands by 5"),
        (_in_percent, ["unit", "unit"], "`u_rated`): is it in percent?"),
    ],
)
def test_instruments_that_are_wrong_are_named(
    tmp_path: Path, change: Callable[[dict[str, np.ndarray]], None], codes: list[str], words: str
) -> None:
    found = _healthy(tmp_path, change)
    assert [f.code for f in found] == codes
    assert all(words in f.message for f in found[:1]), found[0].message
