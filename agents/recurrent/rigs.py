"""The rigs that a recurrent policy is trained on: driven in windows, at whose ends a part of them begins new episodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.recurrent.profile import TRAINING
from agents.recurrent.settings import Settings
from agents.true_map import true_map
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.plant import Plant

KNOWN = 6
"""Numbers of a pair of valves: gain and both edges of each."""


class Rigs:
    """`observation` (num_rigs, 9) is the newest, `before` the one a period earlier (the same where an episode begins), `healthy`
    (num_rigs,) says which rigs have no fault. Groups of
    rigs end their episodes in different windows, so that a window holds every phase of an episode and no episode ends within
    one."""

    def __init__(
        self, settings: Settings, num_rigs: int, window: int, seed: int, env: dict[str, Any] | None = None
    ) -> None:
        self.env = HydraulicSyncVectorEnv(
            num_rigs,
            **(env or settings.env),
            tolerance_rpm=settings.training.tolerance_rpm or None,
            scenario=TRAINING,
            dtype="float32",
            autoreset_mode="Disabled",
        )
        steps = self.env.scenario.steps(self.env.control_period)
        if steps % window:
            raise InputError(f"window {window}: an episode of {steps} periods should be a multiple of it")
        self._groups, self._windows = steps // window, 0
        self.observation, info = self.env.reset(seed=seed)
        self.before, self.healthy = self.observation.copy(), info["fault"] == ""

    @property
    def num_rigs(self) -> int:
        return self.env.num_envs

    @property
    def plant(self) -> Plant:
        assert isinstance(self.env.plant, Plant)
        return self.env.plant

    def inputs(self) -> torch.Tensor:
        """What the network sees, (num_rigs, 18)."""
        return torch.from_numpy(np.concatenate([self.before, self.observation], axis=1))

    def valves(self) -> NDArray[np.float64]:
        """Gain and edges of every valve, (num_rigs, KNOWN), scaled to about one: what a network should find out and keep."""
        true = true_map(self.plant)
        n = self.num_rigs
        return np.concatenate(
            [9.0 * (true.gain[..., 0] - 0.82), 14.0 * (true.edge.reshape(n, 4) - 0.11)], axis=1
        )

    def step(self, commands: NDArray[Any]) -> None:
        """One control period with commands (num_rigs, 2)."""
        self.before = self.observation
        self.observation = self.env.step_rows(commands)[0]

    def next_window(self) -> NDArray[np.int64]:
        """Begins new episodes in the group whose turn it is; returns its rigs. Observations are replaced, not written to."""
        self._windows += 1
        ended = np.arange(self.num_rigs) % self._groups == self._windows % self._groups
        if not ended.any():  # fewer rigs than groups
            return np.flatnonzero(ended)
        self.observation, info = self.env.reset(options={"reset_mask": ended})
        self.healthy = info["fault"] == ""
        self.before = np.where(ended[:, None], self.observation, self.before)
        return np.flatnonzero(ended)
