"""The single environment: Gymnasium's and Stable-Baselines3's checks, seeds, copies, options, signals, faults."""

import copy
import itertools
import pickle
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from hypothesis import given, settings
from hypothesis import strategies as st

import hydro_env  # noqa: F401 (registers the environment)
from hydro_env.envs import OBSERVATION, HydraulicSyncEnv, decode
from hydro_env.envs.observation import LIMIT, SCALES, with_errors
from hydro_env.envs.render import Recorder
from hydro_env.envs.step_kernels import TRUE
from hydro_env.errors import InputError
from hydro_env.plant import Plant, load_model
from hydro_env.tasks import SCENARIOS, draw_pairs
from hydro_env.tasks.mismatch import CASE_STRIDE, NAMED_PAIRS

RPM = 2 * np.pi / 60


def make(**more):
    return gymnasium.make("hydro_env:HydraulicSync-v0", **{"plant": "paper", **more}).unwrapped


def run(env, steps, stream, level=0.6):
    out = []
    for _ in range(steps):
        out.append(env.step(stream.uniform(-level, level, 2).astype(np.float32)))
    return out


def same(one, two):
    assert type(one) is type(two)
    if isinstance(one, dict):
        assert one.keys() == two.keys()
        for key in one:
            same(one[key], two[key])
    elif isinstance(one, (tuple, list)):
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            same(a, b)
    else:
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    "more", [{}, {"history": 3}, {"mismatch": "faulted"}, {"mismatch": None, "noise": 0.0}]
)
def test_checkers_have_nothing_to_say(more):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(**more))


def test_checker_of_stable_baselines3():
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(make())


def test_default_arguments():
    env = gymnasium.make("hydro_env:HydraulicSync-v0")
    assert env.unwrapped.plant.model.name == "paper_dead_zone"
    _, info = env.reset(seed=0)
    assert info["mismatch"]["dead_zone.overlap_positive"].shape == (2,)


def test_same_seed_same_episode_and_the_next_ones():
    one, two, other = make(), make(), make()
    for seed in (5, None, None):
        same(one.reset(seed=seed), two.reset(seed=seed))
        same(run(one, 40, np.random.default_rng(1)), run(two, 40, np.random.default_rng(1)))
    one.reset(seed=5)
    first, _ = one.reset()
    again, _ = other.reset(seed=6)
    assert (first != again).any()


def test_unseeded_environments_differ():
    assert (make().reset()[0] != make().reset()[0]).any()


def test_global_random_state_is_left_alone():
    before = pickle.dumps(np.random.get_state())  # noqa: NPY002
    env = make(mismatch="faulted")
    env.reset()
    run(env, 5, np.random.default_rng(0))
    assert pickle.dumps(np.random.get_state()) == before  # noqa: NPY002


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_alike(duplicate):
    env = make(mismatch="faulted", history=2, scenario={"duration": 0.4, "setpoint_rpm": [[0.1, 300]]})
    env.reset(seed=3)
    run(env, 25, np.random.default_rng(0))
    twin = duplicate(env)
    same(run(env, 15, np.random.default_rng(1)), run(twin, 15, np.random.default_rng(1)))
    same(env.reset(), twin.reset())
    same(run(env, 10, np.random.default_rng(2)), run(twin, 10, np.random.default_rng(2)))


def test_results_share_no_memory():
    env = make(history=2)
    seen = [env.reset(seed=0)[0]]
    kept = [seen[0].copy()]
    for observation, *_ in run(env, 6, np.random.default_rng(0)):
        seen.append(observation)
        kept.append(observation.copy())
    seen.append(env.reset()[0])
    kept.append(seen[-1].copy())
    for i, one in enumerate(seen):
        np.testing.assert_array_equal(one, kept[i])
        for two in seen[:i]:
            assert not np.shares_memory(one, two)


