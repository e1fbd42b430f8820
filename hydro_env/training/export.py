"""Policies of Stable-Baselines3 as policy files, and policy files as ONNX: the deterministic path alone.

A training run exports by itself; `python -m agents.export` in a checkout does it by hand. An ONNX file has the input `inputs`
(rows, features) and the output `outputs` (rows, actions) in [-1, 1]. The interface (what the inputs are and what becomes of the
outputs) is code, not part of the graph; its settings are in the graph's metadata under `interface`.
"""

from __future__ import annotations

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

from hydro_env.controllers.learned.policy import SCHEMA, read_policy
from hydro_env.files import write_bytes

__all__ = ["export_onnx", "export_policy", "policy_arrays"]

ONNX_NAMES = {"tanh": "Tanh", "relu": "Relu", "elu": "Elu"}
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
    metadata = {
        "schema": SCHEMA,
        "activation": activation,
        "squash": squash,
        "interface": dict(interface),
        **about,
    }
    memory = io.BytesIO()
    np.savez_compressed(memory, metadata=np.array(json.dumps(metadata)), **arrays)  # type: ignore[arg-type]
    write_bytes(Path(path), memory.getvalue())


def export_onnx(policy: str | Path, path: str | Path) -> None:
    """Writes the network of a policy file as an ONNX graph in one go. InputError for a file that is no policy."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    network, metadata = read_policy(policy)
    single = network.astype(np.float32)
    nodes, constants, name = [], [], "inputs"
    last = len(single.layers) - 1
    for n, (weight, bias) in enumerate(single.layers):
        constants += [numpy_helper.from_array(weight, f"w{n}"), numpy_helper.from_array(bias, f"b{n}")]
        nodes.append(helper.make_node("Gemm", [name, f"w{n}", f"b{n}"], [f"sum{n}"], transB=1))
        name = f"hidden{n}"
        if n < last:
            nodes.append(helper.make_node(ONNX_NAMES[single.activation], [f"sum{n}"], [name]))
    if single.squash == "tanh":
        nodes.append(helper.make_node("Tanh", [f"sum{last}"], ["outputs"]))
    else:
        limits = [
            numpy_helper.from_array(np.float32(value), key) for key, value in (("low", -1.0), ("high", 1.0))
        ]
        constants += limits
        nodes.append(helper.make_node("Clip", [f"sum{last}", "low", "high"], ["outputs"]))
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("inputs", TensorProto.FLOAT, ["rows", network.num_inputs])],
        [helper.make_tensor_value_info("outputs", TensorProto.FLOAT, ["rows", network.num_outputs])],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(
        model, {"interface": json.dumps(metadata["interface"]), "schema": metadata["schema"]}
    )
    onnx.checker.check_model(model)
    write_bytes(Path(path), model.SerializeToString())
