"""Controllers: the PID law by hand and against SciPy, anti-windup, bumpless start, batch parity, making
them.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm

from agents.true_map import true_map
from docs.evidence import shipped_gains
from hydro_env.controllers import CONTROLLERS, LAWS, make_controller
from hydro_env.controllers.base import FRACTION_PER_V, RPM
from hydro_env.controllers.classical.pid import TABLE_III, Pid, per_rpm
from hydro_env.controllers.estimation.bench_map import ValveMap
from hydro_env.controllers.estimation.nominal import SPOOL_RATE, Motor
from hydro_env.controllers.input_shaping import three_taps
from hydro_env.controllers.tuning import linearised as linear
from hydro_env.controllers.tuning import tune
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.controllers.tuning.linearised import largest_sensitivity
from hydro_env.controllers.tuning.search import Search, Task
from hydro_env.errors import InputError
from hydro_env.plant import Plant, load_model


def test_pid_by_hand(monkeypatch):
    """kp 2, ti 0.5 s, td 0.1 s, N 10 1/s at 0.1 s: every term worked out on paper."""
    monkeypatch.setattr("hydro_env.controllers.classical.pid.FILTER_RATE", 10.0)
    pid = Pid(0.1, 0.0, 2.0, 0.5, 0.1)
    # P = 2 e; I += 2 * 0.1/0.5 e = 0.4 e; D = (D + 2*0.1*10 de) / (1 + 1), no kick at the first sample
    assert pid.step(np.array(1.0), limits=(-100, 100)) == pytest.approx(2.0 + 0.4 + 0.0)
    assert pid.step(np.array(2.0), limits=(-100, 100)) == pytest.approx(4.0 + (0.4 + 0.8) + 1.0)
    assert pid.step(np.array(2.0), limits=(-100, 100)) == pytest.approx(4.0 + 2.0 + 0.5)


@pytest.mark.parametrize("gains", [(0.016, 0.156, 0.005), (0.023, 0.150, 0.0)])
def test_pid_converges_to_the_continuous_law(gains):
    """Table III: the sampled law tends to kp (1 + 1/(ti s) + td s/(1 + s/N)), first order in the sample
    time.
    """
    kp, ti, td = gains
    n = 100.0
    #  kp [ (1 + s/N) ti s + (1 + s/N) + ti td s^2 ] / [ ti s (1 + s/N) ]
    law = signal.TransferFunction([kp * (ti / n + ti * td), kp * (ti + 1 / n), kp], [ti / n, ti, 0.0])
    errors = []
    for period in (1e-3, 5e-4):
        time = np.arange(0.0, 0.5, period)
        error = np.sin(7.0 * time) * 10.0
        _, wanted, _ = signal.lsim(law, error, time)
        pid = Pid(period, 0.0, kp, ti, td)
        got = [pid.step(np.array(e)) for e in error]
        errors.append(np.max(np.abs(got - wanted)))
    assert errors[0] < 4e-3
    assert errors[1] < 0.6 * errors[0]


def test_anti_windup():
    """A second in the limit must not have to be integrated back: the output leaves it as soon as the error
    turns.
    """
    pid = Pid(0.01, 0.0, 0.5, 0.1)
    for _ in range(100):
        assert pid.step(np.array(3.0)) == 1.0
    assert pid.integral < 1.0
    assert pid.step(np.array(-0.1)) < 1.0
    for _ in range(100):
        assert pid.step(np.array(-3.0)) == -1.0
    assert pid.step(np.array(0.1)) > -1.0


def test_anti_windup_counts_what_is_fed_forward():
    pid = Pid(0.01, 0.0, 0.1, 0.1)
    for _ in range(50):
        pid.step(np.array(0.1), feedforward=2.0)
    assert pid.integral == 0.0


def test_bumpless_takeover():
    """Taking over at the set-point changes nothing; the output that is in force stays."""
    pid = Pid(0.01, np.array([[0.3, -0.2]]), 0.5, 0.1)
    np.testing.assert_allclose(pid.step(np.zeros((1, 2))), [[0.3, -0.2]])


def test_units_of_the_paper():
    """Table III is V per rpm: an error of 600 rpm and Kp = 0.016 are 9.6 V of 73."""
    assert per_rpm(0.016) * (600 * RPM) == pytest.approx(9.6 / 73)
    assert pytest.approx(1 / 73) == FRACTION_PER_V


def test_valve_map_inverts_itself():
    curve = ValveMap(np.array([[[0.1, 0.2], [0.0, -0.05]]]), np.array([[[0.8, 0.9], [1.0, 0.7]]]))
    for flow in (0.4, -0.3):
        u = curve.command(np.full((1, 2), flow))[0]
        side = 0 if flow > 0 else 1
        got = (
            np.sign(flow) * curve.gain[0, :, side] * (np.abs(u) - np.sign(flow * u) * curve.edge[0, :, side])
        )
        np.testing.assert_allclose(got, flow)
    np.testing.assert_allclose(
        curve.command(np.zeros((1, 2))), [[-0.05, 0.025]]
    )  # the middle of the dead zone


def test_motor_coasts_at_its_pole():
    """plant.md's pole, 0.178 s; coasting is what takes no flow."""
    motor = Motor()
    assert pytest.approx(0.178, abs=5e-4) == 1 / motor.rate
    assert motor.demand(50.0, -50.0 * motor.rate, 0.0) == pytest.approx(0.0, abs=1e-12)


