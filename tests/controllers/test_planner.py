"""The receding-horizon planner: the modelled spool, the slope of the cost, where planning helps, when commands are averaged."""

import numpy as np
import pytest

from hydro_env.controllers.estimation.nominal import NOMINAL, RATED_TRAVEL, STICTION, Motor
from hydro_env.controllers.estimation.spool import (
    SpoolSettings,
    channel_of,
    deadbeat_position,
    deadbeat_state,
    follow,
)
from hydro_env.controllers.mpc.flow_controller import FlowController, FlowSettings
from hydro_env.controllers.mpc.planner import (
    HORIZON,
    Planner,
    PlannerSettings,
    Scene,
    Work,
    cost_of,
    improve_plans,
    normal_equations,
    predict_delayed,
)
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.observation import decode
from hydro_env.plant import load_model, simulate
from hydro_env.units import RPM

AVERAGED = FlowSettings(planner=None)
STEPS = 8


def channel(friction=0.0, **settings):
    """The channel's model at 10 ms; `friction` as a share of the rated command."""
    return channel_of(SpoolSettings(friction=friction / STICTION, **settings), Motor(), 0.01, HORIZON)


def weights(apart, moves, swing, soft_limit, turns):
    """Beside 1 for the distance from the aim."""
    return PlannerSettings(apart=apart, moves=moves, swing=swing, soft_limit=soft_limit, turns=turns)


def scene(place, motor, load, edge, gain, sent, aim):
    """One rig, from what it begins with."""
    given = (
        np.expand_dims(np.asarray(each, dtype=float), 0) for each in (motor, load, edge, gain, sent, aim)
    )
    return Scene(np.ascontiguousarray(np.asarray(place)[:, None]), *given, np.ones(1))


class Alone:
    """The flow controller without a network as a controller."""

    name, needs, plant = "alone", "measurements", None

    def __init__(self, law):
        self.law = law

    def reset(self, num_rigs, period):
        self.period, self.started = period, False

    def act(self, observation):
        if self.started:
            self.law.update(decode(observation))
        else:
            self.law.start(decode(observation), self.period)
            self.started = True
        return self.law.command()


def test_modelled_spool_goes_where_the_plants_spool_goes():
    """With the plant's friction the model stays within 4 % of the rated travel through full steps to and fro."""
    model = load_model("paper")
    command = np.repeat(np.random.default_rng(1).uniform(-0.6, 0.6, (25, 2)), 3, axis=0)
    true = simulate(model, 73.0 * command, None, 0.01, record=("spool",))["spool"][:, 0]
    travel = 20.0 * 73.0 / (100.0 * 17000.0)
    force = 17000.0 * travel
    x, v, late, ringing, bend = (np.zeros((1, 2)) for _ in range(5))
    edge, gain, seen = np.full((1, 2, 2), 0.1), np.ones((1, 2)), []
    r = channel(friction=0.1 / force)
    for row in command:
        seen.append(x[0].copy())
        follow(x, v, late, ringing, bend, row[None].copy(), edge, gain, r)
    assert np.sqrt(np.mean((np.array(seen) - true / travel) ** 2)) < 0.04


def test_slope_of_the_cost_is_that_of_its_differences():
    r, w, work = channel(), weights(30.0, 100.0, 100.0, 2.0, 1), Work.of(STEPS)
    place = [[0.3, 0.4], [2.0, -1.0], [0.3, 0.4]]
    s = scene(
        place,
        [20.0, 22.0],
        [0.1, 0.3],
        np.full((2, 2), 0.02),
        [0.8, 0.7],
        [0.3, 0.4],
        np.linspace(21.0, 25.0, HORIZON + 1),
    )
    plan = np.array([[0.35, 0.4, 0.38, 0.4], [0.45, 0.5, 0.5, 0.52]])
    cost_of(plan, 0, s, w, r, work)
    normal_equations(plan, 0, s, w, r, work)
    found = np.empty(2 * HORIZON)
    for k in range(2 * HORIZON):
        step = np.zeros(2 * HORIZON)
        step[k] = 1e-5
        more, less = (cost_of(plan + sign * step.reshape(2, -1), 0, s, w, r, work) for sign in (1.0, -1.0))
        found[k] = (more - less) / 4e-5
    np.testing.assert_allclose(work.slope, found, rtol=0.02, atol=0.02 * np.abs(found).max())


