"""Corrections of form: absent bit for bit when neutral, what they do at their ports, and model files that carry them."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from hydro_env.plant import BUILT_IN, CATALOGUE, Plant, PlantModel, load_model, simulate
from hydro_env.plant.catalogue.form_corrections import CORRECTIONS, FAMILY, follows
from hydro_env.units import RPM

SHAPES = [e.name for e in CATALOGUE.values() if e.family == FAMILY]
TIME = np.arange(1200) * 1e-3
COMMAND = np.column_stack([40.0 * np.sin(9.0 * TIME), 25.0 * np.sign(np.sin(7.0 * TIME))])


#: One kernel for all runs here: what is compiled in and neutral changes nothing.
ALL = (*SHAPES, *CORRECTIONS)
PLAYS = ("input_hysteresis", "play_form")


def _run(model: object, effects: tuple[str, ...] = ALL) -> dict[str, np.ndarray]:
    record = ("speed", "pressure", "spool", "measured_speed")
    return simulate(model, COMMAND, None, 1e-3, effects=effects, record=record)  # type: ignore[arg-type]


def test_every_correction_is_absent_when_neutral() -> None:
    bare, compiled_in = _run(load_model("paper"), ()), _run(load_model("paper"))
    for signal, values in bare.items():
        np.testing.assert_array_equal(values, compiled_in[signal])


def _repeated(model: PlantModel, source: str) -> float:
    value = model.value(source.removeprefix("-"), 0)
    return -value if source.startswith("-") else value


@pytest.mark.parametrize("effect", CORRECTIONS)
def test_every_correction_of_an_effect_changes_what_it_leaves(effect: str) -> None:
    sizes = {f"{effect}.{p.name}": p.typical for p in CATALOGUE[effect].parameters if p.typical is not None}
    model = load_model("paper").with_values(sizes)
    plain = _run(model)
    for correction in CORRECTIONS[effect]:
        repeated = follows(correction, effect)
        values = {n: _repeated(model, s) if isinstance(s, str) else s for n, s in repeated.items()}
        own = {
            f"{correction}.{p.name}": p.typical
            for p in CATALOGUE[correction].parameters
            if f"{correction}.{p.name}" not in repeated
        }
        shaped = _run(model.with_values({**values, **own}))
        assert not np.array_equal(plain["measured_speed"], shaped["measured_speed"])
        assert np.sqrt(np.mean((plain["measured_speed"] - shaped["measured_speed"]) ** 2)) < 15.0
        assert np.isfinite(shaped["measured_speed"]).all()


def test_corrections_are_no_effects_that_a_rig_is_known_to_have() -> None:
    assert not {*SHAPES} & {*BUILT_IN}
    assert {name for each in CORRECTIONS.values() for name in each} == {*SHAPES}


def test_a_rounded_corner_is_a_parabola_within_the_rounding() -> None:
    law = CATALOGUE["corner_form"].laws["opening"]
    at = {"rounding": 1e-5, "turn": 1.0, "corner_positive": 1e-4, "corner_negative": 8e-5}
    assert law(0.0, 1e-4, **at) == pytest.approx(2.5e-6)
    assert law(0.0, -8e-5, **at) == pytest.approx(-2.5e-6)
    assert law(0.0, 8.9e-5, **at) == law(0.0, 1.11e-4, **at) == law(0.0, 0.0, **at) == 0.0


def test_a_gain_curve_goes_through_its_knots_and_between_them_as_the_logarithm() -> None:
    law = CATALOGUE["opening_form"].laws["opening"]
    gains = {f"gain_{n}": value for n, value in enumerate((2.1, 1.5, 1.1, 0.6, 0.3, 0.1, 0.0))}
    valve = {"alpha": 2.0, "u_rated": 5.0, "R": 4.0, "k": 2.5}
    rated = 2.0 * 5.0 / (4.0 * 2.5)
    for sign in (1.0, -1.0):
        for n, value in enumerate(gains.values()):
            opening = sign * rated / 2 ** (6 - n)
            assert law(opening, **gains, **valve) == pytest.approx(opening * (1.0 + value))
            assert law(0.1 * opening / 2**n, **gains, **valve) == pytest.approx(
                0.1 * opening / 2**n * (1.0 + gains["gain_0"])
            )
    for share in np.geomspace(1 / 64, 1.0, 50):
        line = np.interp(np.log2(share), range(-6, 1), [*gains.values()])
        assert law(share * rated, **gains, **valve) / (share * rated) - 1.0 == pytest.approx(line, abs=0.01)


def test_a_model_file_carries_a_correction(tmp_path: Path) -> None:
    values = {
        "dead_zone.overlap_positive": (1e-4, 0.0), "corner_form.corner_positive": (1e-4, 0.0),
        "corner_form.rounding": (1e-5, 0.0), "opening_form.gain_3": (0.05, 0.0),
    }  # fmt: skip
    model = load_model("paper").with_values(values)
    model.to_yaml(tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.value("corner_form.rounding", 0) == 1e-5 and again.value("opening_form.gain_3", 0) == 0.05
    np.testing.assert_array_equal(_run(model)["speed"], _run(again)["speed"])


def test_a_coupling_passes_what_its_damper_corrected_by_a_curve_gives() -> None:
    shape = CATALOGUE["coupling_form"]
    knots = {"damper_1": 0.3, "damper_2": 0.2, "damper_3": -0.5}
    at = {"speed": 3.0, "load_speed": 1.0, "gap": 0.02, "stiffness": 200.0, "damping": 0.4}
    for wound, damper in (
        (0.0, 0.0),
        (1e-3, 0.2),
        (2e-3, 0.4),
        (7e-3, 0.55),
        (20e-3, 1.0),
        (50e-3, 0.5),
        (90e-3, 0.5),
    ):
        passed = 200.0 * wound + 0.8 * damper
        before = 200.0 * wound + 0.8 * min(50.0 * wound, 1.0)
        twist = 0.01 + wound
        assert shape.laws["torque"](5.0, twist=twist, **at, **knots) == pytest.approx(5.0 + before - passed)
        rate = shape.states[0].rate(twist=twist, inertia=2e-3, **at, **knots)
        assert rate == pytest.approx((passed - before) / 2e-3)


def test_an_edge_is_laminar_at_small_pressure_drops_and_passes_back() -> None:
    law, full = CATALOGUE["orifice_form"].laws["flow"], 0.5 * 3e-4

    def passed(drive: float, transition: float = 0.0, laminar: float = 0.0) -> float:
        flow = full * np.sqrt(max(drive, 0.0))
        return law(flow, 3e-4, drive, transition=transition, laminar=laminar, Kq=0.5) / full

    assert passed(0.3) == np.sqrt(0.3) and passed(-0.3) == 0.0
    for drive in (0.2, 1.0):  # turbulent
        assert passed(drive, 0.02) == pytest.approx(np.sqrt(drive), rel=1e-5)
    for drive in (1e-5, -2e-5):
        assert passed(drive, 0.02) == pytest.approx(2.0 * drive / np.sqrt(0.02), rel=5e-3)
    for drive in (0.1, 0.9):
        flow = passed(drive, laminar=0.4)
        assert 0.6 * flow**2 + 0.4 * flow == pytest.approx(drive)
        assert passed(-drive, laminar=0.4) == pytest.approx(-flow)


def test_a_knee_lacks_most_at_the_limit() -> None:
    law = CATALOGUE["knee_form"].laws["voltage"]
    at = {"drop": 0.03, "reach": 0.2, "voltage_limit": 40.0}
    assert law(40.0, 40.0, **at) == pytest.approx(40.0 - 1.2)
    assert law(-40.0, -60.0, **at) == -40.0 and law(30.0, 30.0, **at) == 30.0
    assert law(36.0, 36.0, **at) == pytest.approx(36.0 - 1.2 / 8.0)


def test_stops_hold_the_height_of_the_loop_and_survive_a_jump_of_the_command() -> None:
    sizes = {"magnetic_hysteresis.amplitude": 0.3, "stop_form.amplitude": 0.3}
    sizes |= {f"stop_form.height_{n}": 0.25 for n in (1, 2, 3, 4)}
    model = load_model("paper").with_values(sizes)
    command = np.repeat([73.0, -73.0, 20.0, -73.0, 0.0], 100)[:, None] * np.ones(2)
    coarse, fine = (
        simulate(model, command, None, 1e-3, record=("speed", "spool"), tolerance=t) for t in (None, 1e-4)
    )
    assert np.sqrt(np.mean((coarse["speed"] - fine["speed"]) ** 2)) < 0.05
    # At its ends, where all stops have given way, the loop is as high as the effect's own.
    law = CATALOGUE["stop_form"].laws["force"]
    heights = {f"height_{n}": 0.25 for n in (1, 2, 3, 4)}
    ends = {**{f"stop_{n}": 1.0 for n in (1, 2, 3, 4)}, "as_before": 1.0}
    assert law(9.7, amplitude=0.3, **heights, **ends) == 9.7
    assert law(9.7, amplitude=0.3, **heights, **{**ends, "stop_1": -1.0}) == pytest.approx(9.85)


def test_the_second_bristle_takes_over_what_the_first_one_had_more() -> None:
    repeated = follows("bristle_form", "spool_stiction")
    assert repeated["bristle_form.coulomb_taken"] == "-spool_stiction.coulomb"
    more = {"spool_stiction.coulomb": 0.3, "spool_stiction.static": 0.6}
    own = {"coulomb": 0.3, "static": 0.6, "coulomb_taken": -0.3, "static_taken": -0.6}
    taken = {f"bristle_form.{n}": v for n, v in own.items()}
    slow = np.column_stack([12.0 * np.sin(3.0 * TIME)] * 2)
    one, two, none = (
        simulate(load_model("paper").with_values(v), slow, None, 1e-3, record=("spool",))["spool"]
        for v in (more, {**more, **taken, "bristle_form.damping": 0.5}, {})
    )
    # Nearly the same friction in motion, which is far from none.
    assert np.sqrt(np.mean((one - two) ** 2)) < 0.25 * np.sqrt(np.mean((one - none) ** 2))


def test_the_second_bristle_holds_up_to_a_share_of_its_limit_and_gives_way_at_it() -> None:
    (state,) = CATALOGUE["bristle_form"].states
    at = {"coulomb": 0.2, "static": 0.4, "firm": 0.6, "stiffness": 0.5, "vs": 0.01, "s0": 1e5}
    speed = 0.02
    for stribeck in (1.0, 3.0):
        limit = 0.2 + 0.2 * np.exp(-((speed / (0.01 * stribeck)) ** 2))
        rates = [
            state.rate(share * limit / 5e4, speed, stribeck=stribeck, **at) / speed
            for share in (0.0, 0.59, 0.8, 1.0)
        ]
        # Half the way from elastic to plastic, half of it gives way; what is beyond the limit comes back no faster.
        assert rates == pytest.approx([1.0, 1.0, 1.0 - 0.5 * 0.8, 0.0], abs=2e-3)
        # On the way back it is elastic at once.
        assert state.rate(-limit / 5e4, speed, stribeck=stribeck, **at) == speed


def test_three_plays_make_a_loop_of_the_same_mean_width_that_opens_little_by_little() -> None:
    time = np.arange(2000) * 1e-3
    ramps = np.column_stack([40.0 * np.interp(time, [0.0, 0.5, 1.5, 2.0], [0.0, 1.0, -1.0, 0.0])] * 2)
    still = {"R": 1e3, "input_hysteresis.width": 6.0}
    shape = {"play_form.width": 6.0, "play_form.spread": 0.5}
    one, three = (
        simulate(load_model("paper").with_values(v), ramps, None, 1e-3, record=("current",), effects=PLAYS)[
            "current"
        ]
        for v in (still, {**still, **shape})
    )
    volts = 1e3 * (three - one)[:, 0, 0]
    # As wide as the one play where all have turned, and between the first and the last that turn less wide or wider.
    assert np.abs(volts[[400, 900, 1400]]).max() < 0.02
    assert volts[500:600].min() == pytest.approx(-0.25 * 0.5 * 6.0, abs=0.03)
    assert volts[500:600].max() < 0.02


@pytest.mark.parametrize(
    ("effect", "shape", "sizes"),
    [
        ("sensor_lag", "sensor_form", {"time_constant": 0.03}),
        ("supply_droop", "supply_form", {"time_constant": 0.2, "relative_drop": 0.5}),
    ],
)
def test_two_lags_delay_as_much_as_the_one_that_they_replace(
    effect: str, shape: str, sizes: dict[str, float]
) -> None:
    """A ramp arrives late by the sum of the lags, and bends less abruptly."""
    values = {f"{effect}.{n}": v for n, v in sizes.items()}
    ramp = np.column_stack([60.0 * np.minimum(TIME / TIME[-1], 1.0)] * 2)
    model = load_model("paper")
    signal = "measured_speed" if effect == "sensor_lag" else "flow"
    none, one, two = (
        simulate(model.with_values(v), ramp, None, 1e-3, record=(signal,), effects=(effect, shape))[signal][
            :, 0, 0
        ]
        for v in ({}, values, {**values, f"{shape}.share": 0.4})
    )
    late = none - one
    assert abs(two - one)[800:].max() < 0.02 * abs(late)[800:].min()
    assert abs(two - one)[:100].max() > 0.02 * abs(late)[:100].max()


@pytest.mark.parametrize("travel", [1.5e-6, 6e-6, 6e-5])
def test_a_preload_takes_hold_over_the_travel_of_its_correction(travel: float) -> None:
    effect, correction = CATALOGUE["spring_preload"].laws["force"], CATALOGUE["preload_form"].laws["force"]
    for spool in (-3e-5, -2e-6, 0.0, 1e-6, 2e-4):
        force = correction(effect(9.0, spool, preload=2.0), spool, travel=travel, preload=2.0)
        assert force == pytest.approx(9.0 - 2.0 * np.tanh(spool / travel), rel=1e-4)


@pytest.mark.parametrize(
    "values",
    [
        {"spring_preload.preload": 3.0, "preload_form.preload": 3.0, "preload_form.travel": 3e-6},
        {
            "spool_stiction.coulomb": 0.3, "spool_stiction.static": 0.5, "bristle_form.coulomb": 0.3,
            "bristle_form.static": 0.5, "bristle_form.coulomb_taken": -0.3, "bristle_form.static_taken": -0.5,
            "bristle_form.damping": 1.0, "bristle_form.firm": 0.6,
        },
        {"pressure_dependent_flow.supply_pressure": 10e5, "orifice_form.transition": 0.01},
    ],
    ids=["preload", "bristle", "orifice"],
)  # fmt: skip
def test_sharp_forms_are_followed(values: dict[str, float]) -> None:
    """A second bristle that takes all friction from the first needs half the tolerance for that."""
    model = load_model("paper").with_values(values)
    own = model.tolerance / 2.0 if "bristle_form.firm" in values else None
    command = np.repeat(73.0 * np.random.default_rng(1).uniform(-1.0, 1.0, (30, 2)), 50, axis=0)
    coarse, fine = (
        simulate(model, command, None, 1e-3, record=("speed",), tolerance=t)["speed"] for t in (own, 1e-4)
    )
    assert np.sqrt(np.mean((coarse - fine) ** 2)) / RPM < 0.1


@pytest.mark.parametrize("share", [0.0, 0.125, 0.25, 0.5, 1.0, 1.3])
def test_a_leak_is_bent_between_an_eighth_and_half_the_supply(share: float) -> None:
    effect, supply, conductance = CATALOGUE["leak_form"], 8e6, 5e-12
    gains = {"leak_0": 0.8, "leak_1": 0.5, "leak_2": 0.2}
    at = {**gains, "conductance": conductance, "supply_pressure": supply}
    gain = {0.0: 0.8, 0.125: 0.8, 0.25: 0.5, 0.5: 0.2, 1.0: 0.0, 1.3: 0.0}[share]
    # Half of what leaves one line is load flow, as in the law of the leak.
    more = 0.5 * gain * conductance * share * 0.5 * supply
    assert effect.laws["leakage"](1e-6, 0.0, share - 1.0, **at) == pytest.approx(1e-6 + more, rel=1e-12)
    # What the mean of both lines loses is the same oil.
    (state,) = effect.states
    rate = state.rate(share - 1.0, 0.0, 1.2e9, 2e-5, **at)
    assert rate * supply / 2.0 == pytest.approx(-1.2e9 / 2e-5 * more / 2.0, rel=1e-12)


@pytest.mark.parametrize("name", ["bristle_form", "override_form", "leak_form", "orifice_form"])
def test_no_end_of_a_correction_breaks_it(name: str) -> None:
    """A bristle that takes more friction than there is, a relief valve whose flow falls with the pressure, and any leak."""
    parameters = CATALOGUE[name].parameters
    corners = list(itertools.product(*((p.low, min(p.high, 1e9)) for p in parameters)))[:64]
    plant = Plant("paper", len(corners), effects=[name])
    for row, corner in enumerate(corners):
        plant.set_values(
            {f"{name}.{p.name}": value for p, value in zip(parameters, corner, strict=True)}, rows=[row]
        )
    plant.reset()
    command = 73.0 * np.random.default_rng(0).choice([-1.0, 1.0], (40, len(corners), 2))
    speed = plant.run(command, None, 0.01)["speed"]
    assert not plant.diverged.any()
    assert np.isfinite(speed).all() and np.abs(speed).max() < 1000.0
