"""Sliders of effects: neutral in the middle or at the end, the catalogue's bounds at the ends, and every value accepted."""

from __future__ import annotations

from math import inf

import pytest

from hydro_env.lab.adjust import Slider, effects_by_port, sliders
from hydro_env.lab.rig import effects_offered
from hydro_env.plant import CATALOGUE, PlantModel, Scales, scales_of
from hydro_env.plant.catalogue import BUILT_IN, PORTS


@pytest.mark.parametrize("effect", BUILT_IN)
def test_positions_cover_the_catalogues_range(effect: str) -> None:
    for p in CATALOGUE[effect].parameters:
        check(Slider(effect, p, 0))


def check(slider: Slider, model: PlantModel | None = None) -> None:
    p = slider.parameter
    values = [slider.value(position) for position in range(slider.lowest, slider.highest + 1)]
    finite = [value for value in values if value < inf]
    assert (
        slider.value(0) == p.neutral
        and slider.lowest <= 0 <= slider.highest
        and slider.lowest < slider.highest
    )
    assert max(finite) == p.high and min(finite) == min(p.low, p.neutral)
    rising = sorted(values)
    assert values in (rising, rising[::-1])
    for value in {*values[::20], values[-1]}:
        (model or PlantModel()).with_values({slider.name: value})  # none is refused
    assert all(slider.value(slider.position(value)) == value for value in values[::20])
    assert slider.value(10**6) == values[-1]


def at(rated: float) -> PlantModel:
    """The paper's rig with coils of this rated command, V."""
    return PlantModel().with_values({"u_rated": rated, "R": rated / 0.73})


@pytest.mark.parametrize("rated", [1.0, 10.0, 24.0, 200.0])
def test_bounds_in_volts_are_those_of_the_valves(rated: float) -> None:
    for effect in map(CATALOGUE.__getitem__, BUILT_IN):
        for slider in sliders(effect, (scales_of(at(rated), 0), scales_of(at(rated), 1))):
            check(slider, at(rated))
    (limit, _) = sliders(CATALOGUE["driver_saturation"], (scales_of(at(10.0)), scales_of(at(24.0))))
    assert limit.parameter.high == 10.0


def test_every_effect_has_its_port_and_rigs_have_one_slider() -> None:
    ports = effects_by_port()
    assert [port for port in PORTS if port in ports] == list(ports)
    assert (
        {effect.name for effects in ports.values() for effect in effects}
        == {*effects_offered()}
        == {*BUILT_IN}
    )
    assert [slider.channel for slider in sliders(CATALOGUE["supply_droop"], (Scales(), Scales()))] == [
        None,
        None,
    ]


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("dead_zone.overlap_positive", 7e-5, "70 µm"),
        ("pressure_dependent_flow.supply_pressure", inf, "none"),
        ("pressure_dependent_flow.supply_pressure", 1e7, "100 bar"),
        ("viscosity_drift.time_constant", 100.0, "100 s"),
        ("command_delay.delay", 0.005, "5 ms"),
        ("sensor_gain.gain", 1.0, "1"),
    ],
)
def test_values_read_as_an_engineer_writes_them(name: str, value: float, text: str) -> None:
    effect, parameter = name.split(".")
    assert Slider(effect, CATALOGUE[effect].parameter(parameter), 0).text(value) == text