def test_matrix_of_the_normal_equations_is_the_change_of_the_slope():
    """With a cost that is a sum of squares throughout, the lower triangle that is read."""
    r, w, work = channel(), weights(30.0, 100.0, 100.0, 1e6, 1), Work.of(STEPS)
    place = [[0.3, 0.4], [2.0, -1.0], [0.3, 0.4]]
    load, edge = [0.1, 0.3], np.full((2, 2), 0.02)
    s = scene(place, [20.0, 22.0], load, edge, [0.8, 0.7], [0.3, 0.4], np.linspace(21.0, 25.0, HORIZON + 1))
    plan, slopes = np.array([[0.35, 0.4, 0.38, 0.4], [0.45, 0.5, 0.5, 0.52]]), []
    for k in range(2 * HORIZON):
        step = np.zeros(2 * HORIZON)
        step[k] = 1e-5
        for sign in (1.0, -1.0):
            cost_of(plan + sign * step.reshape(2, -1), 0, s, w, r, work)
            normal_equations(plan + sign * step.reshape(2, -1), 0, s, w, r, work)
            slopes.append(sign * work.slope / 2e-5)
    found = np.add.reduceat(slopes, range(0, 4 * HORIZON, 2))
    np.testing.assert_allclose(
        np.tril(work.square), np.tril(found), rtol=0.02, atol=0.02 * np.abs(found).max()
    )


def test_speeds_are_foreseen_as_the_plant_makes_them():
    """Commands that jump from a steady flow. With the pressure's lag the plan's model is off by less than 1 rpm after one and
    two periods (root mean square); with a flow that turns the motor at once by about 3."""
    rng, off = np.random.default_rng(0), []
    r, w, work = (
        channel(friction=0.85 * STICTION),
        weights(1.0, 1.0, 1.0, 1.0, 1),
        Work.of(STEPS),
    )
    for _ in range(16):
        command = np.full((60, 2), 0.45)
        command[50:54] += np.repeat(rng.uniform(-0.35, 0.35, (2, 2)), 2, axis=0)
        true = simulate(
            "paper", 73.0 * command, None, 0.01, values={"Kq": NOMINAL["Kq"]}, record=("spool", "speed")
        )
        place = [true["spool"][50, 0] / RATED_TRAVEL, np.zeros(2), command[49]]
        plan, motor = np.ascontiguousarray(command[50:54].T), true["speed"][50, 0]
        s = scene(place, motor, np.zeros(2), np.zeros((2, 2)), np.ones(2), command[49], np.zeros(HORIZON + 1))
        off.append([])
        for model in (r, r._replace(fresh=1.0)):
            cost_of(plan, 0, s, w, model, work)
            off[-1].append((work.speeds[:, 1:3] - true["speed"][51:53, 0].T) / RPM)
    lagging, at_once = np.sqrt(np.mean(np.square(off), axis=(0, 2, 3)))
    assert lagging < 1.0
    assert at_once > 2.5


def test_a_plan_at_the_commands_limits_is_the_best_there_is():
    """Motors that are to hurry and to meet: no command of the plan can be moved, within the limits, so that it costs less."""
    r, w, work = channel(), weights(300.0, 650.0, 3000.0, 1.5, 40), Work.of(STEPS)
    place = [[0.8, 0.8], [0.0, 0.0], [0.8, 0.8]]
    s = scene(
        place,
        [42.0, 45.5],
        np.zeros(2),
        np.full((2, 2), 0.05),
        [0.8, 0.8],
        [0.8, 0.8],
        np.full(HORIZON + 1, 60.0),
    )
    plan, plain = np.full((1, 2, HORIZON), 0.8), np.full((1, 2, HORIZON), 0.8)
    improve_plans(plan, plain, np.array([0]), s, w, r, work)
    assert plan[0, 0, 0] == 1.0
    best = cost_of(plan[0], 0, s, w, r, work)
    for at in np.ndindex(2, HORIZON):
        for step in (-0.02, 0.02):
            moved = plan[0].copy()
            moved[at] = np.clip(moved[at] + step, -1.0, 1.0)
            assert cost_of(moved, 0, s, w, r, work) > best * (1.0 - 1e-4)


