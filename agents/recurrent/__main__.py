"""Trains a recurrent policy: `python -m agents.recurrent --config configs/gru.yml [--resume] --out DIR`.

Two stages: it imitates the law (`imitation`), then it is improved by the gradient through the simulator
(`simulator_gradient`). What is scored and exported is the running mean of the weights. With `--from POLICY` the second stage goes
on from a trained policy.

DIR receives `policy.npz`, the policy with the best score on the split `val`; `curve.json`, the scores over control periods of
single rigs and over time; `checkpoint.pt`, from which `--resume` goes on with new episodes; and `config.yml`, the file the run
was started with.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small networks: more threads only get in each other's way

import argparse
import io
import json
import platform
import sys
import time
from pathlib import Path
from statistics import geometric_mean
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from agents.command import run_command
from agents.recurrent.imitation import NOTES, ImitationStage
from agents.recurrent.network import RecurrentPolicy
from agents.recurrent.rigs import KNOWN
from agents.recurrent.settings import MILLION, Settings, Training, read_settings
from agents.recurrent.simulator_gradient import GradientStage
from hydro_env.controllers import CONTROLLERS
from hydro_env.errors import InputError
from hydro_env.files import naming, write_bytes
from hydro_env.training.evaluate import evaluate
from hydro_env.training.export import write_policy
from hydro_env.training.lock import alone_in

STAGES: dict[str, type[ImitationStage] | type[GradientStage]] = {
    "imitation": ImitationStage,
    "gradient": GradientStage,
}
MEAN = {"imitation": 0.98, "gradient": 0.99}
"""Share of the running mean of the weights that a window keeps."""


class Run:
    """Policy, running mean, progress and files of a run."""

    def __init__(self, settings: Settings, out: Path, command: str, start: Path | None = None) -> None:
        self.settings, self.out, self.command = settings, out, command
        torch.manual_seed(settings.training.seed)
        n = settings.network
        self.policy, self.mean = (
            RecurrentPolicy((n.inputs, n.recurrent, n.outputs), KNOWN + NOTES) for _ in range(2)
        )
        if start is not None:
            self.policy.take(start)
        self.mean.load_state_dict(self.policy.state_dict())
        self.progress: dict[str, Any] = {
            "stage": "gradient" if start else "imitation",
            "done": 0, "seconds": 0.0, "cpu_seconds": 0.0, "best": float("inf"), "curve": [], "before": 0
        }  # fmt: skip
        self.optimiser: dict[str, Any] | None = None

    def average(self, keep: float) -> None:
        """Moves the running mean towards the weights."""
        with torch.no_grad():
            for mean, weight in zip(self.mean.parameters(), self.policy.parameters(), strict=True):
                mean.lerp_(weight, 1.0 - keep)

    def save(self) -> None:
        """Writes the checkpoint in one go."""
        memory = io.BytesIO()
        state = {
            "policy": self.policy.state_dict(), "mean": self.mean.state_dict(), "optimiser": self.optimiser,
            "progress": json.dumps(self.progress),
        }  # fmt: skip
        torch.save(state, memory)
        write_bytes(self.out / "checkpoint.pt", memory.getvalue())

    def restore(self) -> None:
        """Goes on from the checkpoint. InputError if it cannot be read."""
        path = self.out / "checkpoint.pt"
        try:
            state = torch.load(path, weights_only=True)  # numbers and text alone: nothing in it is run
            self.policy.load_state_dict(state["policy"])
            self.mean.load_state_dict(state["mean"])
            self.progress, self.optimiser = json.loads(state["progress"]), state["optimiser"]
        except Exception as problem:  # any damage, or another network
            reason = " ".join(f"{type(problem).__name__}: {problem}".split())
            raise InputError(f"{path}: cannot be resumed ({reason}); delete it to start over") from None

    def evaluate(self) -> dict[str, float]:
        """Scores the running mean on `val`, exports it if it is the best so far, and adds to the curve."""
        training, progress = self.settings.training, self.progress
        about = {
            **self.mean.metadata(), "algorithm": "gru", "config": self.settings.text, "command": self.command,
            "seed": training.seed, "steps": self.periods, "env_kwargs": self.settings.env, "versions": _versions(),
        }  # fmt: skip
        candidate = self.out / ".candidate.npz"
        write_policy(candidate, self.mean.arrays(), about)
        of_groups = [evaluate(candidate, training.pairs, env) for env, _ in self.settings.driven]
        scores = of_groups[0]
        for n, other in enumerate(of_groups[1:], 2):
            scores |= {f"{key}_{n}": value for key, value in other.items()}
        score = geometric_mean(_score(scores, training) for scores in of_groups)
        times = {key: round(progress[key], 1) for key in ("seconds", "cpu_seconds")}
        progress["curve"].append(
            {"steps": self.periods, "stage": progress["stage"], **times, "score": score, **scores}
        )
        if score < progress["best"]:
            progress["best"] = score
            val = {"pairs": training.pairs, "score": score, "scenario": "setpoint_steps", **scores}
            write_policy(self.out / "policy.npz", self.mean.arrays(), {**about, **times, "val": val})
        candidate.unlink()
        write_bytes(self.out / "curve.json", json.dumps(progress["curve"], indent=1).encode())
        return scores

    @property
    def periods(self) -> int:
        """Control periods of all stages so far."""
        return int(self.progress["before"]) + int(self.progress["done"])


def train(
    settings: Settings, out: Path, *,
    resume: bool = False, command: str = "", bar: bool = True, start: Path | None = None,
) -> Run:  # fmt: skip
    """Trains or goes on training; from a policy file `start` on without the first stage. InputError if the folder or the file do
    not fit what is asked for."""
    torch.set_num_threads(1)
    with alone_in(out), naming(out):
        run = Run(settings, out, command, start)
        exists = (out / "checkpoint.pt").is_file()
        if exists and not resume:
            raise InputError(f"{out}: holds a run already; go on with --resume, or name another folder")
        if resume and not exists:
            raise InputError(f"{out}: holds no checkpoint to resume from")
        if exists:
            run.restore()
        else:
            write_bytes(out / "config.yml", settings.text.encode())
            if start is not None:
                run.evaluate()  # what it begins with stays if nothing better is found
        imitates = run.progress["stage"] == "imitation" or run.progress["before"] > 0
        total = int((settings.imitation.periods * imitates + settings.gradient.periods) * MILLION)
        with tqdm(total=total, initial=run.periods, unit="period", unit_scale=True, disable=not bar) as shown:
            for name in list(STAGES)[list(STAGES).index(run.progress["stage"]) :]:
                if name != run.progress["stage"]:
                    run.progress.update(stage=name, done=0, before=run.periods)
                    run.optimiser = None
                _train_stage(run, name, shown)
        return run


def _train_stage(run: Run, name: str, shown: Any) -> None:
    """Goes on with a stage to its end."""
    stage = STAGES[name](run.settings, run.policy, run.progress["done"])
    if run.optimiser is not None:
        stage.optimiser.load_state_dict(run.optimiser)
    every = run.settings.training.evaluate * MILLION
    due, windows = stage.done + every, 0
    means: dict[str, float] = {}
    clock, cpu = time.monotonic(), time.process_time()
    while stage.done < stage.total:
        said = stage.window()
        windows += 1
        run.average(min(MEAN[name], windows / (windows + 10.0)))
        means = {
            key: means.get(key, value) + 0.05 * (value - means.get(key, value)) for key, value in said.items()
        }
        last, run.progress["done"] = run.progress["done"], stage.done
        shown.update(stage.done - last)
        shown.set_postfix({key: f"{value:.3g}" for key, value in means.items()})
        if stage.done >= min(due, stage.total):
            now, spent = time.monotonic(), time.process_time()
            run.progress["seconds"] += now - clock
            run.progress["cpu_seconds"] += spent - cpu
            clock, cpu, due = now, spent, stage.done + every
            scores = run.evaluate()
            run.optimiser = stage.optimiser.state_dict()
            run.save()
            ends = ["", *(f"_{n}" for n in range(2, len(run.settings.driven) + 1))]
            told = (
                f"{scores[f'max_speed_difference_rpm{e}']:.1f} at {scores[f'tracking_mae_rpm{e}']:.1f} rpm"
                f" (p95 {scores[f'max_speed_difference_rpm_p95{e}']:.0f})"
                for e in ends
            )
            shown.write(
                f"{run.periods / MILLION:.1f} M periods, {run.progress['seconds']:.0f} s: largest difference at tracking error "
                + ", ".join(told)
            )


def _score(scores: dict[str, float], training: Training) -> float:
    """What an evaluation is chosen by, rpm."""
    return (
        scores["max_speed_difference_rpm"]
        + training.tracking_weight * scores["tracking_mae_rpm"]
        + training.tail_weight * scores["max_speed_difference_rpm_p95"]
    )


def _versions() -> dict[str, str]:
    """What the numbers of a run depend on."""
    return {"python": platform.python_version(), "numpy": np.__version__, "torch": torch.__version__}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.recurrent", description=__doc__)
    parser.add_argument("--config", type=Path, required=True, help="training file, see configs/gru.yml")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.add_argument("--from", dest="start", help="policy whose training goes on: gru_any, or a file")
    given = parser.parse_args()
    command = " ".join(["python -m agents.recurrent", *sys.argv[1:]])

    def run() -> None:
        entry = CONTROLLERS.get(given.start)
        named = entry.file if entry is not None else None
        start = named or (Path(given.start) if given.start else None)
        train(
            read_settings(given.config), given.out,
            resume=given.resume, command=command, bar=not given.quiet, start=start,
        )  # fmt: skip

    run_command(run)


if __name__ == "__main__":
    main()
