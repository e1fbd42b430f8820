"""Trained policies without a learning library: a policy file, the network in it, and what lies around the network.

A policy file is an npz without pickled objects: the weights `w0`, `b0`, `w1`, ... of a network (stored as torch has them,
outputs first) and `metadata`, a JSON text: what the file is (`schema`), `activation` of the hidden layers, `squash` of the
output ("clip" for PPO's mean, "tanh" for SAC's), `interface` (how observations become the network's inputs and its outputs
become commands, see `learned.policy_interface`) and, for the reader, how it was trained.

A layer n that also has `v{n}` and `c{n}` is a gated recurrent unit (Cho et al., 2014) of H units in torch's form: `w` (3 H,
inputs), `v` (3 H, H) and the biases `b` and `c` (3 H,) stand for the reset gate, the update gate and the new state.
"""

import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_env.arrays import AnyArray, Reals
from hydro_env.controllers.learned.policy_interface import Policy, make_interface
from hydro_env.errors import InputError, check_known
from hydro_env.reading import check_file, parse_json

SCHEMA = "hydro_env/policy/2"
#: Of files with a recurrent layer, which readers of the other schema would not understand.
RECURRENT_SCHEMA = "hydro_env/policy/3"

#: With which a policy was trained whose file does not say it, s: the environment's own.
CONTROL_PERIOD = 0.01
#: Size of all arrays of a policy file together; a network of some hundred units has less than 1 MiB.
MAX_BYTES = 2**26
#: Layers of a network, units of a layer (every rig of a batch keeps the values of a layer), and size of a weight, with which
#: sums stay finite in single precision.
MAX_LAYERS, MAX_UNITS, MAX_WEIGHT = 32, 4096, 1e6

ACTIVATIONS: dict[str, Callable[[Reals], Reals]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
}
SQUASHES: dict[str, Callable[[Reals], Reals]] = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh}


class Dense(NamedTuple):
    """A fully connected layer: weight (outputs, inputs), bias (outputs,)."""

    weight: Reals
    bias: Reals

    @property
    def outputs(self) -> int:
        return int(self.weight.shape[0])

    def __call__(self, inputs: Reals) -> Reals:
        return _product(inputs, self.weight) + self.bias


class Gru(NamedTuple):
    """A gated recurrent unit, see the module's text: weight (3 H, inputs) and bias (3 H,) of the inputs, `back` (3 H, H) and
    `back_bias` (3 H,) of the state."""

    weight: Reals
    bias: Reals
    back: Reals
    back_bias: Reals

    @property
    def outputs(self) -> int:
        return int(self.back.shape[1])

    def __call__(self, inputs: Reals, state: Reals) -> Reals:
        """The next state (..., H) from inputs and state."""
        given = np.split(_product(inputs, self.weight) + self.bias, 3, axis=-1)
        own = np.split(_product(state, self.back) + self.back_bias, 3, axis=-1)
        reset, keep = (_logistic(a + b) for a, b in zip(given[:2], own[:2], strict=True))
        new = np.tanh(given[2] + reset * own[2])
        following: Reals = new + keep * (state - new)
        return following


def _logistic(x: Reals) -> Reals:
    """1 / (1 + exp(-x)), in a form that does not overflow."""
    value: Reals = 0.5 + 0.5 * np.tanh(0.5 * x)
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

    def start(self, rows: int) -> list[Reals]:
        """States of the recurrent layers before the first input, (rows, H) each."""
        units = [layer for layer in self.layers if isinstance(layer, Gru)]
        return [np.zeros((rows, layer.outputs), layer.weight.dtype) for layer in units]

    def __call__(self, inputs: Reals, states: list[Reals] | None = None) -> Reals:
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

    def astype(self, dtype: type) -> "Network":
        """The same network in another precision."""
        layers = [type(layer)(*(array.astype(dtype) for array in layer)) for layer in self.layers]
        return Network(layers, self.activation, self.squash)


def _product(hidden: Reals, weight: Reals) -> Reals:
    """`hidden @ weight.T`, each row for itself: one product of the whole batch rounds differently with every size of the
    batch, and stiction turns a last bit into another trajectory.
    """
    # Named, as are those above, since local names become those of the exported Structured Text.
    product: Reals = (hidden[..., None, :] @ weight.T)[..., 0, :]
    return product


