"""The environment of two agents: PettingZoo's own tests, and equality with the single environment."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from hydro_env.envs import OBSERVATION, HydraulicSyncEnv
from hydro_env.errors import InputError, InputWarning
from hydro_env.multi_agent import AGENTS, HydraulicSyncParallelEnv

SHORT = {"duration": 0.3, "setpoint_rpm": [[0.0, 300.0]]}


@pytest.mark.parametrize("kwargs", [{}, {"others": False, "history": 3, "scenario": SHORT}])
def test_the_tests_of_pettingzoo_pass(kwargs: dict) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings(
            "ignore", "reset: unknown option 'options'", InputWarning
        )  # the test passes one
        parallel_api_test(HydraulicSyncParallelEnv(**kwargs), num_cycles=700)
    parallel_seed_test(lambda: HydraulicSyncParallelEnv(**kwargs), num_cycles=300)


@pytest.mark.parametrize("history", [1, 3])
def test_joined_it_is_the_single_environment(history: int) -> None:
    more = {"scenario": "setpoint_steps", "mismatch": "test_interp", "history": history, "plant": "paper"}
    two, one = HydraulicSyncParallelEnv(**more), HydraulicSyncEnv(**more)
    stream = np.random.default_rng(1)
    own = [
        [0, *(OBSERVATION.index(f"{name}_{j}") for name in ("speed", "current", "pressure", "command"))]
        for j in (1, 2)
    ]
    for seed in (4, None):
        (seen, infos), (observation, info) = two.reset(seed=seed), one.reset(seed=seed)
        over = False
        while not over:
            frames = observation.reshape(history, 9)
            for j, agent in enumerate(AGENTS):
                assert two.observation_space(agent).contains(seen[agent])
                parts = np.split(seen[agent].reshape(history, 9), [5], axis=1)
                np.testing.assert_array_equal(parts[0], frames[:, own[j]])
                np.testing.assert_array_equal(parts[1], frames[:, own[1 - j][1:]])
                assert infos[agent].keys() == info.keys()
                np.testing.assert_array_equal(infos[agent]["speed_rpm"], info["speed_rpm"])
            np.testing.assert_array_equal(two.state(), observation)
            action = stream.uniform(-1.2, 1.2, 2).astype(np.float32)
            seen, rewards, terminations, truncations, infos = two.step(
                {agent: action[j : j + 1] for j, agent in enumerate(AGENTS)}
            )
            observation, reward, terminated, truncated, info = one.step(action)
            assert rewards == dict.fromkeys(AGENTS, reward)
            assert terminations == dict.fromkeys(AGENTS, terminated)
            assert truncations == dict.fromkeys(AGENTS, truncated)
            over = terminated or truncated
        assert two.agents == []
        assert two.step({}) == ({}, {}, {}, {}, {})


def test_without_the_other_valve() -> None:
    env = HydraulicSyncParallelEnv(others=False, scenario=SHORT)
    seen, _ = env.reset(seed=0)
    for agent, columns in zip(AGENTS, ([0, 1, 3, 5, 7], [0, 2, 4, 6, 8]), strict=True):
        np.testing.assert_array_equal(seen[agent], env.state()[columns])


@pytest.mark.parametrize("others", [False, True])
def test_with_errors_in_front(others: bool) -> None:
    more = {"errors": True, "history": 2, "scenario": "setpoint_steps", "plant": "paper"}
    env, plain = (
        HydraulicSyncParallelEnv(others=others, **more),
        HydraulicSyncParallelEnv(others=others, **{**more, "errors": False}),
    )
    env.reset(seed=3), plain.reset(seed=3)
    for action in np.random.default_rng(0).uniform(-1, 1, (60, 2)).astype(np.float32):
        joined = dict(zip(AGENTS, action[:, None], strict=True))
        seen, without = env.step(joined)[0], plain.step(joined)[0]
    errors = env.state()[:6].reshape(2, 3)
    assert np.abs(errors[:, 2]).min() > 0.0
    for j, agent in enumerate(AGENTS):
        front = errors[:, [j, 1 - j, 2]] if others else errors[:, [j]]
        np.testing.assert_array_equal(seen[agent], np.concatenate([front.ravel(), without[agent]]))
        assert env.observation_space(agent).contains(seen[agent])


def test_options_and_wrong_input() -> None:
    env = HydraulicSyncParallelEnv(scenario=SHORT)
    _, infos = env.reset(seed=0, options={"mismatch": "val", "case": 5})
    assert [infos[agent]["case"] for agent in AGENTS] == [5, 5]
    with pytest.warns(InputWarning, match="did you mean 'mismatch'"):
        env.reset(options={"mismach": "val"})
    with pytest.raises(ValueError, match="expected one for each"):
        env.step({"valve_1": [0.0]})
    with pytest.raises(ValueError, match="not finite"):
        env.step({"valve_1": [np.nan], "valve_2": [0.0]})
    with pytest.raises(InputError):
        HydraulicSyncParallelEnv(plant="no such")
    env.close(), env.close()


def test_a_picture() -> None:
    env = HydraulicSyncParallelEnv(scenario=SHORT, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (480, 640, 3) and env.metadata["render_fps"] == 100
