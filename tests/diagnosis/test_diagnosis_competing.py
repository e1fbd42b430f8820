"""What becomes of a candidate, and what else would do as well in the place of an effect that was taken."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import Estimate, Fit, differentiate, solve
from hydro_env.diagnosis.stages import elimination
from hydro_env.diagnosis.stages.candidates import Accepted, Search, Selection, is_neutral
from hydro_env.diagnosis.stages.elimination import compare_competing, drop_unneeded
from hydro_env.diagnosis.stages.naming import name_effects
from hydro_env.diagnosis.stages.screening import screen
from hydro_env.plant import CATALOGUE
from tests.linear_rig import NOISE, logged, time_of

ROWS = 4000
TIME = time_of(ROWS)


def _found(curves: dict[str, np.ndarray], hidden: str, accepted: str) -> Search:
    """A rig with a hidden effect, for which `accepted` was accepted, after the question what else would do."""
    typical = {n: CATALOGUE[n].parameters[0].typical for n in curves}
    by_value = {f"{n}.coefficient": curve / typical[n] for n, curve in curves.items()}
    fit, base = logged(by_value, {f"{hidden}.coefficient": 0.8 * typical[hidden]}, ROWS)
    screening = screen(fit, {0: base}, fit.rig.candidates(), 4.0)
    found = base.extended(accepted, next(k.start for k in screening if k.effect == accepted))
    solve(fit, [found], 6)
    search = Search(fit, {0: base}, screening, 4.0, {0: found})
    search.accepted = [Accepted(accepted, 0, 5000.0, 18.0, {}, base)]
    compare_competing(search)
    return search


def test_a_declared_alternative_is_listed_though_nothing_had_tried_it() -> None:
    drag = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME)
    search = _found({"line_loss": drag, "quadratic_drag": drag}, "quadratic_drag", "line_loss")
    assert search.accepted[0].effect == "line_loss" and {*search.accepted[0].competing} == {"quadratic_drag"}
    selection = Selection(search.present, search.accepted, [], {})
    named = name_effects(search.fit, selection, search.screening, search.present)
    assert named[0].indistinguishable_from == ["quadratic_drag"]
    assert named[0].probability == pytest.approx(0.5, abs=0.05)


def test_a_declared_alternative_that_explains_much_less_is_not_listed() -> None:
    drag, other = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME), np.cos(11.0 * TIME)
    search = _found({"line_loss": drag, "quadratic_drag": other}, "line_loss", "line_loss")
    assert search.accepted[0].effect == "line_loss" and not search.accepted[0].competing


def test_a_candidate_that_explains_more_takes_the_place() -> None:
    drag = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME)
    near = drag + 0.1 * np.cos(11.0 * TIME)
    search = _found({"line_loss": near, "quadratic_drag": drag}, "quadratic_drag", "line_loss")
    assert search.accepted[0].effect == "quadratic_drag"
    assert search.present[0].effects() == ["quadratic_drag"]


@pytest.mark.parametrize(("curve", "kept"), [(np.sin(3.0 * TIME), False), (np.cos(11.0 * TIME), True)])
def test_an_effect_that_led_known_parameters_out_of_a_bad_place_is_not_named(
    curve: np.ndarray, kept: bool
) -> None:
    typical = CATALOGUE["line_loss"].parameters[0].typical
    assert typical is not None
    curves = {"line_loss.coefficient": 0.02 * curve / typical}
    fit, without = logged(curves, {"line_loss.coefficient": typical}, ROWS)
    # Calibration ended where it explains nothing of a gap that is small, though the inertia alone could (the first curve).
    without.q[:] = 0.0
    fit.evaluate([without])
    found = without.with_effect("line_loss", {"coefficient": 0.5 * typical})
    solve(fit, [found], 6)
    search = Search(fit, {0: without}, [], 4.0, {0: found})
    search.accepted = [Accepted("line_loss", 0, 500.0, 18.0, {}, without)]
    drop_unneeded(search)
    assert [c.effect for c in search.accepted] == (["line_loss"] if kept else [])
    assert search.present[0].effects() == (["line_loss"] if kept else [])
    assert fit.at_noise(search.present[0], 1.05) and len(search.candidates) == (0 if kept else 1)


def test_estimates_near_the_noise_settle_before_they_are_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    curve = np.cos(11.0 * TIME)
    fit, without = logged({"line_loss.coefficient": curve}, {}, ROWS)
    found = without.with_effect("line_loss", {"coefficient": 0.0})
    solve(fit, [found], 6)
    # Without the effect the fit stops a little early: more than the effect costs, and too little to be seen in the residual.
    inertia = without.unknowns[0]
    without.q[:] += 0.1 * NOISE[0, "speed"] / (inertia.value(1.0) / inertia.value(0.0) - 1.0)

    def stops_at_once(fit: Fit, estimates: list[Estimate], *_: object, **__: object) -> None:
        fit.evaluate(estimates)
        differentiate(fit, estimates)

    monkeypatch.setattr(elimination, "solve", stops_at_once)
    fit.evaluate([without])
    assert fit.at_noise(without) and fit.gain(without, found) > 5.0
    search = Search(fit, {0: without}, [], 4.0, {0: found})
    search.accepted = [Accepted("line_loss", 0, 500.0, 5.0, {}, without)]
    drop_unneeded(search)
    assert not search.accepted and not search.present[0].effects()


@pytest.mark.parametrize(
    ("effect", "parameter", "value", "neutral"),
    [
        ("load_bias", "bias", 0.001, True),
        ("load_bias", "bias", -0.1, False),
        ("driver_saturation", "voltage_limit", 72.8, True),  # of 73 V at most
        ("driver_saturation", "voltage_limit", 70.0, False),
        ("flow_saturation", "opening_limit", 8.55e-4, True),
    ],
)
def test_what_is_next_to_neutral_has_vanished(
    effect: str, parameter: str, value: float, neutral: bool
) -> None:
    assert is_neutral(Estimate(0, [], np.zeros(0)).with_effect(effect, {parameter: value}), effect) == neutral
