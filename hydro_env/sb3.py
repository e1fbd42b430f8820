"""The native batch as a `VecEnv` of Stable-Baselines3 (needs the extra `agents`).

    from hydro_env.sb3 import HydraulicSyncVecEnv
    model = PPO("MlpPolicy", VecMonitor(HydraulicSyncVecEnv(64, scenario="random_steps")))

It is many times faster than a `DummyVecEnv` of single environments and the same bit for bit.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from .envs.batch import HydraulicSyncVectorEnv, one_of, row_of
from .errors import suggestion, to_install

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as problem:
    raise ImportError(f"hydro_env.sb3 needs Stable-Baselines3: {to_install('agents')}") from problem

__all__ = ["HydraulicSyncVecEnv"]

Indices = None | int | Iterable[int]
Stepped = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]


class HydraulicSyncVecEnv(VecEnv):
    """`num_envs` rigs for Stable-Baselines3; keyword arguments as for `HydraulicSyncEnv`.

    A row that ends is reset in the same step; its last observation is in `infos[i]["terminal_observation"]`, and
    `infos[i]["TimeLimit.truncated"]` tells whether the scenario was simply over.

    `info`: "end" fills the dictionaries of the rows that ended only (the usual need of training, and fast), "all" fills
    them all with the true values; "privileged" is in all of them. `batch` is the environment underneath: `get_attr` and
    `env_method` look there.
    """

    def __init__(self, num_envs: int, *, info: str = "end", **kwargs: Any) -> None:
        one_of("info", info, ("end", "all"))
        self.batch = HydraulicSyncVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs)
        self.info = info
        self._actions: NDArray[Any] | None = None
        observation, action = self.batch.single_observation_space, self.batch.single_action_space
        assert isinstance(observation, spaces.Box) and isinstance(action, spaces.Box)
        super().__init__(num_envs, observation, action)

    def reset(self) -> NDArray[np.float32]:
        """Begins an episode in every row, with the seeds of `seed` and options of `set_options` if there are any. As
        Stable-Baselines3 has it, the options hold for this episode, and not for those after it."""
        seeds = self._seeds if any(each is not None for each in self._seeds) else None
        groups: dict[int, list[int]] = {}  # rows with the same options
        for row, options in enumerate(self._options):
            groups.setdefault(id(options) if options else 0, []).append(row)
        for rows in groups.values():
            options = {**self._options[rows[0]], "reset_mask": np.isin(np.arange(self.num_envs), rows)}
            observation, info = self.batch.reset(seed=seeds, options=options)  # of all rows
            for row in rows:
                self.reset_infos[row] = row_of(info, row)
        self.batch.use_options()
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes the actions (N, 2) of the step."""
        self._actions = actions

    def step_wait(self) -> Stepped:
        """The step: observations (N, n), rewards, ends (N,), infos."""
        assert self._actions is not None, "step_async comes first"
        observation, reward, terminated, truncated, info = self.batch.step(self._actions)
        ended = terminated | truncated
        if self.info == "all":
            infos = [row_of(info, row) for row in range(self.num_envs)]
        elif self.batch.privileged is not None:
            infos = [{"privileged": row} for row in info["privileged"]]
        else:
            infos = [{} for _ in range(self.num_envs)]
        if ended.any():
            for row in np.flatnonzero(ended).tolist():
                infos[row] = {
                    **row_of(info["final_info"], row),
                    "terminal_observation": info["final_obs"][row],
                    "TimeLimit.truncated": bool(truncated[row] and not terminated[row]),
                }
                self.reset_infos[row] = row_of(info, row)
        return observation, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        """Nothing has to be closed; may be called again."""
        self.batch.close()

    def _rows(self, indices: Indices) -> list[int]:
        return list(self._get_indices(indices))

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The batch's attribute of that name, once for each of the rows."""
        return [getattr(self.batch, attr_name)] * len(self._rows(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets an attribute of the batch. AttributeError for one that it lacks, ValueError if not all rows are meant: they have
        them in common."""
        if len(set(self._rows(indices))) != self.num_envs:
            raise ValueError("rows have attributes in common: set them for all, or pass options to reset")
        if not hasattr(self.batch, attr_name):
            known = [name for name in vars(self.batch) if not name.startswith("_")]
            raise AttributeError(f"the batch has no attribute {attr_name!r}: {suggestion(attr_name, known)}")
        setattr(self.batch, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls the batch's method once and returns its answer for each of the rows (`render`: the row's picture).

        ValueError for what steps or resets the rows; the VecEnv does that.
        """
        answers = self.batch.call(method_name, *method_args, **method_kwargs)
        return [answers[row] for row in self._rows(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """False for each row: nothing is wrapped."""
        return [False] * len(self._rows(indices))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each row, if `render_mode` is "rgb_array"."""
        frames = self.batch.render()
        return [None] * self.num_envs if frames is None else list(frames)
