"""The rigs as a policy's network meets them: a Stable-Baselines3 environment behind a policy interface."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from hydro_env.controllers.learned.policy_interface import FramesInterface
from hydro_env.sb3 import HydraulicSyncVecEnv

__all__ = ["SEED_SPACING", "PolicyVecEnv"]

#: Between the first rigs of the runs of two successive seeds: more than the rigs of any run.
SEED_SPACING = 2**40


class PolicyVecEnv(VecEnvWrapper):
    """Shows the network's inputs as observations and takes its outputs as actions.

    Episode returns are kept here, since Stable-Baselines3 reports them only for environments that do.
    """

    def __init__(self, venv: HydraulicSyncVecEnv, interface: FramesInterface) -> None:
        self.interface = interface
        super().__init__(
            venv,
            observation_space=spaces.Box(-np.inf, np.inf, (interface.num_features,), np.float32),
            action_space=spaces.Box(-1.0, 1.0, (interface.num_actions,), np.float32),
        )
        self._return = np.zeros(self.num_envs)
        self._length = np.zeros(self.num_envs, dtype=int)

    def reset(self) -> VecEnvObs:
        observation = self.venv.reset()
        self._return[:], self._length[:] = 0.0, 0
        return self.interface.start(np.asarray(observation))

    def step_async(self, actions: NDArray[Any]) -> None:
        self.venv.step_async(self.interface.command(actions).astype(np.float32))

    def step_wait(self) -> VecEnvStepReturn:
        observation, reward, done, infos = self.venv.step_wait()
        observation = np.asarray(observation)
        self._return += reward
        self._length += 1
        ended = np.flatnonzero(done)
        last = observation
        if ended.size:
            last = observation.copy()
            for row in ended:
                last[row] = infos[row]["terminal_observation"]
        seen = self.interface.see(last)
        outcomes: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.size:
            for row in ended:
                outcomes[row] = {
                    "terminal_observation": seen[row].copy(),
                    "TimeLimit.truncated": infos[row].get("TimeLimit.truncated", False),
                    "episode": {"r": float(self._return[row]), "l": int(self._length[row]), "t": 0.0},
                }
            seen = seen.copy()
            seen[ended] = self.interface.restart(ended, observation[ended])
            self._return[ended], self._length[ended] = 0.0, 0
        return seen, reward, done, outcomes

    def __getstate__(self) -> dict[str, Any]:
        """All but the table of class members that the base class keeps, which cannot be pickled."""
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds the rigs so that runs of different seeds share no episode, however many rigs they have."""
        return list(self.venv.seed(None if seed is None else seed * SEED_SPACING))
