"""The oracle bounds the others: it beats them, its twin is the plant, it does not foresee the set-point."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hydro_env.controllers import make_controller
from hydro_env.controllers.mpc.shooting import minimise_in_box
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.plant import Plant
from hydro_env.tasks import load_scenario


def scores(name, scenario, cases=12):
    controller = make_controller(name)
    own = controller.plant if hasattr(controller, "plant") else None
    done = roll_out(
        controller,
        range(cases),
        plant=own or "paper_dead_zone",
        mismatch=None if own else "val",
        scenario=scenario,
    )
    found = done.metrics(["max_speed_difference_rpm", "tracking_mae_rpm"])
    return found["max_speed_difference_rpm"], found["tracking_mae_rpm"]


@pytest.mark.parametrize("scenario", ["setpoint_steps", "staircase", "unequal_load", "disturbance"])
def test_it_bounds_the_best_of_the_others(scenario):
    """Pair by pair in the speed difference, also against servo valves; and in tracking, but for servo valves, whose
    full flow follows steps of the set-point faster than these valves can.
    """
    apart, tracking = scores("oracle", scenario)
    assert np.max(apart) < 6.0
    for name in ("adaptive_flow", "probing_flow", "compensated", "servo_pid", "ppo"):
        others, theirs = scores(name, scenario)
        assert np.all(apart < others), name
        if name != "servo_pid" or scenario not in ("setpoint_steps", "staircase"):
            assert np.mean(tracking) < np.mean(theirs), name


def started(scenario, mismatch="test_extrap", plant="paper_dead_zone"):
    env = HydraulicSyncVectorEnv(2, plant=plant, mismatch=mismatch, scenario=scenario)
    observation, _ = env.reset(seed=[1, 2])
    controller = make_controller("oracle")
    controller.prepare(copy.deepcopy(env.plant))
    controller.foresee(np.stack([env.reference(row).load for row in range(2)], axis=1))
    controller.reset(2, 0.01)
    return env, observation, controller


def test_its_twin_is_the_plant():
    """Bit for bit, so that the oracle needs no measurement to know the state."""
    env, observation, controller = started("unequal_load")
    for _ in range(200):
        observation, *_ = env.step(controller.act(observation).astype(np.float32))
    np.testing.assert_array_equal(controller._twin.memory, env.plant.memory)


def test_it_foresees_loads_but_no_set_point():
    base = load_scenario({"duration": 1.0, "setpoint_rpm": [[0.1, 300.0]]})
    other = load_scenario({"duration": 1.0, "setpoint_rpm": [[0.1, 300.0], [0.5, -100.0]]})
    loaded = load_scenario({"duration": 1.0, "setpoint_rpm": [[0.1, 300.0]], "load_Nm": [[0.5, 0.5, 0.0]]})
    sent = {}
    for name, scenario in (("base", base), ("other", other), ("loaded", loaded)):
        done = roll_out(make_controller("oracle"), [3], mismatch="val", scenario=replace(scenario, name=name))
        sent[name] = done.trace.command
    np.testing.assert_array_equal(sent["base"][:50], sent["other"][:50])
    assert np.any(sent["base"][50] != sent["other"][50])
    np.testing.assert_array_equal(sent["base"][:40], sent["loaded"][:40])
    assert np.any(sent["base"][45:50] != sent["loaded"][45:50])


def test_it_drives_other_plants_too():
    """With effects its linear model does not know: the realistic rig with its nearly undamped hydraulics."""
    done = roll_out(make_controller("oracle"), range(2), plant="rig", mismatch="train", scenario="load_step")
    assert np.median(done.metrics()["tracking_mae_rpm"]) < 30.0


def test_minimum_in_a_box():
    """Against SciPy's bounded least squares, with active and inactive bounds, and badly scaled."""
    stream = np.random.default_rng(0)
    for _ in range(40):
        n = int(stream.integers(1, 11))
        matrix = stream.normal(size=(n + 3, n)) * np.exp(3.0 * stream.normal(size=n))
        wanted = 3.0 * stream.normal(size=n + 3)
        low, high = -stream.random(n), stream.random(n)
        x = np.zeros(n)
        minimise_in_box(matrix.T @ matrix + 1e-9 * np.eye(n), -matrix.T @ wanted, low, high, x)
        right = lsq_linear(matrix, wanted, (low, high), tol=1e-14).x
        assert np.all((x >= low) & (x <= high))
        cost = [float(np.sum((matrix @ each - wanted) ** 2)) for each in (x, right)]
        assert cost[0] <= cost[1] * (1.0 + 1e-6) + 1e-9


def test_a_plant_takes_the_state_of_another():
    """Also with another tolerance and precision, and commands on their way; not of other effects."""
    one = Plant("paper_dead_zone", 3)
    one.step([[40.0, 30.0]], 0.0, 0.1)
    two = Plant("paper_dead_zone", 3, tolerance=10 * one.tolerance, dtype=np.float32)
    two.take_state(one)
    np.testing.assert_allclose(two.speed, one.speed, rtol=1e-6)
    for plant in (one, two):
        plant.step([[40.0, 30.0]], 0.0, 0.1)
    np.testing.assert_allclose(two.speed, one.speed, rtol=1e-3)
    with pytest.raises(ValueError, match="effects"):
        two.take_state(Plant("paper", 3))
    late, twin = (Plant("paper", 1, effects=["command_delay"]) for _ in range(2))
    for plant in (late, twin):
        plant.set("command_delay.delay", 0.005)
    late.step([[40.0, 40.0]], 0.0, 0.003)
    twin.take_state(late)
    for plant in (late, twin):
        plant.step([[0.0, 0.0]], 0.0, 0.02)
    np.testing.assert_array_equal(twin.memory, late.memory)


@pytest.mark.parametrize("effects", [(), ("command_delay",)])
def test_a_plant_takes_the_state_of_some_rigs_of_another(effects):
    """Across blocks of lanes, and in another order; what follows is the same bit for bit."""
    many = Plant("paper_dead_zone", 40, effects=effects)
    rows = np.array([33, 2, 17, 16])
    few = Plant("paper_dead_zone", len(rows), effects=effects)
    if effects:
        for plant in (many, few):
            plant.set("command_delay.delay", 0.004)
    command = np.random.default_rng(0).uniform(-60.0, 60.0, (40, 2))
    many.step(command, 0.0, 0.05)
    few.take_state(many, rows)
    np.testing.assert_array_equal(few.speed, many.speed[rows])
    many.step(command, 0.0, 0.05)
    few.step(command[rows], 0.0, 0.05)
    np.testing.assert_array_equal(few.speed, many.speed[rows])


@pytest.mark.parametrize("effects", [(), ("command_delay",)])
def test_selected_rigs_go_on_as_in_the_whole(effects):
    """Parameters, state and delayed commands come along, across blocks of lanes and in another order."""
    many = Plant("paper_dead_zone", 40, effects=effects)
    if effects:
        many.set("command_delay.delay", 0.004)
    stream = np.random.default_rng(1)
    many.set("Kq", many.get("Kq") * stream.uniform(0.8, 1.2, (40, 2)))
    command, rows = stream.uniform(-60.0, 60.0, (40, 2)), np.array([33, 2, 17, 16])
    many.step(command, 0.0, 0.05)
    few = many.select(rows)
    for _ in range(2):
        np.testing.assert_array_equal(few.speed, many.speed[rows])
        many.step(command, 0.0, 0.05)
        few.step(command[rows], 0.0, 0.05)
    np.testing.assert_array_equal(few.get("Kq"), many.get("Kq")[rows])
