"""Agents as Stable-Baselines3 saves them (`model.save("my_ppo.zip")`), trained on the plain observation.

Such a file holds pickled objects, and unpickling runs whatever code is in them. It is loaded only where the user says that its
origin is trusted. Needs the extra `agents`.
"""

from __future__ import annotations

import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.controllers.base import Floats
from hydro_env.controllers.input_guard import InputGuard, guarded
from hydro_env.envs.batch import INCREMENT
from hydro_env.envs.observation import ERRORS, FRAME, with_errors
from hydro_env.errors import InputError, InputWarning
from hydro_env.reading import check_file

__all__ = ["Sb3Policy"]


class Sb3Policy:
    """Drives with the deterministic action of a saved agent; one that was trained with `history` gets its frames, one that was
    trained with `increment` (HydraulicSyncIncrement-v0: 0.3) changes its commands by its actions. One that was trained behind
    `with_errors` is recognised by its number of inputs. The file does not say whether actions are commands (`increment` 0) or
    changes of them: without an `increment` they are taken as commands, with a warning.

    InputError for a file that is not trusted or not saved by Stable-Baselines3, for an agent with other observations or
    actions than those of `HydraulicSync-v0`, and for one with errors, as HydraulicSyncIncrement has them, without `increment`.
    """

    def __init__(self, path: Path, name: str, trust: bool, increment: float | None = None) -> None:
        self.name = name
        self._increment = INCREMENT.check(increment, f"{path}: increment") if increment else None
        policy = _kind_of_policy(path)
        if not trust:
            raise InputError(
                f"{path}: holds pickled objects, so that loading it runs code from the file; with --trust it is loaded"
            )
        self._model = _algorithm(path, policy).load(path, device="cpu")
        observed, acted = self._model.observation_space.shape, self._model.action_space.shape
        widths = [
            n for n in (FRAME, FRAME + ERRORS) if observed and len(observed) == 1 and not observed[0] % n
        ]
        if not widths or acted != (2,):
            raise InputError(
                f"{path}: observations {observed} and actions {acted} are not those of HydraulicSync-v0: "
                f"({FRAME} for each frame,), or {FRAME + ERRORS} with its errors, and (2,)"
            )
        self._history, self._errors = observed[0] // widths[0], widths[0] > FRAME
        if increment is None:
            said = (
                f"{path}: does not say whether its actions are commands or changes of them: {path}:increment=0 for commands,"
                f" {path}:increment=0.3 for an agent of HydraulicSyncIncrement"
            )
            if self._errors:
                raise InputError(said)
            warnings.warn(f"{said}. Taken as commands", InputWarning, stacklevel=2)

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Forgets the last episode."""
        self.guard = InputGuard(num_rigs, control_period)
        self._state: Any = None
        self._first = np.ones(num_rigs, dtype=bool)
        self._frames: list[NDArray[Any]] = []

    @guarded
    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n)."""
        newest = np.asarray(observation, dtype=np.float32)[:, -FRAME:]
        self._frames = [*(self._frames or [newest] * self._history), newest][-self._history :]
        frames = np.concatenate(self._frames, axis=1)
        action, self._state = self._model.predict(
            with_errors(frames) if self._errors else frames,
            state=self._state,
            episode_start=self._first,
            deterministic=True,
        )
        self._first = np.zeros_like(self._first)
        action = np.asarray(action, dtype=float)
        if self._increment is None:
            return action
        return np.clip(newest[:, -2:] + self._increment * np.clip(action, -1.0, 1.0), -1.0, 1.0)


def _kind_of_policy(path: Path) -> str:
    """The module of the agent's policy class, read without unpickling anything."""
    check_file(path, "an agent of Stable-Baselines3")
    try:
        with zipfile.ZipFile(path) as archive:
            return str(json.loads(archive.read("data"))["policy_class"]["__module__"])
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError):
        raise InputError(f"{path}: is no agent as Stable-Baselines3 saves one (model.save)") from None


def _algorithm(path: Path, policy: str) -> Any:
    """The class that loads agents with policies of this module; PPO, TRPO and A2C share theirs, and so do DDPG and TD3."""
    kinds: dict[str, Any]
    if policy.startswith("sb3_contrib"):
        import sb3_contrib as library

        kinds = {
            "recurrent": library.RecurrentPPO,
            "tqc": library.TQC,
            "crossq": library.CrossQ,
            "ars": library.ARS,
        }
    else:
        import stable_baselines3 as library

        kinds = {"sac": library.SAC, "td3": library.TD3, "common": library.PPO}
    found = [kind for name, kind in kinds.items() if f".{name}." in policy]
    if not found:
        raise InputError(f"{path}: agents with policies of {policy} are not known")
    return found[0]
