"""Checkpoints: everything a run needs to go on as if it had never stopped.

A checkpoint is a folder `checkpoints/step_000001000000` with the model and its optimiser (`model.zip`), the replay
buffer if there is one, the environment in the middle of its episodes, the state of all random generators, and the
run's own counters and curve. It is written beside its place and renamed, so what is there is whole; the one before is
removed only then. The files are pickles as those of Stable-Baselines3 are, and run code when they are loaded. So they
are loaded only where no other user can have written them, and only if their checksums are right.
"""

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
from hydro_env.files import naming, sha256_of
from hydro_env.pickles import distrust

SUMS = "sha256.json"


def save(folder: Path, model: BaseAlgorithm, progress: dict[str, Any]) -> Path:
    """Writes a checkpoint into `folder`; `progress` is a JSON table with the count of steps as `steps`."""
    folder.mkdir(exist_ok=True)
    place = folder / f"step_{progress['steps']:012d}"
    work = Path(tempfile.mkdtemp(dir=folder, prefix=".unfinished-"))
    try:
        with naming(place):
            _write(work, model, progress)
            if place.exists():  # the same step again after a resume
                shutil.rmtree(place)
            os.replace(work, place)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        raise
    # Those before it, and what a run left behind that was killed.
    for other in {*_all(folder), *folder.glob(".unfinished-*")} - {place}:
        shutil.rmtree(other)
    return place


def latest(folder: Path) -> Path | None:
    """The newest checkpoint, None if there is none."""
    return next(reversed(_all(folder)), None)


def restore(checkpoint: Path, algorithm: type[BaseAlgorithm]) -> tuple[BaseAlgorithm, dict[str, Any]]:
    """The model, in its environment, and the progress of a checkpoint; sets the random generators.

    Raises InputError if it is damaged, or if another user can have written it.
    """
    _check(checkpoint)
    try:
        content = (checkpoint / "env.pkl").read_bytes()
        # Loading seeds the environment it is given, which must not touch the one that goes on: it gets another copy.
        other = pickle.loads(content)
        model = algorithm.load(checkpoint / "model.zip", env=other, device="cpu", force_reset=False)
        env: VecEnv = pickle.loads(content)
        model.set_env(env, force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            # Not to be cut off at the newest sample: the environment goes on where it was.
            model.load_replay_buffer(checkpoint / "replay.pkl", truncate_last_traj=False)
        of_torch, of_numpy, of_python = pickle.loads((checkpoint / "generators.pkl").read_bytes())
        progress = json.loads((checkpoint / "progress.json").read_text(encoding="utf-8"))
    except Exception as problem:  # whole, but of other versions: an old class may miss anything
        reason = " ".join(f"{type(problem).__name__}: {problem}".split())
        raise InputError(f"{checkpoint}: of other versions ({reason}): use those or {_AFRESH}") from None
    torch.set_rng_state(of_torch)
    np.random.set_state(of_numpy)  # noqa: NPY002
    random.setstate(of_python)
    return model, progress


_AFRESH = "delete the folder `checkpoints` to start over"


def _write(folder: Path, model: BaseAlgorithm, progress: dict[str, Any]) -> None:
    """The files of a checkpoint, and their checksums. All of it is on the disk at the end, also if the power fails."""
    model.save(folder / "model.zip")
    if isinstance(model, OffPolicyAlgorithm):
        assert model.replay_buffer is not None
        model.save_replay_buffer(folder / "replay.pkl")
    (folder / "env.pkl").write_bytes(pickle.dumps(model.env))
    # Stable-Baselines3 draws from NumPy's global generator.
    generators = torch.get_rng_state(), np.random.get_state(), random.getstate()  # noqa: NPY002
    (folder / "generators.pkl").write_bytes(pickle.dumps(generators))
    (folder / "progress.json").write_text(json.dumps(progress, indent=1), encoding="utf-8")
    sums = {path.name: sha256_of(path) for path in sorted(folder.iterdir())}
    (folder / SUMS).write_text(json.dumps(sums, indent=1), encoding="utf-8")
    for path in folder.iterdir():
        path.chmod(0o600)
        with open(path, "rb+") as file:
            os.fsync(file.fileno())


def _check(checkpoint: Path) -> None:
    """InputError for a damaged file, or one that another user can have written; nothing is loaded here."""
    try:
        sums = json.loads((checkpoint / SUMS).read_bytes())
        names = sorted(dict(sums))
    except (OSError, ValueError, TypeError) as problem:
        reason = problem.strerror if isinstance(problem, OSError) else "is damaged"
        raise InputError(f"{checkpoint / SUMS}: {reason}; put back a whole copy, or {_AFRESH}") from None
    for path in [checkpoint, *(checkpoint / name for name in names)]:
        try:
            reason = distrust(path)
            whole = path == checkpoint or sha256_of(path) == sums[path.name]
        except OSError as problem:
            raise InputError(f"{path}: {problem.strerror}; put back a whole copy, or {_AFRESH}") from None
        if reason:
            raise InputError(f"{path}: a checkpoint runs code when it is loaded, and {reason}")
        if not whole:
            raise InputError(f"{path}: is damaged; put back a whole copy, or {_AFRESH}")


def _all(folder: Path) -> list[Path]:
    return sorted(folder.glob("step_*"))