class Spool:
    """Where the nominal spool stands (share of its rated travel): mass, spring, damping, sampled exactly."""

    def __init__(self, position, period, damping):
        continuous = [
            [0.0, 1.0, 0.0],
            [-(SPOOL_RATE**2), -2.0 * damping * SPOOL_RATE, SPOOL_RATE**2],
            [0.0] * 3,
        ]
        self.held = expm(np.array(continuous) * period)
        self.position, self.speed = np.array(position, dtype=float), np.zeros_like(position, dtype=float)

    def step(self, command):
        (a, b, c), (d, e, f), _ = self.held
        self.position, self.speed = (
            a * self.position + b * self.speed + c * command,
            d * self.position + e * self.speed + f * command,
        )


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
def test_shaper_leaves_the_spool_at_rest(period):
    spacing, weight = three_taps(SPOOL_RATE, period)
    spool = Spool(np.zeros(1), period, damping=0.0)
    asked = [np.zeros(1)] * (2 * spacing) + [np.ones(1)] * 60
    peak = 0.0
    for n in range(2 * spacing, len(asked)):
        spool.step(weight * (asked[n] + asked[n - 2 * spacing]) + (1 - 2 * weight) * asked[n - spacing])
        if n > 4 * spacing + 1:
            peak = max(peak, abs(spool.position[0] - 1.0))
    assert peak < 1e-9


def test_bench_finds_what_the_parameters_say():
    """The slow triangle on the simulated bench against the curve that follows from the true parameters."""
    plant = Plant("paper", 3, effects=("dead_zone", "null_offset"))
    plant.set("dead_zone.overlap_positive", [[0.0, 50e-6], [100e-6, 200e-6], [150e-6, 20e-6]])
    plant.set("dead_zone.overlap_negative", 80e-6)
    plant.set("null_offset.offset", [[20e-6, -20e-6], [0.0, 0.0], [-30e-6, 30e-6]])
    plant.set("R", [[90.0, 110.0], [100.0, 100.0], [100.0, 95.0]])
    wanted, controller = true_map(plant), make_controller("compensated")
    controller.prepare(plant)
    got = controller.valves
    np.testing.assert_allclose(got.edge, wanted.edge, atol=0.006)
    np.testing.assert_allclose(got.gain, wanted.gain, rtol=0.02)


def test_controllers_that_need_to_know_the_rig_say_so():
    observation = np.zeros((1, 9), np.float32)
    for name in ("compensated", "oracle"):
        law = LAWS[name]
        controller = law(**{gain.name: gain.high for gain in law.GAINS})
        controller.reset(1, 0.01)
        with pytest.raises(RuntimeError, match="prepare"):
            controller.act(observation)


