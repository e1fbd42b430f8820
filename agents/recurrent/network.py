"""The network: a dense layer of steep and gentle units, a gated recurrent unit, a dense layer, two commands."""

from __future__ import annotations

from math import log
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hydro_env.controllers.learned.policy import read_policy
from hydro_env.controllers.learned.policy_interface import FramesInterface
from hydro_env.envs.observation import FRAME, OBSERVATION
from hydro_env.errors import InputError

FRAMES = 2
"""Observations that the network sees at a time: the newest and the one before, so that it need not learn to subtract."""
STEEPNESS = (0.7, 3.0, 12.0, 40.0, 7.0)
"""Of the first layer's units. A scaled speed of 1 is 600 rpm: the steepest are saturated from 20 rpm on."""

LASTING = (1.5, 1000.0)
"""Shortest and longest memory of the recurrent units at the start of the training, control periods."""


class RecurrentPolicy(nn.Module):
    """`sizes`: units of the dense layer, the recurrent one, and the dense layer behind it. A second head on the recurrent state
    gives `notes` numbers. It is trained with the others, so that the state holds what is needed, and not exported."""

    def __init__(self, sizes: tuple[int, int, int], notes: int) -> None:
        super().__init__()
        self.num_inputs = FRAMES * FRAME
        self.sizes = sizes
        before, units, behind = sizes
        self.encode, self.remember = nn.Linear(self.num_inputs, before), nn.GRUCell(before, units)
        self.decode, self.act = nn.Linear(units, behind), nn.Linear(behind, 2)
        self.note = nn.Linear(units, notes)
        with torch.no_grad():
            self.encode.weight.copy_(_first_weights(before)).add_(0.02 * torch.randn(before, self.num_inputs))
            self.encode.bias.zero_()
            self.act.weight.mul_(0.3)
            # Units that forget after LASTING periods (chrono initialisation; Tallec and Ollivier, Can recurrent neural networks
            # warp time?, 2018). With torch's own start all forget after two, and the edges found at rest are never learnt.
            lasting = torch.exp(torch.linspace(*(log(periods) for periods in LASTING), units))
            self.remember.bias_ih[units : 2 * units] = torch.log(lasting - 1.0)
            self.remember.bias_hh[units : 2 * units] = 0.0

    @property
    def units(self) -> int:
        """Numbers of the recurrent state."""
        return self.remember.hidden_size

    def step(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Commands (N, 2), not limited yet, and the next state (N, units) for inputs (N, num_inputs)."""
        state = self.remember(torch.tanh(self.encode(inputs)), state)
        return self.act(torch.tanh(self.decode(state))), state

    def forward(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Commands (T, N, 2) and notes (T, N, n) for a window of inputs (T, N, num_inputs), from a state (N, units) on."""
        cell = self.remember
        states = torch.gru(
            torch.tanh(self.encode(inputs)), state[None], [cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh],
            True, 1, 0.0, self.training, False, False,
        )[0]  # fmt: skip
        return self.act(torch.tanh(self.decode(states))), self.note(states)

    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """The arrays of a policy file."""
        return {name: value.detach().numpy().copy() for name, value in self._named().items()}

    def _named(self) -> dict[str, Tensor]:
        """What is exported, by the names in a policy file."""
        cell = self.remember
        return {
            "w0": self.encode.weight, "b0": self.encode.bias,
            "w1": cell.weight_ih, "b1": cell.bias_ih, "v1": cell.weight_hh, "c1": cell.bias_hh,
            "w2": self.decode.weight, "b2": self.decode.bias, "w3": self.act.weight, "b3": self.act.bias,
        }  # fmt: skip

    def take(self, path: Path) -> None:
        """Takes over the weights of a policy file. InputError for one that is not of such a network."""
        network, metadata = read_policy(path)
        own = self.arrays()
        given = {
            f"{letter}{n}": array
            for n, layer in enumerate(network.layers)
            for letter, array in zip("wbvc", layer, strict=False)
        }
        shapes = {name: array.shape for name, array in given.items()}
        alike = all(metadata.get(key) == value for key, value in self.metadata().items())
        if not alike or shapes != {name: array.shape for name, array in own.items()}:
            raise InputError(f"{path}: its network is not the one of the training file, {self.sizes} units")
        with torch.no_grad():
            for name, weights in self._named().items():
                weights.copy_(torch.from_numpy(given[name].astype(np.float32)))

    @staticmethod
    def metadata() -> dict[str, Any]:
        """What a policy file says of the network."""
        return {"activation": "tanh", "squash": "clip", "interface": FramesInterface(FRAMES).table()}


def _first_weights(units: int) -> Tensor:
    """Weights (units, inputs) with which the first layer shows errors, the speed difference and every signal at several
    steepnesses: within the noise a start of random weights would see none of them."""
    newest = {name: (FRAMES - 1) * FRAME + n for n, name in enumerate(OBSERVATION)}
    signals: list[dict[int, float]] = [
        {newest["speed_1"]: 1.0, newest["setpoint"]: -1.0},
        {newest["speed_2"]: 1.0, newest["setpoint"]: -1.0},
        {newest["speed_1"]: 1.0, newest["speed_2"]: -1.0},
        *({newest[name]: 0.5 if name.startswith("pressure") else 1.0} for name in OBSERVATION),
        *({newest[name]: 1.0, newest[name] - FRAME: -1.0} for name in ("speed_1", "speed_2")),
    ]
    weights = torch.zeros(units, FRAMES * FRAME)
    for unit in range(units):
        steepness = STEEPNESS[unit // len(signals) % len(STEEPNESS)]
        for column, weight in signals[unit % len(signals)].items():
            weights[unit, column] = steepness * weight
    return weights
