"""Checkpoints: everything a run needs to go on as if it had never stopped.

A checkpoint is a folder `checkpoints/step_000001000000` with the model and its optimiser (`model.zip`), the replay
buffer if there is one, the environment in the middle of its episodes, the state of all random generators, and the
run's own counters and curve. It is written beside its place and renamed, so what is there is whole; the one before is
removed only then. The files are pickles as those of Stable-Baselines3 are: load only what you wrote yourself.
"""

from __future__ import annotations

import json
import os
import pickle
import random
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from hydro_env.errors import InputError

__all__ = ["latest", "restore", "save", "write_whole"]


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file in one go: a temporary file beside it, then a rename."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def save(folder: Path, model: BaseAlgorithm, progress: dict[str, Any]) -> Path:
    """Writes a checkpoint into `folder`; `progress` is a JSON table with the count of steps as `steps`."""
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / f"step_{progress['steps']:012d}"
    work = Path(tempfile.mkdtemp(dir=folder, prefix=".unfinished-"))
    try:
        model.save(work / "model.zip")
        if isinstance(model, OffPolicyAlgorithm):
            assert model.replay_buffer is not None
            model.save_replay_buffer(work / "replay.pkl")
        with open(work / "env.pkl", "wb") as file:
            pickle.dump(model.env, file)
        with open(work / "generators.pkl", "wb") as file:
            # Stable-Baselines3 draws from NumPy's global generator.
            pickle.dump((torch.get_rng_state(), np.random.get_state(), random.getstate()), file)  # noqa: NPY002
        (work / "progress.json").write_text(json.dumps(progress, indent=1), encoding="utf-8")
        if place.exists():  # the same step again after a resume
            shutil.rmtree(place)
        os.replace(work, place)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    for other in _all(folder):
        if other != place:
            shutil.rmtree(other)
    for unfinished in folder.glob(".unfinished-*"):  # left behind by a run that was killed
        shutil.rmtree(unfinished)
    return place


def latest(folder: Path) -> Path | None:
    """The newest checkpoint, None if there is none."""
    found = _all(folder)
    return found[-1] if found else None


def restore(checkpoint: Path, algorithm: type[BaseAlgorithm]) -> tuple[BaseAlgorithm, dict[str, Any]]:
    """The model, in its environment, and the progress of a checkpoint; sets the random generators."""
    try:
        with open(checkpoint / "env.pkl", "rb") as file:
            content = file.read()
        # Loading seeds the environment it is given, which must not touch the one that goes on: it gets another copy.
        model = algorithm.load(
            checkpoint / "model.zip", env=pickle.loads(content), device="cpu", force_reset=False
        )
        env: VecEnv = pickle.loads(content)
        model.set_env(env, force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            # Not to be cut off at the newest sample: the environment goes on where it was.
            model.load_replay_buffer(checkpoint / "replay.pkl", truncate_last_traj=False)
        with open(checkpoint / "generators.pkl", "rb") as file:
            of_torch, of_numpy, of_python = pickle.load(file)
        progress = json.loads((checkpoint / "progress.json").read_text(encoding="utf-8"))
    except (
        OSError,
        EOFError,
        KeyError,
        ValueError,
        AttributeError,
        ImportError,
        pickle.UnpicklingError,
    ) as problem:
        raise InputError(f"{checkpoint}: cannot be resumed ({type(problem).__name__}: {problem})") from None
    torch.set_rng_state(of_torch)
    np.random.set_state(of_numpy)  # noqa: NPY002
    random.setstate(of_python)
    return model, progress


def _all(folder: Path) -> list[Path]:
    return sorted(folder.glob("step_*"))