def test_wrong_number_of_observations():
    controller = make_controller("pid_paper")
    controller.reset(3, 0.01)
    with pytest.raises(ValueError, match=r"reset for 3 rigs, got observations \(2, 9\)"):
        controller.act(np.zeros((2, 9), np.float32))


def test_controller_takes_over_without_a_bump():
    """In a steady state the first command of a PID is the command that is in force."""
    observation = np.zeros((1, 9), np.float32)
    observation[0, :3] = 0.5  # set-point and both speeds: 300 rpm
    observation[0, 7:] = 0.25, 0.375
    for name in (
        "pid",
        "ramped_pid",
        "cross_coupled",
        "relative_coupling",
        "virtual_leader",
        "master_slave",
        "disturbance_observer",
    ):
        controller = LAWS[name](**{gain.name: np.sqrt(gain.low * gain.high) for gain in LAWS[name].GAINS})
        controller.reset(1, 0.01)
        np.testing.assert_allclose(controller.act(observation), [[0.25, 0.375]], atol=1e-6, err_msg=name)


def _observation(setpoint, speed, command=(0.0, 0.0)):
    """One rig; set-point and speeds in rpm."""
    row = np.zeros((1, 9), np.float32)
    row[0, :3] = np.array([setpoint, *speed]) / 600.0
    row[0, 7:] = command
    return row


SHIPPED_LINEAR = ["cross_coupled", "relative_coupling", "disturbance_observer"]


@pytest.mark.parametrize("name", SHIPPED_LINEAR)
@pytest.mark.parametrize("speed", [(300.0, 300.0), (-450.0, -450.0), (310.0, 290.0)])
def test_reset_on_turning_motors_makes_no_jump(name, speed):
    """Taken over at the mean speed: motors apart by 20 rpm are worth a correction, not a jump; and a second
    episode begins as the first did, whatever happened before.
    """
    controller = make_controller(name)
    sign = np.sign(speed[0])
    seen = _observation(np.mean(speed), speed, 0.3 * sign * np.ones(2))
    first = []
    for _ in range(2):
        controller.reset(1, 0.01)
        first.append(controller.act(seen))
        for _ in range(50):
            controller.act(_observation(-600.0, (600.0, -600.0), (1.0, -1.0)))
    np.testing.assert_array_equal(first[0], first[1])
    apart = abs(speed[0] - speed[1])
    np.testing.assert_allclose(first[0], np.full((1, 2), 0.3 * sign), atol=1e-6 + 0.005 * apart)


@pytest.mark.parametrize("name", SHIPPED_LINEAR)
def test_saturation_does_not_wind_up(name):
    """Ten seconds in the limit cost no more time to leave it than one second does."""
    left = []
    for seconds in (1, 10):
        controller = make_controller(name)
        controller.reset(1, 0.01)
        command = np.zeros((1, 2))
        for _ in range(100 * seconds):  # blocked motors
            command = controller.act(_observation(600.0, (0.0, 0.0), command[0]))
            assert np.all(np.abs(command) <= 1.0)
        assert np.all(command == 1.0)
        steps = 0
        while np.any(command > 0.0) and steps < 500:
            command = controller.act(_observation(0.0, (300.0, 300.0), command[0]))
            steps += 1
        left.append(steps)
    assert left[0] == left[1] <= 40, left


@pytest.mark.parametrize("name", SHIPPED_LINEAR)
def test_whatever_is_measured_the_command_is_finite(name):
    """Signals at the ends of the observation's range, thrown about at random for two seconds."""
    rng = np.random.default_rng(0)
    controller = make_controller(name)
    controller.reset(20, 0.01)
    for _ in range(200):
        command = controller.act(rng.uniform(-10.0, 10.0, (20, 9)).astype(np.float32))
        assert command.shape == (20, 2) and np.all(np.abs(command) <= 1.0)


