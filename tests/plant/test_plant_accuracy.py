"""The compiled kernel against the reference simulator: the largest error of the speed, rpm."""

from __future__ import annotations

import math

import numpy as np
import pytest

from docs.evidence.accuracy import COMMANDS, against_reference, commands, compare, drawn, loads
from hydro_env.plant import BUILT_IN, CATALOGUE, PARAMETERS, Plant, load_model, simulate
from hydro_env.practice.reference import simulate_reference
from tests.golden import SHAPES
from tests.practice.test_reference import paper_experiment

RPM = math.pi / 30


def _error_rpm(model, command, load, period):
    truth = simulate_reference(model, command, load, period, tolerance=1e-8)
    kernel = simulate(model, command, load, period, record=("speed", "measured_speed"))
    return max(np.abs(kernel[name][:, 0] - truth[name]).max() for name in kernel) / RPM


@pytest.mark.parametrize("overlap", [0.0, 70e-6])
def test_paper_experiment(overlap):
    model = load_model("paper")
    if overlap:
        model = model.with_values(
            {"dead_zone.overlap_positive": (overlap, 0.0), "dead_zone.overlap_negative": (overlap, 0.0)}
        )
    truth = paper_experiment(model, tolerance=1e-8)
    kernel = simulate(model, truth["command"], truth["load"], 0.01, record=("speed",))
    assert np.abs(kernel["speed"][:, 0] - truth["speed"]).max() / RPM < 0.1


@pytest.mark.parametrize("kind", ["random", "bang_bang"])
def test_any_command(kind):
    """Commands over the whole action box every 10 ms, spools in their stops."""
    rng = np.random.default_rng(0)
    size = (120, 2)
    command = 73.0 * (rng.uniform(-1.0, 1.0, size) if kind == "random" else rng.choice([-1.0, 1.0], size))
    assert _error_rpm("paper", command, np.zeros(size), 0.01) < 0.1


@pytest.mark.parametrize("preset", ["paper_dead_zone", "rig", "servo", "valve_1", "valve_2"])
def test_presets_under_hard_commands(preset):
    model = load_model(preset)
    rated, rng = model.value("u_rated", 0), np.random.default_rng(1)
    levels = np.concatenate([rng.uniform(-1.0, 1.0, (60, 2)), rng.choice([-1.0, 1.0], (60, 2))])
    command = np.repeat(rated * levels, 5, axis=0)
    assert _error_rpm(model, command, np.zeros_like(command), 0.002) < 0.1


#: The default run takes these, `pytest -m slow` the others.
QUICK = (
    "dead_zone",
    "magnetic_hysteresis",
    "command_delay",
    "supply_droop",
    "motor_coulomb_friction",
    "entrained_air",
)


def _strong(effect):
    """The effect at its strongest bound."""
    values = {}
    for p in effect.parameters:
        typical = p.typical
        if typical == p.nominal:
            value = p.nominal
        elif math.isinf(p.nominal):
            value = p.low
        elif p.nominal > 0.0 and p.log:
            value = p.low if typical < p.nominal else p.high
        else:
            value = p.high if typical > p.nominal else p.low
        values[f"{effect.name}.{p.name}"] = value
    return values | {key: value for key, value in SHAPES.items() if key in values}


@pytest.fixture(scope="module")
def strongest():
    """All effects at their strongest, one to a rig, side by side: commands, loads and the speeds (T, rigs, 2)."""
    rng = np.random.default_rng(1)
    levels = np.where(rng.random((60, 2)) < 0.5, rng.uniform(-73.0, 73.0, (60, 2)), np.nan)
    levels[0] = 30.0
    for n in range(1, 60):  # half of the levels are held for longer
        levels[n] = np.where(np.isnan(levels[n]), levels[n - 1], levels[n])
    load = np.repeat(rng.uniform(-1.0, 1.0, (6, 2)), 10, axis=0)
    command, load = np.repeat(levels, 5, axis=0), np.repeat(load, 5, axis=0)
    plant = Plant("paper", len(BUILT_IN), effects=BUILT_IN)
    for row, name in enumerate(BUILT_IN):
        plant.set_values(_strong(CATALOGUE[name]), rows=[row])
    plant.reset()
    return command, load, plant.run(command, load, 0.002, ("speed", "measured_speed"))


