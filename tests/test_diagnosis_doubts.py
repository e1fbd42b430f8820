"""What makes an answer doubtful, and what a candidate is given before it is given up."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.least_squares import Problem, evaluate, solve
from hydro_env.diagnosis.estimation.uncertainty import Certainty, undetermined
from hydro_env.diagnosis.models.base import Segment
from hydro_env.diagnosis.stages.screening import Look
from hydro_env.diagnosis.stages.selection import (
    Choice,
    Selection,
    Trial,
    _form_leads_inside,
    _second_wind,
    at_edge,
    extended,
)
from hydro_env.diagnosis.stages.validation import Proof
from hydro_env.diagnosis.stages.verdict import doubts
from hydro_env.plant import CATALOGUE
from tests.linear_machine import FLOORS, LinearMachine, logged, time_of

ROWS = 12000
TIME = time_of(ROWS)
GAIN = "flow_gain_nonlinearity"


def _look(effect: str, value: float, gain: float = 1000.0) -> Look:
    return Look(effect, 0, {CATALOGUE[effect].parameters[0].name: value}, gain, 1e4, np.zeros(1))


@pytest.mark.parametrize(("size", "inside"), [(0.4, True), (3.0, False)])
def test_an_estimate_at_the_edge_is_judged_beside_the_form(size: float, inside: bool) -> None:
    """A form that pushes the estimate to the edge is put right; a size that no rig has stays beyond it."""
    bend = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME)
    curves = {f"{GAIN}.curvature": bend, "opening_shape.gain_2": 4.0 * bend + np.cos(11.0 * TIME)}
    rig, base = logged(curves, {f"{GAIN}.curvature": size, "opening_shape.gain_2": 0.3}, ROWS)
    look = _look(GAIN, 0.5)
    found = extended(base, look)
    solve(rig, [found], FLOORS, 6)  # type: ignore[arg-type]
    assert at_edge(found, GAIN)
    assert _form_leads_inside(rig, base, found, look, FLOORS) is inside  # type: ignore[arg-type]


def test_what_leads_away_at_first_is_refitted_before_it_is_given_up() -> None:
    curves = {"quadratic_drag.coefficient": 1e4 * np.sin(2.0 * TIME), "load_bias.bias": np.cos(11.0 * TIME)}
    rig, base = logged(curves, {"quadratic_drag.coefficient": 1e-4}, ROWS)
    looks = [_look("quadratic_drag", 1e-4, 900.0), _look("load_bias", 0.1, 800.0)]
    batch = [(0, k, extended(base, k)) for k in looks]
    batch[0][2].q = np.array([0.0, -3.0])  # a cheap refit that went the wrong way
    evaluate(rig, [p for _, _, p in batch], FLOORS)  # type: ignore[arg-type]
    lost = [Trial(k.effect, 0, 2, -50.0, 18.0, "others explain more", p) for _, k, p in batch]
    best, trials = [batch[1]], list(lost)
    _second_wind(rig, {0: base}, [0], batch, best, trials, FLOORS)  # type: ignore[arg-type]
    assert [k.effect for _, k, _ in best] == ["load_bias", "quadratic_drag"] and trials == [lost[1]]
    values = best[1][2].values(0)
    assert values["quadratic_drag.coefficient"] == pytest.approx(1e-4, rel=0.05)
    # Where a candidate pays already nothing more is tried.
    again = [best[1]]
    _second_wind(rig, {0: base}, [0], batch[1:], again, trials, FLOORS)  # type: ignore[arg-type]
    assert len(again) == 1


def _doubts(
    fit: dict[str, float],
    sealed: dict[str, float],
    quick: bool = False,
    share: float = 1.0,
    apart: float = 0.0,
) -> list[str]:
    """The doubts about a name with these errors of the speed, of which those of the fit logs are in a `share` of the time.

    `apart` is by how many times the noise the courses of a replica differ that the fit logs cannot part from the estimate.
    """
    rig, every = (
        LinearMachine({"load_bias.bias": np.ones(ROWS)}, TIME, quick=quick, signals=2),
        np.arange(ROWS),
    )
    size = np.where(every < share * ROWS, fit["after"] / np.sqrt(share), 1.0)
    errors = {"speed": size, "pressure": np.ones(ROWS)}
    rng = np.random.default_rng(1)
    rig.segments[0] = [
        Segment(0, 0, name, v * rng.standard_normal(ROWS), every, every >= 0, 1e-3, slice(n * ROWS, (n + 1) * ROWS))
        for n, (name, v) in enumerate(errors.items())
    ]  # fmt: skip
    problem = extended(Problem(0, [], np.zeros(0)), _look("load_bias", 0.1))
    moved = problem.q + apart / problem.unknowns[-1].scale
    problem.certainty = Certainty(moved, moved, moved, moved[None])
    selection = Selection({0: problem}, [Choice("load_bias", 0, 500.0, 18.0)], [], {})
    entries = [{"noise": 1.0, "placebo": 30.0, "before": 50.0, **e} for e in (fit, sealed)]
    pressure = {"noise": 1.0, "calibrated": 20.0, "after": 1.0, "placebo": 9.0, "before": 50.0}
    traces = {"after": {0: np.zeros(2 * ROWS)}}
    proofs = [Proof(rig, {"speed_1_rpm": e, "pressure_1_bar": pressure}, traces) for e in entries]  # type: ignore[arg-type]
    floors = {(0, name): 1.0 for name in errors}
    return doubts(rig, selection, {0: problem}, *proofs, floors)  # type: ignore[arg-type]


def test_right_names_are_not_doubted() -> None:
    assert not _doubts({"calibrated": 40.0, "after": 1.02}, {"calibrated": 38.0, "after": 1.05})
    # Far off in the catalogue's form and near the noise in the corrected one.
    assert not _doubts(
        {"calibrated": 40.0, "named": 7.0, "after": 1.1}, {"calibrated": 38.0, "named": 8.0, "after": 2.1}
    )
    # A course through an unstable rest is nobody's fault as long as the fit logs are explained.
    assert not _doubts({"calibrated": 40.0, "after": 1.3}, {"calibrated": 40.0, "after": 34.0})
    # With a tenth of the noise everything is so many times the noise.
    assert not _doubts({"calibrated": 400.0, "after": 12.0}, {"calibrated": 380.0, "after": 13.0})


def test_a_rest_that_no_form_explains_is_doubted() -> None:
    found = _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2})
    assert len(found) == 1 and "the speed of channel 1" in found[0] and "6.3 times its noise" in found[0]
    # Off in a twentieth of the time it is doubted too, but not for one event, as a spool that sticks a moment longer makes it.
    assert _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, share=0.05)
    assert not _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, share=0.008)
    # A steady-valve model is known to leave what moves fast.
    assert not _doubts({"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}, quick=True)


def test_a_rig_that_cannot_be_foretold_refutes_no_name() -> None:
    """What is left of the fit logs, or wrong on the sealed ones, says nothing where replicas part by more."""
    fit, sealed = {"calibrated": 70.0, "after": 6.3}, {"calibrated": 65.0, "after": 6.2}
    assert not _doubts(fit, sealed, apart=8.0) and _doubts(fit, sealed, apart=4.0)
    fit, sealed = {"calibrated": 40.0, "after": 1.0}, {"calibrated": 40.0, "after": 60.0}
    assert not _doubts(fit, sealed, apart=70.0) and _doubts(fit, sealed, apart=50.0)


def test_a_signal_that_pays_for_another_one_is_doubted() -> None:
    found = _doubts({"calibrated": 1.09, "after": 1.22}, {"calibrated": 1.15, "after": 1.20})
    assert len(found) == 1 and "worse" in found[0]
    assert not _doubts({"calibrated": 1.00, "after": 1.02}, {"calibrated": 1.15, "after": 1.20})
    assert not _doubts({"calibrated": 1.01, "after": 1.05}, {"calibrated": 1.01, "after": 1.05})


def test_what_the_sealed_logs_deny_is_doubted() -> None:
    assert _doubts({"calibrated": 40.0, "after": 1.0}, {"calibrated": 40.0, "after": 60.0})


def test_courses_that_part_by_less_than_a_fit_knows_are_said_to_be_undetermined() -> None:
    rig, base = logged({}, {}, ROWS)
    same = np.zeros((8, 1))
    base.certainty = Certainty(same[0], same[0], same[0], same)
    assert undetermined(rig, base, 0, FLOORS) == {}  # type: ignore[arg-type]
    moved = same.copy()
    moved[3] = 1.0  # one of them has another inertia
    base.certainty = Certainty(same[0], same[0], same[0], moved)
    found = undetermined(rig, base, 0, FLOORS)  # type: ignore[arg-type]
    assert set(found) == {"speed"} and found["speed"] > 10.0
