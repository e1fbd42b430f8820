"""The law that plans: the model's spool, the plan's slope, where it helps, and when it hands over to the law beneath."""

import numpy as np
import pytest

from hydro_env.controllers.estimation.valve_estimate import SpoolModel, ValveEstimate
from hydro_env.controllers.learned.policy_interface import make_view
from hydro_env.controllers.mpc.flow_controller import FRICTION, RATED_TRAVEL, FlowView, Motor
from hydro_env.controllers.mpc.flow_law import NOMINAL
from hydro_env.controllers.mpc.planner import (
    Weights,
    _drive,
    _normal,
    follow,
    improve_plans,
    lead_to,
    responses,
    throw_to,
    wait_out,
)
from hydro_env.controllers.mpc.planning_controller import HORIZON, STEPS, PlanningView
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.observation import FRAME
from hydro_env.errors import InputError
from hydro_env.plant import load_model, simulate
from hydro_env.units import RPM

MOTOR = (Motor().per_speed, Motor().per_torque, Motor().per_acceleration)


def channel(friction=0.0, horizon=HORIZON):
    return responses(0.01, STEPS, horizon, 206.0, 0.03, friction, MOTOR)


class Alone:
    """A view without a network as a controller."""

    name, needs, plant = "alone", "measurements", None

    def __init__(self, view):
        self.view = view

    def reset(self, num_rigs, period):
        self.num_rigs, self.period, self.started = num_rigs, period, False

    def act(self, observation):
        if self.started:
            self.view.take_in(observation)
        else:
            self.view.start(observation, self.period)
            self.started = True
        return self.view.command(np.zeros((2 * self.num_rigs, self.view.num_actions)))


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
    r, w = channel(), Weights(30.0, 1.0, 100.0, 100.0, 2.0, 1)
    place, motor = np.array([[0.3, 0.4], [2.0, -1.0], [0.3, 0.4]]), np.array([20.0, 22.0])
    load, gain, edge = np.array([0.1, 0.3]), np.array([0.8, 0.7]), np.full((2, 2), 0.02)
    sent, aim = np.array([0.3, 0.4]), np.linspace(21.0, 25.0, HORIZON + 1)
    plan = np.array([[0.35, 0.4, 0.38, 0.4], [0.45, 0.5, 0.5, 0.52]])
    n = 2 * HORIZON
    speeds, ends, opened = np.empty((2, HORIZON + 1)), np.empty((2, 2)), np.empty((2, HORIZON * STEPS))

    def cost(given):
        return _drive(given, place, motor, load, edge, gain, sent, aim, w, r, speeds, ends, opened)

    cost(plan)
    square, slope = np.empty((n, n)), np.empty(n)
    turned, risen, change = np.empty(HORIZON), np.empty(HORIZON), np.empty((2, HORIZON, HORIZON + 1))
    _normal(plan, gain, sent, aim, w, r, speeds, ends, opened, turned, risen, change, square, slope)
    found = np.empty(n)
    for k in range(n):
        step = np.zeros(n)
        step[k] = 1e-5
        found[k] = (cost(plan + step.reshape(2, -1)) - cost(plan - step.reshape(2, -1))) / 4e-5
    np.testing.assert_allclose(slope, found, rtol=0.02, atol=0.02 * np.abs(found).max())
    np.testing.assert_allclose(square, square.T, atol=1e-9)


def test_speeds_are_foreseen_as_the_plant_makes_them():
    """Commands that jump from a steady flow. With the pressure's lag the plan's model is off by less than 1 rpm after one and
    two periods (root mean square); with a flow that turns the motor at once by about 3."""
    rng, off = np.random.default_rng(0), []
    speeds, ends, opened = np.empty((2, HORIZON + 1)), np.empty((2, 2)), np.empty((2, HORIZON * STEPS))
    r, w = channel(friction=0.85 * FRICTION), Weights(1.0, 1.0, 1.0, 1.0, 1.0, 1)
    for _ in range(16):
        command = np.full((60, 2), 0.45)
        command[50:54] += np.repeat(rng.uniform(-0.35, 0.35, (2, 2)), 2, axis=0)
        true = simulate(
            "paper", 73.0 * command, None, 0.01, values={"Kq": NOMINAL["Kq"]}, record=("spool", "speed")
        )
        place = np.array([true["spool"][50, 0] / RATED_TRAVEL, np.zeros(2), command[49]])
        plan, motor = np.ascontiguousarray(command[50:54].T), true["speed"][50, 0]
        still = np.zeros(2), np.zeros((2, 2)), np.ones(2), command[49], np.zeros(HORIZON + 1)
        off.append([])
        for model in (r, r._replace(fresh=1.0)):
            _drive(plan, place, motor, *still, w, model, speeds, ends, opened)
            off[-1].append((speeds[:, 1:3] - true["speed"][51:53, 0].T) / RPM)
    lagging, at_once = np.sqrt(np.mean(np.square(off), axis=(0, 2, 3)))
    assert lagging < 1.0
    assert at_once > 2.5


