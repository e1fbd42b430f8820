"""Learning curves of the usual algorithms on equal terms, and the line to beat (`agents.line_to_beat`):
`python -m agents.baselines --agents ppo sac tqc --steps 1000000 --seeds 5 --out runs/baselines`.

`AGENTS` says what there is: algorithms of Stable-Baselines3 at their default settings and with those of a recipe, both on the
recipe's rigs, observations and reward; PPO in one file; clones of controllers. OUT/STEPS/AGENT/seed_N receives for every seed
`curve.json`, scores on pairs of `val` over control periods, wall and processor time, and the agent with the best mean return.
OUT receives `baselines.md`, `.png` and `.json` of all that was trained there so far, scored on pairs that chose nothing, and
`line_to_beat.md`: the best controller of each class on the same episodes. The same command again goes on with the seeds that are
not finished; without `--agents` nothing is trained.

`--lines` measures the classical controllers on every rung of a ladder of tasks and writes `ladder.md`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents import ppo_single
from agents.cloning import clone
from agents.command import run_command
from agents.line_to_beat import ladder, report
from hydro_env.controllers.learned.policy_interface import FramesInterface, make_interface
from hydro_env.controllers.learned.sb3_policy import Sb3Policy
from hydro_env.limits import Limits
from hydro_env.training.config import POLICY, read_config, with_changes
from hydro_env.training.recipes import recipe
from hydro_env.training.train import make_model


@dataclass(frozen=True)
class Agent:
    """What is trained: an algorithm of a library on the rigs, observations and reward of a recipe, `tuned` with its settings as
    well and not the library's own; or the clone of a `teacher`; otherwise `agents.ppo_single`."""

    title: str
    algorithm: str = ""
    recipe: str = ""
    tuned: bool = False
    teacher: str = ""


AGENTS = {
    "ppo": Agent("PPO, default settings", "stable_baselines3.PPO", "ppo_short"),
    "sac": Agent("SAC, default settings", "stable_baselines3.SAC", "sac"),
    "ppo_recipe": Agent("PPO, recipe", "stable_baselines3.PPO", "ppo_short", tuned=True),
    "ppo_single": Agent("PPO in one file, the recipe's settings"),
    "sac_recipe": Agent("SAC, recipe", "stable_baselines3.SAC", "sac", tuned=True),
    "tqc": Agent("TQC, settings of the SAC recipe", "sb3_contrib.TQC", "sac", tuned=True),
    "recurrent_ppo": Agent(
        "RecurrentPPO, the PPO recipe and an LSTM of 64", "sb3_contrib.RecurrentPPO", "ppo_short", tuned=True
    ),
    "clone_cross_coupled": Agent("clone of `cross_coupled`", teacher="cross_coupled"),
    "clone_probing_flow": Agent("clone of `probing_flow`", teacher="probing_flow"),
}
#: Pairs of `val` by which an agent is chosen; the next ones score it.
CHOOSING, POINTS = 100, 10


class InTraining(Sb3Policy):
    """A model of Stable-Baselines3 that is being trained, as a controller."""

    def __init__(self, model: BaseAlgorithm, interface: FramesInterface) -> None:
        self.name, self.interface, self._model = "in training", interface, model


class Scores(BaseCallback):
    """Scores a model between rollouts, and keeps the best as `agent.zip`."""

    def __init__(self, folder: Path, every: float, pairs: int, interface: FramesInterface) -> None:
        super().__init__()
        self.folder, self.every, self.pairs, self.interface = folder, every, pairs, interface
        self.curve, self.begun = list[dict[str, Any]](), ppo_single.clocks()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self._score(self.every)

    def _on_training_end(self) -> None:
        self._score(1)

    def _score(self, least: float) -> None:
        """Scores the model if it was trained for at least that many periods since the last time."""
        if self.num_timesteps - (self.curve[-1]["steps"] if self.curve else 0) >= least:
            agent = InTraining(self.model, self.interface)
            if ppo_single.score(agent, self.curve, self.num_timesteps, self.begun, self.folder, self.pairs):
                self.model.save(self.folder / "agent.zip")


def train(name: str, steps: int, seed: int, folder: Path, pairs: int = CHOOSING) -> None:
    """Trains an agent of `AGENTS` for that many control periods; writes curve and best agent into the folder."""
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    agent = AGENTS[name]
    if agent.teacher:
        clone(agent.teacher, steps, seed, folder, POINTS, pairs)
    elif agent.algorithm:
        model, interface = make(agent, steps, seed)
        model.learn(steps, callback=Scores(folder, steps / POINTS, pairs, interface))
    else:
        ppo_single.train(steps, seed, folder, POINTS, pairs)


def make(agent: Agent, steps: int, seed: int) -> tuple[BaseAlgorithm, FramesInterface]:
    """The model before training, and what lies around its network."""
    library, _, kind = agent.algorithm.partition(".")
    algorithm = getattr(import_module(library), kind)
    config = with_changes(read_config(recipe(agent.recipe)), steps=steps, seed=seed)
    settings, policy = dict(config.hyper) if agent.tuned else {}, POLICY
    if kind.startswith("Recurrent"):
        settings["policy_kwargs"] = {**settings["policy_kwargs"], "lstm_hidden_size": 64}
        policy = "MlpLstmPolicy"
    model = algorithm(policy, make_model(config).get_env(), seed=seed, device="cpu", **settings)
    return model, make_interface(config.training.interface)


def train_all(arguments: argparse.Namespace) -> None:
    """Trains what is not finished of every agent's seeds, agent by agent."""
    for name in arguments.agents:
        for seed in range(arguments.seeds):
            folder = arguments.out / str(arguments.steps) / name / f"seed_{seed}"
            if not (folder / "finished").is_file():
                print(f"{name}, seed {seed}", flush=True)
                train(name, arguments.steps, seed, folder, arguments.pairs)
                (folder / "finished").touch()


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m agents.baselines",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--agents", choices=AGENTS, nargs="*", default=[], help="to train")
    parser.add_argument(
        "--steps", type=Limits(1, 10**12, whole=True), default=10**6, help="control periods of each seed"
    )
    parser.add_argument("--seeds", type=Limits(1, 1000, whole=True), default=5, help="how many, from 0 on")
    parser.add_argument(
        "--pairs", type=Limits(1, 500, whole=True), default=CHOOSING, help="episodes of an evaluation"
    )
    parser.add_argument("--lines", action="store_true", help="the classical controllers alone, on every rung")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    arguments = parser.parse_args()

    def run() -> None:
        if arguments.lines:
            ladder(arguments.out, arguments.pairs)
            return
        train_all(arguments)
        report(arguments.out, {name: agent.title for name, agent in AGENTS.items()}, arguments.pairs)

    run_command(run)


if __name__ == "__main__":
    main()