def test_relative_coupling_is_cross_coupling_with_a_shared_integral_time():
    """What its text says of two motors, in the linear range; with a weight of its own it is not."""
    common = {"Kp": 0.02, "Ti": 0.2, "filter": 0.05}
    relative = LAWS["relative_coupling"](coupling=2.0, **common)
    cross = LAWS["cross_coupled"](Kc=0.04, Tic=0.2, **common)
    rng = np.random.default_rng(1)
    relative.reset(1, 0.01), cross.reset(1, 0.01)
    for _ in range(50):
        seen = _observation(60.0, rng.uniform(30.0, 90.0, 2))
        np.testing.assert_allclose(relative.act(seen), cross.act(seen), atol=1e-9)


def test_disturbance_observer_finds_a_constant_disturbance():
    """The rated motor with a constant offset at the valve's input: found, and no error is left."""
    controller = LAWS["disturbance_observer"](rate=20.0, Kp=5.0, Ks=5.0, observer=20.0)
    controller.reset(1, 0.01)
    offset = np.array([[-0.12, -0.05]])
    motor = Motor()
    per_flow = (1.0 - np.exp(-motor.rate * 0.01)) / motor.per_speed
    speed, command = np.zeros((1, 2)), np.zeros((1, 2))
    spool = Spool(command, 0.01, damping=0.15)
    for _ in range(400):
        command = controller.act(_observation(300.0, speed[0] / RPM, command[0]))
        before = spool.position
        spool.step(command)
        opening = 0.5 * (before + spool.position) + offset
        speed = np.exp(-motor.rate * 0.01) * speed + per_flow * opening
    np.testing.assert_allclose(controller.disturbance, offset, atol=1e-3)
    np.testing.assert_allclose(speed, 300.0 * RPM, rtol=2e-3)


def test_tuning_improves_on_its_first_guess_and_can_be_read_back(tmp_path):
    task = Task("pid", plant="paper", scenarios=("setpoint_steps",))
    few = Search(task, cases=1, episodes=72, progress=False)
    first = tune.run(tmp_path / "a", few)
    more = tune.run(tmp_path / "b", replace(few, episodes=144))
    assert more.tuning["cost"] <= first.tuning["cost"]
    assert tune.run(tmp_path / "c", few) == first
    assert (tmp_path / "a/gains.json").read_bytes() == (tmp_path / "c/gains.json").read_bytes()
    controller = make_controller(str(tmp_path / "b/gains.json"))
    gains = {key: float(value) for key, value in controller.gains.items() if np.isfinite(value)}
    assert gains == more.gains  # no limit of the rate is left out


def test_a_search_begins_at_shipped_gains_and_where_the_linearised_plant_carries_them():
    """Once on the paper's plant, where both are the same; the stiff plant of `rig` takes a tenth of the gain."""
    shipped, carried = tune.starts("pid", "paper_dead_zone", 0.01)
    assert shipped["Kp"] == make_controller("pid_tuned").gains["Kp"] and carried == pytest.approx(shipped)
    shipped, carried = tune.starts("pid", "rig", 0.01)
    assert carried["Kp"] < 0.2 * shipped["Kp"] and carried["Ti"] < 0.2 * shipped["Ti"]
    assert carried["shape"] == shipped["shape"]


def test_a_search_says_how_far_it_came(tmp_path):
    few = Search(Task("pid", scenarios=("setpoint_steps",)), cases=1, episodes=72, progress=False)
    found = tune.run(tmp_path, few)
    tuning, text = found.tuning, tune.summary(found)
    assert (
        tuning["cost"] <= tuning["start"] < tuning["at_rest"]
    )  # shipped gains are among the last candidates
    assert tuning["judged_on"] == 4 and tuning["episodes"] == 72
    assert "with motors at rest" in text and "hardly better" not in text
    worse = {**tuning, "cost": tuning["at_rest"], "at_end_of_range": {"Kp": 0}}
    text = tune.summary(found.model_copy(update={"tuning": worse}))
    assert "hardly better" in text and "Kp ended at the lower end" in text