def test_a_plan_at_the_commands_limits_is_the_best_there_is():
    """Motors that are to hurry and to meet: no command of the plan can be moved, within the limits, so that it costs less."""
    r, w = channel(), Weights(300.0, 1.0, 650.0, 3000.0, 1.5, 40)
    place = np.array([[[0.8, 0.8]], [[0.0, 0.0]], [[0.8, 0.8]]])
    motor, load, gain, edge = (
        np.array([[42.0, 45.5]]),
        np.zeros((1, 2)),
        np.full((1, 2), 0.8),
        np.full((1, 2, 2), 0.05),
    )
    sent, aim = np.full((1, 2), 0.8), np.full((1, HORIZON + 1), 60.0)
    plan, plain = np.full((1, 2, HORIZON), 0.8), np.full((1, 2, HORIZON), 0.8)
    improve_plans(plan, plain, np.array([0]), place, motor, load, edge, gain, sent, aim, np.ones(1), w, r)
    assert plan[0, 0, 0] == 1.0
    speeds, ends, opened = np.empty((2, HORIZON + 1)), np.empty((2, 2)), np.empty((2, HORIZON * STEPS))
    given = (place[:, 0], motor[0], load[0], edge[0], gain[0], sent[0], aim[0], w, r, speeds, ends, opened)
    best = _drive(plan[0], *given)
    for at in np.ndindex(2, HORIZON):
        for step in (-0.02, 0.02):
            moved = plan[0].copy()
            moved[at] = np.clip(moved[at] + step, -1.0, 1.0)
            assert _drive(moved, *given) > best * (1.0 - 1e-4)


def test_the_valve_with_the_longer_way_sets_out_first():
    """From rest, with dead zones of 2 and 20 %: both motors are to begin to turn in the same period."""
    r, w = channel(), Weights(300.0, 1.0, 1000.0, 1000.0, 2.0, 20)
    edge = np.array([[[0.02, 0.02], [0.20, 0.20]]])
    place, motor, load = np.zeros((3, 1, 2)), np.zeros((1, 2)), np.zeros((1, 2))
    gain, sent = np.full((1, 2), 0.8), np.zeros((1, 2))
    aim = np.array([[0.0, 1.0, 2.0, 3.0, 4.0]])
    plan, plain = np.zeros((1, 2, HORIZON)), np.tile([[[0.1], [0.28]]], (1, 1, HORIZON))
    improve_plans(plan, plain, np.array([0]), place, motor, load, edge, gain, sent, aim, np.ones(1), w, r)
    speeds, ends, opened = np.empty((2, HORIZON + 1)), np.empty((2, 2)), np.empty((2, HORIZON * STEPS))
    given = (place[:, 0], motor[0], load[0], edge[0], gain[0], sent[0], aim[0], w, r, speeds, ends, opened)
    _drive(plan[0], *given)
    planned = np.abs(speeds[0] - speeds[1]).max()
    _drive(plain[0], *given)
    assert speeds.mean(axis=0)[-1] > 0.0
    assert planned < 0.2 * np.abs(speeds[0] - speeds[1]).max()
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
        lead_to(sent, np.ones((1, 2), bool), x, v, late, way, pace, r)
        follow(x, v, late, np.zeros((1, 2)), np.zeros((1, 2)), sent, edge, gain, r)
        if k >= 2:
            np.testing.assert_allclose(x, way - 0.01 * pace, atol=0.012)
    np.testing.assert_allclose(v, pace, atol=0.6)
    left = np.full((1, 2), 9.0)
    lead_to(left, np.zeros((1, 2), bool), x, v, late, way, pace, r)
    assert np.all(left == 9.0)


def test_a_spool_is_thrown_back_within_a_period():
    """It passes the goal a period later and has left the place where it let flow pass before half of that."""
    r = channel(friction=0.01)
    x, v, late = np.array([[0.13, 0.0]]), np.array([[2.7, 0.0]]), np.array([[0.14, 0.0]])
    sent, goal = np.full((1, 2), 9.0), np.array([[0.05, 0.0]])
    throw_to(sent, np.array([[True, False]]), x, v, late, goal, r)
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
    view = PlanningView()
    found = roll_out(Alone(view), range(200), mismatch="train", scenario=rest).metrics()
    assert np.median(found["max_speed_difference_rpm"]) < 3.8
    assert np.percentile(found["max_speed_difference_rpm"], 95) < 8.0
    assert np.mean(~view.valves.unknown) > 0.97


