"""Corrections of form: a rounded dead zone is mended, a right form is left alone, and without a name there is nothing."""

from __future__ import annotations

from math import isnan, nan
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate, joined
from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.estimation.gauss_newton import solve
from hydro_env.diagnosis.estimation.unknowns import effect_unknowns
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.logs import Logs
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import Calibrated, base_unknowns
from hydro_env.diagnosis.stages.candidates import ACCEPTED, Accepted
from hydro_env.diagnosis.stages.form_correction import (
    correct,
    correct_all,
    of_given,
    with_correction,
)
from hydro_env.diagnosis.stages.search import Search
from hydro_env.diagnosis.stages.selection import drop_vanished, prefer_form
from hydro_env.plant import CATALOGUE, load_model
from hydro_env.practice.generate import make_practice
from tests.linear_rig import LinearRig, logged, time_of

SIZES = ("overlap_positive", "overlap_negative")


def _fitted(folder: Path, forms: str) -> tuple[Fit, Estimate]:
    """A rig with overlap on channel 1, whose corners are round or (forms "same") sharp, with the right effect fitted."""
    sizes = {"overlap_positive": 1e-4, "overlap_negative": 7e-5}
    practice = make_practice(
        ["dead_zone:1"], values={f"dead_zone.{n}": v for n, v in sizes.items()}, duration=6.0, rate=500.0, seed=4,
        runs=("fit_1",), forms=forms, noise=0.3,
    )  # fmt: skip
    practice.write(folder)
    fit, found = _fit_of(folder)
    solve(fit, [found], 6)
    return fit, found


def _fit_of(folder: Path) -> tuple[Fit, Estimate]:
    """The log of a folder, with overlap at its true size in the first channel's model."""
    sizes = {"overlap_positive": 1e-4, "overlap_negative": 7e-5}
    rig = DynamicRig(load_model("paper"), read_parts([folder / "fit_1.csv"], None))
    rig.channels = (0,)
    unknowns = [*base_unknowns(rig, 0), *effect_unknowns(CATALOGUE["dead_zone"], sizes)]
    found = Estimate(0, unknowns, np.zeros(len(unknowns)), "dead_zone")
    Fit(rig, {(0, s.signal): 1e-9 for s in rig.segments[0]}).evaluate([found])
    fit = Fit(rig, noise_of(rig, {0: found}))
    fit.evaluate([found])
    return fit, found


@pytest.mark.parametrize(("forms", "truth"), [("different", 0.0), ("same", 0.1)])
def test_what_another_form_explains_is_no_second_effect(tmp_path: Path, forms: str, truth: float) -> None:
    name = "flow_gain_nonlinearity"
    sizes = {"dead_zone.overlap_positive": 1e-4, "dead_zone.overlap_negative": 7e-5}
    hidden = ["dead_zone:1"] + ([f"{name}:1"] if truth else [])
    values = {**sizes, **({f"{name}.curvature": truth} if truth else {})}
    practice = make_practice(
        hidden, values=values, duration=6.0, rate=500.0, seed=4, runs=("fit_1",), forms=forms, noise=0.3
    )
    practice.write(tmp_path)
    fit, one = _fit_of(tmp_path)
    both = one.with_effect(name, {"curvature": 0.05})
    solve(fit, [one, both], 6)
    bare = one.without("dead_zone")
    fit.evaluate([bare])
    search = Search(fit, {0: bare}, [], 6.0, {0: both})
    search.accepted = [
        Accepted("dead_zone", 0, 5000.0, 37.0, {}, bare),
        Accepted(name, 0, 50.0, 18.0, {}, one),
    ]
    prefer_form(search)
    assert [k.effect for k in search.accepted] == ["dead_zone", name] if truth else ["dead_zone"]
    assert search.present[0].effects() == [k.effect for k in search.accepted]
    assert all(k.outcome != ACCEPTED for k in search.candidates)


def test_a_second_effect_goes_where_another_form_of_the_first_explains_more() -> None:
    rows = 4000
    first, second, third, little = (np.sin(w * time_of(rows)) for w in (60.0, 83.0, 111.0, 137.0))
    curves = {
        "flow_gain_nonlinearity.curvature": first,
        "directional_gain.ratio": first + 2.0 * second + 0.02 * little,
        "load_bias.bias": little,
        "opening_form.gain_2": second,
        "opening_form.gain_4": third,
    }
    # The first law, a quarter of one bend, 10 % of another, and a trace that only the second law has.
    truth = {
        "flow_gain_nonlinearity.curvature": 0.5,
        "opening_form.gain_2": 0.25,
        "opening_form.gain_4": 0.1,
        "load_bias.bias": 0.01,
    }
    fit, base = logged(curves, truth, rows)
    one = base.with_effect("flow_gain_nonlinearity", {"curvature": 0.5})
    both = one.with_effect("directional_gain", {"ratio": 0.1})
    solve(fit, [one, both], 6)
    search = Search(fit, {0: base}, [], 4.0, {0: both})
    search.accepted = [
        Accepted("flow_gain_nonlinearity", 0, 500.0, 18.0, {}, base),
        Accepted("directional_gain", 0, 500.0, 18.0, {}, one),
    ]
    prefer_form(search)
    assert [k.effect for k in search.accepted] == ["flow_gain_nonlinearity"]
    best = search.form_of(search.present[0])
    assert best is not None and best.estimate.effects() == ["flow_gain_nonlinearity", "opening_form"]
    assert fit.at_noise(best.estimate, 1.5) and not fit.at_noise(search.present[0], 5.0)


