"""The rig as an environment of two agents, one for each valve, in PettingZoo's parallel interface (needs the extra `multi`).

    from hydro_env.multi_agent import HydraulicSyncParallelEnv
    env = HydraulicSyncParallelEnv(scenario="setpoint_steps")
    observations, infos = env.reset(seed=0)
    observations, rewards, terminations, truncations, infos = env.step({"valve_1": [0.1], "valve_2": [0.2]})

It is the single environment of the same seed, bit for bit, with the action and the observation divided among the agents.
"""

import warnings
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from .envs import OBSERVATION, HydraulicSyncEnv
from .envs.batch import OPTIONS
from .envs.observation import ERRORS, LIMIT
from .errors import InputError, InputWarning, shown, suggestion, to_install

try:
    from pettingzoo import ParallelEnv
except ImportError as problem:
    raise ImportError(f"hydro_env.multi_agent needs PettingZoo: {to_install('multi')}") from problem

__all__ = ["AGENTS", "HydraulicSyncParallelEnv"]

AGENTS = ("valve_1", "valve_2")

Observations = dict[str, NDArray[np.float32]]
Infos = dict[str, dict[str, Any]]


def _seen(channel: int, others: bool) -> list[int]:
    """Where in a frame the signals of an agent are: set-point, its own ones, and if `others` those of the other valve."""
    channels = [str(channel + 1), *([str(2 - channel)] if others else [])]
    own = [name for each in channels for name in OBSERVATION if name.endswith(f"_{each}")]
    return [OBSERVATION.index(name) for name in ("setpoint", *own)]


class HydraulicSyncParallelEnv(ParallelEnv[str, NDArray[np.float32], NDArray[np.float32]]):
    """
    Agents `valve_1` and `valve_2` drive one rig together.

    * Action of each: `Box(-1, 1, (1,), float32)`, the command of its valve as in `HydraulicSyncEnv`.
    * Observation of each: set-point in force from now on, then of its own channel speed, current, pressure difference and last
      action, then with `others` (default) the same of the other channel; scaled as in `HydraulicSyncEnv`. With `history`
      above 1 the last frames of these, oldest first. With `errors` its own error to the set-point stands in front, then with
      `others` that of the other channel and the speed difference, 1 less 2. Without `others` an agent cannot see the speed
      difference that it is to keep small.
    * Reward: both get that of the single environment. The task is a common one, and its main term, the speed difference, belongs
      to neither valve alone. The terms are in `info`.
    * `state()` is the observation of the single environment, for a central critic.
    * Info of each: that of the single environment.

    Both agents end together. `reset` takes the options of the single environment; others are ignored with a warning, as
    PettingZoo asks for.

    Arguments: `others`, and those of `HydraulicSyncEnv` by keyword, without `observation`. Raises what that raises; ValueError if
    the actions are not one for each agent.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (PettingZoo's way)
        "name": "hydraulic_sync_v0",
        "render_modes": ["rgb_array"],
        "is_parallelizable": True,
    }

    def __init__(self, *, others: bool = True, **kwargs: Any) -> None:
        if kwargs.get("observation") is not None:
            raise InputError("observation: agents share the frames; leave it out")
        self.rig = HydraulicSyncEnv(**kwargs)
        self.render_mode = self.rig.render_mode
        self.metadata = {**type(self).metadata, "render_fps": self.rig.metadata["render_fps"]}
        self.possible_agents = list(AGENTS)
        self.agents: list[str] = []
        count = self.rig.batch.history
        errors = ERRORS * count if self.rig.batch.errors else 0  # they stand in front of all frames
        self._columns = []
        for channel in (0, 1):
            frames = errors + np.arange(count)[:, None] * len(OBSERVATION) + _seen(channel, bool(others))
            shown_errors = [channel, 1 - channel, 2] if others else [channel]
            front = np.arange(0, errors, ERRORS)[:, None] + shown_errors
            self._columns.append(np.concatenate([front.ravel(), frames.ravel()]))
        shape = self._columns[0].shape
        self.observation_spaces = {agent: spaces.Box(-LIMIT, LIMIT, shape, np.float32) for agent in AGENTS}
        self.action_spaces = {agent: spaces.Box(-1.0, 1.0, (1,), np.float32) for agent in AGENTS}
        self.state_space = self.rig.observation_space

    def observation_space(self, agent: str) -> spaces.Space[NDArray[np.float32]]:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[NDArray[np.float32]]:
        """The space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begins an episode, as `HydraulicSyncEnv.reset`."""
        for key in options or {}:
            if key not in OPTIONS:
                said = f"reset: unknown option {shown(key)} is ignored: {suggestion(key, OPTIONS)}"
                warnings.warn(InputWarning(said), stacklevel=2)
        known = {key: value for key, value in (options or {}).items() if key in OPTIONS}
        self._state, info = self.rig.reset(seed=seed, options=known)
        self.agents = list(AGENTS)
        return self._observations(), self._each(info)

    def step(
        self, actions: dict[str, ArrayLike]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """One control period. Once the episode is over, nothing happens and nobody gets anything until the next `reset`."""
        if not self.agents:
            return {}, {}, {}, {}, {}
        if set(actions) != set(AGENTS):
            raise ValueError(f"actions are for {sorted(actions)}, expected one for each of {list(AGENTS)}")
        action = np.concatenate([np.asarray(actions[agent], np.float32).reshape(1) for agent in AGENTS])
        self._state, reward, terminated, truncated, info = self.rig.step(action)
        if terminated or truncated:
            self.agents = []
        return (
            self._observations(),
            dict.fromkeys(AGENTS, reward),
            dict.fromkeys(AGENTS, terminated),
            dict.fromkeys(AGENTS, truncated),
            self._each(info),
        )

    def state(self) -> NDArray[np.float32]:
        """The observation of the single environment, (9 * history,)."""
        return self._state

    def render(self) -> NDArray[np.uint8] | None:
        """As `HydraulicSyncEnv.render`."""
        return self.rig.render()

    def close(self) -> None:
        """Nothing has to be closed; may be called again."""
        self.rig.close()

    def _observations(self) -> Observations:
        return {agent: self._state[columns] for agent, columns in zip(AGENTS, self._columns, strict=True)}

    def _each(self, info: dict[str, Any]) -> Infos:
        return {agent: dict(info) for agent in AGENTS}
