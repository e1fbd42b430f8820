"""Training files: one table of settings per environment id as in RL-Zoo, and a table `training` beside it.

HydraulicSync-v0:              # RL-Zoo's keys: n_envs, n_timesteps, policy, env_kwargs and the algorithm's arguments
  n_envs: 256                  # rigs side by side
  n_timesteps: !!float 2e7     # control periods of single rigs
  learning_rate: lin_1e-3      # falls linearly to zero; a plain number stays
  policy_kwargs: dict(net_arch=[64, 64], activation_fn=nn.Tanh)
training:                      # what RL-Zoo has no key for
  algorithm: ppo
  interface: {kind: frames, frames: 2, increment: 0.3, errors: true}
"""

import ast
import inspect
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import yaml
from pydantic import AfterValidator, Field, create_model
from pydantic_core import PydanticCustomError
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from hydro_env.controllers.learned.policy_interface import InterfaceTable
from hydro_env.errors import InputError
from hydro_env.reading import MAX_BYTES_OF_YAML, parse_yaml, read_text
from hydro_env.tasks.scenarios import SCENARIOS
from hydro_env.validation import Count, FileTable, Number, checked, known

ENV_ID: Final = "HydraulicSync-v0"
POLICY: Final = "MlpPolicy"
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC}
# Arguments of the algorithms that are set elsewhere or have no place in a file.
CLOSED = ("self", "env", "device", "verbose", "seed", "tensorboard_log", "stats_window_size", "_init_setup_model",
          "rollout_buffer_class", "rollout_buffer_kwargs", "replay_buffer_class", "replay_buffer_kwargs",
          "action_noise", "optimize_memory_usage", "n_steps_td")  # fmt: skip
ACTIVATIONS = {"nn.Tanh": nn.Tanh, "nn.ReLU": nn.ReLU, "nn.ELU": nn.ELU}

NotNegative = Annotated[Number, Field(ge=0.0)]
Scenario = Annotated[str, known("scenario", SCENARIOS)]


class Training(FileTable):
    """The table `training`.

    Attributes:
        algorithm: "ppo" or "sac".
        interface: between observations and the network; the plain observation if empty.
        seed: of networks, exploration and environment.
        checkpoint_every: env steps between checkpoints.
        evaluate_every: env steps between evaluations.
        evaluate_scenarios: the scenarios it drives; the first one's scores are reported.
        evaluate_pairs: how many pairs of split `val` an evaluation drives.
        tracking_weight: an evaluation's score is the interquartile mean of the largest speed difference plus this
            times the interquartile mean of the tracking error, both in rpm, averaged over the scenarios; the policy
            with the lowest score is exported.
        tail_weight: of the 95th percentile of the largest difference in that score.
    """

    algorithm: Literal["ppo", "sac"]
    interface: InterfaceTable = InterfaceTable()
    seed: Annotated[int, Field(strict=True, ge=0)] = 0
    checkpoint_every: Count = 1_000_000
    evaluate_every: Count = 500_000
    evaluate_scenarios: Annotated[tuple[Scenario, ...], Field(min_length=1)] = ("setpoint_steps",)
    evaluate_pairs: Count = 64
    tracking_weight: NotNegative = 0.5
    tail_weight: NotNegative = 0.0


# --- arguments of the algorithms --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Falling:
    """A schedule from `start` to zero."""

    start: float

    def __call__(self, remaining: float) -> float:
        return remaining * self.start


def _schedule(value: Any) -> Any:
    """`lin_3e-4` as a schedule that falls linearly to zero."""
    text, start = str(value), math.nan
    with suppress(ValueError):
        start = float(text.removeprefix("lin_"))
    if not 0.0 <= start <= 1e6:
        raise PydanticCustomError("schedule", "Input should be a number from 0 to 1e6, or lin_ and one")
    return Falling(start) if text.startswith("lin_") else start


def _finite(value: Any) -> Any:
    """The value, if no number in it is infinite or none."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is no finite number")
    items = value.values() if isinstance(value, dict) else value
    for item in items if isinstance(value, dict | list | tuple) else ():
        _finite(item)
    return value


def _policy_kwargs(value: Any) -> dict[str, Any]:
    """A table, or RL-Zoo's `dict(net_arch=[64, 64], activation_fn=nn.Tanh)`, of which only plain values are read."""
    if not isinstance(value, dict):
        with suppress(SyntaxError, ValueError, RecursionError, MemoryError):
            value = _plain(ast.parse(str(value).strip(), mode="eval").body)
    if not isinstance(value, dict):
        raise ValueError("expected dict(net_arch=[64, 64], activation_fn=nn.Tanh) or the like")
    name = value.get("activation_fn")
    return value | {"activation_fn": _activation(name)} if isinstance(name, str) else value


