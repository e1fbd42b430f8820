"""Models with unusual values: a substep that follows them, found by a short simulation, or one line that refuses them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.experiments.accuracy import commands
from hydro_env.plant import PARAMETERS, Plant, PlantModel, load_model, preset_names, substep_check
from hydro_env.plant.model import SUBSTEP
from hydro_env.practice.reference import simulate_reference
from hydro_env.units import RPM

#: Leakage into the smallest line, of the stiffest oil: with whole substeps 0.18 rpm off.
NOT_FOLLOWED = {
    "V": 2e-6, "beta": 1.9e10, "external_leakage.conductance": -1e-10, "external_leakage.supply_pressure": 2e7,
}  # fmt: skip
#: End stops that hardly damp: the substep and its half differ by six times what is right.
SPRINGY = {"V": 1e-2, "beta": 1.9e10, "v_stop": 0.5}
#: A stiff, hardly damped coupling that rattles.
SEPARATES = {
    "V": 1e-2, "beta": 1.9e10, "Km": 0.0, "shaft_backlash.inertia": 5e-3, "shaft_backlash.gap": 0.1,
    "shaft_backlash.stiffness": 2000.0, "shaft_backlash.damping": 0.01,
}  # fmt: skip


def given(values: dict[str, Any]) -> PlantModel:
    return load_model("paper").with_values(values, name="mine")


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """In how many parts the substep is simulated, with nothing known from before."""
    made: list[int] = []
    simulate = substep_check._speeds

    def counted(values: Any, effects: Any, substep: float, parts: int, *rest: Any) -> Any:
        made.append(parts)
        return simulate(values, effects, substep, parts, *rest)

    substep_check._parts.cache_clear()
    monkeypatch.setattr(substep_check, "_speeds", counted)
    yield made
    substep_check._parts.cache_clear()


def test_usual_models_are_not_simulated(runs: list[int]) -> None:
    ends = [{name: end for name, p in PARAMETERS.items() if np.isfinite(end := pick(p))} for pick in (
        lambda p: p.low, lambda p: p.high,
    )]  # fmt: skip
    usual = [
        *(load_model(name) for name in preset_names()),
        load_model("servo").with_values({"J": 0.003, "dead_zone.overlap_positive": 5e-5}),
        *(given({"V": values["V"], "J": values["J"], "Km": values["Km"]}) for values in ends),
        load_model({"schema": "hydro_env/model/1", "base": "rig", "channel_2": {"valve": "servo"}}),
    ]
    for model in usual:
        assert load_model(model) is model
        Plant(model, 3)
    assert runs == []


def test_a_substep_of_its_own_is_taken_as_it_is(runs: list[int]) -> None:
    model = replace(given(NOT_FOLLOWED), substep=1.1e-4)
    assert load_model(model) is model
    assert Plant(given(NOT_FOLLOWED), substep=SUBSTEP).model.substep == SUBSTEP
    assert runs == []


def test_a_model_that_is_followed_is_stepped_in_halves_and_simulated_once(runs: list[int]) -> None:
    model = given({"Km": 1e-9})
    found = load_model(model)
    assert found == replace(model, finer=2)
    assert load_model(found) is found
    assert runs == [1, 2]
    assert found.with_values({"Km": 1.592e-10}).finer == 1  # of other values nothing is known
    assert Plant(model.with_values({}, name="other"), 2).substep == SUBSTEP / 2
    assert len(runs) == 2


def test_commands_that_are_very_late_do_not_hide_anything() -> None:
    late = given({**NOT_FOLLOWED, "command_delay.delay": 5.0})
    assert load_model(late).finer > 2


def test_a_model_that_is_not_followed_gets_a_finer_substep_and_agrees_with_the_reference(
    tmp_path: Path,
) -> None:
    model = given(NOT_FOLLOWED)
    finer = load_model(model)
    assert finer == replace(model, finer=16)
    model.to_yaml(tmp_path / "mine.yaml", "this test")
    assert load_model(tmp_path / "mine.yaml") == Plant(model).model == finer
    assert load_model(finer) is finer
    volts = 73.0 * commands("bang_bang", 0.3, np.random.default_rng(1))
    truth = simulate_reference(model, volts, None, 0.01, tolerance=1e-8)["speed"]

    def error(used: PlantModel) -> float:
        speed = Plant(used).run(volts, None, 0.01)["speed"][:, 0]
        return float(np.sqrt(np.mean((speed - truth) ** 2, axis=0)).max() / RPM)

    assert error(replace(model, substep=(1.0 - 1e-9) * SUBSTEP)) > 0.1
    assert error(finer) < 0.05


def test_what_no_substep_follows_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, runs: list[int]
) -> None:
    # Models that an eighth does not follow are hard to find.
    monkeypatch.setattr(substep_check, "_PARTS", (1,))
    monkeypatch.setattr(substep_check, "GROWTH", 1e9)
    said = (
        r"model 'mine': channel [12]: no substep down to 125 us follows .*V 0.01 \(usual 2e-05 to 0.001 m3\).*"
        "; give values nearer to what is usual, or a shorter substep$"
    )
    for _ in range(2):
        with pytest.raises(InputError, match=f"^{said}") as caught:
            load_model(given(SPRINGY))
        assert "\n" not in str(caught.value)
    given(SPRINGY).to_yaml(tmp_path / "mine.yaml", "this test")
    with pytest.raises(InputError, match=f"mine.yaml: {said}"):
        Plant(tmp_path / "mine.yaml")


def test_a_motion_that_separates_neighbouring_solutions_does_not_count(runs: list[int]) -> None:
    model = given(SEPARATES)
    load_model(model)  # is not refused
    assert max(runs) == 16


def test_the_result_is_always_the_same() -> None:
    found = []
    for values in (NOT_FOLLOWED, dict(reversed(NOT_FOLLOWED.items()))):
        substep_check._parts.cache_clear()
        found.append(load_model(given(values)).finer)
    assert found[0] == found[1]
