"""Networks of policy files as ONNX graphs.

A graph has the input `inputs` (rows, features) and the output `outputs` (rows, actions) in [-1, 1]. A recurrent layer n adds the
input `state{n}` (rows, units), zeros at first, and the output `next_state{n}`, which is to be given back in the next period. The
interface (what the inputs are and what becomes of the outputs) is code, not part of the graph; its settings are in the graph's
metadata under `interface`. Needs onnx (extra `agents`).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.learned.policy import Gru, read_policy
from hydro_env.files import write_bytes

ONNX_NAMES = {"tanh": "Tanh", "relu": "Relu", "elu": "Elu"}


def export_onnx(policy: str | Path, path: str | Path) -> None:
    """Writes the network of a policy file as an ONNX graph in one go. InputError for a file that is no policy."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    network, metadata = read_policy(policy)
    single = network.astype(np.float32)
    constants: dict[str, NDArray[Any]] = {}
    nodes, states, name = [], [], "inputs"
    last = len(single.layers) - 1
    for n, layer in enumerate(single.layers):
        if isinstance(layer, Gru):
            made, kept = _gru_nodes(n, layer, name)
            nodes += made
            constants |= kept
            states.append((f"state{n}", layer.outputs))
            name = f"next_state{n}"
            continue
        constants |= {f"w{n}": layer.weight, f"b{n}": layer.bias}
        nodes.append(helper.make_node("Gemm", [name, f"w{n}", f"b{n}"], [f"sum{n}"], transB=1))
        name = f"hidden{n}"
        if n < last:
            nodes.append(helper.make_node(ONNX_NAMES[single.activation], [f"sum{n}"], [name]))
    if single.squash == "tanh":
        nodes.append(helper.make_node("Tanh", [f"sum{last}"], ["outputs"]))
    else:
        constants |= {"low": np.array(-1.0, np.float32), "high": np.array(1.0, np.float32)}
        nodes.append(helper.make_node("Clip", [f"sum{last}", "low", "high"], ["outputs"]))

    def rows(name: str, width: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["rows", width])

    graph = helper.make_graph(
        nodes, "policy", [rows("inputs", network.num_inputs), *(rows(state, width) for state, width in states)],
        [rows("outputs", network.num_outputs), *(rows(f"next_{state}", width) for state, width in states)],
        [numpy_helper.from_array(array, key) for key, array in constants.items()],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(
        model, {"interface": json.dumps(metadata["interface"]), "schema": metadata["schema"]}
    )
    onnx.checker.check_model(model)
    write_bytes(Path(path), model.SerializeToString())


def _gru_nodes(n: int, layer: Gru, inputs: str) -> tuple[list[Any], dict[str, NDArray[Any]]]:
    """Nodes and constants of recurrent layer n: one step from `state{n}` to `next_state{n}`, both (rows, H)."""
    from onnx import helper

    def in_order(array: NDArray[Any]) -> NDArray[Any]:
        """ONNX has the update gate before the reset gate, and an axis for directions in front."""
        reset, keep, new = np.split(array, 3)
        return np.concatenate([keep, reset, new])[None]

    constants = {
        f"w{n}": in_order(layer.weight),
        f"v{n}": in_order(layer.back),
        f"b{n}": np.concatenate([in_order(layer.bias), in_order(layer.back_bias)], axis=1),
        f"axis{n}": np.zeros(1, np.int64),
    }
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