def test_the_valve_with_the_longer_way_sets_out_first():
    """From rest, with dead zones of 2 and 20 %: both motors are to begin to turn in the same period."""
    r, w, work = channel(), weights(300.0, 1000.0, 1000.0, 2.0, 20), Work.of(STEPS)
    edge, none = [[0.02, 0.02], [0.20, 0.20]], np.zeros(2)
    s = scene(np.zeros((3, 2)), none, none, edge, [0.8, 0.8], none, [0.0, 1.0, 2.0, 3.0, 4.0])
    plan, plain = np.zeros((1, 2, HORIZON)), np.tile([[[0.1], [0.28]]], (1, 1, HORIZON))
    improve_plans(plan, plain, np.array([0]), s, w, r, work)
    cost_of(plan[0], 0, s, w, r, work)
    planned = np.abs(work.speeds[0] - work.speeds[1]).max()
    cost_of(plain[0], 0, s, w, r, work)
    assert work.speeds.mean(axis=0)[-1] > 0.0
    assert planned < 0.2 * np.abs(work.speeds[0] - work.speeds[1]).max()
    assert plan[0, 1, 0] > plan[0, 0, 0]


def test_spools_are_led_along_a_sweep_and_home():
    """Turned in the middle of a sweep, one is on its way back after two periods and stays on it; one at rest goes home."""
    r = channel(friction=0.01)
    x, v, late = np.array([[0.13, 0.0]]), np.array([[2.7, 0.0]]), np.array([[0.14, 0.0]])
    pace = np.array([[-2.7, 0.0]])
    edge, gain = np.full((1, 2, 2), 0.1), np.ones((1, 2))
    for k in range(8):
        way = np.array([[0.02 - 0.027 * k, 0.05]])
        sent = np.full((1, 2), 9.0)
        deadbeat_state(sent, np.ones((1, 2), bool), x, v, late, way, pace, r)
        follow(x, v, late, np.zeros((1, 2)), np.zeros((1, 2)), sent, edge, gain, r)
        if k >= 2:
            np.testing.assert_allclose(x, way - 0.01 * pace, atol=0.012)
    np.testing.assert_allclose(v, pace, atol=0.6)
    left = np.full((1, 2), 9.0)
    deadbeat_state(left, np.zeros((1, 2), bool), x, v, late, way, pace, r)
    assert np.all(left == 9.0)


