"""What else would do as well in the place of an effect that was taken."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from hydro_env.diagnosis.fit import Problem, solve
from hydro_env.diagnosis.machine import Request, Segment
from hydro_env.diagnosis.result import named_effects
from hydro_env.diagnosis.select import Choice, Selection, _rivals_again, extended
from hydro_env.diagnosis.signatures import Look, first_look
from hydro_env.diagnosis.unknowns import base_unknown
from hydro_env.plant import CATALOGUE, PARAMETERS

ROWS = 4000
TIME = np.arange(ROWS) * 1e-3


@dataclass
class _Linear:
    """A machine whose speed is a sum of curves: one for the inertia and one for every effect, by its share of the typical
    size; `curves` of two effects may be equal."""

    curves: dict[str, np.ndarray]
    channels: tuple[int, ...] = (0,)
    quick: bool = False
    segments: dict[int, list[Segment]] = field(default_factory=dict)

    def predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        return [{0: self._speed(dict(r.values))} for r in requests]  # type: ignore[arg-type]

    def _speed(self, values: dict[str, float]) -> np.ndarray:
        total = values.get("J", PARAMETERS["J"].nominal) / PARAMETERS["J"].nominal * np.sin(3.0 * TIME)
        for name, curve in self.curves.items():
            parameter = CATALOGUE[name].parameters[0]
            total = total + values.get(f"{name}.{parameter.name}", 0.0) / parameter.typical * curve
        return total

    def candidates(self) -> list[str]:
        return list(self.curves)


FLOORS = {(0, "speed"): 0.01}


def _found(curves: dict[str, np.ndarray], hidden: str, taken: str) -> tuple[_Linear, Selection, list[Look]]:
    """A rig with a hidden effect, for which `taken` was taken, after the question what else would do."""
    rig = _Linear(curves)
    truth = rig._speed({f"{hidden}.coefficient": 0.8 * CATALOGUE[hidden].parameters[0].typical})
    noise = 0.01 * np.random.default_rng(0).standard_normal(ROWS)
    every = np.arange(ROWS)
    rig.segments[0] = [
        Segment(0, 0, "speed", truth + noise, every, np.ones(ROWS, bool), 1e-3, slice(0, ROWS))
    ]
    base = Problem(0, [base_unknown(PARAMETERS["J"], PARAMETERS["J"].nominal)], np.zeros(1), "calibrated")
    solve(rig, [base], FLOORS, 4)  # type: ignore[arg-type]
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
