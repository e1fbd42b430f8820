"""Loss models of the motor: the published equations, in all four quadrants, in the kernel, the reference and files."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.envs import HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.plant import BUILT_IN, CATALOGUE, Plant, load_model, simulate
from hydro_env.plant.catalogue.losses import FAMILY
from hydro_env.plant.motor_map import motor_map
from hydro_env.plant.plant import SIGNALS
from hydro_env.practice.generate import make_practice
from hydro_env.practice.reference import simulate_reference
from hydro_env.tasks.mismatch import load_mismatch
from tests.plant.test_plant_accuracy import _strong

RPM = math.pi / 30
MODELS = [e.name for e in CATALOGUE.values() if e.family == FAMILY]
D = 8.47e-6 / (2 * math.pi)
BETA, MU, RHO = 1.267e9, 0.040, 870.0


# --- the published steady equations, with their own coefficients, for sizes dp >= 0 and w >= 0 ------------------------
def wilson(dp, w, Cs, Cd, Cf, Tc):
    """Leakage m3/s and lost torque N m."""
    return Cs * D * dp / MU, Cd * D * MU * w + Cf * D * dp + Tc


def schloesser(dp, w, Cs, Cst, Cv, Cf, Ch, Tc):
    slip, torque = wilson(dp, w, Cs, Cv, Cf, Tc)
    return slip + Cst * D ** (2 / 3) * np.sqrt(2 * dp / RHO), torque + Ch * D ** (5 / 3) * RHO * w**2 / 2


def dorey(dp, w, Cs, growth, Vr, Cv, Cf, boundary, fall):
    slip, torque = wilson(dp, w, Cs * (1 + growth * dp), Cv, Cf * (1 + boundary * np.exp(-w / fall)), 0.0)
    return slip + (Vr + 1) * D * w * dp / BETA, torque


def jeong(dp, w, Cs, widening, Cv, Cf, Tc, stribeck, fall, Ch):
    slip = Cs * (1 + widening * dp) ** 3 * D * dp / MU
    rubbing = (Cf * D * dp + Tc) * (1 + stribeck * np.exp(-w / fall))
    return slip, rubbing + Cv * D * MU * w + Ch * D ** (5 / 3) * RHO * w**2 / 2


def ivantysyn(dp, w, a, b, c, d, e, f):
    return a * dp**2 + b * dp * w, c + d * dp + e * w**2 + f * dp * w


#: Equation, published coefficients, and the same as parameters of the effect.
CASES = {
    "wilson_losses": (
        wilson, (1.2e-6, 3e4, 0.06, 0.08), {"slip": 1.2e-6, "drag": 3e4, "friction": 0.06, "constant_torque": 0.08},
    ),
    "schloesser_losses": (
        schloesser, (1e-6, 8e-4, 2e4, 0.05, 600.0, 0.07),
        {"slip": 1e-6, "turbulent_area": 8e-4 * D ** (2 / 3), "drag": 2e4, "friction": 0.05,
         "hydrodynamic": 600.0 * D ** (5 / 3) / 2, "constant_torque": 0.07},
    ),
    "dorey_losses": (
        dorey, (1e-6, 2e-7, 0.54, 2e4, 0.05, 2.5, 8.0),
        {"slip": 1e-6, "slip_growth": 2e-7, "compression": 1.54, "drag": 2e4, "friction": 0.05, "boundary": 2.5,
         "boundary_speed": 8.0},
    ),
    "jeong_losses": (
        jeong, (1e-6, 5e-8, 2e4, 0.05, 0.06, 1.5, 12.0, 400.0),
        {"slip": 1e-6, "gap_growth": 5e-8, "drag": 2e4, "friction": 0.05, "constant_torque": 0.06, "stribeck": 1.5,
         "stribeck_speed": 12.0, "hydrodynamic": 400.0 * D ** (5 / 3) / 2},
    ),
    "ivantysyn_losses": (
        ivantysyn, (2e-17, 2e-13, 0.08, 6e-8, 4e-5, 4e-10),
        {"flow_pp": 2e-17, "flow_pw": 2e-13, "torque_0": 0.08, "torque_p": 6e-8, "torque_ww": 4e-5, "torque_pw": 4e-10},
    ),
}  # fmt: skip


def values(name, parameters=None):
    """Values of a model's effect; without `parameters` those of its case."""
    parameters = CASES[name][2] if parameters is None else parameters
    return {f"{name}.{own}": value for own, value in parameters.items()}