def test_observation_is_what_sensors_show():
    env = make(noise=0.0, mismatch=None, scenario="setpoint_steps")
    observation, info = env.reset(seed=0)
    np.testing.assert_array_equal(observation, np.zeros(9))
    for _ in range(30):
        observation, _, _, _, info = env.step(np.array([0.5, -0.4], np.float32))
    assert observation.dtype == np.float32
    measured = decode(observation[None])
    assert measured.setpoint[0] == pytest.approx(600 * RPM)
    np.testing.assert_allclose(measured.speed, env.plant.measured_speed, rtol=1e-6)
    np.testing.assert_allclose(measured.current, env.plant.current, rtol=1e-6)
    np.testing.assert_allclose(measured.pressure, env.plant.pressure, rtol=1e-6)
    np.testing.assert_allclose(measured.command[0], [0.5, -0.4], rtol=1e-6)
    np.testing.assert_allclose(info["speed_rpm"], env.plant.speed[0] / RPM)
    assert info["setpoint_rpm"] == pytest.approx(600)
    assert info["speed_difference_rpm"] == info["speed_rpm"][0] - info["speed_rpm"][1]
    np.testing.assert_allclose(info["command_V"], [36.5, -29.2], rtol=1e-6)
    assert info["angle_difference_deg"] == pytest.approx(np.degrees(np.subtract(*env.plant.angle[0])))
    assert info["speed_rpm"][0] > 50 > -50 > info["speed_rpm"][1]


def test_no_signal_is_constant_and_none_at_the_limit():
    env = make()
    seen = []
    for seed in range(3):
        seen.append(env.reset(seed=seed)[0])
        seen += [step[0] for step in run(env, 600, np.random.default_rng(seed), level=1.0)]
    seen = np.array(seen)
    assert np.isfinite(seen).all()
    assert (seen.std(axis=0) > 0.05).all(), dict(zip(OBSERVATION, seen.std(axis=0), strict=True))
    assert np.abs(seen).max() < LIMIT


def test_noise_has_the_published_size():
    traces = []
    for level in (0.0, 1.0, {"speed_rpm": 5.0}):
        env = make(noise=level, mismatch=None, scenario="sine")
        first = env.reset(seed=2)[0]
        rows = [first] + [step[0] for step in run(env, 600, np.random.default_rng(0), level=0.3)]
        traces.append(np.array(rows) * SCALES)
    noise = (traces[1] - traces[0]).std(axis=0)
    np.testing.assert_allclose(noise[1:7], [RPM, RPM, 2e-3, 2e-3, 5e3, 5e3], rtol=0.1)
    assert (noise[[0, 7, 8]] == 0).all()
    assert (traces[2] - traces[0]).std(axis=0)[1] == pytest.approx(5 * RPM, rel=0.1)
    # speeds, currents and pressures of both motors: no two sensors share their noise
    assert np.abs(np.corrcoef((traces[1] - traces[0])[:, 1:7].T) - np.eye(6)).max() < 0.2


def test_history_is_oldest_first():
    plain, deep = make(), make(history=3)
    frames = [plain.reset(seed=1)[0]]
    np.testing.assert_array_equal(deep.reset(seed=1)[0], np.tile(frames[0], 3))
    stream = np.random.default_rng(0)
    for n in range(5):
        action = stream.uniform(-1, 1, 2)
        frames.append(plain.step(action)[0])
        wanted = [frames[max(0, n + 1 - back)] for back in (2, 1, 0)]
        np.testing.assert_array_equal(deep.step(action)[0], np.concatenate(wanted))


def test_reward_by_hand():
    env = make(
        noise=0.0, mismatch=None, scenario={"duration": 1.0, "setpoint_rpm": [[0.0, 300], [0.05, 100]]}
    )
    env.reset(seed=0)
    before = np.zeros(2)
    for n in range(8):
        action = np.array([0.5, 0.25]) if n else np.array([0.5, 0.75])
        _, reward, _, _, info = env.step(action)
        target = (
            300 if n < 5 else 100
        )  # in force during the period, although the observation shows the next one
        one, two = info["speed_rpm"]
        parts = (
            -0.5 * (abs(one - target) + abs(two - target)) / 2 / 100,
            -1.5 * abs(one - two) / 100,
            -0.1 * np.abs(action - before).mean(),
        )
        assert info["reward_tracking"] == pytest.approx(parts[0])
        assert info["reward_difference"] == pytest.approx(parts[1])
        assert info["reward_variation"] == pytest.approx(parts[2])
        assert reward == pytest.approx(sum(parts))
        assert info["cost_difference"] == pytest.approx(max(abs(one - two) - 20.0, 0.0))
        assert info["cost_travel"] == pytest.approx(np.abs(action - before).mean())
        before = action
    assert info["setpoint_rpm"] == pytest.approx(100)
    np.testing.assert_allclose(env.batch.reference().setpoint[[0, 4, 5]], np.array([300, 300, 100]) * RPM)
    env = make(reward={"tracking": 0.0, "difference": 0.0, "variation": 2.0})
    env.reset(seed=0)
    assert env.step(np.array([1.0, 0.0]))[1] == pytest.approx(-1.0)