def test_tuning_what_ships_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    """What has been found is kept; a controller that is interrupted leaves nothing."""
    wanted, searched = ["pid_tuned", "servo_pid"], []

    def quick(wanted, known=()):
        searched.append((wanted.task.plant, wanted.period, bool(known)))
        if len(searched) == 5:
            raise KeyboardInterrupt
        return {"gains": {"Kp": 0.1, "Ti": 0.1, "Td": 0.0}, "tuning": {"control_period_s": wanted.period}}

    monkeypatch.setattr(shipped_gains, "search", quick)
    with pytest.raises(KeyboardInterrupt):
        shipped_gains.run(tmp_path / "new/gains", wanted)
    assert [path.name for path in (tmp_path / "new/gains").iterdir()] == ["pid_tuned.json"]
    found = shipped_gains.run(tmp_path / "new/gains", wanted)
    periods = [
        (0.01, False),
        (0.005, True),
        (0.02, True),
    ]  # the first from nothing, the others from its gains
    plants = [("paper_dead_zone", *each) for each in periods], [("servo", *each) for each in periods]
    assert searched == [*plants[0], *plants[1][:2], *plants[1]]
    assert found["pid_tuned"] == read_gains(tmp_path / "new/gains/pid_tuned.json")
    assert [*found["pid_tuned"].by_period()] == [0.01, 0.005, 0.02]
    drives = {name: make_controller(str(tmp_path / f"new/gains/{name}.json")).plant for name in wanted}
    assert drives == {"pid_tuned": None, "servo_pid": "servo"}


def test_nothing_is_tuned_on_a_test_split(tmp_path):
    with pytest.raises(InputError, match="never on other splits"):
        tune.run(tmp_path, Search(Task(mismatch="test_interp")))
    with pytest.raises(InputError, match="at least 1728"):
        tune.run(tmp_path, Search(Task(), episodes=100))
    with pytest.raises(InputError, match="unknown control law 'pdi'"):
        tune.run(tmp_path, Search(Task("pdi")))
    with pytest.raises(InputError, match="did you mean 'setpoint_steps'"):
        tune.run(tmp_path, Search(Task(scenarios=("setpoint_step",))))
    with pytest.raises(InputError, match="unknown plant 'papr'"):
        tune.run(tmp_path, Search(Task(plant="papr")))
    assert not list(tmp_path.iterdir())


def test_unknown_names_are_answered_with_the_nearest():
    with pytest.raises(InputError, match="did you mean 'pid_tuned'"):
        make_controller("pid_tunde")
    with pytest.raises(InputError, match="no such file"):
        make_controller("nothing_here.json")
    with pytest.raises(InputError, match="cannot be imported"):
        make_controller("no_such_module_at_all:Thing")
    with pytest.raises(InputError, match="did you mean 'PidController'"):
        make_controller("hydro_env.controllers.classical.pid:PidControler")
    with pytest.raises(InputError, match="no method 'reset'"):
        make_controller(object())
    with pytest.raises(InputError, match="'Ti' is missing"):
        make_controller(LAWS["pid"], Kp=1.0, Td=0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not JSON"),
        ("{}", "schema"),
        (
            '{"schema": "hydro_env/gains/1", "controller": "pid", "gains": {"Kp": "big", "Ti": 1, "Td": 0}}',
            "Kp",
        ),
        ('{"schema": "hydro_env/gains/1", "controller": "pdi", "gains": {}}', "did you mean 'pid'"),
        ('{"schema": "hydro_env/gains/1", "controller": "pid", "gains": {"Kp": 1, "Ti": 1}}', "Td"),
        (
            '{"schema": "hydro_env/gains/1", "controller": "pid", "gains": {"Kp": NaN, "Ti": 1, "Td": 0}}',
            "NaN",
        ),
        *(
            (
                f'{{"schema": "hydro_env/gains/1", "controller": "pid", "gains": {{"{key}": 1}}}}',
                f"gain '{key}'",
            )
            for key in ("self", "name", "model")
        ),
    ],
)
def test_bad_gains_files_are_named(tmp_path, text, message):
    path = tmp_path / "gains.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        make_controller(str(path))
    assert str(path) in str(caught.value)


