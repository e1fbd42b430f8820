"""A coupling that rattles is told from everything else by simulations that follow the measured speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.logs import Logs
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages import calibration, consistency, rattling
from hydro_env.plant import load_model
from hydro_env.practice.generate import make_practice


def _rig(folder: Path, effects: list[str], seed: int, **settings: float) -> DynamicRig:
    make_practice(effects, seed=seed, rate=500.0, duration=6.0, runs=("fit_1",), **settings).write(folder)
    return DynamicRig(load_model("paper"), read_parts([folder / "fit_1.csv"], None))


def test_noise_alone_leaves_the_same_if_the_measured_speed_is_followed(tmp_path: Path) -> None:
    rig = _rig(tmp_path, [], 1)
    fit, left = Fit(rig, {}), []
    for each in (rig, rig.following({0})):
        both = each.predict([Request(c, {}) for c in (0, 1)])
        left.append([fit.rms(both[c][c], c)[0, "speed"] for c in (0, 1)])
    free, followed = left
    assert followed[0] == pytest.approx(free[0], rel=0.03) and followed[0] != free[0]
    assert followed[1] == free[1]  # the other channel is simulated freely


@pytest.mark.parametrize(
    ("effect", "seed", "followed"),
    [
        ("shaft_backlash:1", 7103, {0}),
        ("shaft_backlash:2", 8205, {1}),
        ("motor_coulomb_friction:1", 8403, set()),
    ],
)
def test_only_a_coupling_that_rattles_has_the_measured_speed_followed(
    tmp_path: Path, effect: str, seed: int, followed: set[int]
) -> None:
    rig = _rig(tmp_path, [effect], seed, base_error=0.1)
    calibrated = calibration.run(*consistency.run(Logs(Fit(rig, {}), rig, rig)))
    found = rattling.run(calibrated, calibrated.estimates)
    logs = found.logs
    assert logs.rig.followed == logs.fine.followed == logs.held_out.followed == followed
    assert {k.channel for k in found.backlashes} == followed
    assert all(np.isfinite(p.cost) for p in found.estimates.values())


@pytest.mark.slow
def test_a_backlash_whose_damper_has_another_form_is_named_alone(tmp_path: Path) -> None:
    make_practice(["shaft_backlash:1"], seed=7104, base_error=0.1, rate=500.0).write(tmp_path)
    logs = [tmp_path / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
    found = diagnose(logs[:2], logs[2:], model="paper")
    assert found.verdict == "effects" and [(e.name, e.channel) for e in found.effects] == [
        ("shaft_backlash", "1")
    ]
    assert any("rattles" in text for text in found.warnings)
