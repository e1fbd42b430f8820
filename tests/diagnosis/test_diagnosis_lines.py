"""Pressures of both lines in the diagnosis: what of them counts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import as_given
from hydro_env.diagnosis.stages.consistency import implausible
from hydro_env.plant import load_model
from hydro_env.practice.generate import make_practice
from hydro_env.units import BAR


def _rig(folder: Path, record: Sequence[str], effects: Sequence[str] = ()) -> DynamicRig:
    make_practice(effects, duration=4.0, rate=500.0, runs=("fit_1",), seed=3, record=record).write(folder)
    return DynamicRig(load_model("paper"), read_parts([folder / "fit_1.csv"], None))


def _fit(rig: DynamicRig) -> Fit:
    noise = {(c, s.signal): 1e-3 for c in rig.channels for s in rig.segments[c]}
    return Fit(rig, noise_of(rig, as_given(Fit(rig, noise))))


def test_the_mean_of_both_lines_is_compared_and_its_level_is_not(tmp_path: Path) -> None:
    rig = _rig(tmp_path, ("line_pressures",), ["external_leakage:1"])
    given = as_given(_fit(rig))
    for channel, least in ((0, 2.0 * BAR), (1, 0.0)):
        (mean,) = (s for s in rig.segments[channel] if s.signal == "mean_line_pressure")
        assert (
            np.mean(mean.measured) > 10.0 * BAR
        )  # of the rig's supply, which the paper's model does not know
        error = mean.error(given[channel].simulated[channel])
        assert abs(np.mean(error)) < 1e-3 * BAR
        assert least < np.std(error) < (np.inf if channel == 0 else 0.06 * BAR)


def test_a_supply_that_both_lines_do_not_have_is_said(tmp_path: Path) -> None:
    supply = "pressure_dependent_flow.supply_pressure"
    right = load_model("paper").with_values({supply: 80.0 * BAR})
    make_practice(
        (), model=right, duration=3.0, rate=500.0, runs=("fit_1",), record=("line_pressures",)
    ).write(tmp_path)
    said = []
    for pressure in (80.0 * BAR, 120.0 * BAR):
        rig = DynamicRig(right.with_values({supply: pressure}), read_parts([tmp_path / "fit_1.csv"], None))
        found = implausible(rig, as_given(_fit(rig)))
        said.append([f for f in found if f.code == "supply"])
    assert said[0] == [] and [f.channel for f in said[1]] == [1, 2]
    assert "80 bar" in said[1][0].text and "120 bar" in said[1][0].text and not said[1][0].sure