def test_shipped_gains_say_how_they_were_found():
    for entry in CONTROLLERS.values():
        if entry.file is None or entry.file.suffix != ".json":
            continue
        found = read_gains(entry.file)
        on_servo_valves = entry.build().plant == "servo"
        assert found.tuning["split"] == (None if on_servo_valves else "train"), entry.name
        commands = "hydro-env tune", "python -m docs.evidence.shipped_gains"
        assert found.tuning["command"].startswith(commands), entry.name
        assert found.tuning["episodes"] > 0 and "seed" in found.tuning, entry.name
        json.dumps(found.tuning)


CLASSICAL = [
    "pid_paper", "pid_tuned", "master_slave", "cross_coupled", "relative_coupling", "virtual_leader", "disturbance_observer",
]  # fmt: skip


@pytest.mark.parametrize("name", CLASSICAL)
def test_no_command_changes_faster_than_the_rate_limit(name):
    """730 V/s are a tenth of the rated command in 10 ms; also the first command, from the one in force."""
    rng = np.random.default_rng(3)
    controller = make_controller(name, slew=730.0)
    controller.reset(20, 0.01)
    last = rng.uniform(-1.0, 1.0, (20, 2))
    for _ in range(60):
        seen = rng.uniform(-1.0, 1.0, (20, 9)).astype(np.float32)
        seen[:, 7:] = last
        command = controller.act(seen)
        assert np.max(np.abs(command - last)) <= 0.1 + 1e-6
        last = command


@pytest.mark.parametrize("name", [each for each in CLASSICAL if each != "disturbance_observer"])
def test_the_integrator_does_not_wind_up_on_the_rate_limit(name):
    """While the command climbs at its limit, the integral stands still where it would ask for more."""
    fast = make_controller(name, slew=30000.0, shape=0.0)
    slow = make_controller(name, slew=146.0, shape=0.0)  # a second and a half from end to end
    integral = {}
    for label, controller in (("fast", fast), ("slow", slow)):
        controller.reset(1, 0.01)
        command = np.zeros((1, 2))
        for _ in range(4):
            command = controller.act(_observation(600.0, (0.0, 0.0), command[0]))
        law = next(v for k, v in vars(controller).items() if k in ("_pid", "_track"))
        integral[label] = float(np.max(np.abs(law.integral)))
    assert integral["slow"] == 0.0 or integral["slow"] <= integral["fast"]
    assert np.max(np.abs(command)) <= 4 * 0.02 + 1e-9
    # and it is left as fast as it was climbed, as soon as the error turns
    assert slow.act(_observation(-600.0, (600.0, 600.0), command[0]))[0, 0] < command[0, 0]


def test_the_rate_limit_is_none_if_left_out():
    controller = make_controller("pid_paper")
    controller.reset(1, 0.01)
    assert np.isinf(controller.gains["slew"]) and controller.gains["shape"] == 0.0
    np.testing.assert_array_equal(controller.act(_observation(1e4, (-1e4, -1e4))), [[1.0, 1.0]])


def test_a_shaped_command_leaves_the_spool_at_rest():
    """After a step of the command the spool rings; of the shaped step it is at rest after two control periods."""
    swing = {}
    for shape in (0.0, 1.0):
        controller = LAWS["pid"](Kp=0.05, Ti=1e6, Td=0.0, shape=shape)
        controller.reset(1, 0.01)
        spool, command, seen = Spool(np.zeros((1, 2)), 0.01, damping=0.0), np.zeros((1, 2)), []
        controller.act(_observation(0.0, (0.0, 0.0)))
        for _ in range(20):
            command = controller.act(_observation(300.0, (0.0, 0.0), command[0]))
            spool.step(command)
            seen.append(spool.position[0, 0])
        swing[shape] = np.ptp(seen[4:])
    assert swing[1.0] < 0.02 * swing[0.0]


