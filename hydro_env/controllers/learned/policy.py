"""Trained policies without a learning library: a policy file, the network in it, and what lies around the network.

A policy file is an npz without pickled objects: the weights `w0`, `b0`, `w1`, ... of a fully connected network (stored
as SB3 has them, outputs first) and `metadata`, a JSON text: what the file is (`schema`), `activation` of the hidden
layers, `squash` of the output ("clip" for PPO's mean, "tanh" for SAC's), `interface` (how observations become the network's
inputs and its outputs become commands, see `learned.policy_interface`) and, for the reader, how it was trained.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.learned.policy_interface import PolicyInterface, make_interface
from hydro_env.errors import InputError, suggestion

__all__ = ["SCHEMA", "Network", "NumpyPolicy", "read_policy"]

SCHEMA = "hydro_env/policy/2"

Floats = NDArray[np.floating[Any]]

ACTIVATIONS: dict[str, Callable[[Floats], Floats]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
}
SQUASHES: dict[str, Callable[[Floats], Floats]] = {
    "clip": lambda x: np.clip(x, -1.0, 1.0),
    "tanh": np.tanh,
}


@dataclass(frozen=True)
class Network:
    """A fully connected network: `layers` of (weight (outputs, inputs), bias (outputs,))."""

    layers: Sequence[tuple[Floats, Floats]]
    activation: str
    squash: str

    @property
    def num_inputs(self) -> int:
        return int(self.layers[0][0].shape[1])

    @property
    def num_outputs(self) -> int:
        return int(self.layers[-1][0].shape[0])

    def __call__(self, inputs: Floats) -> Floats:
        """Outputs (..., num_outputs) in [-1, 1] for inputs (..., num_inputs), in the precision of the weights."""
        hidden = np.asarray(inputs, dtype=self.layers[0][0].dtype)
        activate = ACTIVATIONS[self.activation]
        for weight, bias in self.layers[:-1]:
            hidden = activate(_product(hidden, weight) + bias)
        weight, bias = self.layers[-1]
        return SQUASHES[self.squash](_product(hidden, weight) + bias)

    def astype(self, dtype: type) -> Network:
        """The same network in another precision."""

        def cast(array: Floats) -> Floats:
            return array.astype(dtype)

        layers = [(cast(weight), cast(bias)) for weight, bias in self.layers]
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
    if not path.is_file():
        raise InputError(f"{path}: no such policy file")
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, KeyError):
        raise InputError(
            f"{path}: is no policy file, it should be an npz of plain arrays (agents.export)"
        ) from None
    if "metadata" not in arrays:
        raise InputError(f"{path}: has no 'metadata'; a policy file is written by agents.export")
    try:
        metadata = json.loads(str(arrays.pop("metadata")))
    except json.JSONDecodeError:
        raise InputError(f"{path}: 'metadata' is not JSON") from None
    if not isinstance(metadata, dict) or metadata.get("schema") != SCHEMA:
        raise InputError(f"{path}: 'metadata' should say schema {SCHEMA!r}")
    for key, known in (("activation", ACTIVATIONS), ("squash", SQUASHES)):
        if metadata.get(key) not in known:
            raise InputError(
                f"{path}: {key} {metadata.get(key)!r} is unknown: {suggestion(metadata.get(key), known)}"
            )
    layers = _layers(path, arrays)
    return Network(layers, metadata["activation"], metadata["squash"]), metadata


def _layers(path: Path, arrays: dict[str, NDArray[Any]]) -> list[tuple[Floats, Floats]]:
    count = len(arrays) // 2
    wanted = {f"{kind}{n}" for n in range(count) for kind in "wb"}
    if not count or set(arrays) != wanted:
        raise InputError(
            f"{path}: holds {', '.join(sorted(arrays)) or 'no weights'}; it should hold w0, b0, w1, b1, ..."
        )
    layers: list[tuple[Floats, Floats]] = []
    width: int | None = None
    for n in range(count):
        weight, bias = arrays[f"w{n}"], arrays[f"b{n}"]
        if weight.dtype.kind != "f" or bias.dtype.kind != "f":
            raise InputError(f"{path}: w{n} and b{n} should hold floating-point numbers")
        if weight.ndim != 2 or bias.shape != weight.shape[:1]:
            raise InputError(
                f"{path}: w{n} {weight.shape} and b{n} {bias.shape} do not fit: (out, in) and (out,)"
            )
        if width is not None and weight.shape[1] != width:
            raise InputError(
                f"{path}: w{n} takes {weight.shape[1]} inputs, the layer before has {width} outputs"
            )
        if not (np.all(np.isfinite(weight)) and np.all(np.isfinite(bias))):
            raise InputError(f"{path}: w{n} or b{n} holds a value that is not finite")
        width = weight.shape[0]
        layers.append((weight, bias))
    return layers


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
            self.interface: PolicyInterface = make_interface(self.metadata.get("interface"))
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
        """Forgets the last episode. `control_period` in s."""
        self._num_rigs, self._period, self._fresh = int(num_rigs), float(control_period), True

    def act(self, observation: Floats) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n) as the environment gives them."""
        observation = np.asarray(observation)
        if observation.ndim != 2 or len(observation) != self._num_rigs:
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got observations {observation.shape}"
            )
        if self._fresh:
            inputs = self.interface.start(observation, self._period)
            self._fresh = False
        else:
            inputs = self.interface.see(observation)
        return self.interface.command(self.network(inputs))