def test_valves_that_change_while_they_run_are_followed():
    """Gain and edges wander, of a valve that is in use and of the side that is not."""
    n, period = 40, 0.01
    valves = ValveEstimate(
        n,
        period,
        drift=0.03,
        gain_drift=0.004,
        doubt=(0.012, 0.06),
        first=0.0065,
        moved=0.1,
        idle=0.05,
        unused=0.02,
    )
    valves.forget(slice(None))
    valves.told(np.full((n, 2, 2), 0.1), np.full((n, 2), 0.8), 0.004, 0.02)
    spool, rng = SpoolModel(n, period, 206.0, 0.03, 0.01), np.random.default_rng(0)
    for _ in range(300):
        spool.place(slice(None), np.full((n, 2), 0.4))
        valves.learn(spool, 0.8 * (0.4 - 0.13) + 0.002 * rng.standard_normal((n, 2)), np.ones((n, 2)))
    beyond = valves.gain * (0.4 - valves.edge[..., 0])
    np.testing.assert_allclose(np.median(beyond), 0.8 * 0.27, atol=0.004)
    unused = np.sqrt(valves.edge_variance[..., 1])
    assert np.all((unused > 0.015) & (unused < 0.021))


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
    wait_out(np.array([2, 0]), sent, place, motor, load, edge, gain, r)
    np.testing.assert_allclose(place[:, 0], [x[0], v[0], late[0]])
    np.testing.assert_array_equal(place[:, 1], begin[:, 1])
    assert np.all(motor[0] != 0.0) and np.all(motor[1] == 0.0)


def test_late_commands_are_noticed_and_planned_for():
    late = load_model("paper_dead_zone").with_values({"command_delay.delay": 0.01})
    view = PlanningView()
    found = roll_out(
        Alone(view), range(24), plant=late, mismatch="train", scenario="setpoint_steps"
    ).metrics()
    assert np.mean(view.delays.periods == 1) > 0.9
    assert np.median(found["max_speed_difference_rpm"]) < 17.0
    usual = PlanningView()
    roll_out(Alone(usual), range(24), mismatch="train", scenario="setpoint_steps")
    assert not usual.delays.periods.any()


def test_sticking_spools_are_no_delay():
    """Pairs of valves with much friction, of which a spool without coil and lag looked a period late."""
    view = PlanningView()
    found = roll_out(Alone(view), [1153, 1314], mismatch="train", scenario="load_step").metrics()
    assert not view.delays.periods.any()
    assert np.all(found["max_speed_difference_rpm"] < 20.0)


def test_a_pair_that_hunts_is_calmed():
    """Moves get dearer where flow is not what the model says, in steady running alone, and no longer once it is again."""
    view = PlanningView()
    view.start(np.zeros((2, 2 * FRAME)), 0.01)
    view.valves.surprise[:] = [[0.0, 0.0], [0.05, 0.0]]
    for _ in range(30):
        dearer = view._dearer()
    np.testing.assert_allclose(dearer, [1.0, 6.0])
    view.acceleration[:] = 50.0
    np.testing.assert_array_equal(view._dearer(), 1.0)
    view.acceleration[:], view.valves.surprise[:] = 0.0, 0.0
    for _ in range(60):
        dearer = view._dearer()
    np.testing.assert_allclose(dearer, 1.0, atol=0.05)


@pytest.mark.parametrize("scenario", ["staircase", "sine"])
def test_planning_beats_averaging_through_standstill(scenario):
    """After the first second, in which probing and the first start set the largest difference of both."""
    largest = []
    for view in (PlanningView(), FlowView()):
        trace = roll_out(Alone(view), range(24), mismatch="train", scenario=scenario).trace
        largest.append(np.median(np.abs(trace.difference_rpm[100:]).max(axis=0)))
    assert largest[0] < 0.95 * largest[1]


def test_a_row_of_a_batch_is_that_rig_alone():
    steps = {"duration": 0.6, "setpoint_rpm": [[0.2, 400.0]]}
    many = roll_out(Alone(PlanningView()), range(4), mismatch="train", scenario=steps).trace.command
    alone = roll_out(Alone(PlanningView()), [2], mismatch="train", scenario=steps).trace.command
    np.testing.assert_array_equal(many[:, 2], alone[:, 0])


def test_settings_come_back_and_unknown_ones_are_refused():
    view = make_view({"kind": "plan", "apart": 200.0, "slew": 12.0})
    again = make_view(view.settings())
    assert again.settings() == view.settings()
    assert (again.slew, again.settings()["kind"]) == (12.0, "plan")
    for wrong in ("others", "spart"):
        with pytest.raises(InputError, match=wrong):
            make_view({"kind": "plan", wrong: 1.0})


def test_at_other_control_periods_the_law_beneath_commands():
    largest = roll_out(
        Alone(PlanningView()), range(12), mismatch="train", scenario="setpoint_steps", control_period=0.02
    ).metrics()["max_speed_difference_rpm"]
    assert np.median(largest) < 40.0
