"""What a diagnosis of fewer logs found takes part in that of more, and is kept where it explains more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.stages import search, selection
from hydro_env.diagnosis.stages.candidates import ACCEPTED, OUTDONE, Accepted, Candidate, penalty
from hydro_env.diagnosis.stages.screening import screen
from hydro_env.diagnosis.stages.search import Search, in_whole_orders
from hydro_env.diagnosis.stages.selection import recall
from hydro_env.plant import load_model
from hydro_env.practice.generate import make_practice
from tests.linear_rig import logged, time_of

ROWS = 4000
FIRST, SECOND, THIRD = (np.sin(w * time_of(ROWS)) for w in (60.0, 83.0, 97.0))
ALONE, FORMER = "flow_gain_nonlinearity", ("load_bias.bias", "sensor_offset.offset")
CURVES = dict(
    zip((f"{ALONE}.curvature", *FORMER), (FIRST + SECOND + 0.3 * THIRD, FIRST, SECOND), strict=True)
)
#: A model of both effects, with values that are near those of the rigs.
MODEL = load_model("paper").with_values(dict.fromkeys(FORMER, (0.2, 0.0)))


@pytest.fixture(autouse=True)
def no_early_windows(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """The linear rig has one minimum, and no logs to take beginnings of."""
    if "tmp_path" not in request.fixturenames:
        monkeypatch.setattr(search, "grow_horizon", lambda fit, estimates: [])
        monkeypatch.setattr(selection, "_compete_on_beginning", lambda search, refits: {})


def _search(truth: dict[str, float]) -> Search:
    """A search that has accepted one effect in the place of the two that the former model has."""
    fit, base = logged(CURVES, truth, ROWS)
    names = fit.rig.candidates()
    own = Search(fit, {0: base}, screen(fit, {0: base}, names, 4.0), 4.0, {0: base})
    own.put(base.with_effect(ALONE, {"curvature": 0.1}, 0))
    own.settle([own.present[0]])
    own.accepted.append(Accepted(ALONE, 0, 500.0, penalty(fit, ALONE), {}, base))
    own.candidates.append(Candidate(ALONE, 0, 1, 500.0, penalty(fit, ALONE), ACCEPTED, own.present[0]))
    return own


def test_what_was_found_before_is_kept_where_it_explains_more() -> None:
    own = _search({FORMER[0]: 0.23, FORMER[1]: 0.17})
    recall(own, MODEL)
    assert {k.effect for k in own.accepted} == {"load_bias", "sensor_offset"}
    assert all(k.gain > k.needed for k in own.accepted)
    assert {ALONE: OUTDONE}.items() <= {k.effect: k.outcome for k in own.candidates[1:]}.items()
    values = own.present[0].values(0)
    assert [values[name] for name in FORMER] == pytest.approx([0.23, 0.17], abs=0.002)


@pytest.mark.parametrize("channel", [0, 1])
def test_what_was_found_before_and_explains_no_more_is_forgotten(channel: int) -> None:
    """On the same channel it costs a parameter more; on the other one there is nothing of it."""
    own = _search({f"{ALONE}.curvature": 0.2})
    present = own.present[0]
    pairs = dict.fromkeys(FORMER, (0.2, 0.0) if channel == 0 else (0.0, 0.2))
    recall(own, load_model("paper").with_values(pairs))
    assert [k.effect for k in own.accepted] == [ALONE] and own.present[0] is present


def _ripple(order: float) -> tuple[Fit, Estimate]:
    """A ripple of this order, fitted with the order as a real number."""
    curves = {"displacement_ripple.amplitude": FIRST, "displacement_ripple.order": SECOND}
    fit, base = logged(
        curves, {"displacement_ripple.amplitude": 0.1, "displacement_ripple.order": order}, ROWS
    )
    found = base.with_effect("displacement_ripple", {"amplitude": 0.05, "order": 7.0}, 0)
    Search(fit, {}, [], 4.0, {}).settle([free := replace(found)])
    return fit, free


def test_an_order_is_held_at_a_whole_number_unless_the_logs_speak_against_it() -> None:
    for order, kept in ((7.0, 7.0), (7.3, pytest.approx(7.3, abs=0.01))):
        fit, found = _ripple(order)
        assert found.values(0)["displacement_ripple.order"] == kept
        low, high = found.bounds
        assert (low[-1] == high[-1]) == (order == 7.0)
        cost = found.cost
        in_whole_orders(fit, [found])
        assert found.cost == cost


@pytest.mark.slow
def test_names_of_fewer_logs_are_found_again(tmp_path: Path) -> None:
    make_practice(["dead_zone:1"], seed=650010, base_error=0.1, rate=500.0, duration=6.0).write(tmp_path)
    one, two, sealed = (tmp_path / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed"))
    first = diagnose([one], [sealed], model=tmp_path / "model.yaml")
    first.model.to_yaml(tmp_path / "found.yaml")
    both = diagnose([one, two], [sealed], model=tmp_path / "model.yaml", former=tmp_path / "found.yaml")
    assert [(e.name, e.channel) for e in both.effects] == [("dead_zone", "1")]