def test_increments_change_the_command():
    """Driven with the sums of the same actions, HydraulicSync-v0 shows the same signals, bit for bit."""
    changing, plain = gymnasium.make("hydro_env:HydraulicSyncIncrement-v0"), make(history=2)
    assert changing.observation_space.shape == (24,) and changing.spec.reward_threshold == -150.0
    batch = gymnasium.make_vec("hydro_env:HydraulicSyncIncrement-v0", num_envs=2)
    observation, other = changing.reset(seed=3)[0], plain.reset(seed=3)[0]
    rows = batch.reset(seed=3)[0]
    command = np.zeros(2)
    stream = np.random.default_rng(0)
    for _ in range(40):
        np.testing.assert_array_equal(observation, with_errors(other))
        np.testing.assert_array_equal(observation, rows[0])
        np.testing.assert_array_equal(decode(rows).speed[0], decode(other[None]).speed[0])
        action = stream.uniform(-1.5, 1.5, 2)
        command = np.clip(command + 0.3 * np.clip(action, -1.0, 1.0), -1.0, 1.0)
        observation, reward, *_, info = changing.step(action)
        other, expected, *_ = plain.step(command)
        rows = batch.step(np.stack([action, action]))[0]
        assert reward == expected
        np.testing.assert_allclose(info["command_V"], 73.0 * command)
    with pytest.raises(ValueError, match="not finite"):
        changing.step(np.array([np.nan, 0.0]))


def test_a_batch_answers_calls_for_each_row_as_gymnasiums_own_batches_do():
    batch = gymnasium.make_vec("hydro_env:HydraulicSync-v0", num_envs=2, render_mode="rgb_array")
    batch.reset(seed=0)
    assert batch.call("control_period") == (0.01, 0.01)
    one, two = batch.call("render")
    np.testing.assert_array_equal(one, batch.render()[0])
    assert two.shape == one.shape
    assert gymnasium.make_vec("hydro_env:HydraulicSync-v0", num_envs=2).call("render") == (None, None)
    with pytest.raises(ValueError, match="step concerns all rows"):
        batch.call("step", np.zeros((2, 2)))


def test_episode_ends_by_truncation_with_its_scenario():
    env = make(scenario={"duration": 0.25, "setpoint_rpm": [[0, 100]]})
    for _ in range(2):
        env.reset(seed=0)
        ends = [
            (terminated, truncated)
            for _, _, terminated, truncated, _ in run(env, 25, np.random.default_rng(0))
        ]
        assert ends == [(False, False)] * 24 + [(False, True)]


def test_divergence_terminates_with_its_reason():
    env = make(control_period=0.01)
    env.reset(seed=0)
    env.plant.memory[:, env.plant.row_of("diverged"), :] = 1.0
    _, reward, terminated, _, info = env.step(np.zeros(2))
    assert terminated
    assert info["termination"].startswith("diverged")
    assert -20 < reward < -9
    env.reset(seed=0)
    assert not env.plant.diverged.any()


def test_reset_options_hold_for_one_episode():
    env = make(mismatch="train", scenario="random_steps")
    env.reset(seed=0)
    _, info = env.reset(options={"mismatch": "paper_pair", "scenario": "load_step"})
    np.testing.assert_array_equal(info["mismatch"]["Kq"], [476106e-6, 315000e-6])
    np.testing.assert_array_equal(info["mismatch"]["R"], [100, 100])
    steps = run(env, 600, np.random.default_rng(0))
    assert steps[-1][3] and not steps[-2][3]
    assert {round(step[4]["setpoint_rpm"]) for step in steps} == {0, 600}
    _, info = env.reset()
    assert info["mismatch"]["Kq"][0] != 476106e-6
    # effects the plant lacked so far
    _, info = env.reset(
        options={"mismatch": {"sensor_lag.time_constant": [0.05, 0.0], "spool_stiction.static": 0.1}}
    )
    np.testing.assert_array_equal(info["mismatch"]["sensor_lag.time_constant"], [0.05, 0.0])
    np.testing.assert_array_equal(env.plant.get("sensor_lag.time_constant"), [[0.05, 0.0]])
    run(env, 3, np.random.default_rng(0))
    env.reset()
    np.testing.assert_array_equal(env.plant.get("sensor_lag.time_constant"), [[0.0, 0.0]])


