"""PPO in one file: `python -m agents.ppo_single --steps 8000000 --seed 0 --out runs/ppo_single`.

Proximal policy optimisation (Schulman and others, 2017) in the style of CleanRL (Huang and others, 2022), to be read and
changed: PyTorch, NumPy, Gymnasium and the native batch of rigs. Settings are those of configs/ppo_short.yml. OUT receives
`curve.json`, scores on pairs of `val` over control periods and time, and `policy.npz`, the policy with the best return, which
`hydro-env benchmark runs/ppo_single/policy.npz` drives.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Normal

from hydro_env.controllers.learned.policy import SCHEMA
from hydro_env.training.evaluate import evaluate

RIGS, LENGTH = 128, 64  # the batch and the periods of a rollout
RATE, GAMMA, LAMBDA, CLIP, EPOCHS, BATCH, LOG_STD = 1e-3, 0.99, 0.95, 0.2, 4, 2048, -2.0
#: Actions change the commands, the last two observations are seen with their errors, returns are of about one.
SMALL = {"tracking": 0.08, "difference": 0.18, "variation": 0.002}
ENV: dict[str, Any] = {"increment": 0.3, "history": 2, "errors": True, "reward": SMALL}
#: The same in a policy file.
INTERFACE = {"kind": "frames", "frames": 2, "increment": 0.3, "errors": True}
SCENARIOS = ("random_steps", "setpoint_steps")


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Two hidden layers of 64; weights are orthogonal, with `gain` in the last layer."""
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, size in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, size)  # type: ignore[arg-type]
        nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
    return nn.Sequential(*layers)


def export(policy: nn.Sequential, path: Path) -> None:
    """Writes the policy file of a network, see `hydro_env.controllers.learned.policy`."""
    arrays: dict[str, Any] = {}
    for n, layer in enumerate(each for each in policy if isinstance(each, nn.Linear)):
        arrays |= {f"w{n}": layer.weight.detach().numpy(), f"b{n}": layer.bias.detach().numpy()}
    about = {"schema": SCHEMA, "activation": "tanh", "squash": "clip", "interface": INTERFACE}
    np.savez_compressed(path, metadata=np.array(json.dumps(about)), **arrays)


def rigs(seed: int) -> tuple[Any, NDArray[np.float32]]:
    """The environment, whose episodes begin at different times so that a rollout holds every phase of one, and what it shows."""
    env: Any = gymnasium.make_vec(
        "hydro_env:HydraulicSync-v0", num_envs=RIGS, autoreset_mode="SameStep", **ENV
    )
    env.reset(seed=seed * 2**40)  # far apart: runs share no episode
    for group in range(16):
        env.reset(options={"reset_mask": np.arange(RIGS) % 16 == group})
        for _ in range(env.unwrapped.episode_steps // 16):
            observation, *_ = env.step(np.zeros((RIGS, 2), np.float32))
    return env, observation


def advantages(reward: Tensor, value: Tensor, ended: Tensor, following: Tensor) -> Tensor:
    """Generalised advantage estimation (Schulman and others, 2016); `following` is the value (RIGS,) after the last period."""
    advantage, after = torch.zeros_like(value), torch.zeros(RIGS)
    for t in reversed(range(LENGTH)):
        error = reward[t] + GAMMA * following * (1.0 - ended[t]) - value[t]
        advantage[t] = after = error + GAMMA * LAMBDA * (1.0 - ended[t]) * after
        following = value[t]
    return advantage


def score(
    agent: Any, curve: list[dict[str, Any]], steps: int, begun: tuple[float, float], out: Path, pairs: int
) -> bool:
    """Adds a point to a learning curve: the scores of a policy file or policy on pairs of `val` after these control periods,
    and the time that passed on both `clocks`. Returns whether its mean return is the best so far."""
    wall, cpu = (round(now - then, 1) for now, then in zip(clocks(), begun, strict=True))
    scores = {name: evaluate(agent, pairs, {}, name) for name in SCENARIOS}
    point = {"steps": steps, "seconds": wall, "cpu_seconds": cpu, **scores[SCENARIOS[0]], "scenarios": scores}
    curve.append(point)
    (out / "curve.json").write_text(json.dumps(curve, indent=1))
    print(f"{steps} control periods, {wall:.0f} s: mean return {point['mean_return']:.1f}", flush=True)
    return bool(point["mean_return"] >= max(each["mean_return"] for each in curve))


def clocks() -> tuple[float, float]:
    """Wall and processor time, s."""
    return time.monotonic(), time.process_time()


def train(steps: int, seed: int, out: Path, points: int = 10, pairs: int = 100) -> nn.Sequential:
    """Trains for at least `steps` control periods of single rigs, with `points` evaluations; returns the last policy."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    env, observation = rigs(seed)
    inputs = observation.shape[1]
    policy, critic = network(inputs, 2, 0.01), network(inputs, 1, 1.0)
    log_std = nn.Parameter(torch.full((2,), LOG_STD))
    weights = [*policy.parameters(), log_std, *critic.parameters()]
    optimiser = torch.optim.Adam(weights, lr=RATE, eps=1e-5)
    seen, acted = torch.zeros(LENGTH, RIGS, inputs), torch.zeros(LENGTH, RIGS, 2)
    log_prob, reward, value, ended = (torch.zeros(LENGTH, RIGS) for _ in range(4))
    curve: list[dict[str, Any]] = []
    rollouts, begun = -(-steps // (LENGTH * RIGS)), clocks()

    def values(inputs: Any) -> Tensor:
        return critic(torch.as_tensor(inputs)).squeeze(-1)  # type: ignore[no-any-return]

    for rollout in range(1, rollouts + 1):
        optimiser.param_groups[0]["lr"] = RATE * (1.0 - (rollout - 1) / rollouts)
        with torch.no_grad():
            for t in range(LENGTH):
                seen[t] = torch.from_numpy(observation)
                actions = Normal(policy(seen[t]), log_std.exp())
                acted[t] = actions.sample()
                log_prob[t], value[t] = actions.log_prob(acted[t]).sum(-1), values(seen[t])
                observation, earned, stopped, over, info = env.step(acted[t].clamp(-1.0, 1.0).numpy())
                reward[t], ended[t] = torch.from_numpy(earned), torch.from_numpy(stopped | over)
                if over.any():  # the time was up: what would have followed is worth what the critic says
                    reward[t, over] += GAMMA * values(np.stack(info["final_obs"][over]))
            advantage = advantages(reward, value, ended, values(observation))
        batch = [each.flatten(0, 1) for each in (seen, acted, log_prob, advantage, advantage + value)]
        for _ in range(EPOCHS):
            for rows in torch.randperm(LENGTH * RIGS).split(BATCH):
                saw, action, before, gain, target = (each[rows] for each in batch)
                ratio = (Normal(policy(saw), log_std.exp()).log_prob(action).sum(-1) - before).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                improvement = torch.min(gain * ratio, gain * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
                loss = 0.5 * (values(saw) - target).square().mean() - improvement
                optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(weights, 0.5)
                optimiser.step()
        if rollout * points // rollouts > (rollout - 1) * points // rollouts:
            export(policy, out / "candidate.npz")
            if score(out / "candidate.npz", curve, rollout * LENGTH * RIGS, begun, out, pairs):
                (out / "candidate.npz").replace(out / "policy.npz")
    return policy


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m agents.ppo_single", description=__doc__)
    parser.add_argument("--steps", type=int, default=8_000_000, help="control periods of single rigs")
    parser.add_argument("--seed", type=int, default=0, help="of network, exploration and rigs")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    given = parser.parse_args()
    train(given.steps, given.seed, given.out)
