"""The steady-valve model, and the whole workflow on it: quick enough for every run of the tests."""

import json
import os
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from docs.evidence.blind_trials.rules import RULES
from docs.evidence.blind_trials.running import changed
from hydro_env.case.command import run
from hydro_env.diagnosis import STAGES, diagnose
from hydro_env.diagnosis.models.steady_valve import elementwise
from hydro_env.diagnosis.stages.selection import without_weakest
from hydro_env.errors import InputError
from hydro_env.measured import load_mapping, read_log
from hydro_env.plant import CATALOGUE, load_model

MAPPING = """
schema: hydro_env/mapping/1
time: {column: t, unit: s}
channel_1:
  actuator: cylinder
  command: {column: u, unit: fraction, full_scale: 73}
  speed: {column: v, unit: mm/s}
"""


def _axis(
    folder: Path, name: str, opening, *, lag: float = 0.15, seed: int = 0, seconds: float = 30.0
) -> Path:  # type: ignore[no-untyped-def]
    """A log of an axis whose speed is 40 mm/s times `opening(u)`, late by a lag, with noise of 0.3 mm/s."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / 0.01)) * 0.01
    command = 0.35 * np.sin(0.5 * time) + 0.25 * np.sin(1.3 * time + seed)
    command += 0.2 * np.repeat(rng.uniform(-1, 1, time.size // 150 + 1), 150)[: time.size]
    command[:100] = 0.0
    speed, x = np.empty(time.size), 0.0
    for n, target in enumerate(40.0 * opening(command)):
        speed[n] = x
        x += (target - x) * (1.0 - np.exp(-0.01 / lag))
    rows = np.column_stack([time, command, speed + 0.3 * rng.standard_normal(time.size)])
    path = folder / f"{name}.csv"
    np.savetxt(path, rows, delimiter=",", header="t,u,v", comments="", fmt="%.6f")
    (folder / "map.yaml").write_text(MAPPING)
    return path


def _overlap(u: np.ndarray) -> np.ndarray:
    return u - np.clip(u, -0.12, 0.06)


def test_laws_on_arrays_are_the_laws() -> None:
    values = np.linspace(-5e-4, 5e-4, 11)
    law = CATALOGUE["dead_zone"].laws["opening"]
    np.testing.assert_array_equal(
        elementwise(law)(values, 1e-4, 2e-4), [law(float(v), 1e-4, 2e-4) for v in values]
    )


def test_a_dead_zone_is_named_and_proved(tmp_path: Path) -> None:
    fit, sealed = _axis(tmp_path, "fit", _overlap), _axis(tmp_path, "sealed", _overlap, seed=1)
    found = run([fit], [sealed], tmp_path / "out", mapping=tmp_path / "map.yaml", quiet=True)
    data = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert data["schema"] == "hydro_env/diagnosis/1"
    assert data["verdict"] == "effects"
    assert [(e["name"], e["channel"]) for e in data["effects"]] == [("dead_zone", "1")]
    # The whole command is a spool of 0.86 mm.
    rated = 20.0 * 73.0 / (100.0 * 17000.0)
    for own, share in (("overlap_positive", 0.06), ("overlap_negative", 0.12)):
        entry = data["effects"][0]["parameters"][own]
        assert entry["value"] == pytest.approx(share * rated, rel=0.1)
        assert entry["low"] <= entry["value"] <= entry["high"]
    gap = data["gap"]["sealed"]["speed_1_mm_per_s"]
    assert gap["after"] < 1.15 * 0.3 < gap["placebo"] <= 1.01 * max(gap["calibrated"], gap["placebo"])
    assert gap["calibrated"] > 2.0 * gap["after"]
    assert data["detectable"]["dead_zone"]["1"] is True
    page = (tmp_path / "out/report.html").read_text()
    assert "dead zone" in page and "<svg" in page and "http://" not in page.replace("http://www.w3.org", "")
    model = load_model(tmp_path / "out/model.yaml")
    assert model.value("dead_zone.overlap_negative", 0) == pytest.approx(
        found.effects[0].parameters["overlap_negative"].value
    )


def test_nothing_is_named_where_only_the_gain_is_unknown(tmp_path: Path) -> None:
    fit, sealed = _axis(tmp_path, "fit", lambda u: u), _axis(tmp_path, "sealed", lambda u: u, seed=1)
    data = diagnose([fit], [sealed], mapping=tmp_path / "map.yaml").as_dict()
    assert data["verdict"] in ("none", "calibration")
    assert data["effects"] == []


@pytest.mark.parametrize("area", ["", "  displacement: {value: 201, unit: cm2}\n"])
def test_the_estimated_model_drives_the_environment(tmp_path: Path, area: str) -> None:
    """With the area of a piston, too: the shaft turns by as many rad/s as the axis moves by m/s, dead zone and all."""
    fit = _axis(tmp_path, "fit", _overlap)
    (tmp_path / "map.yaml").write_text(MAPPING + area)
    run([f"{fit}@0:20"], [f"{fit}@20:30"], tmp_path / "out", mapping=tmp_path / "map.yaml", quiet=True)
    path = tmp_path / "out/model.yaml"
    env = gymnasium.make("hydro_env:HydraulicSync-v0", plant=str(path), mismatch=None)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    model = load_model(path)
    opening = 20.0 * 73.0 * 0.5 / (100.0 * 17000.0) - model.value("dead_zone.overlap_positive", 0)
    speed = model.value("Kq", 0) * opening / model.value("D", 0)
    assert speed == pytest.approx(0.040 * (0.5 - 0.06), rel=0.05)


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    fit = _axis(tmp_path, "fit", lambda u: u)
    mapping = tmp_path / "map.yaml"
    with pytest.raises(InputError, match="no held-out log"):
        diagnose([fit], [], mapping=mapping)
    with pytest.raises(InputError, match="no such file"):
        diagnose([fit], [tmp_path / "missing.csv"], mapping=mapping)
    with pytest.raises(InputError, match="shares rows"):
        diagnose([fit], [fit], mapping=mapping)
    with pytest.raises(InputError, match="unknown plant"):
        diagnose([fit], [fit], mapping=mapping, model="papr")


def test_loaded_logs_give_the_same_as_their_files_and_rules_can_be_switched_off(tmp_path: Path) -> None:
    paths = [_axis(tmp_path, name, _overlap, seed=n) for n, name in enumerate(("fit", "sealed"))]
    mapping = load_mapping(tmp_path / "map.yaml")
    logs = [read_log(path, mapping) for path in paths]
    told: list[str] = []
    found = diagnose(logs[:1], logs[1:], progress=lambda text, simulations: told.append(text))
    files = diagnose(paths[:1], paths[1:], mapping=mapping)
    assert found.verdict == files.verdict and [e.name for e in found.effects] == ["dead_zone"]
    assert found.as_dict() == {**files.as_dict(), "seconds": found.as_dict()["seconds"]}
    assert set(told) >= {*STAGES.values()} - {STAGES[without_weakest]}
    # The same arrays without a file, and without any rule.
    bare = [replace(log, name="", sha256="") for log in logs]
    with changed((), [*RULES]):
        plain = diagnose(bare[:1], bare[1:])
    assert [e.name for e in plain.effects] == ["dead_zone"]
    with pytest.raises(InputError, match="shares rows"):
        diagnose(bare[:1], bare[:1])


@pytest.mark.skipif(
    "HYDRO_ENV_REALDATA" not in os.environ, reason="HYDRO_ENV_REALDATA names no folder of measured logs"
)
def test_a_measured_crane_axis(tmp_path: Path) -> None:
    mapping = tmp_path / "crane.yaml"
    mapping.write_text(
        """
schema: hydro_env/mapping/1
time: {column: time, unit: s}
channel_1:
  actuator: cylinder
  command: {column: MainU, unit: fraction, full_scale: 73}
  speed: {column: MainPistonVelocity, unit: m/s}
  pressure: {column: MainPaDCV, unit: bar, minus: {column: MainPbDCV, unit: bar}}
"""
    )
    log = Path(os.environ["HYDRO_ENV_REALDATA"]) / "crane_two_axes" / "main_sine.csv.gz"
    data = diagnose([f"{log}@0:13,23:34"], [f"{log}@13:23,34:47"], mapping=mapping).as_dict()
    assert data["verdict"] == "effects"
    assert data["effects"][0]["name"] == "dead_zone"
    gap = data["gap"]["sealed"]["speed_1_mm_per_s"]
    assert gap["before"] == pytest.approx(1.9, abs=0.15)
    assert gap["after"] < 0.8 < gap["placebo"]
