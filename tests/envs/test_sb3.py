"""The VecEnv of Stable-Baselines3: its protocol, parity with the single environment, its algorithms run."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from gymnasium.spaces import Box, Dict
from gymnasium.wrappers import TransformObservation
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from hydro_env.envs import HydraulicSyncEnv, privileged_names
from hydro_env.errors import InputError
from hydro_env.sb3 import HydraulicSyncVecEnv

SHORT = {"duration": 0.1, "setpoint_rpm": [[0.0, 300.0]]}
MORE = {"plant": "paper", "scenario": SHORT}


def test_same_as_a_batch_of_single_environments():
    ours = HydraulicSyncVecEnv(5, info="all", **MORE)
    theirs = DummyVecEnv([lambda: HydraulicSyncEnv(**MORE)] * 5)
    ours.seed(3), theirs.seed(3)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    stream = np.random.default_rng(0)
    for n in range(25):
        action = stream.uniform(-1, 1, (5, 2)).astype(np.float32)
        one, two = ours.step(action), theirs.step(action)
        for a, b in zip(one[:3], two[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for a, b in zip(one[3], two[3], strict=True):
            assert a.get("TimeLimit.truncated", False) == b["TimeLimit.truncated"] == (n in (9, 19))
            np.testing.assert_array_equal(a["speed_rpm"], b["speed_rpm"])
            assert a["reward_tracking"] == b["reward_tracking"]
            assert ("terminal_observation" in a) == ("terminal_observation" in b)
            if "terminal_observation" in a:
                np.testing.assert_array_equal(a["terminal_observation"], b["terminal_observation"])


def test_infos_of_the_end_only():
    env = HydraulicSyncVecEnv(2, **MORE)
    env.reset()
    for n in range(10):
        _, _, ended, infos = env.step(np.zeros((2, 2)))
        assert ended.all() == (n == 9)
        assert [bool(info) for info in infos] == ended.tolist()
    assert infos[1]["TimeLimit.truncated"] and infos[1]["terminal_observation"].shape == (9,)
    assert "Kq" in env.reset_infos[1]["mismatch"]


def test_every_step_tells_a_critic_what_it_asks_for():
    ours = HydraulicSyncVecEnv(2, privileged=True, noise=[0.5, 2.0], **MORE)
    single = HydraulicSyncEnv(privileged=True, noise=[0.5, 2.0], **MORE)
    ours.seed(3), ours.reset()
    _, told = single.reset(seed=4)
    np.testing.assert_array_equal(ours.reset_infos[1]["privileged"], told["privileged"])
    for _ in range(10):
        infos = ours.step(np.full((2, 2), 0.4))[3]
        *_, told = single.step(np.full(2, 0.4))
        np.testing.assert_array_equal(infos[1]["privileged"], told["privileged"])
    assert privileged_names(ours) == privileged_names(single)


def test_its_policy_for_several_inputs_takes_them_apart():
    def both(frames, true):
        return np.hstack([frames, true["privileged"]])

    env = HydraulicSyncEnv(observation=both, privileged=True, **MORE)
    parts = Dict(actor=Box(-10, 10, (9,)), critic=Box(-10, 10, (env.observation_space.shape[0] - 9,)))
    env = TransformObservation(env, lambda seen: {"actor": seen[:9], "critic": seen[9:]}, parts)
    PPO("MultiInputPolicy", env, n_steps=16, batch_size=16, n_epochs=1, device="cpu").learn(32)


def test_divergence_is_no_time_limit():
    env = HydraulicSyncVecEnv(2, **MORE)
    env.reset()
    env.batch.plant.memory[1, env.batch.plant.row_of("diverged"), 0] = 1.0
    _, _, ended, infos = env.step(np.zeros((2, 2)))
    assert ended.tolist() == [False, True]
    assert infos[1]["TimeLimit.truncated"] is False
    assert infos[1]["termination"].startswith("diverged")


def test_seeds_and_options():
    env = HydraulicSyncVecEnv(3, **{**MORE, "mismatch": "val"})
    assert env.seed(4) == [4, 5, 6]
    first = env.reset()
    assert [info["case"] for info in env.reset_infos] == [4, 5, 6]
    assert (env.reset() != first).any()
    env.seed(4)
    np.testing.assert_array_equal(env.reset(), first)
    env.set_options({"mismatch": "paper_pair"})
    env.reset()
    assert env.reset_infos[2]["mismatch"]["Kq"][0] == 476106e-6
    env.set_options({"scenario": "sine"})  # for one episode, as Stable-Baselines3 says
    env.reset()
    for _ in range(601):
        env.step(np.zeros((3, 2)))
    assert env.batch.reference(0).setpoint.size == 11
    env.set_options([{"case": [9, 9, 9]}, {}, {"case": [9, 9, 9]}])
    env.reset()
    assert [info["case"] for info in env.reset_infos][::2] == [9, 9]
    with pytest.raises(InputError):
        HydraulicSyncVecEnv(2, plant="no such")


def test_seed_leaves_the_global_random_state_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    env = HydraulicSyncVecEnv(2, **MORE)
    env.seed()
    env.reset()
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_attributes_and_methods():
    env = HydraulicSyncVecEnv(3, render_mode="rgb_array", **MORE)
    env.reset()
    assert env.get_attr("control_period", [0, 2]) == [0.01, 0.01]
    assert env.has_attr("scenario") and not env.has_attr("nothing")
    assert env.env_is_wrapped(VecMonitor) == [False] * 3
    assert env.env_method("render", indices=1)[0].shape == (480, 640, 3)
    assert env.render().ndim == 3
    env.set_attr("max_episode_steps", 4)
    assert env.get_attr("max_episode_steps") == [4] * 3
    with pytest.raises(AttributeError, match="did you mean 'max_episode_steps'"):
        env.set_attr("max_episode_step", 4)
    with pytest.raises(ValueError, match="in common"):
        env.set_attr("max_episode_steps", 4, indices=0)
    with pytest.raises(ValueError, match="all rows"):
        env.env_method("reset")
    env.close(), env.close()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_algorithms_run():
    env = VecMonitor(HydraulicSyncVecEnv(4, **MORE))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(128)
    assert model.ep_info_buffer and model.ep_info_buffer[0]["l"] == 10
    env = VecNormalize(HydraulicSyncVecEnv(2, **MORE), norm_obs=False)
    SAC("MlpPolicy", env, learning_starts=8, buffer_size=200, batch_size=8, seed=0, device="cpu").learn(30)
