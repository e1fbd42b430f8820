"""What is done where everything failed, and what a size at the edge says."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.least_squares import Problem, solve
from hydro_env.diagnosis.estimation.unknowns import starts
from hydro_env.diagnosis.stages.screening import Look
from hydro_env.diagnosis.stages.selection import (
    EDGE,
    MOST,
    Choice,
    Trial,
    _lost,
    _once_more,
    _verdict,
    extended,
)
from hydro_env.plant import CATALOGUE
from tests.linear_machine import FLOORS, LinearMachine, logged, time_of

ROWS = 6000
TIME = time_of(ROWS)
BEND, OTHER = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME), np.cos(11.0 * TIME)
DRAG, BIAS, GAIN = "quadratic_drag", "load_bias", "flow_gain_nonlinearity"


def _again(
    rig: LinearMachine, base: Problem, names: list[str]
) -> tuple[bool, Problem, list[Choice], list[Trial]]:
    """The whole catalogue once more on a channel for which nothing was found."""
    present, choices, trials = {0: base}, [], []
    found = _once_more(rig, {0: base}, present, 0, names, FLOORS, 6.0, trials, choices, {})  # type: ignore[arg-type]
    return found, present[0], choices, trials


def test_what_was_lost_is_found_when_all_begin_again() -> None:
    curves = {f"{DRAG}.coefficient": 1e4 * BEND, f"{BIAS}.bias": OTHER}
    rig, base = logged(curves, {f"{DRAG}.coefficient": 7e-5}, ROWS)
    assert _lost(rig, base, base, 0, FLOORS)  # type: ignore[arg-type]
    found, problem, choices, trials = _again(rig, base, [BIAS, DRAG])
    assert found and [k.effect for k in choices] == [DRAG] and problem.effects() == [DRAG]
    assert problem.values(0)[f"{DRAG}.coefficient"] == pytest.approx(7e-5, rel=0.05)
    assert {t.effect: t.fate for t in trials} == {DRAG: "taken", BIAS: "others explain more"}
    assert all(t.round == MOST + 1 for t in trials)
    assert not _lost(rig, base, problem, 0, FLOORS)  # type: ignore[arg-type]


def test_what_leaves_much_is_not_taken_from_many_starts() -> None:
    """The best of many starts of wrong effects explains something; that is no name."""
    curves = {f"{DRAG}.coefficient": 1e4 * BEND + OTHER * 3e3, f"{BIAS}.bias": np.sin(5.0 * TIME)}
    rig, base = logged(curves, {f"{DRAG}.coefficient": 7e-5}, ROWS)
    rig.curves = {f"{DRAG}.coefficient": 1e4 * BEND, f"{BIAS}.bias": np.sin(5.0 * TIME)}
    found, problem, choices, trials = _again(rig, base, [BIAS, DRAG])
    assert not found and problem is base and not choices
    assert "leaves too much to be trusted" in {t.fate for t in trials}


@pytest.mark.parametrize(("beyond", "fate"), [(1.005, "taken"), (1.6, EDGE)])
def test_a_size_at_the_edge_counts_where_it_leaves_nothing(beyond: float, fate: str) -> None:
    high = CATALOGUE[GAIN].parameter("curvature").high
    rig, base = logged({f"{GAIN}.curvature": BEND}, {f"{GAIN}.curvature": beyond * high}, ROWS)
    found = extended(base, Look(GAIN, 0, {"curvature": 0.5}, 1.0, 1.0, np.zeros(1)))
    solve(rig, [found], FLOORS, 6)  # type: ignore[arg-type]
    assert _verdict(rig, base, found, GAIN, 0, 1000.0, 18.0, FLOORS) == fate  # type: ignore[arg-type]


def test_every_size_and_shape_is_a_start_where_the_whole_list_is_wanted() -> None:
    eccentric = CATALOGUE["eccentric_load"]
    few, many = starts(eccentric, 12.0), starts(eccentric, 12.0, whole=True)
    assert {row["amplitude"] for row in few} < {row["amplitude"] for row in many}
    assert {row["phase"] for row in few} == {row["phase"] for row in many}
