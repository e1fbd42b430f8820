"""What becomes of a candidate, and which effects the known parameters do without."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import Estimate, Fit, differentiate, solve
from hydro_env.diagnosis.stages import elimination
from hydro_env.diagnosis.stages.candidates import Accepted, is_neutral
from hydro_env.diagnosis.stages.elimination import drop_unneeded
from hydro_env.diagnosis.stages.search import Search
from hydro_env.plant import CATALOGUE
from tests.linear_rig import NOISE, logged, time_of

ROWS = 4000
TIME = time_of(ROWS)


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