def published(name, pressure, speed, Km, B):
    """Flow into the motor and torque on its load after the equations of the publication and the base terms."""
    equation, coefficients, _ = CASES[name]
    leakage, lost = equation(np.abs(pressure), np.abs(speed), *coefficients)
    flow = D * speed + Km * pressure + np.sign(pressure) * leakage
    return flow, D * pressure - B * speed - np.sign(speed) * lost


def test_every_model_has_a_case():
    assert set(CASES) == set(MODELS) and list(BUILT_IN[-len(MODELS) :]) == MODELS


# --- steady equations -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MODELS)
def test_map_follows_the_published_equations(name):
    pressure = np.array([-150.0, -20.0, -1.0, 1.0, 20.0, 150.0])[:, None] * 1e5
    speed = np.array([-300.0, -30.0, -1.0, 1.0, 30.0, 300.0])
    found = motor_map(load_model("paper").with_values(values(name)), pressure, speed)
    base = load_model("paper").channels[0]
    flow, torque = published(name, *np.broadcast_arrays(pressure, speed), base["Km"], base["B"])
    lost = np.abs(torque - D * pressure)  # the root is smooth below 0.1 bar and 0.3 % low at 1 bar
    assert np.all(
        np.abs(found.flow - flow) <= 3e-3 * np.abs(flow - D * speed - base["Km"] * pressure) + 1e-12
    )
    np.testing.assert_allclose(found.torque, torque, atol=1e-6 * lost.max())


def test_compiled_plant_settles_where_the_published_equations_say():
    """Valves held open against loads that brake and loads that drive: both directions, motoring and pumping."""
    points = [
        (u, load) for u in (-60.0, -45.0, -25.0, 25.0, 45.0, 60.0) for load in (-2.5, -1.2, 0.0, 1.2, 2.5)
    ]
    rigs = [(name, point) for name in MODELS for point in points]
    plant = Plant("paper", len(rigs), effects=MODELS, tolerance=1e-4)
    for row, (name, _) in enumerate(rigs):
        plant.set_values(values(name), rows=[row])
    plant.reset()
    settings = np.array([point for _, point in rigs])
    command, load = np.tile(settings[:, :1], 2), np.tile(settings[:, 1:], 2)
    plant.run(np.tile(command, (400, 1, 1)), np.tile(load, (400, 1, 1)), 0.01)
    before = plant.speed
    plant.step(command, load, 0.01)
    assert np.abs(plant.speed - before).max() < 1e-5
    quadrants = set()
    for name in MODELS:
        rows = np.array([each == name for each, _ in rigs])
        pressure, speed = plant.pressure[rows], plant.speed[rows]
        turning = np.abs(speed) > 1.0
        flow, torque = published(name, pressure, speed, plant.get("Km")[rows], plant.get("B")[rows])
        np.testing.assert_allclose(plant.flow[rows][turning], flow[turning], rtol=2e-3)
        np.testing.assert_allclose(load[rows][turning], torque[turning], atol=1e-4)
        signs = np.stack([np.sign(pressure[turning]), np.sign(speed[turning])], axis=-1)
        quadrants |= {(name, *pair) for pair in signs.tolist()}
    assert len(quadrants) == 4 * len(MODELS)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("size", ["case", "strongest"])
