"""What else would do as well in the place of an effect that was taken."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.least_squares import at_noise, beside, evaluate, solve
from hydro_env.diagnosis.stages.screening import Look, first_look
from hydro_env.diagnosis.stages.selection import (
    Choice,
    Selection,
    Trial,
    _needed_after_all,
    _rivals_again,
    extended,
)
from hydro_env.diagnosis.stages.verdict import named_effects
from hydro_env.plant import CATALOGUE
from tests.linear_machine import FLOORS, LinearMachine, logged, time_of

ROWS = 4000
TIME = time_of(ROWS)


def _found(
    curves: dict[str, np.ndarray], hidden: str, taken: str
) -> tuple[LinearMachine, Selection, list[Look]]:
    """A rig with a hidden effect, for which `taken` was taken, after the question what else would do."""
    typical = {n: CATALOGUE[n].parameters[0].typical for n in curves}
    by_value = {f"{n}.coefficient": curve / typical[n] for n, curve in curves.items()}
    rig, base = logged(by_value, {f"{hidden}.coefficient": 0.8 * typical[hidden]}, ROWS)
    looks = first_look(rig, {0: base}, FLOORS, rig.candidates(), 4.0)  # type: ignore[arg-type]
    start = next(k for k in looks if k.effect == taken)
    problem = extended(base, start)
    solve(rig, [problem], FLOORS, 6)  # type: ignore[arg-type]
    choices = [Choice(taken, 0, 5000.0, 18.0, {}, base)]
    present = {0: problem}
    _rivals_again(rig, present, choices, looks, FLOORS)  # type: ignore[arg-type]
    return rig, Selection(present, choices, [], {}), looks


def test_a_declared_rival_is_listed_though_nothing_had_tried_it() -> None:
    drag = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME)
    rig, selection, looks = _found({"line_loss": drag, "quadratic_drag": drag}, "quadratic_drag", "line_loss")
    assert selection.choices[0].effect == "line_loss" and set(selection.choices[0].rivals) == {
        "quadratic_drag"
    }
    named = named_effects(rig, selection, looks, FLOORS)  # type: ignore[arg-type]
    assert named[0].indistinguishable_from == ["quadratic_drag"]
    assert named[0].probability == pytest.approx(0.5, abs=0.05)


def test_a_declared_rival_that_explains_much_less_is_not_listed() -> None:
    drag, other = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME), np.cos(11.0 * TIME)
    _, selection, _ = _found({"line_loss": drag, "quadratic_drag": other}, "line_loss", "line_loss")
    assert selection.choices[0].effect == "line_loss" and not selection.choices[0].rivals


def test_a_rival_that_explains_more_takes_the_place() -> None:
    drag = np.abs(np.sin(2.0 * TIME)) * np.sin(2.0 * TIME)
    near = drag + 0.1 * np.cos(11.0 * TIME)
    _, selection, _ = _found({"line_loss": near, "quadratic_drag": drag}, "quadratic_drag", "line_loss")
    assert selection.choices[0].effect == "quadratic_drag"
    assert selection.problems[0].effects() == ["quadratic_drag"]


@pytest.mark.parametrize(("curve", "kept"), [(np.sin(3.0 * TIME), False), (np.cos(11.0 * TIME), True)])
def test_an_effect_that_led_known_parameters_out_of_a_bad_place_is_not_named(
    curve: np.ndarray, kept: bool
) -> None:
    typical = CATALOGUE["line_loss"].parameters[0].typical
    assert typical is not None
    rig, without = logged(
        {"line_loss.coefficient": 0.02 * curve / typical}, {"line_loss.coefficient": typical}, ROWS
    )
    # Calibration ended where it explains nothing of a gap that is small, though the inertia alone could (the first curve).
    without.q[:] = 0.0
    evaluate(rig, [without], FLOORS)  # type: ignore[arg-type]
    problem = beside(without, "line_loss", {"coefficient": 0.5 * typical})
    solve(rig, [problem], FLOORS, 6)  # type: ignore[arg-type]
    choices, present = [Choice("line_loss", 0, 500.0, 18.0, {}, without)], {0: problem}
    trials: list[Trial] = []
    _needed_after_all(rig, present, choices, FLOORS, trials)  # type: ignore[arg-type]
    assert [c.effect for c in choices] == (["line_loss"] if kept else [])
    assert present[0].effects() == (["line_loss"] if kept else [])
    assert at_noise(rig, present[0], FLOORS, 1.05) and len(trials) == (0 if kept else 1)  # type: ignore[arg-type]