def _plain(node: ast.expr) -> Any:
    if isinstance(node, ast.Attribute):
        return ast.unparse(node)
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "dict" and not node.args:
        return {str(each.arg): _plain(each.value) for each in node.keywords}
    return ast.literal_eval(node)


def _activation(name: str) -> Callable[..., nn.Module]:
    if name not in ACTIVATIONS:
        raise InputError(f"activation_fn {name} is unknown; there are {', '.join(ACTIVATIONS)}")
    return ACTIVATIONS[name]


_COUNT, _SHARE = Annotated[Count, Field(le=10**9)], Annotated[Number, Field(ge=0.0, le=1.0)]
_SIZE, _SCHEDULE = Annotated[Number, Field(ge=0.0, le=1e6)], Annotated[Any, AfterValidator(_schedule)]
#: Arguments with which an algorithm would fail, or learn nothing, beyond these limits.
ARGUMENTS: dict[str, Any] = {
    **dict.fromkeys(("n_steps", "batch_size", "n_epochs", "buffer_size", "target_update_interval"), _COUNT),
    **dict.fromkeys(("gamma", "gae_lambda", "tau"), _SHARE),
    **dict.fromkeys(("vf_coef", "max_grad_norm"), _SIZE),
    **dict.fromkeys(("learning_rate", "clip_range"), _SCHEDULE),
    "clip_range_vf": _SCHEDULE | None,
    "target_kl": _SIZE | None,
    "learning_starts": Annotated[int, Field(ge=0, le=10**15)],
    "gradient_steps": Annotated[int, Field(ge=-1, le=10**9)],
}


_NETWORK = Annotated[Any, AfterValidator(_policy_kwargs), AfterValidator(_finite)]


class _Environment(FileTable):
    """The table of the environment, beside the algorithm's arguments."""

    n_envs: Count = 1
    n_timesteps: Count
    policy: Literal["MlpPolicy"] = POLICY  # others cannot be exported
    env_kwargs: dict[str, Any] = Field(default_factory=dict)
    policy_kwargs: _NETWORK = Field(default_factory=dict)


def _with_arguments(algorithm: str) -> type[_Environment]:
    """The table of the environment with the arguments of an algorithm."""
    # SAC takes texts and lists, too.
    own = {"train_freq": _COUNT, "ent_coef": _SIZE} if algorithm == "ppo" else {}
    names = inspect.signature(ALGORITHMS[algorithm]).parameters.keys() - {*CLOSED, *_Environment.model_fields}
    other = Annotated[Any, AfterValidator(_finite)]
    fields: dict[str, Any] = {name: ((ARGUMENTS | own).get(name, other), None) for name in sorted(names)}
    return create_model("_Arguments", __base__=_Environment, **fields)


# --- files ------------------------------------------------------------------------------------------------------------
class _File(FileTable):
    environment: dict[str, Any] = Field(alias="HydraulicSync-v0")
    training: Training


@dataclass(frozen=True)
class Config:
    """A training file: `hyper` are the algorithm's arguments, ready to be passed on; `text` is the file itself."""

    path: Path
    text: str
    num_envs: int
    num_steps: int
    env_kwargs: dict[str, Any]
    hyper: dict[str, Any]
    training: Training

    @property
    def algorithm(self) -> type[BaseAlgorithm]:
        return ALGORITHMS[self.training.algorithm]


def read_config(path: str | Path) -> Config:
    """Reads a training file. InputError, in one line that names file and key, for anything that is not right."""
    return _config(Path(path), read_text(path, "a training file in YAML", max_bytes=MAX_BYTES_OF_YAML))


def with_changes(config: Config, *, steps: int | None = None, seed: int | None = None) -> Config:
    """The same file with another number of control periods or another seed; None leaves them."""
    if steps is None and seed is None:
        return config
    data = parse_yaml(config.text, str(config.path))
    if steps is not None:
        data[ENV_ID]["n_timesteps"] = steps
    if seed is not None:
        data["training"]["seed"] = seed
    return _config(config.path, yaml.safe_dump(data, sort_keys=False))


def _config(path: Path, text: str) -> Config:
    data = checked(_File, parse_yaml(text, str(path)), path)
    where = f"{path}: {ENV_ID}"
    table = checked(_with_arguments(data.training.algorithm), data.environment, where)
    hyper = {key: getattr(table, key) for key in data.environment if key not in _Environment.model_fields}
    hyper["policy_kwargs"] = table.policy_kwargs
    return Config(path, text, table.n_envs, table.n_timesteps, dict(table.env_kwargs), hyper, data.training)
