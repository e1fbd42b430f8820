"""Trains a policy, or goes on training it.

The folder of a run receives `policy.npz`, the policy with the best score on the split `val`; `curve.json`, the scores over
steps, wall and processor time, those of each scenario under `scenarios`; `checkpoints/`, the newest state, from which a resumed
run goes on exactly; `tensorboard/`; and `config.yml`, the file the run was started with. With one seed, the same versions and the
same machine a run gives the same policy, whether it was interrupted or not.
"""

import inspect
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small networks: more threads only get in each other's way

import numpy as np
import stable_baselines3
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecMonitor
from tqdm import tqdm

from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.errors import InputError
from hydro_env.files import naming, write_text
from hydro_env.sb3 import HydraulicSyncVecEnv
from hydro_env.training import checkpoint
from hydro_env.training.config import POLICY, Config
from hydro_env.training.evaluate import evaluate
from hydro_env.training.export import export_policy
from hydro_env.training.lock import alone_in

#: Between the first rigs of the runs of two successive seeds: more than the rigs of any run.
SEED_SPACING = 2**40


class TrainingRigs(VecMonitor):
    """The rigs that a policy is trained on: reports the returns of episodes, and can be pickled with a checkpoint."""

    def __getstate__(self) -> dict[str, Any]:
        """All but the table of class members that the base class keeps, which cannot be pickled."""
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds the rigs so that runs of different seeds share no episode, however many rigs they have."""
        return list(self.venv.seed(None if seed is None else seed * SEED_SPACING))


class Run(BaseCallback):
    """Checkpoints, evaluations and the progress bar of a run.

    Everything happens between two rollouts, where the state of an algorithm is whole. Counts are control periods of
    single rigs; Stable-Baselines3 counts a rig once for each row of its interface.
    """

    def __init__(
        self,
        config: Config,
        out: Path,
        command: str,
        progress: dict[str, Any],
        bar: bool,
        report: Callable[[int, float], None] | None = None,
    ) -> None:
        super().__init__()
        self.config, self.out, self.command, self.progress = config, out, command, progress
        self.report = report
        total, begun = config.num_steps, progress["steps"]
        self._bar = tqdm(total=total, initial=begun, unit="step", unit_scale=True, disable=not bar)
        self._since = time.monotonic() - progress["seconds"]
        self._cpu_since = time.process_time() - progress["cpu_seconds"]

    @property
    def steps(self) -> int:
        return int(self.model.num_timesteps)

    def _on_rollout_start(self) -> None:
        training = self.config.training
        if self.steps - self.progress["evaluated"] >= training.evaluate_every:
            self.evaluate()
        if self.steps - self.progress["steps"] >= training.checkpoint_every:
            self.save()

    def _on_step(self) -> bool:
        self._bar.update(self.steps - self._bar.n)
        return True

    def _on_training_end(self) -> None:
        if self.progress["evaluated"] != self.steps:
            self.evaluate()
        if self.progress["steps"] != self.steps:
            self.save()
        self._bar.close()

    def save(self) -> None:
        """Writes a checkpoint and the curve that belongs to it."""
        self.progress |= {"steps": self.steps, **self.times()}
        checkpoint.save(self.out / "checkpoints", self.model, self.progress)

    def times(self) -> dict[str, float]:
        """Wall and processor time of the run, s."""
        return {
            "seconds": round(time.monotonic() - self._since, 1),
            "cpu_seconds": round(time.process_time() - self._cpu_since, 1),
        }

    def evaluate(self) -> None:
        """Scores the present policy on `val`; exports it if it is the best so far."""
        training, candidate = self.config.training, self.out / ".candidate.npz"
        about = {
            "algorithm": training.algorithm, "config": self.config.text, "command": self.command,
            "seed": training.seed, "steps": self.steps, "env_kwargs": self.config.env_kwargs,
            "versions": versions(),
        }  # fmt: skip
        self._export(candidate, about)
        each = {
            name: evaluate(candidate, training.evaluate_pairs, self.config.env_kwargs, name)
            for name in training.evaluate_scenarios
        }
        names = "max_speed_difference_rpm", "tracking_mae_rpm", "max_speed_difference_rpm_p95"
        difference, tracking, tail = (np.mean([scores[name] for scores in each.values()]) for name in names)
        score = float(difference + training.tracking_weight * tracking + training.tail_weight * tail)
        first, times = training.evaluate_scenarios[0], self.times()
        scores = each[first]
        told = {"score": score, **scores, "scenarios": each}
        self.progress["curve"].append({"steps": self.steps, **times, **told})
        if score < self.progress["best"]:
            self.progress["best"] = score
            val = {"pairs": training.evaluate_pairs, "score": score, "scenario": first, **told}
            self._export(self.out / "policy.npz", {**about, **times, "val": val})
        candidate.unlink()
        self.progress["evaluated"] = self.steps
        write_text(self.out / "curve.json", json.dumps(self.progress["curve"], indent=1))
        for name, value in scores.items():
            self.logger.record(f"val/{name}", value)
        self.logger.record("val/score", score)
        self._bar.set_postfix(
            difference=f"{scores['max_speed_difference_rpm']:.1f}",
            tracking=f"{scores['tracking_mae_rpm']:.1f} rpm",
        )
        if self.report is not None:
            self.report(self.steps, score)

    def _export(self, path: Path, about: dict[str, Any]) -> None:
        export_policy(self.model, path, make_interface(self.config.training.interface).table(), about)


def versions() -> dict[str, str]:
    """What the numbers of a run depend on."""
    return {
        "python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__,
        "stable_baselines3": stable_baselines3.__version__,
    }  # fmt: skip


def staggered(rigs: HydraulicSyncVecEnv, groups: int = 16) -> list[dict[str, Any]]:
    """Options that let the first episodes end at different times, so that a rollout holds every phase of an episode."""
    batch = rigs.batch
    length = batch.episode_steps
    durations = [max(1, length * (group + 1) // groups) * batch.control_period for group in range(groups)]
    scenarios = [replace(batch.scenario, duration=duration) for duration in durations]
    return [{"scenario": scenarios[row % groups]} for row in range(rigs.num_envs)]


def make_model(config: Config) -> BaseAlgorithm:
    """An untrained model in its environment."""
    usual = {"mismatch": "train", "scenario": "random_steps", "control_period": 0.01}
    seen = make_interface(config.training.interface).env_kwargs()
    try:
        rigs = HydraulicSyncVecEnv(config.num_envs, **{**usual, **config.env_kwargs, **seen})
    except TypeError as problem:
        raise InputError(f"{config.path}: env_kwargs: {problem}") from None
    rigs.set_options(staggered(rigs))
    env, seed = TrainingRigs(rigs), config.training.seed
    try:
        return config.algorithm(POLICY, env, seed=seed, device="cpu", **config.hyper)
    except Exception as problem:  # whatever the algorithm does not take
        said = " ".join(str(problem).split()) or type(problem).__name__
        raise InputError(f"{config.path}: {said}") from None


def train(
    config: Config,
    out: Path,
    *,
    resume: bool = False,
    command: str = "",
    bar: bool = True,
    report: Callable[[int, float], None] | None = None,
) -> dict[str, Any]:
    """Trains or goes on training; returns the run's counters and curve. `report` is called with the steps and score of every
    evaluation; what it raises ends the run."""
    torch.set_num_threads(1)
    with alone_in(out), naming(out):
        newest = _newest(config, out, resume)
        if newest is not None:
            model, progress = checkpoint.restore(newest, config.algorithm)
        else:
            model = make_model(config)
            times = {"seconds": 0.0, "cpu_seconds": 0.0}
            progress = {"steps": 0, **times, "evaluated": 0, "best": float("inf"), "curve": []}
            write_text(out / "config.yml", config.text)
        model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))
        run = Run(config, out, command, progress, bar, report)
        left = config.num_steps - model.num_timesteps
        if left > 0:
            model.learn(left, callback=run, log_interval=1, reset_num_timesteps=newest is None)
        return progress


def _newest(config: Config, out: Path, resume: bool) -> Path | None:
    """The checkpoint to go on from, None for a new run. InputError if the folder, the file and `resume` do not agree."""
    newest, begun = checkpoint.latest(out / "checkpoints"), out / "config.yml"
    if newest is not None and not resume:
        raise InputError(f"{out}: holds a run already; go on with --resume, or name another folder")
    if resume and newest is None and begun.is_file():
        print(f"{out}: the run was stopped before its first checkpoint, it starts over", file=sys.stderr)
    elif resume and newest is None:
        raise InputError(f"{out}: holds no checkpoint to resume from")
    if newest is not None and begun.is_file() and begun.read_text(encoding="utf-8") != config.text:
        raise InputError(f"{config.path}: differs from {begun}, with which the run began; resume with that")
    return newest