def test_losses_never_give_power(name, size):
    chosen = values(name) if size == "case" else _strong(CATALOGUE[name])
    model = load_model("paper").with_values({"Km": 0.0, "B": 0.0, **chosen})
    pressure = np.concatenate([[0.0], *(s * np.geomspace(1.0, 3e7, 20) for s in (-1, 1))])[:, None]
    speed = np.concatenate([[0.0], *(s * np.geomspace(1e-4, 600.0, 20) for s in (-1, 1))])
    found = motor_map(model, pressure, speed)
    # Slip and friction separately, to the last bits: neither may hide behind the other.
    bits = 1e-15 * np.abs(D * found.pressure * found.speed)
    assert np.all(found.pressure * (found.flow - D * found.speed) >= -bits)
    assert np.all(found.speed * (D * found.pressure - found.torque) >= -bits)
    turning = (np.abs(found.pressure) > 1e5) & (np.abs(found.speed) > 1.0)
    assert np.all(found.loss[turning] > 0.0)
    reverse = motor_map(model, -pressure, -speed)
    np.testing.assert_allclose(found.flow, -reverse.flow, rtol=1e-9)
    np.testing.assert_allclose(found.torque, -reverse.torque, rtol=1e-9, atol=1e-9)


# --- neutral, smooth, accurate ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MODELS)
def test_fluid_and_shapes_alone_change_no_bit(name):
    """Coefficients at zero are the base plant, whatever the viscosity, the density and the other shapes."""
    effect = CATALOGUE[name]
    shapes = {p.name: 0.5 * (p.low + p.high) for p in effect.parameters if p.typical == p.nominal}
    assert effect.is_neutral(shapes) and not effect.is_neutral(CASES[name][2])
    command = np.random.default_rng(0).uniform(-73.0, 73.0, (60, 2))
    base = simulate("paper", command, None, 0.01, record=SIGNALS)
    found = simulate(
        "paper", command, None, 0.01, values=values(name, shapes), effects=MODELS, record=SIGNALS
    )
    for signal in SIGNALS:
        assert np.array_equal(found[signal], base[signal]), signal


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("size", ["case", "strongest", "alone"])
def test_kernel_and_reference_agree(name, size):
    """About standstill and at speed; also where the model stands alone, without the base terms that damp everything."""
    rng = np.random.default_rng(2)
    command = np.repeat(rng.uniform(-73.0, 73.0, (40, 2)), 10, axis=0)
    command[200:] *= np.where(np.arange(200) < 100, 0.1, 0.4)[:, None]
    load = np.repeat(rng.uniform(-0.8, 0.8, (4, 2)), 100, axis=0)
    model = load_model("paper").with_values(values(name) if size == "case" else _strong(CATALOGUE[name]))
    if name == "jeong_losses" and size != "case":
        model = model.with_values({"jeong_losses.stribeck": 0.8})  # a greater peak would hold the shaft
    if size == "alone":
        model = model.with_values({"B": 0.0} if name == "ivantysyn_losses" else {"Km": 0.0, "B": 0.0})
    truth = simulate_reference(model, command, load, 1e-3, tolerance=1e-8)
    kernel = simulate(model, command, load, 1e-3, effects=MODELS, record=("speed", "pressure"))
    assert np.abs(truth["speed"]).max() > (100.0 if size == "case" else 20.0) * RPM
    assert np.abs(kernel["speed"][:, 0] - truth["speed"]).max() / RPM < 0.1


@pytest.mark.parametrize("name", [n for n in MODELS if n != "dorey_losses"])
def test_friction_holds_the_shaft_at_rest(name):
    """A load below the dry friction turns the shaft at a creep only, within the steep line that stands for the jump."""
    dry = {"torque_0": 0.4} if name == "ivantysyn_losses" else {"constant_torque": 0.4}
    out = simulate(
        "paper", np.zeros((200, 2)), np.full((200, 2), 0.3), 0.01, values=values(name, dry), effects=MODELS
    )
    assert np.abs(out["speed"]).max() < 0.1


