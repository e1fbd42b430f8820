"""Trained policies without a learning library: a policy file, the network in it, and what lies around the network.

A policy file is an npz without pickled objects: the weights `w0`, `b0`, `w1`, ... of a network (stored as torch has them,
outputs first) and `metadata`, a JSON text: what the file is (`schema`), `activation` of the hidden layers, `squash` of the
output ("clip" for PPO's mean, "tanh" for SAC's), `interface` (how observations become the network's inputs and its outputs
become commands, see `learned.policy_interface`) and, for the reader, how it was trained.

A layer n that also has `v{n}` and `c{n}` is a gated recurrent unit (Cho et al., 2014) of H units in torch's form: `w` (3 H,
inputs), `v` (3 H, H) and the biases `b` and `c` (3 H,) stand for the reset gate, the update gate and the new state.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.input_guard import InputGuard, guarded
from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.errors import InputError, shown, suggestion
from hydro_env.reading import check_file, parse_json

__all__ = ["RECURRENT_SCHEMA", "SCHEMA", "Network", "NumpyPolicy", "read_policy"]

SCHEMA = "hydro_env/policy/2"
RECURRENT_SCHEMA = "hydro_env/policy/3"
"""Of files with a recurrent layer, which readers of the other schema would not understand."""

Floats = NDArray[np.floating[Any]]

MOST_BYTES = 2**26
"""Size of all arrays of a policy file together; a network of some hundred units has less than 1 MiB."""
MOST_LAYERS, MOST_UNITS, MOST_WEIGHT = 32, 4096, 1e6
"""Layers of a network, units of a layer (every rig of a batch keeps the values of a layer), and size of a weight, with which
sums stay finite in single precision."""

ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
}
SQUASHES: dict[str, Callable[[Floats], Floats]] = {
    "clip": lambda x: np.clip(x, -1.0, 1.0),
    "tanh": np.tanh,
}


class Dense(NamedTuple):
    """A fully connected layer: weight (outputs, inputs), bias (outputs,)."""

    weight: Floats
    bias: Floats

    @property
    def outputs(self) -> int:
        return int(self.weight.shape[0])

    def __call__(self, inputs: Floats) -> Floats:
        return _product(inputs, self.weight) + self.bias


class Gru(NamedTuple):
    """A gated recurrent unit, see the module's text: weight (3 H, inputs) and bias (3 H,) of the inputs, `back` (3 H, H) and
    `back_bias` (3 H,) of the state."""

    weight: Floats
    bias: Floats
    back: Floats
    back_bias: Floats

    @property
    def outputs(self) -> int:
        return int(self.back.shape[1])

    def __call__(self, inputs: Floats, state: Floats) -> Floats:
        """The next state (..., H) from inputs and state."""
        given = np.split(_product(inputs, self.weight) + self.bias, 3, axis=-1)
        own = np.split(_product(state, self.back) + self.back_bias, 3, axis=-1)
        reset, keep = (_logistic(a + b) for a, b in zip(given[:2], own[:2], strict=True))
        new = np.tanh(given[2] + reset * own[2])
        following: Floats = new + keep * (state - new)
        return following


def _logistic(x: Floats) -> Floats:
    """1 / (1 + exp(-x)), in a form that does not overflow."""
    value: Floats = 0.5 + 0.5 * np.tanh(0.5 * x)
    return value


@dataclass(frozen=True)
class Network:
    """A network of `layers`; `activation` follows each dense layer but the last, `squash` the last."""

    layers: Sequence[Dense | Gru]
    activation: str
    squash: str

    @property
    def num_inputs(self) -> int:
        return int(self.layers[0].weight.shape[1])

    @property
    def num_outputs(self) -> int:
        return self.layers[-1].outputs

    def start(self, rows: int) -> list[Floats]:
        """States of the recurrent layers before the first input, (rows, H) each."""
        units = [layer for layer in self.layers if isinstance(layer, Gru)]
        return [np.zeros((rows, layer.outputs), layer.weight.dtype) for layer in units]

    def __call__(self, inputs: Floats, states: list[Floats] | None = None) -> Floats:
        """Outputs (..., num_outputs) in [-1, 1] for inputs (..., num_inputs), in the precision of the weights. `states` are
        those of the recurrent layers, (..., H) each, as `start` makes them; they are replaced."""
        hidden = np.asarray(inputs, dtype=self.layers[0].weight.dtype)
        activate, unit = ACTIVATIONS[self.activation], 0
        for layer in self.layers[:-1]:
            if isinstance(layer, Gru):
                assert states is not None
                hidden = states[unit] = layer(hidden, states[unit])
                unit += 1
            else:
                hidden = activate(layer(hidden))
        last = self.layers[-1]
        assert isinstance(last, Dense)
        return SQUASHES[self.squash](last(hidden))

    def astype(self, dtype: type) -> Network:
        """The same network in another precision."""
        layers = [type(layer)(*(array.astype(dtype) for array in layer)) for layer in self.layers]
        return Network(layers, self.activation, self.squash)


def _product(hidden: Floats, weight: Floats) -> Floats:
    """`hidden @ weight.T`, each row for itself: one product of the whole batch rounds differently with every size of the
    batch, and stiction turns a last bit into another course.
    """
    product: Floats = (hidden[..., None, :] @ weight.T)[..., 0, :]
    return product


def read_policy(path: str | Path) -> tuple[Network, dict[str, Any]]:
    """The network and the metadata of a policy file. InputError names what is wrong with it."""
    path = Path(path)
    check_file(path, "a policy file")
    try:
        arrays = _arrays(path)
    except (
        Exception
    ) as problem:  # the readers of zip, deflate and npy each have their own errors for what is damaged
        reason = f"{type(problem).__name__}: {problem}"
        raise InputError(
            f"{path}: is no policy file, it should be an npz of plain arrays (hydro_env.training.export); {reason}"
        ) from None
    if "metadata" not in arrays:
        raise InputError(f"{path}: has no 'metadata'; a policy file is written by hydro_env.training.export")
    text = arrays.pop("metadata")
    if text.shape != () or text.dtype.kind != "U":
        raise InputError(f"{path}: 'metadata' is an array {text.shape} of {text.dtype}, expected one text")
    metadata = parse_json(str(text), f"{path}: 'metadata'")
    schema = RECURRENT_SCHEMA if any(name.startswith("v") for name in arrays) else SCHEMA
    if not isinstance(metadata, dict) or metadata.get("schema") != schema:
        raise InputError(f"{path}: 'metadata' should say schema {schema!r}")
    for key, known in (("activation", ACTIVATIONS), ("squash", SQUASHES)):
        named = metadata.get(key)
        if not isinstance(named, str) or named not in known:
            raise InputError(f"{path}: {key} {shown(named)} is unknown: {suggestion(named, known)}")
    layers = _layers(path, arrays)
    return Network(layers, metadata["activation"], metadata["squash"]), metadata


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an npz by name. Any error for a damaged file, one with pickled objects or too large a one: no more than
    `MOST_BYTES` are unpacked, whatever the file says of itself, and no array is made larger than what was unpacked.
    """
    arrays: dict[str, NDArray[Any]] = {}
    left = MOST_BYTES
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            name = entry.filename.removesuffix(".npy")
            if name in arrays:
                raise ValueError(f"{shown(name)} is there twice")
            with archive.open(entry) as file:
                data = file.read(left + 1)
            left -= len(data)
            if left < 0:
                raise ValueError(f"it holds more than {MOST_BYTES / 2**20:g} MiB")
            arrays[name] = _array(data)
    return arrays