def test_cases_of_fixed_splits():
    env = make(mismatch="test_extrap")
    listed = draw_pairs("test_extrap", 1000).values
    _, info = env.reset(seed=17)
    assert info["case"] == 17
    for name, values in listed.items():
        np.testing.assert_array_equal(info["mismatch"][name], values[17])
    _, info = env.reset()
    assert info["case"] == 17 + CASE_STRIDE
    _, info = env.reset(options={"case": 8})
    np.testing.assert_array_equal(info["mismatch"]["Kq"], listed["Kq"][8])
    assert env.reset(seed=2016)[1]["case"] == 16


def test_train_is_what_draw_pairs_says():
    env = make()
    listed = draw_pairs("train", 3, seed=11).values
    for episode in range(3):
        _, info = env.reset(seed=11 if episode == 0 else None)
        for name, values in listed.items():
            np.testing.assert_array_equal(info["mismatch"][name], values[episode])
        np.testing.assert_array_equal(env.plant.get("Kq")[0], listed["Kq"][episode])


def test_stuck_and_noisy_speed_sensors():
    sick = {"speed_sensor.stuck_from": [0.1, np.inf], "speed_sensor.noise_factor": [1.0, 20.0]}
    env = make(mismatch=sick, scenario="sine")
    env.reset(seed=0)
    shown, true = [], []
    for observation, _, _, _, info in run(env, 300, np.random.default_rng(0), level=0.4):
        shown.append(decode(observation[None]).speed[0] / RPM)
        true.append(info["speed_rpm"])
    shown, true = np.array(shown), np.array(true)
    assert (shown[8:, 0] == shown[8, 0]).all()  # the reading at 0.09 s stays
    assert np.ptp(true[8:, 0]) > 50
    assert (shown - true)[:8, 0].std() < 3
    assert (shown - true)[:, 1].std() == pytest.approx(20, rel=0.2)


