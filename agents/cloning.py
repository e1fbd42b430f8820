"""Behaviour cloning: a network without memory learns to command what a controller commands, from the controller's episodes."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from agents.ppo_single import INTERFACE, clocks, export, network, score
from hydro_env.controllers import make_controller
from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.controllers.rollout import Step, roll_out

RIGS, EPOCHS, BATCH, RATE = 128, 5, 2048, 1e-3


def demonstrations(teacher: str, first: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Inputs (n, features) and wanted outputs (n, 2) of a network, from an episode of `random_steps` on each of 128 pairs of
    `train` that the controller drives, from that seed on."""
    steps: list[Step] = []
    roll_out(
        make_controller(teacher),
        range(first, first + RIGS),
        mismatch="train",
        scenario="random_steps",
        steps=steps,
    )
    interface = make_interface(INTERFACE)
    inputs, outputs = list[NDArray[Any]](), list[NDArray[Any]]()
    for step, following in pairwise(steps):
        assert following.action is not None
        inputs.append(interface.see(step.observation) if inputs else interface.start(step.observation))
        change = (following.action - step.observation[:, -2:]) / interface.increment
        outputs.append(np.clip(change, -1.0, 1.0).astype(np.float32))
    return torch.from_numpy(np.concatenate(inputs)), torch.from_numpy(np.concatenate(outputs))


def clone(teacher: str, steps: int, seed: int, out: Path, points: int, pairs: int) -> None:
    """Learns from at least `steps` control periods of a controller: after each of `points` shares of them a few passes over all
    that was driven, and a score. Writes `curve.json` and `policy.npz` as `agents.ppo_single` does."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    policy = network(make_interface(INTERFACE).num_features, 2, 0.01)
    optimiser = torch.optim.Adam(policy.parameters())
    curve: list[dict[str, Any]] = []
    inputs, outputs, begun = torch.empty(0), torch.empty(0), clocks()
    episodes = seed * 2**40  # far apart: runs share no episode
    for point in range(points):
        while len(inputs) < steps * (point + 1) / points:
            new = demonstrations(teacher, episodes)
            inputs, outputs = (torch.cat(pair) for pair in zip((inputs, outputs), new, strict=True))
            episodes += RIGS
        optimiser.param_groups[0]["lr"] = RATE * (1.0 - point / points)
        for _ in range(EPOCHS):
            for rows in torch.randperm(len(inputs)).split(BATCH):
                loss = (policy(inputs[rows]) - outputs[rows]).abs().mean()
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
                optimiser.step()
        export(policy, out / "candidate.npz")
        if score(out / "candidate.npz", curve, len(inputs), begun, out, pairs):
            (out / "candidate.npz").replace(out / "policy.npz")
