"""What is usual follows the size of the rig."""

from __future__ import annotations

import pytest

from hydro_env.plant import BUILT_IN, CATALOGUE, PlantModel, Scales, load_model, scales_of

#: A motor of 50 cm3 at 250 bar behind a 10 V valve of 60 l/min with 2 mm of travel.
LARGE = {
    "D": 50.0 / 8.47 * 1.348e-6, "J": 0.04, "u_rated": 10.0, "R": 10.0, "alpha": 34.0, "Kq": 0.58,
    "x_max": 0.0025, "pressure_dependent_flow.supply_pressure": 250e5,
}  # fmt: skip


def large() -> PlantModel:
    return PlantModel().with_values(LARGE)


@pytest.mark.parametrize("preset", ["paper", "paper_dead_zone", "rig", "servo"])
def test_scales_are_one_on_the_presets_but_for_the_volts_of_the_rig(preset: str) -> None:
    model = load_model(preset)
    for channel in (None, 0, 1):
        found = scales_of(model, channel)
        volts = model.value("u_rated", 0) / 73.0
        assert found == Scales(command=volts, current=found.current)
        assert found.current == pytest.approx(1.0, abs=0.01)


def test_a_rig_that_is_scaled_by_similarity_has_every_effect_scaled_by_it() -> None:
    """The same share of the travel, of the rated flow, of the torque ... is usual whatever the size."""
    scales = scales_of(large())
    assert scales.displacement == 6.3 and scales.pressure == 2.5 and scales.travel == 2.5
    assert scales.torque == pytest.approx(6.3 * 2.5)
    overlap = scales.effect(CATALOGUE["dead_zone"]).parameters[0]
    assert overlap.typical == pytest.approx(2.5e-4) and overlap.high == pytest.approx(2.5 * 4.5e-4)
    friction = scales.effect(CATALOGUE["motor_coulomb_friction"])
    assert friction.parameter("coulomb").typical == pytest.approx(0.3 * scales.torque)
    assert friction.parameter("stribeck_speed").nominal == pytest.approx(3.0 * scales.speed)
    loss = scales.effect(CATALOGUE["line_loss"]).parameters[0]
    rated = 0.5 * scales.flow * 24.5e-3 / 60.0
    assert loss.typical * rated**2 / (2.5 * 100e5) == pytest.approx(
        4e13 * (0.5 * 24.5e-3 / 60.0) ** 2 / 100e5
    )


def test_a_calibrated_model_keeps_the_scales_of_the_given_one() -> None:
    given = load_model("paper_dead_zone")
    for factor in (0.9, 1.1):
        moved = {name: factor * given.value(name, 0) for name in ("Kq", "D", "J", "k", "R")}
        for name, value in moved.items():
            assert scales_of(given.with_values({name: value})) == scales_of(given)


def test_neutral_values_stay_neutral() -> None:
    scales = scales_of(large())
    for effect in map(CATALOGUE.__getitem__, BUILT_IN):
        for before, after in zip(effect.parameters, scales.effect(effect).parameters, strict=True):
            if before.carries_size:
                assert after.nominal == before.nominal and after.carries_size
            assert (after.low <= after.high) and after.possible[0] <= before.possible[0] <= before.possible[1]
            assert after.possible[1] >= before.possible[1]


def test_each_valve_has_its_own_command_and_the_rig_one_motor_size() -> None:
    model = PlantModel().with_values({"u_rated": (10.0, 73.0), "R": (13.7, 100.0), "Kq": (0.476106, 0.2)})
    first, second = scales_of(model, 0), scales_of(model, 1)
    assert first.command == pytest.approx(10.0 / 73.0) and second.command == 1.0
    assert first.flow == second.flow == 1.0


def test_what_belongs_to_the_oil_stays() -> None:
    usual = scales_of(large()).effect(CATALOGUE["anti_cavitation"])
    assert usual.parameter("opening_pressure") is CATALOGUE["anti_cavitation"].parameter("opening_pressure")


def test_a_rig_of_about_the_papers_size_has_its_numbers_in_a_diagnosis() -> None:
    near = Scales(command=0.2, flow=0.63, pressure=1.25, displacement=1.6)
    assert near.rough == Scales(command=0.2)
    far = Scales(flow=2.0, displacement=0.5)
    assert far.rough == far