ROWS = 4000
_BEND, _OTHER = np.sin(83.0 * time_of(ROWS)), np.sin(111.0 * time_of(ROWS))
#: Curves of a given effect's own correction, of one that it shares, and of three effects: one that the shared curve can take up,
#: one that it imitates, and one that is nothing of both.
BENDS = {
    "orifice_form.laminar": np.sin(60.0 * time_of(ROWS)),
    "torque_form.torque_4": _BEND,
    "sensor_gain.gain": _BEND,
    "sensor_offset.offset": _BEND + 2.0 * _OTHER,
    "load_bias.bias": np.sin(137.0 * time_of(ROWS)),
}
GIVEN = {"pressure_dependent_flow.supply_pressure": 1e7, "line_loss.coefficient": 4e13}


def _with_given(truth: dict[str, float]) -> tuple[Fit, Estimate]:
    """A rig whose model has an orifice law and a line loss; its speed has the `truth`."""
    fit, base = logged(BENDS, truth, ROWS)
    fit.rig.model = load_model("paper").with_values(GIVEN)
    return fit, base


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_form_of_a_given_effect_is_corrected_before_anything_is_named(missing: float) -> None:
    """Also beside a missing effect, but not by a curve that could take that up."""
    truth = {"orifice_form.laminar": 0.2, "torque_form.torque_4": 0.1, "load_bias.bias": missing}
    fit, base = _with_given(truth)
    before = Calibrated(Logs(fit, fit.rig, fit.rig), {}, {0: base}, [])
    after, kept = of_given(before)
    assert [(k.effect, k.correction, k.channel) for k in kept] == [
        ("pressure_dependent_flow", "orifice_form", 0)
    ]
    assert after.estimates[0].effects() == ["orifice_form"] and after.plain == {0: base}
    assert after.estimates[0].values(0)["orifice_form.laminar"] == pytest.approx(0.2, abs=0.02)


def test_a_given_effect_of_the_right_form_is_left_alone() -> None:
    fit, base = _with_given({})
    before = Calibrated(Logs(fit, fit.rig, fit.rig), {}, {0: base}, [])
    assert of_given(before) == (before, [])


@pytest.mark.parametrize(
    ("effect", "own", "stays"),
    [("sensor_gain", 0.0, True), ("sensor_offset", 0.0, False), ("load_bias", 0.05, True)],
)
def test_an_effect_beside_given_ones_explains_more_than_their_form(
    effect: str, own: float, stays: bool
) -> None:
    """As much with fewer numbers, or what no form of them explains."""
    truth = {"torque_form.torque_4": 0.1, "load_bias.bias": own}
    fit, base = _with_given(truth)
    name = next(n for n in BENDS if n.startswith(effect))
    more = base.with_effect(effect, {name.split(".")[1]: 0.05})
    solve(fit, [more], 6)
    search = Search(fit, {0: base}, [], 4.0, {0: more})
    search.accepted = [Accepted(effect, 0, 500.0, 18.0, {}, base)]
    prefer_form(search)
    assert [k.effect for k in search.accepted] == ([effect] if stays else [])


def test_rounded_corners_are_put_right_at_their_own_port(tmp_path: Path) -> None:
    fit, found = _fitted(tmp_path, "different")
    better, kept = correct(fit, found, [("dead_zone", 0)])
    assert "corner_form" in [k.correction for k in kept] and better.cost < found.cost
    left = [
        max(v / fit.noise[0, s] for (_, s), v in fit.rms(p.simulated[0], 0).items()) for p in (found, better)
    ]
    assert left[1] < left[0]
    values = better.values(0)
    assert 1e-6 < values["corner_form.rounding"] < 3e-5
    assert values["corner_form.corner_positive"] == values["dead_zone.overlap_positive"]
    assert values["dead_zone.overlap_positive"] == pytest.approx(1e-4, rel=0.05)


