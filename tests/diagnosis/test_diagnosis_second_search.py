"""The second search where nothing explains a channel, and what a size at the edge says."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import Estimate, Fit, effect_starts, solve
from hydro_env.diagnosis.stages.candidates import AT_EDGE, Search, judge
from hydro_env.diagnosis.stages.second_search import is_lost, search_again
from hydro_env.plant import CATALOGUE
from tests.linear_rig import LinearRig, logged, time_of

ROWS = 6000
TIME = time_of(ROWS)
BEND, OTHER = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME), np.cos(11.0 * TIME)
DRAG, BIAS, GAIN = "quadratic_drag", "load_bias", "flow_gain_nonlinearity"


def _search(fit: Fit, base: Estimate) -> Search:
    """A search in which nothing was found."""
    return Search(fit, {0: base}, [], 6.0, {0: base})


def test_what_was_lost_is_found_when_all_begin_again() -> None:
    curves = {f"{DRAG}.coefficient": 1e4 * BEND, f"{BIAS}.bias": OTHER}
    search = _search(*logged(curves, {f"{DRAG}.coefficient": 7e-5}, ROWS))
    assert is_lost(search, 0)
    assert search_again(search, 0) and not is_lost(search, 0)
    found = search.present[0]
    assert [k.effect for k in search.accepted] == [DRAG] and found.effects() == [DRAG]
    assert found.values(0)[f"{DRAG}.coefficient"] == pytest.approx(7e-5, rel=0.05)
    assert {t.effect: t.outcome for t in search.candidates} == {DRAG: "taken", BIAS: "others explain more"}
    assert all(t.round == search.fit.settings.max_effects + 1 for t in search.candidates)


def test_what_leaves_much_is_not_taken_from_many_starts() -> None:
    """The best of many starts of wrong effects explains something; that is no name."""
    curves = {f"{DRAG}.coefficient": 1e4 * BEND + OTHER * 3e3, f"{BIAS}.bias": np.sin(5.0 * TIME)}
    fit, base = logged(curves, {f"{DRAG}.coefficient": 7e-5}, ROWS)
    assert isinstance(fit.rig, LinearRig)
    fit.rig.curves = {f"{DRAG}.coefficient": 1e4 * BEND, f"{BIAS}.bias": np.sin(5.0 * TIME)}
    search = _search(fit, base)
    assert not search_again(search, 0) and search.present[0] is base and not search.accepted
    assert "leaves too much to be trusted" in {t.outcome for t in search.candidates}


@pytest.mark.parametrize(("beyond", "outcome"), [(1.005, "taken"), (1.6, AT_EDGE)])
def test_a_size_at_the_edge_counts_where_it_leaves_nothing(beyond: float, outcome: str) -> None:
    high = CATALOGUE[GAIN].parameter("curvature").high
    fit, base = logged({f"{GAIN}.curvature": BEND}, {f"{GAIN}.curvature": beyond * high}, ROWS)
    found = base.extended(GAIN, {"curvature": 0.5})
    solve(fit, [found], 6)
    assert judge(fit, base, found, GAIN, 1000.0) == outcome


def test_every_size_and_shape_is_a_start_where_the_whole_list_is_wanted() -> None:
    eccentric = CATALOGUE["eccentric_load"]
    few, many = effect_starts(eccentric, 12.0), effect_starts(eccentric, 12.0, whole=True)
    assert {row["amplitude"] for row in few} < {row["amplitude"] for row in many}
    assert {row["phase"] for row in few} == {row["phase"] for row in many}
