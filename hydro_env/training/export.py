"""Policies of Stable-Baselines3 as policy files: the deterministic path alone.

A training run exports by itself; `python -m agents.export` in a checkout does it by hand. `hydro_env.export` writes policy files
as ONNX, C or Structured Text.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from hydro_env.controllers.learned.policy import RECURRENT_SCHEMA, SCHEMA
from hydro_env.files import write_bytes

ACTIVATIONS = {nn.Tanh: "tanh", nn.ReLU: "relu", nn.ELU: "elu"}


def policy_arrays(model: BaseAlgorithm) -> tuple[dict[str, NDArray[np.float32]], str, str]:
    """Weights `w0`, `b0`, ... of the path from observation to deterministic action, activation, and squash."""
    modules: list[nn.Module]
    if isinstance(model, PPO):
        modules = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
        squash = "clip"
    elif isinstance(model, SAC):
        modules = [*model.policy.actor.latent_pi, model.policy.actor.mu]
        squash = "tanh"
    else:
        raise TypeError(f"{type(model).__name__} cannot be exported, only PPO and SAC can")
    linear = [module for module in modules if isinstance(module, nn.Linear)]
    between = {type(module) for module in modules if not isinstance(module, nn.Linear)}
    if len(between) > 1 or not between <= set(ACTIVATIONS):
        raise TypeError(f"layers between the linear ones are {between}, expected one of {set(ACTIVATIONS)}")
    arrays = {}
    for n, layer in enumerate(linear):
        arrays[f"w{n}"] = layer.weight.detach().cpu().numpy().astype(np.float32)
        arrays[f"b{n}"] = layer.bias.detach().cpu().numpy().astype(np.float32)
    return arrays, ACTIVATIONS[between.pop()] if between else "tanh", squash


def export_policy(
    model: BaseAlgorithm, path: str | Path, interface: Mapping[str, Any], about: Mapping[str, Any]
) -> None:
    """Writes a policy file in one go. `about` is what the reader should know of its training; JSON values."""
    arrays, activation, squash = policy_arrays(model)
    own = {"activation": activation, "squash": squash, "interface": dict(interface)}
    write_policy(path, arrays, {**own, **about})


def write_policy(path: str | Path, arrays: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any]) -> None:
    """Writes a policy file of these arrays in one go; `metadata` without the schema, JSON values."""
    recurrent = any(name.startswith("v") for name in arrays)
    text = json.dumps({"schema": RECURRENT_SCHEMA if recurrent else SCHEMA, **metadata})
    memory = io.BytesIO()
    np.savez_compressed(memory, metadata=np.array(text), **arrays)  # type: ignore[arg-type]
    write_bytes(Path(path), memory.getvalue())