def test_the_size_of_an_orifice_law_of_another_form_is_right(tmp_path: Path) -> None:
    """At 10 bar the load comes near to the supply pressure, where the edges are laminar."""
    name, supply = "pressure_dependent_flow", 10e5
    make_practice(
        [f"{name}:1"], values={f"{name}.supply_pressure": supply}, duration=6.0, rate=500.0, seed=552, runs=("fit_1",)
    ).write(tmp_path)  # fmt: skip
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    rig.channels = (0,)
    unknowns = [*base_unknowns(rig, 0), *effect_unknowns(CATALOGUE[name], {"supply_pressure": 1.05 * supply})]
    found = Estimate(0, unknowns, np.zeros(len(unknowns)), name)
    Fit(rig, {(0, s.signal): 1e-9 for s in rig.segments[0]}).evaluate([found])
    fit = Fit(rig, noise_of(rig, {0: found}))
    solve(fit, [found], 6)
    better, kept = correct(fit, found, [(name, 0)])
    assert [k.correction for k in kept] == ["orifice_form"]
    off = [abs(p.values(0)[f"{name}.supply_pressure"] / supply - 1.0) for p in (found, better)]
    assert off[1] < 0.002 < off[0] and fit.at_noise(better, 1.1) and not fit.at_noise(found, 1.1)


def test_a_right_form_is_left_alone(tmp_path: Path) -> None:
    fit, found = _fitted(tmp_path, "same")
    better, kept = correct(fit, found, [("dead_zone", 0)])
    assert not kept and better is found


def _bare() -> Estimate:
    unknowns = effect_unknowns(CATALOGUE["dead_zone"], {"overlap_positive": 1e-4, "overlap_negative": 8e-5})
    return Estimate(0, unknowns, np.zeros(len(unknowns)), "dead_zone")


class _Silent:
    """A model that must not be asked."""

    has_hidden_states = True
    channels = (0, 1)
    model = load_model("paper")

    def predict(self, requests: list[Request]) -> list[dict[int, np.ndarray]]:
        raise AssertionError("nothing is to be simulated")


def test_without_a_name_nothing_is_corrected() -> None:
    problems = {0: _bare()}
    fit = Fit(_Silent(), {})  # type: ignore[arg-type]
    assert correct_all(fit, problems, []) == (problems, [])


def test_a_correction_repeats_what_it_corrects() -> None:
    problem = with_correction(_bare(), "dead_zone", CATALOGUE["corner_form"])
    values = problem.request().values
    assert values["corner_form.corner_negative"] == values["dead_zone.overlap_negative"] == 8e-5
    assert values["corner_form.turn"] == 1.0 and "corner_form.turn" not in [u.name for u in problem.unknowns]


def test_channels_that_are_joined_keep_their_own_effects() -> None:
    sizes = {"overlap_positive": 3e-5, "overlap_negative": 3e-5}
    other = Estimate(1, effect_unknowns(CATALOGUE["dead_zone"], sizes), np.zeros(2))
    first = _bare()
    first.simulated, other.simulated = {0: np.zeros(3)}, {1: np.zeros(3)}
    values = joined({0: first, 1: other}).request().values
    assert values["dead_zone.overlap_positive"] == (1e-4, 3e-5)
    other.unknowns, other.q = effect_unknowns(CATALOGUE["load_bias"], {"bias": 0.2}), np.zeros(1)
    whole = with_correction(joined({0: first, 1: other}), "dead_zone", CATALOGUE["corner_form"], 0)
    values = whole.request().values
    assert values["dead_zone.overlap_positive"] == (1e-4, nan) and values["load_bias.bias"] == (nan, 0.2)
    assert values["corner_form.rounding"] == (1e-5, nan)
    assert values["corner_form.corner_positive"][0] == 1e-4 and isnan(
        values["corner_form.corner_positive"][1]
    )
    assert whole.values(1) == {"load_bias.bias": 0.2, "corner_form.turn": 1.0}


def test_an_effect_that_vanishes_beside_one_of_the_rig_is_not_named() -> None:
    first, other = (
        _bare(),
        Estimate(1, effect_unknowns(CATALOGUE["dead_zone"], dict.fromkeys(SIZES, 0.0)), np.zeros(2)),
    )
    first.simulated, other.simulated = {0: np.zeros(3)}, {1: np.zeros(3)}
    choices = [Accepted("dead_zone", c, 50.0, 36.0) for c in (0, 1)] + [
        Accepted("supply_droop", None, 90.0, 36.0)
    ]
    whole = joined({0: first, 1: other})
    rig = LinearRig({"dead_zone.overlap_positive": np.ones(3)}, np.arange(3.0))
    search = Search(Fit(rig, {}), {}, [], 4.0, dict.fromkeys((0, 1), whole), choices)  # type: ignore[arg-type]
    assert drop_vanished(search, whole).placed_effects() == [("dead_zone", 0)]
    assert [(k.effect, k.channel) for k in search.accepted] == [("dead_zone", 0), ("supply_droop", None)]
    (trial,) = search.candidates
    assert (trial.effect, trial.channel) == ("dead_zone", 1) and "vanishes" in trial.outcome