def test_a_spool_is_brought_back_within_a_period():
    """It passes the goal a period later and has left the place where it let flow pass before half of that."""
    r = channel(friction=0.01)
    x, v, late = np.array([[0.13, 0.0]]), np.array([[2.7, 0.0]]), np.array([[0.14, 0.0]])
    sent, goal = np.full((1, 2), 9.0), np.array([[0.05, 0.0]])
    deadbeat_position(sent, np.array([[True, False]]), x, v, late, goal, r)
    assert sent[0, 1] == 9.0
    sent[0, 1] = 0.0
    halfway = channel(friction=0.01)._replace(steps=STEPS // 2)
    given = np.zeros((1, 2)), np.zeros((1, 2)), sent, np.full((1, 2, 2), 0.1), np.ones((1, 2))
    begin = x.copy(), v.copy(), late.copy()
    follow(*begin, *given, halfway)
    assert begin[0][0, 0] < 0.13
    follow(x, v, late, *given, r)
    np.testing.assert_allclose(x[0, 0], 0.05, atol=0.003)


def test_sweeps_move_the_shafts_little_and_find_the_edges():
    """In 0.2 s at rest, with edges that no sweep could know: most valves are known then to a hundredth of the command."""
    rest = {"duration": 0.2, "setpoint_rpm": [[0.1, 0.0]]}
    law = FlowController()
    found = roll_out(Alone(law), range(200), mismatch="train", scenario=rest).metrics()
    assert np.median(found["max_speed_difference_rpm"]) < 3.8
    assert np.percentile(found["max_speed_difference_rpm"], 95) < 8.0
    assert np.mean(~law.estimator.valves.state.unknown) > 0.97


def test_commands_on_their_way_are_waited_out():
    """As `follow` moves the spools, newest command last."""
    r, rng = channel(friction=0.01), np.random.default_rng(2)
    sent = rng.uniform(-0.5, 0.5, (3, 2, 2))
    place, motor, load = rng.uniform(-0.2, 0.2, (3, 2, 2)), np.zeros((2, 2)), np.zeros((2, 2))
    edge, gain = np.full((2, 2, 2), 0.05), np.ones((2, 2))
    x, v, late = (each.copy() for each in place)
    for k in (1, 0):
        follow(x, v, late, np.zeros((2, 2)), np.zeros((2, 2)), sent[k].copy(), edge, gain, r)
    begin = place.copy()
    predict_delayed(np.array([2, 0]), sent, place, motor, load, edge, gain, r)
    np.testing.assert_allclose(place[:, 0], [x[0], v[0], late[0]])
    np.testing.assert_array_equal(place[:, 1], begin[:, 1])
    assert np.all(motor[0] != 0.0) and np.all(motor[1] == 0.0)


def test_late_commands_are_noticed_and_planned_for():
    late = load_model("paper_dead_zone").with_values({"command_delay.delay": 0.01})
    law = FlowController()
    found = roll_out(Alone(law), range(24), plant=late, mismatch="train", scenario="setpoint_steps").metrics()
    assert np.mean(law.estimator.delay.periods == 1) > 0.9
    assert np.median(found["max_speed_difference_rpm"]) < 17.0
    usual = FlowController()
    roll_out(Alone(usual), range(24), mismatch="train", scenario="setpoint_steps")
    assert not usual.estimator.delay.periods.any()


def test_sticking_spools_are_no_delay():
    """Pairs of valves with much friction, of which a spool without coil and lag looked a period late."""
    law = FlowController()
    found = roll_out(Alone(law), [1153, 1314], mismatch="train", scenario="load_step").metrics()
    assert not law.estimator.delay.periods.any()
    assert np.all(found["max_speed_difference_rpm"] < 20.0)


def test_a_pair_that_hunts_is_calmed():
    """Moves cost more where flow is not what the model says, in steady running alone, and no longer once it is again."""
    planner = Planner(PlannerSettings(), np.zeros((2, 2)), channel())
    innovation, steady = np.array([[0.0, 0.0], [0.05, 0.0]]), np.zeros(2)
    for _ in range(30):
        weights = planner.move_weights(innovation, steady)
    np.testing.assert_allclose(weights, [1.0, 6.0])
    np.testing.assert_array_equal(planner.move_weights(innovation, steady + 50.0), 1.0)
    for _ in range(60):
        weights = planner.move_weights(np.zeros((2, 2)), steady)
    np.testing.assert_allclose(weights, 1.0, atol=0.05)


@pytest.mark.parametrize("scenario", ["staircase", "sine"])
def test_planning_beats_averaging_through_standstill(scenario):
    """After the first second, in which probing and the first start set the largest difference of both."""
    largest = []
    for law in (FlowController(), FlowController(AVERAGED)):
        trace = roll_out(Alone(law), range(24), mismatch="train", scenario=scenario).trace
        largest.append(np.median(np.abs(trace.difference_rpm[100:]).max(axis=0)))
    assert largest[0] < 0.95 * largest[1]


def test_a_row_of_a_batch_is_that_rig_alone():
    steps = {"duration": 0.6, "setpoint_rpm": [[0.2, 400.0]]}
    many = roll_out(Alone(FlowController()), range(4), mismatch="train", scenario=steps).trace.command
    alone = roll_out(Alone(FlowController()), [2], mismatch="train", scenario=steps).trace.command
    np.testing.assert_array_equal(many[:, 2], alone[:, 0])


def test_at_other_control_periods_the_law_beneath_commands():
    largest = roll_out(
        Alone(FlowController()), range(12), mismatch="train", scenario="setpoint_steps", control_period=0.02
    ).metrics()["max_speed_difference_rpm"]
    assert np.median(largest) < 40.0