def read_policy(path: str | Path) -> tuple[Network, dict[str, Any]]:
    """The network and the metadata of a policy file. InputError names what is wrong with it."""
    path = Path(path)
    check_file(path, "a policy file")
    try:
        arrays = _arrays(path)
    except Exception as problem:  # zip, deflate and npy each have their own errors for what is damaged
        reason = f"{type(problem).__name__}: {problem}"
        raise InputError(f"{path}: is no policy file, an npz of plain arrays; {reason}") from None
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
        check_known(f"{path}: unknown {key}", [metadata.get(key)], list(known))
    return Network(_layers(path, arrays), metadata["activation"], metadata["squash"]), metadata


def _arrays(path: Path) -> dict[str, AnyArray]:
    """The arrays of an npz by name. Any error for a damaged file, one with pickled objects or too large a one."""
    with zipfile.ZipFile(path) as archive:  # which unpacks no more of an entry than its size says
        if sum(entry.file_size for entry in archive.infolist()) > MAX_BYTES:
            raise ValueError(f"it holds more than {MAX_BYTES / 2**20:g} MiB")
    with np.load(path, allow_pickle=False) as arrays:
        return {name: np.asarray(array) for name, array in arrays.items()}


def _layers(path: Path, arrays: dict[str, AnyArray]) -> list[Dense | Gru]:
    count = sum(name.startswith("w") for name in arrays)
    kinds = ["wbvc" if f"v{n}" in arrays and n < count - 1 else "wb" for n in range(count)]
    names = [[f"{letter}{n}" for letter in kind] for n, kind in enumerate(kinds)]
    if not 0 < count <= MAX_LAYERS or set(arrays) != {name for each in names for name in each}:
        raise InputError(
            f"{path}: holds {', '.join(sorted(arrays)) or 'no weights'}; it should hold w0, b0, w1, b1, ... of at most"
            f" {MAX_LAYERS} layers, and v, c beside those of a recurrent one, which is not the last"
        )
    layers: list[Dense | Gru] = []
    for each in names:
        layers.append(_layer(path, {name: arrays[name] for name in each}, layers[-1] if layers else None))
    return layers


def _layer(path: Path, own: dict[str, AnyArray], before: Dense | Gru | None) -> Dense | Gru:
    """A layer of its arrays, by name. InputError unless their shapes fit and they hold numbers in single precision's reach."""
    for name, array in own.items():
        fits = array.dtype.kind == "f" and 0 < max(array.shape, default=0) <= MAX_UNITS
        if not fits or not np.abs(array).max(initial=0.0) <= MAX_WEIGHT:
            raise InputError(
                f"{path}: {name} should hold floating-point numbers, finite and not beyond {MAX_WEIGHT:g}, of at most"
                f" {MAX_UNITS} units"
            )
    # A dense layer has one gate, a recurrent one three.
    weight, gates = next(iter(own.values())), len(own) - 1
    units, inputs = weight.shape[0] // gates, before.outputs if before else weight.shape[-1]
    shapes = [(gates * units, inputs), (gates * units,), (gates * units, units), (gates * units,)][: len(own)]
    if [array.shape for array in own.values()] != shapes or min(units, inputs) < 1:
        found = ", ".join(f"{name} {array.shape}" for name, array in own.items())
        wanted = ", ".join(map(str, shapes))
        raise InputError(f"{path}: {found} do not fit each other and the layer before: expected {wanted}")
    return Gru(*own.values()) if gates == 3 else Dense(*own.values())


class NumpyPolicy(Policy):
    """A policy file as a controller."""

    def __init__(self, path: str | Path, name: str | None = None, dtype: type = np.float32) -> None:
        network, self.metadata = read_policy(path)
        self.network = network.astype(dtype)
        self.name = name or Path(path).stem
        self.interface = make_interface(self.metadata.get("interface"), f"{path}: interface")
        found = self.network.num_inputs, self.network.num_outputs
        wanted = self.interface.num_features, self.interface.num_actions
        if found != wanted:
            raise InputError(f"{path}: the network has {found} inputs and outputs, the interface {wanted}")
        self.trained_period = _trained_period(self.metadata)
        self.reset(1, self.trained_period)

    def outputs(self, inputs: Reals, fresh: bool) -> Reals:
        if fresh:
            self.memory = self.network.start(len(inputs))
        return self.network(inputs, self.memory)


def _trained_period(metadata: dict[str, Any]) -> float:
    """The control period that a policy was trained with, s."""
    given = metadata.get("env_kwargs")
    period = given.get("control_period") if isinstance(given, dict) else None
    return float(period) if isinstance(period, int | float) and 0.0 < period < 1.0 else CONTROL_PERIOD
