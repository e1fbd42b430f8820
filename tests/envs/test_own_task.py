"""A task of one's own: functions for reward and observation, privileged signals, ranges of noise and delay, coming options."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

import hydro_env  # noqa: F401 (registers the environments)
from hydro_env.envs import HydraulicSyncVectorEnv, privileged_names
from hydro_env.errors import InputError
from hydro_env.tasks import SPLITS
from hydro_env.tasks.rigs import DERIVED

ID = "hydro_env:HydraulicSync-v0"
IDS = ("HydraulicSync-v0", "HydraulicSyncIncrement-v0", "HydraulicSyncTraining-v0")
SHORT = {"duration": 0.1, "setpoint_rpm": [[0.0, 300.0]], "load_Nm": [[0.0, 0.4, 0.8]]}


def frames_only(frames, true):
    return frames


def minus_travel(true):
    return -true["cost_travel"]


# --- privileged signals -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("mismatch", list(SPLITS))
def test_what_is_drawn_is_told_between_minus_one_and_one(mismatch):
    env = HydraulicSyncVectorEnv(200, mismatch=mismatch, privileged=True, noise={"speed_rpm": [0.5, 2.0]})
    _, info = env.reset(seed=0)
    names, told = privileged_names(env), info["privileged"]
    assert told.shape == (200, len(names)) and told.dtype == np.float32 and len({*names}) == len(names)
    split = SPLITS[mismatch]
    with_range = {*split.ranges, *(name for fault in split.faults.values() for name in fault)}
    with_range -= set(DERIVED) if split.rig else set()
    drawn = [n for n, name in enumerate(names) if name.rpartition("_")[0] in with_range]
    assert len(drawn) == 2 * len(with_range)
    healthy = told[:, drawn][told[:, drawn] != 2.0]  # 2 is a sensor that never sticks
    assert healthy.min() >= -1.0 and healthy.max() <= 1.0
    low, high = SPLITS[mismatch].ranges["Kq"].ends
    share = 2.0 * np.log(info["mismatch"]["Kq"] / low) / np.log(high / low) - 1.0
    gains = told[:, [names.index("Kq_1"), names.index("Kq_2")]]
    np.testing.assert_allclose(gains, share, atol=1e-6)
    assert (gains.max(axis=0) > 0.8).all() and (gains.min(axis=0) < -0.8).all()
    assert names[0] == "noise_speed" and "noise_current" not in names and np.ptp(told[:, 0]) > 1.8


def test_true_states_are_told():
    env = gymnasium.make(ID, plant="paper", mismatch=None, scenario=SHORT, privileged=True)
    _, info = env.reset(seed=0)
    names = privileged_names(env)
    assert names == tuple(
        f"{n}_{c}" for n in ("speed", "current", "pressure", "spool", "load") for c in (1, 2)
    )
    for _ in range(5):
        _, _, _, _, info = env.step(np.array([0.5, -0.3]))
    told = dict(zip(names, info["privileged"].tolist(), strict=True))
    np.testing.assert_allclose(
        [600.0 * told["speed_1"], 600.0 * told["speed_2"]], info["speed_rpm"], rtol=1e-6
    )
    np.testing.assert_allclose(told["spool_2"] * 1e-3, env.unwrapped.plant.get("spool")[0, 1], rtol=1e-6)
    assert (told["load_1"], told["load_2"]) == (0.5, 1.0)
    with pytest.raises(ValueError, match="privileged=True"):
        privileged_names(gymnasium.make(ID))


# --- functions --------------------------------------------------------------------------------------------------------
def test_functions_see_what_info_tells_and_cannot_change_it():
    seen = {}

    def reward(true):
        seen.update(true)
        with pytest.raises(ValueError, match="read-only"):
            true["speed_rpm"][0] = 0.0
        return true["reward"]

    make = {"num_envs": 3, "scenario": SHORT, "errors": True}
    own = HydraulicSyncVectorEnv(**make, reward=reward, observation=frames_only)
    plain = HydraulicSyncVectorEnv(**make)
    np.testing.assert_array_equal(own.reset(seed=0)[0], plain.reset(seed=0)[0])
    for _ in range(25):  # and on into the next episodes
        actions = np.full((3, 2), 0.3)
        one, two = own.step(actions), plain.step(actions)
        for a, b in zip(one[:4], two[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        if not one[3].any() and (one[1] != 0.0).any():
            assert {*seen} == {key for key in one[4] if not key.startswith("_")} - {
                "mismatch",
                "fault",
                "case",
            } | {"reward"}
            np.testing.assert_array_equal(seen["speed_rpm"], one[4]["speed_rpm"])


def test_other_rows_show_what_they_showed_at_a_masked_reset():
    def observation(frames, true):
        return np.column_stack([true["speed_rpm"], frames])

    env = HydraulicSyncVectorEnv(3, observation=observation)
    assert env.single_observation_space.shape == (11,)
    env.reset(seed=0)
    for _ in range(5):
        last = env.step(np.full((3, 2), 0.8))[0]
    mask = np.array([False, True, False])
    after, _ = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], last[~mask])
    assert (after[mask] != last[mask]).any() and last.any(axis=0)[0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"reward": lambda true: 1.0}, r"reward: the function returned 1.0, expected finite numbers of the shape \(2,\)"),
        ({"reward": lambda true: true["speed_rpm"]}, r"shape \(2, 2\), expected .* \(2,\)"),
        ({"reward": lambda true: np.array([0.0, np.nan])}, "returned nan in row 1"),
        ({"reward": lambda true: None}, r"reward: the function returned None"),
        ({"observation": lambda frames, true: frames[:, 0]}, r"observation: .* shape \(2,\), expected .* \(2, n\)"),
        ({"observation": lambda frames, true: "x"}, "observation: the function returned 'x'"),
        ({"observation": lambda frames, true: 1.0 / frames[:, 7:8]}, "observation: .*inf.* in row 0"),
        ({"observation": 3}, "observation is 3, expected None or a function"),
        ({"privileged": 1}, "privileged"),
    ],
)  # fmt: skip
def test_what_a_function_must_not_return_is_named_in_a_line(arguments, told):
    with pytest.raises(InputError, match=told) as caught, np.errstate(all="ignore"):
        env = HydraulicSyncVectorEnv(2, **arguments)
        env.reset(seed=0)
        env.step(np.zeros((2, 2)))
    assert "\n" not in str(caught.value)


# --- specifications ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize(
    "more",
    [{}, {"scenario": "random_steps", "mismatch": "train", "privileged": True}, {"noise": (0.5, 2.0), "mismatch": "val"}],
    ids=["default", "same", "other"],
)  # fmt: skip
def test_every_id_can_be_made_again(name, more):
    """Without a warning, single or many, from the specification or its JSON; the threshold stays where the task is the same."""
    threshold = None if "noise" in more else gymnasium.spec(name).reward_threshold
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(f"hydro_env:{name}", **more)
        for spec in (env.spec, EnvSpec.from_json(env.spec.to_json())):
            assert gymnasium.make(spec).spec == env.spec
        mode = AutoresetMode.SAME_STEP
        envs = gymnasium.make_vec(f"hydro_env:{name}", num_envs=3, autoreset_mode=mode, **more)
        for spec in (envs.spec, EnvSpec.from_json(envs.spec.to_json())):
            again = gymnasium.make_vec(spec)
            assert again.spec == envs.spec and (again.num_envs, again.autoreset_mode) == (3, mode)
    assert env.spec.reward_threshold == envs.spec.reward_threshold == threshold
    shorter = gymnasium.make_vec(f"hydro_env:{name}", num_envs=2, max_episode_steps=50)
    assert shorter.spec.reward_threshold is None and gymnasium.make_vec(shorter.spec).episode_steps == 50


def test_a_specification_with_functions_has_no_json():
    env = gymnasium.make(ID, reward=minus_travel, observation=frames_only)
    assert env.spec.reward_threshold is None
    again = gymnasium.make(env.spec)
    env.reset(seed=0), again.reset(seed=0)
    for one, two in zip(env.step(np.ones(2))[:4], again.step(np.ones(2))[:4], strict=True):
        np.testing.assert_array_equal(one, two)
    with pytest.raises(TypeError, match="function is not JSON serializable"):
        env.spec.to_json()


# --- ranges and options -----------------------------------------------------------------------------------------------
def test_noise_of_a_range_is_that_of_its_level():
    """Drawn for each episode and kind of sensor; nothing else that is drawn changes."""
    task = {"num_envs": 40, "plant": "paper", "mismatch": "train", "scenario": "random_steps"}
    ranged, whole, none = (HydraulicSyncVectorEnv(**task, noise=noise) for noise in ([0.5, 2.0], 1.0, 0.0))
    levels = []
    for seed in (0, None):
        seen = [env.reset(seed=seed) for env in (ranged, whole, none)]
        for _ in range(3):
            shares = (seen[0][0] - seen[2][0])[:, 1:7] / (seen[1][0] - seen[2][0])[:, 1:7]
            levels.append(np.median(shares.reshape(-1, 3, 2), axis=2))
            np.testing.assert_allclose(
                levels[-1], levels[len(levels) // 4 * 3], rtol=0.05
            )  # the same all along
            seen = [env.step(np.full((40, 2), 0.5)) for env in (ranged, whole, none)]
    assert all((each > 0.49).all() and (each < 2.02).all() and np.ptp(each) > 1.3 for each in levels)
    assert (np.abs(levels[0] - levels[-1]) > 0.01).mean() > 0.9  # another level in the next episode
    assert (np.abs(np.diff(levels[0], axis=1)) > 0.01).mean() > 0.9  # and for each kind of sensor


@pytest.mark.parametrize(
    "noise", [[2.0, 0.5], [1.0], np.array(1.0), {"current_A": [0.0, "much"]}, [[0.5], 2.0], [-1.0, 2.0]]
)
def test_a_wrong_range_of_noise_is_named(noise):
    with pytest.raises(InputError, match=r"noise(: current_A)? is "):
        HydraulicSyncVectorEnv(noise=noise)
    env = HydraulicSyncVectorEnv()
    with pytest.raises(InputError, match="noise"):
        env.reset(options={"noise": noise})


def test_a_delay_is_drawn_on_top_of_a_split():
    own = {"base": "train", "command_delay.delay": {"uniform": [0.0, 0.02]}}
    ours, plain = HydraulicSyncVectorEnv(50, mismatch=own), HydraulicSyncVectorEnv(50, mismatch="train")
    drawn, base = (env.reset(seed=0)[1]["mismatch"] for env in (ours, plain))
    delay = drawn["command_delay.delay"]
    assert 0.0 <= delay.min() < 0.003 and 0.017 < delay.max() <= 0.02
    for name in SPLITS["train"].parameters:
        np.testing.assert_array_equal(drawn[name], base[name])
    for _ in range(4):
        info = ours.step(np.ones((50, 2)))[-1]
    late = delay.max(axis=1) - delay.min(axis=1) > 0.01  # the valve that hears later starts later
    first = np.argmin(delay[late], axis=1)
    speed = np.abs(info["speed_rpm"][late])
    assert (speed[np.arange(late.sum()), first] > speed[np.arange(late.sum()), 1 - first]).mean() > 0.8


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_curriculum_reaches_the_coming_episodes(mode):
    env = HydraulicSyncVectorEnv(3, scenario=SHORT, autoreset_mode=mode, noise=0.0)
    _, info = env.reset(seed=0)
    env.step(np.zeros((3, 2)))
    env.use_options({"mismatch": {"base": "train", "Kq": 0.4}, "scenario": {"duration": 0.05}, "noise": 1.0})
    assert (env.pairs["Kq"] == info["mismatch"]["Kq"]).all() and env.reference().setpoint.size == 11
    for _ in range(11):
        env.step(np.zeros((3, 2)))
    assert (env.pairs["Kq"] == 0.4).all() and env.reference().setpoint.size == 6
    assert env._rollout.deviation.all()
    env.use_options()
    for _ in range(6):
        env.step(np.zeros((3, 2)))
    assert (env.pairs["Kq"] != 0.4).all() and env.reference().setpoint.size == 11
    for options, told in (
        ({"mismatch": {"command_delay.delay": 0.01}}, "lacks command_delay"),
        ({"case": 1, "x": 2}, "'x'"),
    ):
        with pytest.raises(InputError, match=told):
            env.use_options(options)


def test_a_row_of_privileged_numbers_keeps_its_places_under_other_options():
    env = HydraulicSyncVectorEnv(2, privileged=True)
    _, info = env.reset(seed=0, options={"mismatch": {"Kq": 0.7}})
    told = dict(zip(privileged_names(env), info["privileged"][0].tolist(), strict=True))
    assert told["Kq_1"] == 2.0  # beyond its range, and clipped
