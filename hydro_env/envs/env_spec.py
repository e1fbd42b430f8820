"""What `env.spec` says of an environment that was made: the length of its episodes, whether the reward threshold holds, and
arguments that JSON can hold.

Gymnasium's own limit of time (`max_episode_steps` of the registered specification) is one number for every scenario and control
period, and would cut longer episodes off. So none is registered: the environment ends its episodes itself, and the specification
of the environment that was made has the length of its own.
"""

from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec, registry

from ..plant import Plant, PlantModel
from ..tasks.mismatch import NAMED_PAIRS, SPLITS, default_mismatch
from ..tasks.scenarios import SCENARIOS

#: Arguments under which a return means the same as with those registered, for which the threshold was measured.
SAME_TASK = {
    "render_mode", "render_width", "history", "increment", "errors", "observation", "privileged", "dtype", "threads", "num_envs",
    "vectorization_mode", "autoreset_mode",
}  # fmt: skip


class OwnSpec:
    """The attribute `spec` of an environment: what Gymnasium made it from, with the length of its episodes."""

    def __get__(self, env: Any, owner: Any = None) -> Any:
        return None if env is None else vars(env).get("_spec")

    def __set__(self, env: Any, spec: EnvSpec | None) -> None:
        vars(env)["_spec"] = None if spec is None else env_spec(spec, env)


def env_spec(spec: EnvSpec, env: Any) -> EnvSpec:
    """The specification that Gymnasium gives to a new environment, with the length of its episodes in steps; without a
    reward threshold where the arguments make it another task. What is made from it, or from its JSON, is the same environment. An
    argument that no name or file could stand for is left as it is: a function, a scenario with one, a mismatch in code. The
    environment is made again from the specification then, but not from JSON, which Gymnasium refuses with a TypeError."""
    batch = getattr(env, "batch", env)
    # Gymnasium hands the length back to a batch as an argument: it stands beside the arguments.
    kwargs = {name: _plain(value) for name, value in spec.kwargs.items() if name != "max_episode_steps"}
    registered = {name: each.default for name, each in signature(type(env)).parameters.items()}
    registered |= registry[spec.id].kwargs if spec.id in registry else {}
    changed = {key for key, own in kwargs.items() if registered.get(key) != own} - SAME_TASK
    if kwargs.get("mismatch") == "train":  # what `auto` is for the default plant
        changed.discard("mismatch")
    shorter = batch.episode_steps < batch.scenario.steps(batch.control_period)
    threshold = None if changed or shorter else spec.reward_threshold
    if isinstance(spec.kwargs.get("plant"), PlantModel | Plant) and kwargs.get("mismatch", "auto") == "auto":
        kwargs["mismatch"] = default_mismatch(spec.kwargs["plant"])  # that of its content may be another one
    return replace(spec, max_episode_steps=batch.episode_steps, reward_threshold=threshold, kwargs=kwargs)


def _plain(value: Any) -> Any:
    """An argument in terms of JSON, as far as it has any."""
    if isinstance(value, Plant) and type(value.model) is PlantModel:
        value = replace(value.model, tolerance=value.tolerance)
    if type(value) is PlantModel:  # others, such as an FMU, are more than values
        return value.to_dict("the model that the environment was made of")
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    named = {**SCENARIOS, **SPLITS, **NAMED_PAIRS}
    return next((name for name, known in named.items() if known is value), value)
