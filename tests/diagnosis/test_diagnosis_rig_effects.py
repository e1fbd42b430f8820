"""Effects of the whole rig: when they come first, and what a channel has beside them."""

from __future__ import annotations

from math import nan
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.estimate import Estimate, joined
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import base_unknowns
from hydro_env.diagnosis.stages.screening import Screening, screen
from hydro_env.diagnosis.stages.search import Search
from hydro_env.diagnosis.stages.selection import rig_effect_leads
from hydro_env.plant import load_model
from hydro_env.practice.generate import make_practice

DROOP = {"relative_drop": 0.3, "time_constant": 0.05}


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """Three seconds of a rig with an unbalanced load on channel 2 and a supply that droops."""
    folder = tmp_path_factory.mktemp("rig")
    values = {"eccentric_load.amplitude": 0.3, "eccentric_load.phase": 0.5}
    values |= {f"supply_droop.{n}": v for n, v in DROOP.items()}
    practice = make_practice(
        ["eccentric_load:2", "supply_droop"], values=values, duration=3.0, rate=500.0, seed=5, runs=("fit_1",),
        forms="same", base_error=0.0,
    )  # fmt: skip
    practice.write(folder)
    rig = DynamicRig(load_model("paper"), read_parts([folder / "fit_1.csv"], None))
    return Fit(rig, {(c, s.signal): 0.01 for c in rig.channels for s in rig.segments[c]})


def _of_rig(fit: Fit) -> Estimate:
    """The model as given with the supply's droop in it."""
    sides = {}
    for c in fit.rig.channels:
        unknowns = base_unknowns(fit.rig, c)
        sides[c] = Estimate(c, unknowns, np.zeros(len(unknowns)), "as given")
    fit.evaluate(list(sides.values()))
    whole = joined(sides).with_effect("supply_droop", DROOP)
    fit.evaluate([whole])
    whole.columns = {c: np.zeros((whole.simulated[c].size, len(whole.unknowns))) for c in fit.rig.channels}
    return whole


def test_an_effect_of_one_channel_stands_beside_one_of_the_rig(fit: Fit) -> None:
    whole = _of_rig(fit)
    found = whole.with_effect("eccentric_load", {"amplitude": 0.3, "phase": 0.5}, 1)
    assert found.placed_effects() == [("supply_droop", None), ("eccentric_load", 1)]
    assert found.request().values["eccentric_load.amplitude"] == (nan, 0.3)  # NaN: as given
    assert found.request().values["supply_droop.relative_drop"] == (0.3, 0.3)
    assert found.without("eccentric_load", 0).placed_effects() == found.placed_effects()
    assert found.without("eccentric_load", 1).request() == whole.request()
    # What is true of both is simulated to within the noise.
    fit.evaluate([found])
    rms = fit.rms(found.simulated[1], 1)[0, "speed"]
    assert rms < 0.02 * fit.rms(whole.simulated[1], 1)[0, "speed"] + 0.15


def test_a_channel_is_screened_beside_an_effect_of_the_rig(fit: Fit) -> None:
    whole = _of_rig(fit)
    present = dict.fromkeys(fit.rig.channels, whole)
    names = ["load_bias", "eccentric_load", "sensor_offset"]
    best = screen(fit, present, names, 3.0)[0]
    assert (best.effect, best.channel) == ("eccentric_load", 1)


@pytest.mark.parametrize(("gains", "leads"), [((90.0, 50.0, 30.0), True), ((70.0, 50.0, 30.0), False)])
def test_an_effect_of_the_rig_leads_where_it_promises_more_than_both_channels(
    fit: Fit, gains: tuple[float, float, float], leads: bool
) -> None:
    of_rig, one, two = gains
    rows = [
        ("supply_droop", None, of_rig),
        ("dead_zone", 0, one),
        ("load_bias", 0, 10.0),
        ("dead_zone", 1, two),
    ]
    screening = [Screening(name, c, {}, gain, 100.0) for name, c, gain in rows]
    assert rig_effect_leads(Search(fit, {}, screening, 3.0, {})) == leads


@pytest.mark.slow
def test_what_a_channel_has_is_found_beside_an_effect_of_the_rig(tmp_path: Path) -> None:
    practice = make_practice(
        ["directional_gain:1", "viscosity_drift"], duration=8.0, rate=500.0, seed=11, base_error=0.1
    )
    practice.write(tmp_path)
    logs = [tmp_path / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
    found = diagnose(logs[:2], logs[2:], model=tmp_path / "model.yaml")
    assert {(e.name, e.channel) for e in found.effects} == {
        ("directional_gain", "1"),
        ("viscosity_drift", "rig"),
    }
