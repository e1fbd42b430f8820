"""Candidates that compete on the beginning of the logs, and when they have to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.estimation.local_minima import best_on_early_window, early_window_of
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import base_unknowns, calibrate
from hydro_env.plant import Plant, load_model
from hydro_env.practice.generate import make_practice
from tests.linear_rig import NOISE, logged, time_of

ROWS = 4000


@pytest.mark.parametrize(("size", "pays"), [(1.1, False), (3.0, True)])
def test_a_residual_that_goes_on_for_long_is_looked_into_where_it_would_stay_unexplained(
    size: float, pays: bool
) -> None:
    slow = {"line_loss.coefficient": np.cos(0.4 * np.pi * time_of(ROWS))}
    fit, base = logged(slow, {"line_loss.coefficient": size * NOISE[0, "speed"]}, ROWS)
    assert fit.could_pay(base, 0) == pays


def test_the_hidden_effect_is_first_on_the_beginning_of_the_logs(tmp_path: Path) -> None:
    hidden = {"eccentric_load.amplitude": 0.15, "eccentric_load.phase": -0.3}
    practice = make_practice(
        ["eccentric_load:1"], values=hidden, duration=8.0, rate=500.0, seed=5, runs=("fit_1",), forms="same", base_error=0.1,
    )  # fmt: skip
    practice.write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    rig.channels = (0,)
    unknowns = base_unknowns(rig, 0)
    given = Estimate(0, unknowns, np.zeros(len(unknowns)), "as given")
    fit = Fit(rig, {(0, s.signal): 1e-9 for s in rig.segments[0]})
    fit.evaluate([given])
    fit = Fit(rig, noise_of(rig, {0: given}))
    base = calibrate(fit, 6)[0]
    names = ["load_bias", "sensor_offset", "eccentric_load", "null_offset", "flow_force"]
    (found,) = best_on_early_window(fit, [(0, base)], [names])
    assert found[0].label == "eccentric_load" and {p.label for p in found} <= {*names}
    values = found[0].values(0)
    assert values["eccentric_load.amplitude"] == pytest.approx(0.15, rel=0.2)
    assert values["eccentric_load.phase"] == pytest.approx(-0.3, abs=0.4)
    assert all(not p.simulated for p in found)


def test_an_early_window_simulates_no_more_than_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_practice([], duration=4.0, rate=500.0, seed=3, runs=("fit_1",)).write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    whole, rows = rig.predict([Request(0, {})])[0][0], []
    run = Plant.run
    monkeypatch.setattr(Plant, "run", lambda *a, **k: rows.append(len(a[1])) or run(*a, **k))
    window = early_window_of(rig, 0.1)
    short = window.predict([Request(0, {})])[0][0]
    assert rows == [-(-len(rig.parts[0].log) // 10)]
    for s, first in zip(rig.segments[0], window.segments[0], strict=True):
        if s.signal != "mean_line_pressure":
            np.testing.assert_array_equal(short[first.place], whole[s.place][: first.measured.size])
