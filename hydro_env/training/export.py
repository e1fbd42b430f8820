"""Policies of Stable-Baselines3 as policy files, and policy files as ONNX: the deterministic path alone.

A training run exports by itself; `python -m agents.export` in a checkout does it by hand. An ONNX file has the input `inputs`
(rows, features) and the output `outputs` (rows, actions) in [-1, 1]. A recurrent layer n adds the input `state{n}` (rows, units),
zeros at first, and the output `next_state{n}`, which is to be given back in the next period. The interface (what the inputs
are and what becomes of the outputs) is code, not part of the graph; its settings are in the graph's metadata under `interface`.
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

from hydro_env.controllers.learned.policy import RECURRENT_SCHEMA, SCHEMA, Gru, read_policy
from hydro_env.files import write_bytes

__all__ = ["export_onnx", "export_policy", "policy_arrays", "write_policy"]

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
    write_policy(
        path, arrays, {"activation": activation, "squash": squash, "interface": dict(interface), **about}
    )


def write_policy(path: str | Path, arrays: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any]) -> None:
    """Writes a policy file of these arrays in one go; `metadata` without the schema, JSON values."""
    recurrent = any(name.startswith("v") for name in arrays)
    text = json.dumps({"schema": RECURRENT_SCHEMA if recurrent else SCHEMA, **metadata})
    memory = io.BytesIO()
    np.savez_compressed(memory, metadata=np.array(text), **arrays)  # type: ignore[arg-type]
    write_bytes(Path(path), memory.getvalue())


def export_onnx(policy: str | Path, path: str | Path) -> None:
    """Writes the network of a policy file as an ONNX graph in one go. InputError for a file that is no policy."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    network, metadata = read_policy(policy)
    single = network.astype(np.float32)
    nodes, constants, states, name = [], [], [], "inputs"
    last = len(single.layers) - 1
    for n, layer in enumerate(single.layers):
        if isinstance(layer, Gru):
            made, kept = _gru_nodes(n, layer, name)
            nodes += made
            constants += kept
            states.append((f"state{n}", layer.outputs))
            name = f"next_state{n}"
            continue
        constants += [
            numpy_helper.from_array(layer.weight, f"w{n}"),
            numpy_helper.from_array(layer.bias, f"b{n}"),
        ]
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

    def rows(name: str, width: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["rows", width])

    graph = helper.make_graph(
        nodes,
        "policy",
        [rows("inputs", network.num_inputs), *(rows(state, width) for state, width in states)],
        [rows("outputs", network.num_outputs), *(rows(f"next_{state}", width) for state, width in states)],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(
        model, {"interface": json.dumps(metadata["interface"]), "schema": metadata["schema"]}
    )
    onnx.checker.check_model(model)
    write_bytes(Path(path), model.SerializeToString())


def _gru_nodes(n: int, layer: Gru, inputs: str) -> tuple[list[Any], list[Any]]:
    """Nodes and constants of recurrent layer n: one step from `state{n}` to `next_state{n}`, both (rows, H)."""
    from onnx import helper, numpy_helper

    def in_order(array: NDArray[Any]) -> NDArray[Any]:
        """ONNX has the update gate before the reset gate, and an axis for directions in front."""
        reset, keep, new = np.split(array, 3)
        return np.concatenate([keep, reset, new])[None]

    both = np.concatenate([in_order(layer.bias), in_order(layer.back_bias)], axis=1)
    constants = [
        numpy_helper.from_array(in_order(layer.weight), f"w{n}"),
        numpy_helper.from_array(in_order(layer.back), f"v{n}"),
        numpy_helper.from_array(both, f"b{n}"),
        numpy_helper.from_array(np.zeros(1, np.int64), f"axis{n}"),
    ]
    nodes = [
        helper.make_node("Unsqueeze", [inputs, f"axis{n}"], [f"sequence{n}"]),
        helper.make_node("Unsqueeze", [f"state{n}", f"axis{n}"], [f"before{n}"]),
        helper.make_node(
            "GRU",
            [f"sequence{n}", f"w{n}", f"v{n}", f"b{n}", "", f"before{n}"],
            ["", f"after{n}"],
            hidden_size=layer.outputs,
            linear_before_reset=1,
        ),
        helper.make_node("Squeeze", [f"after{n}", f"axis{n}"], [f"next_state{n}"]),
    ]
    return nodes, constants