@pytest.mark.parametrize("width", [320, 1280])
def test_pictures_show_shafts_speeds_and_commands(width):
    pytest.importorskip("PIL")
    env = make(render_mode="rgb_array", scenario="setpoint_steps", render_width=width)
    env.reset(seed=0)
    first = env.render()
    run(env, 60, np.random.default_rng(0))
    later = env.render()
    assert first.shape == later.shape == (width * 3 // 4, width, 3)
    assert first.dtype == np.uint8
    changed = (first != later).any(axis=2)
    third, half = width // 4, width // 2
    for part in (
        changed[:third, :half],
        changed[:third, half:],
        changed[third : 2 * third],
        changed[2 * third :],
    ):
        assert part.any()  # shaft 1 and its numbers, shaft 2, speeds, commands
    assert make().render() is None


def test_shafts_in_pictures_turn():
    pytest.importorskip("PIL")
    recorder = Recorder(2, 320)
    true, rows = np.zeros((2, TRUE)), np.arange(2)
    recorder.add(rows, true, np.array([[0.0, 1.0], [0.0, 1.0 + 2 * np.pi]]))
    one, two = (recorder.picture(row, 0.01, 73.0) for row in (0, 1))
    assert (one == two).all()  # a whole turn further
    recorder.add(rows, true, np.array([[0.0, 1.0], [0.0, 2.0]]))
    one, two = (recorder.picture(row, 0.01, 73.0) for row in (0, 1))
    differ = (one != two).any(axis=2)
    assert differ[:80, 160:].any() and not differ[:, :160].any()


def test_a_window_shows_the_pictures_in_real_time(monkeypatch):
    """With the driver of SDL that needs no screen: every fourth control period, and no longer once it is closed."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("hydro_env:HydraulicSync-v0", render_mode="human", render_width=320)
    env.reset(seed=0)
    shown = []
    for _ in range(9):
        env.step(np.ones(2, np.float32))
        shown.append(pygame.surfarray.array3d(pygame.display.get_surface()))
    changed = [bool((one != two).any()) for one, two in itertools.pairwise(shown)]
    assert shown[0].shape == (320, 240, 3) and env.render() is None
    assert changed == [False, False, True, False, False, False, True, False]
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(8):
        env.step(np.ones(2, np.float32))
    assert not pygame.display.get_init()
    env.close()


def test_pictures_without_the_extra_say_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r"'\.\[render\]"):
        make(render_mode="rgb_array")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match=r"'\.\[render\]"):
        make(render_mode="human")


def test_videos_are_recorded(tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.make(
        "hydro_env:HydraulicSync-v0", render_mode="rgb_array", scenario={"duration": 0.1}, render_width=320
    )
    env = RecordVideo(env, str(tmp_path / "videos"))
    env.reset(seed=0)
    over = False
    while not over:
        *_, over, _ = env.step(np.array([0.5, 0.5], np.float32))
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "steps", "threshold"),
    [
        ({}, 600, -150.0),
        ({"history": 3}, 600, -150.0),
        ({"id": "HydraulicSyncTraining-v0"}, 600, -22.0),
        ({"id": "HydraulicSyncTraining-v0", "reward": {"tracking": 0.5}}, 600, None),
        ({"scenario": "staircase"}, 800, None),
        ({"control_period": 0.005, "mismatch": "own"}, 1200, None),
    ],
)
def test_the_specification_of_what_was_made_has_its_length(arguments, steps, threshold):
    """No limit of Gymnasium's cuts an episode off, neither of this environment nor of one made again from its specification."""
    arguments = {"id": "HydraulicSync-v0", **arguments}
    arguments["id"] = f"hydro_env:{arguments['id']}"
    made = gymnasium.make(**arguments)
    assert (made.spec.max_episode_steps, made.spec.reward_threshold) == (steps, threshold)
    for env in (made, gymnasium.make(made.spec)):
        env.reset(seed=0)
        ends = [env.step(np.zeros(2, np.float32))[3] for _ in range(steps)]
        assert not any(ends[:-1]) and ends[-1]
        assert env.spec == made.spec
    batch = gymnasium.make_vec(num_envs=2, **arguments)
    assert (batch.spec.max_episode_steps, batch.spec.reward_threshold) == (steps, threshold)


@pytest.mark.parametrize(
    "arguments",
    [
        {"plant": load_model("rig").with_values({"J": 0.02})},
        {
            "plant": Plant("servo", tolerance=0.2),
            "mismatch": NAMED_PAIRS["paper_pair"],
            "scenario": SCENARIOS["sine"],
        },
        {
            "mismatch": {"Kq": np.array([0.4, 0.45])},
            "noise": np.float64(0.5),
            "tolerance_rpm": np.float64(0.3),
        },
    ],
)
def test_it_can_be_made_again_from_json(arguments):
    made = gymnasium.make("hydro_env:HydraulicSync-v0", **arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = gymnasium.make(EnvSpec.from_json(made.spec.to_json()))
    assert again.spec == made.spec
    for env in (made, gymnasium.make(made.spec)):
        same(env.reset(seed=4), again.reset(seed=4))
        for _ in range(3):
            same(env.step(np.full(2, 0.4)), again.step(np.full(2, 0.4)))


def test_the_lowest_line_pressure_is_told_where_it_is_known():
    """A quick stop empties a line of a rig without anti-cavitation valves far below vacuum."""
    assert "lowest_line_pressure_bar" not in make().reset(seed=0)[1]
    bare, lowest = load_model("rig").without("crossport_relief").with_values({"J": 0.02}), {}
    valves = {"anti_cavitation.conductance": 1e-9, "anti_cavitation.supply_pressure": 1e7}
    for name, model in {"bare": bare, "valves": bare.with_values(valves)}.items():
        env = make(plant=model, mismatch=None, noise=0.0)
        _, info = env.reset(seed=0)
        assert info["lowest_line_pressure_bar"] == pytest.approx(50.0)
        seen = []
        for step in range(160):
            info = env.step(np.full(2, 1.0 if step < 100 else 0.0))[-1]
            mean, half = env.plant.get("mean_line_pressure"), 0.5 * np.abs(env.plant.pressure)
            assert info["lowest_line_pressure_bar"] == pytest.approx((mean - half).min() / 1e5)
            seen.append(info["lowest_line_pressure_bar"])
        lowest[name] = min(seen)
    assert lowest["bare"] < -100.0 and lowest["valves"] > -6.0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"plant": "papr"}, "papr"),
        (
            {"plant": {"schema": "hydro_env/model/1", "both": {"u_rated": np.inf}}},
            "u_rated: inf V is out of range",
        ),
        ({"mismatch": {"u_rated": np.inf}}, "u_rated: inf V is out of range"),
        ({"scenario": "steps"}, "scenario"),
        ({"mismatch": "trane"}, "did you mean 'train'"),
        ({"control_period": 0.0}, "control_period"),
        ({"history": 0}, "history"),
        ({"noise": -1.0}, "noise"),
        ({"noise": {"speed": 1.0}}, "speed_rpm"),
        ({"reward": {"tracing": 1.0}}, "tracing"),
        ({"reward": {"tracking": "much"}}, "tracking"),
        ({"render_mode": "ansi"}, "render_mode"),
        ({"render_mode": "rgb_array", "render_width": 10}, "render_width"),
        ({"scenario": {"duration": 1e-4}}, "less than the control period"),
    ],
)
def test_wrong_arguments_are_named(arguments, told):
    with pytest.raises(InputError, match=told) as caught:
        HydraulicSyncEnv(**{"plant": "paper", **arguments}).reset()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"mismatches": {}}, "unknown option 'mismatches'"),
        ({"mismatch": {"Kqq": 1}}, "Kqq"),
        ({"scenario": "steps"}, "scenario"),
        ({"case": 3}, "fixed list"),
        ({"mismatch": "val", "case": 1000}, "999"),
    ],
)
def test_wrong_options_are_named_and_do_no_harm(options, told):
    env = make()
    env.reset(seed=0)
    twin = copy.deepcopy(env)
    with pytest.raises(InputError, match=told):
        env.reset(options=options)
    same(env.reset(), twin.reset())


