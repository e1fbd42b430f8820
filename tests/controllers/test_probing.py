"""The laws that plan flow: probing at rest or a bench before it, settings, and that they forget one rig before the next."""

import numpy as np
import pytest

from hydro_env.controllers import make_controller
from hydro_env.controllers.mpc.fitted import settings_of
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.plant import PlantModel, load_model


def scores(spec, **changed):
    given = {"plant": "paper_dead_zone", "mismatch": "val", "scenario": "setpoint_steps"} | changed
    found = roll_out(make_controller(spec), range(200), **given).metrics()
    return np.median(found["max_speed_difference_rpm"]), np.median(found["tracking_mae_rpm"])


def test_slower_settings_keep_closer_together_and_track_worse():
    fast, calm = scores("probing_flow"), scores("probing_flow:rate=20,rise=9")
    assert calm[0] < fast[0] - 0.3
    assert calm[1] > fast[1] + 8.0
    assert fast[0] < 6.8 and fast[1] < 30.0


def test_it_uses_the_rest_before_the_first_step():
    """Without a rest there is nothing to probe in: edges are met on the way, as `adaptive_flow` does."""
    steps = {"duration": 1.5, "setpoint_rpm": [[0.3, 400.0], [0.8, -300.0]]}
    at_once = {"duration": 1.2, "setpoint_rpm": [[0.0, 400.0], [0.5, -300.0]]}
    assert scores("probing_flow", scenario=steps)[0] < scores("probing_flow", scenario=at_once)[0] - 2.0


def test_what_the_bench_found_is_worth_more_than_probing():
    """And nothing is probed, so that the shafts hardly move before the set-point does, at 0.2 s."""
    told, probed = scores("bench_flow"), scores("probing_flow")
    assert told[0] < probed[0] - 1.0
    played = {
        name: roll_out(make_controller(name), range(6), mismatch="val", scenario="setpoint_steps").trace
        for name in ("bench_flow", "probing_flow")
    }
    moved = {name: np.abs(trace.speed_rpm[:20]).max() for name, trace in played.items()}
    # a valve with an offset lets some oil through at rest
    assert moved["bench_flow"] < 0.3 * moved["probing_flow"]


def test_without_a_bench_it_does_not_begin():
    controller = make_controller("bench_flow")
    controller.reset(1, 0.01)
    with pytest.raises(RuntimeError, match="on a bench"):
        controller.act(np.zeros((1, 9), np.float32))


@pytest.mark.parametrize("name", ["probing_flow", "bench_flow"])
def test_reset_forgets(name):
    controller = make_controller(name)
    first, again = (
        roll_out(controller, range(3), mismatch="val", scenario="load_step").trace.command for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)


def test_wrong_settings_are_refused():
    with pytest.raises(InputError, match="slew"):
        make_controller("probing_flow:slew=9")
    controller = make_controller("probing_flow")
    controller.reset(2, 0.01)
    with pytest.raises(ValueError, match=r"reset for 2 rigs, got observations \(3, 9\)"):
        controller.act(np.zeros((3, 9), np.float32))


def hoses(size=1.0, flow=1.0, inertia=1.0):
    """Motors that leak little behind long hoses and valves that do not ring, in other units of displacement, flow and inertia."""
    pressure = inertia * flow / size**2
    values = {
        "D": 1.3e-6 * size, "J": 5e-3 * inertia, "Km": 3e-12 * flow / pressure, "V": 5e-4 * flow / pressure, "beta": 8e8,
        "B": 1e-3 * size**2 * pressure / flow, "Kq": 0.4 * flow, "C": 60.0,
        "pressure_dependent_flow.supply_pressure": 1e7 * pressure,
    }  # fmt: skip
    return PlantModel(name="hoses", values={name: (value, value) for name, value in values.items()})


def test_rigs_that_are_similar_have_the_same_settings():
    one, other = (settings_of(model, 0.01) for model in (hoses(), hoses(1.3, 1.2, 1.4)))
    # noise is the sensors', which come in sizes
    for part in ("motor", "feedback", "reference"):
        given = {name: value for name, value in getattr(one, part)._asdict().items() if name != "noise"}
        assert {name: getattr(getattr(other, part), name) for name in given} == pytest.approx(given), part


@pytest.mark.parametrize("plant", ["hoses", "rig"])
def test_it_drives_motors_that_swing(plant):
    """The settings for the paper's motor would not: the speeds would differ by a thousand rpm."""
    model = hoses() if plant == "hoses" else load_model(plant)
    apart, off = scores("probing_flow", plant=model)
    assert off < 60.0 and apart < (40.0 if plant == "hoses" else 220.0)
    calm = scores("probing_flow:rate=4", plant=model)
    assert calm[1] > off + 20.0
