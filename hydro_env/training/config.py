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

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import yaml
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.errors import InputError, shown, suggestion
from hydro_env.limits import Limits
from hydro_env.reading import MAX_BYTES_OF_YAML, parse_yaml, read_text
from hydro_env.tasks.scenarios import SCENARIOS

__all__ = ["ALGORITHMS", "ENV_ID", "Config", "Training", "read_config", "with_changes"]

ENV_ID = "HydraulicSync-v0"
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC}
OWN_KEYS = ("n_envs", "n_timesteps", "policy", "env_kwargs", "policy_kwargs")
# Arguments of the algorithms that are set elsewhere or have no place in a file.
CLOSED = ("self", "env", "device", "verbose", "seed", "tensorboard_log", "stats_window_size", "_init_setup_model",
          "rollout_buffer_class", "rollout_buffer_kwargs", "replay_buffer_class", "replay_buffer_kwargs",
          "action_noise", "optimize_memory_usage", "n_steps_td")  # fmt: skip
#: Numbers that an algorithm would take and then fail by, or learn nothing with.
_COUNT, _SHARE, _SIZE = Limits(1, 10**9, whole=True), Limits(0, 1), Limits(0, 1e6)
LIMITS = {
    **dict.fromkeys(
        ("n_steps", "batch_size", "n_epochs", "buffer_size", "train_freq", "target_update_interval"), _COUNT
    ),
    **dict.fromkeys(("gamma", "gae_lambda", "tau"), _SHARE),
    **dict.fromkeys(
        ("learning_rate", "clip_range", "clip_range_vf", "ent_coef", "vf_coef", "max_grad_norm", "target_kl"),
        _SIZE,
    ),
    "learning_starts": Limits(0, 10**15, whole=True),
    "gradient_steps": Limits(-1, 10**9, whole=True),
}
ACTIVATIONS = {"nn.Tanh": nn.Tanh, "nn.ReLU": nn.ReLU, "nn.ELU": nn.ELU}


@dataclass(frozen=True)
class Training:
    """The table `training`.

    Attributes:
        algorithm: "ppo" or "sac".
        interface: table of `hydro_env.controllers.learned.policy_interface.make_interface`; the plain observation if empty.
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

    algorithm: str
    interface: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    checkpoint_every: int = 1_000_000
    evaluate_every: int = 500_000
    evaluate_scenarios: tuple[str, ...] = ("setpoint_steps",)
    evaluate_pairs: int = 64
    tracking_weight: float = 0.5
    tail_weight: float = 0.0


@dataclass(frozen=True)
class Config:
    """A training file: `hyper` are the algorithm's arguments, ready to be passed on; `text` is the file itself."""

    path: Path
    text: str
    num_envs: int
    num_steps: int
    policy: str
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
    data = parse_yaml(text, str(path))
    if not isinstance(data, dict) or not all(isinstance(table, dict) for table in data.values()):
        raise InputError(f"{path}: should hold the tables {ENV_ID!r} and 'training'")
    for key in data:
        _known(f"{path}", key, (ENV_ID, "training"))
    for key in (ENV_ID, "training"):
        if key not in data:
            raise InputError(f"{path}: the table {key!r} is missing")
    training = _training(path, data["training"])
    table = dict(data[ENV_ID])
    algorithm = ALGORITHMS[training.algorithm]
    arguments = [name for name in inspect.signature(algorithm).parameters if name not in CLOSED]
    for key in table:
        _known(f"{path}: {ENV_ID}", key, (*OWN_KEYS, *(name for name in arguments if name not in OWN_KEYS)))
    where = f"{path}: {ENV_ID}"
    num_envs = _whole(where, "n_envs", table.pop("n_envs", 1))
    num_steps = _whole(where, "n_timesteps", table.pop("n_timesteps", None))
    policy = table.pop("policy", "MlpPolicy")
    if policy != "MlpPolicy":
        raise InputError(f"{where}: policy {policy!r} cannot be exported; only 'MlpPolicy' can")
    env_kwargs = table.pop("env_kwargs", None) or {}
    if not isinstance(env_kwargs, dict):
        raise InputError(f"{where}: env_kwargs should be a table of arguments of the environment")
    free = (
        ("ent_coef", "train_freq") if algorithm is SAC else ()
    )  # texts such as `auto`, lists such as `[1, step]`
    hyper = {key: _value(where, key, value, key in free) for key, value in table.items()}
    hyper["policy_kwargs"] = _policy_kwargs(where, hyper.pop("policy_kwargs", None))
    return Config(path, text, num_envs, num_steps, policy, dict(env_kwargs), hyper, training)


def _known(where: str, key: object, known: Iterable[str]) -> None:
    names = list(known)
    if key not in names:
        raise InputError(f"{where}: unknown key {key!r}: {suggestion(key, names)}")