def _array(data: bytes) -> NDArray[Any]:
    """The array of an npy file that has just as many bytes as its header asks for."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    shape, by_columns, dtype = header[version](file)
    rest = data[file.tell() :]
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(rest):
        raise ValueError(f"an array {shown(shape)} of {shown(dtype)} does not fit its {len(rest)} bytes")
    return np.ndarray(shape, dtype, rest, order="F" if by_columns else "C")


def _layers(path: Path, arrays: dict[str, NDArray[Any]]) -> list[Dense | Gru]:
    count = sum(name.startswith("w") for name in arrays)
    recurrent = {n for n in range(count - 1) if f"v{n}" in arrays}
    wanted = {f"{kind}{n}" for n in range(count) for kind in ("wbvc" if n in recurrent else "wb")}
    if not 0 < count <= MOST_LAYERS or set(arrays) != wanted:
        raise InputError(
            f"{path}: holds {', '.join(sorted(arrays)) or 'no weights'}; it should hold w0, b0, w1, b1, ... of at most"
            f" {MOST_LAYERS} layers, and v, c beside those of a recurrent one, which is not the last"
        )
    layers: list[Dense | Gru] = []
    for n in range(count):
        _check_numbers(path, n, arrays)
        layers.append(_gru(path, n, arrays) if n in recurrent else _dense(path, n, arrays))
        inputs = layers[n].weight.shape[1]
        if n and inputs != layers[n - 1].outputs:
            raise InputError(
                f"{path}: w{n} takes {inputs} inputs, the layer before has {layers[n - 1].outputs} outputs"
            )
    return layers


def _check_numbers(path: Path, n: int, arrays: dict[str, NDArray[Any]]) -> None:
    """InputError unless the arrays of layer n hold numbers that can be reckoned with, and not too many."""
    for name in (f"{kind}{n}" for kind in "wbvc" if f"{kind}{n}" in arrays):
        array = arrays[name]
        if array.dtype.kind != "f":
            raise InputError(f"{path}: {name} should hold floating-point numbers")
        if array.ndim and max(array.shape) > MOST_UNITS:
            raise InputError(f"{path}: {name} {array.shape}: a layer has at most {MOST_UNITS} units")
        if array.size and not np.abs(array).max() <= MOST_WEIGHT:
            raise InputError(f"{path}: {name} holds a value that is not finite, or beyond {MOST_WEIGHT:g}")


def _dense(path: Path, n: int, arrays: dict[str, NDArray[Any]]) -> Dense:
    weight, bias = arrays[f"w{n}"], arrays[f"b{n}"]
    if weight.ndim != 2 or bias.shape != weight.shape[:1] or not min(weight.shape) >= 1:
        raise InputError(
            f"{path}: w{n} {weight.shape} and b{n} {bias.shape} do not fit: (out, in) and (out,)"
        )
    return Dense(weight, bias)


def _gru(path: Path, n: int, arrays: dict[str, NDArray[Any]]) -> Gru:
    weight, bias, back, back_bias = (arrays[f"{kind}{n}"] for kind in "wbvc")
    units = back.shape[-1] if back.ndim == 2 else 0
    fits = weight.ndim == 2 and min(weight.shape) >= 1 and weight.shape[0] == 3 * units
    if not (fits and back.shape == (3 * units, units) and bias.shape == back_bias.shape == (3 * units,)):
        shapes = ", ".join(f"{kind}{n} {arrays[f'{kind}{n}'].shape}" for kind in "wbvc")
        raise InputError(f"{path}: {shapes} do not fit: (3 H, in), (3 H,), (3 H, H) and (3 H,)")
    return Gru(weight, bias, back, back_bias)


class NumpyPolicy:
    """A policy file as a controller: `reset`, then `act` once a control period, one row per rig.

    `needs` and `plant` as in `hydro_env.controllers.base.Controller`: it knows nothing but the measurements.
    """

    needs = "measurements"
    plant: str | None = None

    def __init__(self, path: str | Path, name: str | None = None, dtype: type = np.float32) -> None:
        network, self.metadata = read_policy(path)
        self.network = network.astype(dtype)
        self.name = name or Path(path).stem
        try:
            self.interface = make_interface(self.metadata.get("interface"))
        except InputError as problem:
            raise InputError(f"{path}: interface: {problem}") from None
        if (self.network.num_inputs, self.network.num_outputs) != (
            self.interface.num_features,
            self.interface.num_actions,
        ):
            raise InputError(
                f"{path}: the network takes {self.network.num_inputs} inputs and gives {self.network.num_outputs} "
                f"outputs, its interface wants {self.interface.num_features} and {self.interface.num_actions}"
            )
        self.reset(1, 0.01)

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Forgets the last episode. The policy drives at any control period (s) in the same way."""
        self._num_rigs, self._fresh = int(num_rigs), True
        self.guard = InputGuard(self._num_rigs, control_period)

    @guarded
    def act(self, observation: Floats) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n) as the environment gives them."""
        observation = np.asarray(observation)
        if observation.ndim != 2 or len(observation) != self._num_rigs:
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got observations {observation.shape}"
            )
        if self._fresh:
            inputs = self.interface.start(observation)
            self._states = self.network.start(len(inputs))
            self._fresh = False
        else:
            inputs = self.interface.see(observation)
        return self.interface.command(self.network(inputs, self._states))
