"""Effects that the model as given has: they are calibrated, down to neutral, and may still be missing on the other channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env.case.command import run
from hydro_env.diagnosis import Diagnosis, diagnose
from hydro_env.diagnosis.estimation.unknowns import given_unknown
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.steady_valve import SteadyValve
from hydro_env.plant import CATALOGUE, PlantModel, load_model
from hydro_env.practice.generate import make_practice

OVERLAPS = {"dead_zone.overlap_positive": 9e-5, "dead_zone.overlap_negative": 6e-5}


def _rig(
    folder: Path, channel: str = "1", overlaps: dict[str, float] = OVERLAPS, **settings: Any
) -> PlantModel:
    """Logs of a rig with a dead zone; the model without it."""
    effects = [f"dead_zone:{channel}"] if channel else []
    own: dict[str, Any] = {"duration": 5.0, "rate": 500.0, "forms": "same", "base_error": 0.05, "seed": 4}
    own |= {"values": overlaps if channel else {}, **settings}
    practice = make_practice(effects, **own)
    practice.write(folder)
    return practice.given


def _diagnosed(folder: Path, model: PlantModel | str | Path) -> Diagnosis:
    return diagnose([folder / "fit_1.csv", folder / "fit_2.csv"], [folder / "sealed.csv"], model=model)


def _speed_is_explained(found: Diagnosis) -> bool:
    """Of the fit logs: short ones do not determine all that the held-out one shows."""
    errors = found.proofs.fit.errors
    return all(e["after"] < 1.1 * e["noise"] for (_, signal), e in errors.items() if signal == "speed")


REPEATED = {(e.name, own) for e in CATALOGUE.values() for names in e.corrects.values() for own in names}


@pytest.mark.parametrize(
    "p",
    [p for e in CATALOGUE.values() for p in e.parameters if (e.name, p.name) not in REPEATED],
    ids=lambda p: p.name,
)
def test_the_range_of_a_given_parameter_reaches_to_neutral(p: Any) -> None:
    for value in {v for v in (p.typical, p.low, p.high, 0.5 * (p.neutral + p.typical)) if np.isfinite(v)}:
        u = given_unknown(f"effect.{p.name}", p, value)
        low, high = u.bounds
        assert u.value(0.0) == value and low <= 0.0 <= high
        if p.role == "size":
            assert u.low <= p.neutral <= u.high
            assert u.value(u.q(p.neutral)) == pytest.approx(
                p.neutral, abs=1e-12 * max(abs(u.low), abs(u.high))
            )


@pytest.mark.parametrize("factor", [0.3, 2.0])
def test_a_given_size_that_is_wrong_is_calibrated(factor: float, tmp_path: Path) -> None:
    given = _rig(tmp_path).with_values({n: (factor * v, 0.0) for n, v in OVERLAPS.items()})
    found = _diagnosed(tmp_path, given)
    assert found.verdict == "calibration" and found.effects == []
    assert _speed_is_explained(found)
    calibrated = found.as_dict()["calibrated"]
    for name, value in OVERLAPS.items():
        entry = calibrated[f"{name}_1"]
        assert entry["nominal"] == pytest.approx(factor * value)
        assert entry["value"] == pytest.approx(value, rel=0.02)
        assert f"{name}_2" not in calibrated
        assert found.model.value(name, 0) == entry["value"]
        assert entry["low"] <= value <= entry["high"]


def test_a_given_effect_that_is_absent_is_said(tmp_path: Path) -> None:
    given = _rig(tmp_path, "").with_values({n: (v, 0.0) for n, v in OVERLAPS.items()})
    found = _diagnosed(tmp_path, given)
    assert found.verdict == "calibration" and _speed_is_explained(found)
    assert [w for w in found.warnings if "these logs do not show" in w and "channel 1" in w]
    assert not [w for w in found.warnings if "dead_zone" in w and "edge" in w]


def test_the_same_effect_is_found_on_the_other_channel(tmp_path: Path) -> None:
    given = _rig(tmp_path, "both").with_values({n: (0.6 * v, 0.0) for n, v in OVERLAPS.items()})
    found = _diagnosed(tmp_path, given)
    assert [(e.name, e.channel) for e in found.effects] == [("dead_zone", "2")]
    assert found.verdict == "effects" and _speed_is_explained(found)
    for name, value in OVERLAPS.items():
        assert found.model.pair(name) == pytest.approx((value, value), rel=0.05)


@pytest.mark.slow
def test_a_diagnosed_model_is_diagnosed_again_after_it_drifted(tmp_path: Path) -> None:
    """The form of the rig's dead zone is another than the catalogue's, so the model that is written has a correction of form."""
    rig = {"duration": 8.0, "forms": "different", "base_error": 0.1}
    first, second = tmp_path / "first", tmp_path / "second"
    given = _rig(first, **rig)
    logs = [str(first / name) for name in ("fit_1.csv", "fit_2.csv")]
    found = run(logs, [str(first / "sealed.csv")], tmp_path / "out", model=given, quiet=True)
    assert [(e.name, e.channel) for e in found.effects] == [("dead_zone", "1")]
    worn = {n: 1.5 * v for n, v in OVERLAPS.items()}
    _rig(second, overlaps=worn, **rig)
    again = _diagnosed(second, tmp_path / "out" / "model.yaml")
    assert again.verdict == "calibration" and again.effects == []
    assert _speed_is_explained(again)
    for name, value in worn.items():
        assert again.model.value(name, 0) == pytest.approx(value, rel=0.1)
        entry = again.as_dict()["calibrated"][f"{name}_1"]
        assert entry["nominal"] == load_model(tmp_path / "out" / "model.yaml").value(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["paper", "paper_dead_zone", "rig", "servo"])
def test_every_preset_is_calibrated_on_logs_of_its_own_kind(preset: str, tmp_path: Path) -> None:
    """The sizes of all its effects differ by up to a tenth, its laws are the catalogue's."""
    model, rng = load_model(preset), np.random.default_rng(3)
    true = {}
    for effect in map(CATALOGUE.__getitem__, model.declared):
        for p in effect.parameters:
            if p.role == "size":
                factor = 1.0 + 0.1 * rng.uniform(-1.0, 1.0)
                pair = model.pair(f"{effect.name}.{p.name}")
                true[f"{effect.name}.{p.name}"] = tuple(min(max(factor * v, p.low), p.high) for v in pair)
    _rig(tmp_path, "", model=model.with_values(true), duration=8.0, base_error=0.05)
    found = _diagnosed(tmp_path, preset)
    assert found.verdict == "calibration" and found.effects == []
    assert _speed_is_explained(found)


def test_the_steady_model_has_what_is_given(tmp_path: Path) -> None:
    _rig(tmp_path, "")
    parts = read_parts([tmp_path / "fit_1.csv"], None)
    given = load_model("paper").with_values({n: (v, 0.0) for n, v in OVERLAPS.items()})
    bare, rig = SteadyValve(load_model("paper"), parts), SteadyValve(given, parts)
    assert rig.base(0) == ["Kq", "lag", *OVERLAPS] and rig.base(1) == ["Kq", "lag"]
    assert "dead_zone" in rig.candidates() and rig.has("dead_zone", 0) and not rig.has("dead_zone", 1)
    same = [Request(0, dict(OVERLAPS)), Request(1, {})]
    for one, other in zip(rig.predict([Request(0, {}), Request(1, {})]), bare.predict(same), strict=True):
        for channel, values in one.items():
            np.testing.assert_array_equal(values, other[channel])