def _whole(where: str, key: str, value: Any) -> int:
    fits = isinstance(value, int | float) and not isinstance(value, bool) and 1 <= value <= 1e15
    if not fits or value % 1:
        raise InputError(
            f"{where}: {key} is {shown(value)}, expected a whole number of at least 1 (write 1.0e+6, not 1e6)"
        )
    return int(value)


def _training(path: Path, table: dict[str, Any]) -> Training:
    where = f"{path}: training"
    for key in table:
        _known(where, key, [each.name for each in fields(Training)])
    if table.get("algorithm") not in ALGORITHMS:
        raise InputError(
            f"{where}: algorithm is {table.get('algorithm')!r}, expected {' or '.join(ALGORITHMS)}"
        )
    values = dict(table)
    for key in ("checkpoint_every", "evaluate_every", "evaluate_pairs"):
        if key in values:
            values[key] = _whole(where, key, values[key])
    kinds: dict[str, Any] = {
        "seed": int,
        **dict.fromkeys(("tracking_weight", "tail_weight"), (int, float)),
    }
    for key, kind in kinds.items():
        if key in values and (
            isinstance(values[key], bool)
            or not isinstance(values[key], kind)
            or not 0 <= values[key] < math.inf
        ):
            raise InputError(f"{where}: {key} is {values[key]!r}, expected a number of at least 0")
    if "evaluate_scenarios" in values:
        names = values["evaluate_scenarios"]
        if not isinstance(names, list) or not names:
            raise InputError(f"{where}: evaluate_scenarios is {names!r}, expected a list of scenarios")
        for name in names:
            _known(f"{where}: evaluate_scenarios", name, SCENARIOS)
        values["evaluate_scenarios"] = tuple(names)
    try:
        make_interface(values.get("interface"))
    except (InputError, TypeError, ValueError) as problem:
        raise InputError(f"{where}: interface: {problem}") from None
    values["interface"] = dict(values.get("interface") or {})
    return Training(**values)


def _value(where: str, key: str, value: Any, free: bool) -> Any:
    """Numbers as they are, where they can be right; `lin_3e-4` as a schedule that falls linearly to zero."""
    if isinstance(value, str) and value.startswith("lin_"):
        return Falling(_SIZE.read(value[4:], f"{where}: {key}: lin_"))
    limits = LIMITS.get(key)
    others = (
        isinstance(value, str | list) if free else value is None and key in ("target_kl", "clip_range_vf")
    )
    if limits is None or others:
        _check_finite(where, key, value)
        return value
    if key in ("learning_rate", "clip_range") and isinstance(value, str):
        raise InputError(
            f"{where}: {key} is {value!r}, expected a number (write 1.0e-3, not 1e-3) or lin_1e-3"
        )
    whole = limits.whole and isinstance(value, float) and value.is_integer()
    return limits.check(int(value) if whole else value, f"{where}: {key}")


def _check_finite(where: str, key: str, value: Any) -> None:
    """InputError for a number somewhere in a value that is not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: {key} is {value}, expected a finite number")
    for item in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    ):
        _check_finite(where, key, item)


@dataclass(frozen=True)
class Falling:
    """A schedule from `start` to zero."""

    start: float

    def __call__(self, remaining: float) -> float:
        return remaining * self.start


def _policy_kwargs(where: str, value: Any) -> dict[str, Any]:
    """A table, or RL-Zoo's `dict(net_arch=[64, 64], activation_fn=nn.Tanh)`, of which only plain values are read."""
    if value is None:
        return {}
    if isinstance(value, dict):
        given = dict(value)
        if isinstance(given.get("activation_fn"), str):
            given["activation_fn"] = _activation(where, given["activation_fn"])
        _check_finite(where, "policy_kwargs", given)
        return given
    try:
        call = ast.parse(str(value).strip(), mode="eval").body
        if not (isinstance(call, ast.Call) and ast.unparse(call.func) == "dict" and not call.args):
            raise ValueError
        parsed = {str(each.arg): _plain(where, each.value) for each in call.keywords}
    except InputError:
        raise
    except (SyntaxError, ValueError):
        raise InputError(
            f"{where}: policy_kwargs is {value!r}, expected dict(net_arch=[64, 64], activation_fn=nn.Tanh) or the like"
        ) from None
    _check_finite(where, "policy_kwargs", parsed)
    return parsed


def _plain(where: str, node: ast.expr) -> Any:
    if isinstance(node, ast.Attribute):
        return _activation(where, ast.unparse(node))
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "dict" and not node.args:
        return {str(each.arg): _plain(where, each.value) for each in node.keywords}
    return ast.literal_eval(node)


def _activation(where: str, name: str) -> Callable[..., nn.Module]:
    if name not in ACTIVATIONS:
        raise InputError(
            f"{where}: policy_kwargs: activation_fn {name} is unknown; there are {', '.join(ACTIVATIONS)}"
        )
    return ACTIVATIONS[name]