@pytest.mark.parametrize("increment", [None, 0.3])
@pytest.mark.parametrize(
    "action",
    [
        np.array([np.nan, 0.0]),
        np.array([0.0, np.inf]),
        np.zeros(3),
        np.zeros((1, 2)),
        np.array([0.5j, 0.1]),
        np.array(["2020-01-01", "2021-01-01"], "datetime64[D]"),
        ["0.5", "0.1"],
        [None, 0.0],
        [[0.1], [0.2, 0.3]],
    ],
)
def test_wrong_actions_raise(action, increment):
    env = make(increment=increment)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action"):
        env.step(action)


def test_actions_are_clipped():
    env, twin = make(), make()
    env.reset(seed=0), twin.reset(seed=0)
    same(env.step(np.array([5.0, -3.0])), twin.step(np.array([1.0, -1.0])))


def test_decode_refuses_other_shapes():
    for shape in ((9,), (2, 8), (2, 0)):
        with pytest.raises(ValueError, match="shape"):
            decode(np.zeros(shape))


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary() | st.complex_numbers() | st.just(object()),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9) | st.integers(), inner, max_size=4),
    max_leaves=8,
)  # fmt: skip


@given(
    st.sampled_from(["plant", "scenario", "mismatch", "control_period", "history", "noise", "reward"]),
    ANYTHING,
)
@settings(deadline=None, max_examples=300)
def test_any_argument_works_or_is_refused_by_its_name(name, value):
    try:
        make(**{name: value}).close()
    except InputError as problem:
        assert name in str(problem) or "model" in str(problem)
        assert str(problem).isprintable()


@given(st.sampled_from(["mismatch", "scenario", "case", "reset_mask"]), ANYTHING)
@settings(deadline=None, max_examples=100)
def test_any_option_of_reset_works_or_is_refused(name, value):
    try:
        make().reset(seed=1, options={name: value})
    except InputError as problem:
        assert str(problem).isprintable()


@pytest.mark.parametrize("seed", [-1, 1.5, "x", b"x", [1], 2**128, True, np.zeros(2)])
def test_a_seed_is_a_whole_number(seed):
    with pytest.raises(InputError, match="reset: seed is"):
        make().reset(seed=seed)