#: Effects that separate neighbouring motions where they are strongest: a gap that rattles, a spring that swings to and fro.
SEPARATING = ("shaft_backlash", "spring_preload")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in BUILT_IN]
)
def test_each_effect_at_its_strongest(name, strongest):
    command, load, kernel = strongest
    model = load_model("paper").with_values(_strong(CATALOGUE[name]))
    truth = simulate_reference(model, command, load, 0.002, tolerance=1e-8)
    row = BUILT_IN.index(name)
    ours = {signal: each[:, row] for signal, each in kernel.items()}
    if name in SEPARATING:
        plant = Plant(model, tolerance=model.tolerance / 30.0)
        out = plant.run(command[:, None], load[:, None], 0.002, tuple(kernel))
        ours = {signal: each[:, 0] for signal, each in out.items()}
    assert max(np.abs(ours[signal] - truth[signal]).max() for signal in kernel) / RPM < 0.1


#: Lines that quick stops and overrunning loads empty, at little supply pressure.
EMPTIED = {
    "typical": {"anti_cavitation.conductance": 1e-9},
    "strong, boosted, small lines": {
        "anti_cavitation.conductance": 3e-9, "anti_cavitation.opening_pressure": 5e5, "V": 2e-5,
    },
    "smallest lines": {"anti_cavitation.conductance": 3e-9, "V": 2e-6},
    "with a leak": {
        "anti_cavitation.conductance": 3e-9, "external_leakage.conductance": 1e-10,
        "external_leakage.supply_pressure": 50e5,
    },
    "tight motor, large inertia": {
        "anti_cavitation.conductance": 3e-9, "pressure_dependent_flow.supply_pressure": 20e5, "Km": 5e-12, "J": 0.01,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", EMPTIED)
def test_check_valves_fill_emptied_lines(name):
    rng = np.random.default_rng(7)
    stops = 73.0 * np.where(rng.random((20, 2)) < 0.5, 0.0, rng.choice([-1.0, 1.0], (20, 2)))
    command, load = np.repeat(stops, 10, axis=0), np.repeat(rng.uniform(-5.0, 5.0, (20, 2)), 10, axis=0)
    model = load_model("paper").with_values({"anti_cavitation.supply_pressure": 20e5, **EMPTIED[name]})
    without = simulate(model.without("anti_cavitation"), command, load, 0.002)["speed"]
    assert np.abs(simulate(model, command, load, 0.002)["speed"] - without).max() > RPM
    assert _error_rpm(model, command, load, 0.002) < 0.1


#: Valves that lag beside a reversal, and lines that cross a setting of 10 bar within tens of microseconds.
RELIEVED = {
    "lag": {"time_constant": 0.003},
    "friction and lag": {"hysteresis": 0.3, "time_constant": 0.02},
    "small lines": {"V": 2e-5, "beta": 1.9e9, "conductance": 2.5e-9},
    "friction, small lines": {"V": 2e-5, "beta": 1.9e9, "hysteresis": 0.1, "conductance": 5e-10},
    "smallest lines": {"V": 2e-6, "conductance": 2e-9},
}


@pytest.mark.parametrize("name", RELIEVED)
def test_relief_valves_open_and_close_in_small_lines(name):
    rng = np.random.default_rng(5)
    command = 73.0 * np.where(np.cumsum(rng.random((50, 2)) < 0.4, axis=0) % 2 == 0, 1.0, -1.0)
    own = {n if n in PARAMETERS else f"crossport_relief.{n}": value for n, value in RELIEVED[name].items()}
    model = load_model("paper").with_values({"crossport_relief.relief_pressure": 10e5, **own})
    assert _error_rpm(model, command, None, 0.01) < 0.1


def test_lines_of_a_tight_motor_that_reach_the_supply():
    """The flow falls to nothing with the steepest slope of its root there."""
    rng = np.random.default_rng(77)
    values = {"pressure_dependent_flow.supply_pressure": 31e5, "Km": 4e-12, "V": 6e-5}
    command = 73.0 * rng.uniform(-1.0, 1.0, (50, 2))
    assert _error_rpm(load_model("paper").with_values(values), command, None, 0.01) < 0.1


#: What moves within microseconds, and a spool without dry friction.
STIFF = {
    "no friction": {"Fc": 0.0, "Fs": 0.0},
    "little friction": {"Fc": 0.001, "Fs": 0.001},
    # Softer bristles in the plant, not in the reference.
    "hardly any friction": {"Fc": 2e-4, "Fs": 2e-4},
    "hardly any static friction": {"Fc": 0.002, "Fs": 2e-4},
    "next to no friction": {"Fc": 1e-7, "Fs": 1e-7},
    "stiff bristles": {"s0": 3e6},
    "light spool": {"m": 0.04},
    "hard stop": {"k_stop": 1e7, "v_stop": 1e-3},
    "high breakaway": {"Fs": 2.0},
    "stiff bristles and a quick exchange": {
        "s0": 3e6, "Fs": 0.0025, "line_volume.conductance": 8e-10, "line_volume.volume": 5e-4, "V": 2e-5,
    },
    "quick coil": {"L": 0.001, "magnetic_hysteresis.amplitude": 2.0, "magnetic_hysteresis.width": 0.01},
}  # fmt: skip


@pytest.mark.parametrize("name", STIFF)
def test_stiff_models_are_followed(name):
    rng = np.random.default_rng(4)
    levels = np.concatenate([rng.uniform(-1.0, 1.0, (30, 2)), rng.choice([-1.0, 1.0], (30, 2))])
    model = load_model("paper").with_values(STIFF[name])
    assert _error_rpm(model, 73.0 * levels, None, 0.01) < 0.1


def _driven(models, kind, seconds, rng):
    volts = np.stack(
        [commands(kind, seconds, rng) * np.minimum(m.pair("u_rated"), 200.0) for m in models], axis=1
    )
    return volts, np.stack([loads(model, seconds, rng) for model in models], axis=1)


def test_random_models_against_the_reference():
    """Within the accepted ranges, both channels alike; a motor that turns fast may be off by 1e-4 of its speed."""
    rng = np.random.default_rng(3)
    models, _ = drawn(5, rng)
    for model, kind in zip(models, COMMANDS, strict=True):
        volts, load = (each[:, 0] for each in _driven([model], kind, 0.4, rng))
        speed = simulate(model, volts, load, 0.01)["speed"]
        assert against_reference(model, volts, load) < max(0.1, 1e-4 * np.abs(speed).max() / RPM), model


def test_unlike_valves_behind_a_drooping_supply():
    """Both channels of a rig take the same steps, though the friction of one spool asks for shorter ones."""
    values = {"supply_droop.relative_drop": 0.3, "command_delay.delay": (0.0024, 0.0105), "s0": (3.0e5, 3.0e4)}
    command = np.repeat(22.0 * np.array([[1.0, 0.5], [0.0, 0.3], [-0.6, 0.8], [0.4, -0.2]]), 15, axis=0)
    assert _error_rpm(load_model("rig").with_values(values), command, np.zeros_like(command), 0.01) < 0.1


def test_check_valves_of_small_lines_against_the_reference():
    """Check valves that pass much oil into lines that hold little, on a motor that hardly leaks."""
    values = {"anti_cavitation.conductance": 3e-9, "V": 2e-5, "Km": 2.653e-12}
    volts, load = _driven([load_model("paper").with_values(values)], "uniform", 0.6, np.random.default_rng(1))
    assert against_reference(load_model("paper").with_values(values), volts[:, 0], load[:, 0]) < 0.1


@pytest.mark.parametrize("leakage", [0.0, 1e-14])
def test_a_ring_that_hardly_anything_damps_keeps_its_phase(leakage):
    """The smallest volume of stiff oil and a motor that hardly leaks."""
    model = load_model("paper").with_values({"V": 2e-6, "beta": 4.77e9, "Km": leakage})
    volts, load = _driven([model], "bang_bang", 0.7, np.random.default_rng(1))
    (result,) = compare([model], volts, 0.0 * load, "bang_bang")
    assert result.speed > 500.0 and result.error < 0.1


@pytest.mark.slow
def test_random_models_against_a_thirtieth_of_the_tolerance():
    rng = np.random.default_rng(6)
    models, _ = drawn(210, rng)
    for kind in COMMANDS:
        volts, load = _driven(models, kind, 1.0, rng)
        results = compare(models, volts, load, kind)
        assert sum(r.diverged or r.off for r in results) < 0.05 * len(results)