# --- efficiencies -----------------------------------------------------------------------------------------------------
#: Coefficients of an axial piston machine of 107 cm3/rev (Pourmovahed, Beachley and Fronczak 1992), as a motor of 8.47;
#: the constant torque is assumed.
PISTON = {
    "Km": 0.0, "B": 0.0, "schloesser_losses.slip": 4.26e-9, "schloesser_losses.drag": 23.5e3,
    "schloesser_losses.friction": 53.7e-3, "schloesser_losses.hydrodynamic": 53.6 * D ** (5 / 3) / 2,
    "schloesser_losses.viscosity": 32e-6 * 870, "schloesser_losses.constant_torque": 0.1,
}  # fmt: skip


def test_published_coefficients_give_the_map_of_a_piston_motor():
    pressure = np.linspace(20e5, 350e5, 34)[:, None]
    speed = np.linspace(100.0, 4000.0, 40) * RPM
    found = motor_map(load_model("paper").with_values(PISTON), pressure, speed)
    for efficiency in (found.volumetric, found.hydromechanical):
        assert np.all((efficiency > 0.0) & (efficiency < 1.0))
    assert np.all(np.diff(found.volumetric, axis=1) > 0) and np.all(np.diff(found.volumetric, axis=0) < 0)
    assert np.all(np.diff(found.hydromechanical, axis=1) < 0) and np.all(
        np.diff(found.hydromechanical, axis=0) > 0
    )
    best = np.unravel_index(np.argmax(found.total), found.total.shape)
    assert 0.90 < found.total[best] < 0.95
    assert 50e5 < pressure[best[0], 0] < 350e5 and 400.0 < speed[best[1]] / RPM < 3000.0
    np.testing.assert_allclose(found.loss, (1.0 - found.total) * found.pressure * found.flow, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "mixed"), [("dorey_losses", {"boundary": 2.0}), ("jeong_losses", {"stribeck": 1.0})]
)
def test_mixed_friction_gives_the_hydromechanical_efficiency_a_peak(name, mixed):
    parameters = {"slip": 4e-9, "drag": 6e4, "friction": 0.03, **mixed}
    model = load_model("paper").with_values({"Km": 0.0, "B": 0.0, **values(name, parameters)})
    speed = np.linspace(10.0, 3000.0, 300) * RPM
    efficiency = motor_map(model, 100e5, speed).hydromechanical
    best = int(np.argmax(efficiency))
    assert 50.0 < speed[best] / RPM < 1500.0
    assert efficiency[0] < efficiency[best] - 0.01 and efficiency[-1] < efficiency[best] - 0.01
    assert efficiency.min() > 0.0 and efficiency.max() < 1.0


def test_nothing_assumed_acts_unless_it_is_given():
    """With sizes of the sourced terms alone, `dorey_losses` is the linear model with compression, at any point."""
    sourced = {"slip": 1e-6, "compression": 1.54, "drag": 2e4, "friction": 0.05}
    pressure, speed = np.array([-2e6, 1e5, 3e6])[:, None], np.array([-50.0, 2.0, 90.0])
    found = motor_map(load_model("paper").with_values(values("dorey_losses", sourced)), pressure, speed)
    base = load_model("paper").channels[0]
    leakage = (1e-6 * D / MU + 1.54 * D * np.abs(speed) / BETA) * pressure
    np.testing.assert_allclose(found.flow, D * speed + base["Km"] * pressure + leakage, rtol=1e-12)
    friction = 0.05 * D * np.abs(pressure) * np.sign(speed)
    expected = D * pressure - (base["B"] + 2e4 * D * MU) * speed - friction
    np.testing.assert_allclose(found.torque, expected, rtol=1e-9)