def test_gains_follow_the_control_period(tmp_path):
    """The set whose period is nearest in ratio; single gains can be changed at all periods."""
    one = {"Kp": 0.1, "Ti": 0.1, "Td": 0.0}
    path = tmp_path / "gains.json"
    sets = {"0.005": {"gains": one | {"Kp": 0.05}}, "0.02": {"gains": one | {"Kp": 0.2, "slew": 5000.0}}}
    data = {
        "schema": "hydro_env/gains/1",
        "controller": "pid",
        "gains": one,
        "tuning": {"control_period_s": 0.01},
    }
    path.write_text(json.dumps(data | {"periods": sets}))
    controller = make_controller(str(path))
    for period, kp in (
        (0.001, 0.05),
        (0.005, 0.05),
        (0.007, 0.05),
        (0.0072, 0.1),
        (0.01, 0.1),
        (0.02, 0.2),
        (0.01, 0.1),
    ):
        controller.reset(1, period)
        assert controller.gains["Kp"] == kp, period
    changed = make_controller(str(path), Ti=0.5)
    changed.reset(1, 0.02)
    assert (changed.gains["Kp"], changed.gains["Ti"], changed.gains["slew"]) == (0.2, 0.5, 5000.0)
    for bad, message in (
        ({"soon": sets["0.02"]}, "soon"),
        ({"0.02": {}}, "gains"),
        ({"0.02": {"gains": {"Kp": "x"}}}, "Kp"),
    ):
        path.write_text(json.dumps(data | {"periods": bad}))
        with pytest.raises(InputError, match=message):
            make_controller(str(path))


def test_linear_tuning_comes_near_table_iii(tmp_path):
    """What a PID tuner does on the linearised plant: Kp within 5 %, Ti within 20 % of what the paper's tuner found."""
    found = linear.run(tmp_path)
    for channel in (0, 1):
        assert found.gains["Kp"][channel] == pytest.approx(TABLE_III["Kp"][channel], rel=0.05)
        assert found.gains["Ti"][channel] == pytest.approx(TABLE_III["Ti"][channel], rel=0.20)
    assert "valve 2: Kp 0.02405 V/rpm (0.023) +5 %" in linear.summary(found)
    assert make_controller(str(tmp_path / "gains.json")).gains["Kp"].shape == (2,)
    with pytest.raises(InputError, match=r"--max-sensitivity is .*, expected a number from"):
        linear.run(tmp_path, max_sensitivity=0.5)


def test_the_linearised_plant_is_the_plant():
    """A step around an open valve: the kernel answers as the five linear states do where there is little friction."""
    model = load_model("paper").with_values({"Fc": 0.01, "Fs": 0.01})
    plant = Plant(model)
    for _ in range(200):
        plant.step(np.full((1, 2), 20.0), np.zeros((1, 2)), 0.01)
    rest = plant.speed
    a, b, c = linear.linear_plant(model, 0)
    held = expm(np.block([[a, b[:, None]], [np.zeros((1, 6))]]) * 0.01)
    state = np.zeros(6)
    state[5] = 30.0
    for _ in range(60):
        plant.step(np.full((1, 2), 50.0), np.zeros((1, 2)), 0.01)
        state = held @ state
        assert (plant.speed - rest)[0, 0] / RPM == pytest.approx(c @ state[:5], abs=0.01 * 30 * 28.8)
    assert c @ np.linalg.solve(-a, b) == pytest.approx(28.82, abs=0.01)  # rpm per volt


def test_largest_sensitivity_by_hand():
    """A loop that is unstable has none; with a vanishing gain it is one."""
    plant = linear.linear_plant(load_model("paper"), 0)
    assert largest_sensitivity(plant, 1e-6, 0.2) == pytest.approx(1.0, abs=1e-3)
    assert largest_sensitivity(plant, 0.2, 0.2) == np.inf


def test_gains_can_be_given_with_the_name():
    controller = make_controller("adaptive_flow:rise=2.5,rate=20")
    assert (controller.gains["rise"], controller.gains["rate"]) == (2.5, 20.0)
    assert controller.name == "adaptive_flow:rise=2.5,rate=20"
    for wrong, message in (
        ("adaptive_flow:rsie=2", "did you mean 'rise'"),
        ("adaptive_flow:rise=much", "GAIN=NUMBER"),
        ("adaptive_flow:", "GAIN=NUMBER"),
        ("ppo:Kp=1", "no gains"),
    ):
        with pytest.raises(InputError, match=message):
            make_controller(wrong)