# --- the same description everywhere ----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", MODELS)
def test_model_files(name, tmp_path):
    model = load_model("paper").with_values(values(name))
    model.to_yaml(tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml") == model
    assert name in (tmp_path / "model.yaml").read_text()


PRACTICE = {"duration": 3.0, "rate": 100.0, "runs": ("fit_1",), "seed": 1, "noise": 0.0}


@pytest.fixture(scope="module")
def plain():
    return make_practice([], **PRACTICE)


@pytest.mark.parametrize("name", MODELS)
def test_hidden_losses_are_in_the_logs_and_in_the_truth(name, plain):
    practice = make_practice([f"{name}:1"], **PRACTICE)
    assert practice.truth["effects"][0]["name"] == name and practice.truth["effects"][0]["channel"] == "1"
    log, other = practice.logs["fit_1"], plain.logs["fit_1"]
    assert np.abs(log["speed_1_rpm"] - other["speed_1_rpm"]).max() > 3.0
    np.testing.assert_array_equal(log["speed_2_rpm"], other["speed_2_rpm"])


def test_losses_may_differ_from_motor_to_motor_and_rig_to_rig():
    """As a mismatch of the environment."""
    sizes = {
        f"{name}.{own}": {"uniform": [0.0, value]}
        for name in MODELS
        for own, value in CASES[name][2].items()
        if CATALOGUE[name].parameter(own).neutral == 0.0
    }
    spread = load_mismatch(sizes)
    assert spread is not None
    assert list(spread.effects) == MODELS
    env = HydraulicSyncVectorEnv(2, plant="paper", mismatch=spread)
    _, info = env.reset(seed=3)
    assert np.ptp(info["mismatch"]["wilson_losses.friction"]) > 0.0


def test_diagnosis_tries_them_only_when_the_model_lists_them():
    rig = object.__new__(DynamicRig)
    rig.channels = (0, 1)
    rig.without = ()
    rig.model = load_model("paper")
    assert not set(rig.candidates()) & set(MODELS) and "quadratic_drag" in rig.candidates()
    rig.model = load_model({"schema": "hydro_env/model/1", "base": "paper", "effects": {"wilson_losses": {}}})
    assert set(rig.candidates()) & set(MODELS) == {"wilson_losses"}


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"wilson_loss": {}}, "did you mean 'wilson_losses'"),
        ({"wilson_losses": {"both": {"slipp": 1e-6}}}, "did you mean 'slip'"),
        ({"wilson_losses": {"both": {"slip": "much"}}}, "should be a number"),
        ({"schloesser_losses": {"both": {"density": 0.0}}}, "schloesser_losses.both.density: 0 kg/m3 is out of range"),
        ({"jeong_losses": {"channel_2": {"viscosity": -0.04}}}, "jeong_losses.channel_2.viscosity: -0.04 Pa s is out of range"),
    ],
)  # fmt: skip
def test_bad_models(effects, message, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump({"schema": "hydro_env/model/1", "base": "paper", "effects": effects}))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_model(path)
    assert "model.yaml" in str(caught.value) and "\n" not in str(caught.value)


def test_the_model_of_the_document(tmp_path):
    """The YAML of docs/reference/losses.md is a model, and its best total efficiency is the one that stands there."""
    text = (Path(__file__).parents[2] / "docs" / "reference" / "losses.md").read_text(encoding="utf-8")
    example = re.search(r"```yaml\n(.*?)```", text, re.S)
    said = re.search(r"peaks at ([\d.]+) % at (\d+) bar\s+and (\d+) rpm", text)
    assert example is not None and said is not None
    (tmp_path / "model.yaml").write_text(example[1])
    model = load_model(tmp_path / "model.yaml")
    pressure, speed = np.arange(10.0, 351.0, 10.0)[:, None] * 1e5, np.arange(100.0, 4001.0, 100.0) * RPM
    total = motor_map(model, pressure, speed).total
    best = np.unravel_index(np.nanargmax(total), total.shape)
    found = (100.0 * total[best], pressure[best[0], 0] / 1e5, speed[best[1]] / RPM)
    assert (f"{found[0]:.1f}", round(found[1]), round(found[2])) == (said[1], int(said[2]), int(said[3]))
