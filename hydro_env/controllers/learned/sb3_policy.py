"""Agents as Stable-Baselines3 saves them (`model.save("my_ppo.zip")`), trained on the plain observation.

Such a file holds pickled objects, and unpickling runs whatever code is in them. It is loaded only where the user says that its
origin is trusted. Needs the extra `agents`.
"""

import json
import warnings
import zipfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.arrays import Reals
from hydro_env.controllers.learned.policy_interface import FramesInterface, Policy
from hydro_env.envs.batch import INCREMENT
from hydro_env.envs.observation import ERRORS, FRAME
from hydro_env.errors import InputError, InputWarning
from hydro_env.reading import check_file


class Sb3Policy(Policy):
    """Drives with the deterministic action of a saved agent; one that was trained with `history` gets its frames, one that was
    trained with `increment` (HydraulicSyncIncrement-v0: 0.3) changes its commands by its actions. One that was trained behind
    `with_errors` is recognised by its number of inputs. The file does not say whether actions are commands (`increment` 0) or
    changes of them: without an `increment` they are taken as commands, with a warning.

    InputError for a file that is not trusted or not saved by Stable-Baselines3, for an agent with other observations or
    actions than those of `HydraulicSync-v0`, and for one with errors, as HydraulicSyncIncrement has them, without `increment`.
    """

    def __init__(self, path: Path, name: str, trust: bool, increment: float | None = None) -> None:
        self.name = name
        self._state: Any = None
        changes = INCREMENT.check(increment, f"{path}: increment") if increment else 0.0
        policy = _kind_of_policy(path)
        if not trust:
            raise InputError(f"{path}: is a pickle, which runs code when it is loaded; with --trust it is")
        self._model = _algorithm(path, policy).load(path, device="cpu")
        observed: tuple[int, ...] = self._model.observation_space.shape or ()
        acted = self._model.action_space.shape
        widths = [n for n in (FRAME, FRAME + ERRORS) if len(observed) == 1 and not observed[0] % n]
        if not widths or acted != (2,):
            raise InputError(
                f"{path}: observations {observed} and actions {acted} are not those of HydraulicSync-v0: "
                f"({FRAME} for each frame,), or {FRAME + ERRORS} with its errors, and (2,)"
            )
        errors = widths[0] > FRAME
        self.interface = FramesInterface(observed[0] // widths[0], changes, errors)
        if increment is None:
            said = (
                f"{path}: does not say whether its actions are commands or changes of them: {path}:increment=0 for commands,"
                f" {path}:increment=0.3 for an agent of HydraulicSyncIncrement"
            )
            if errors:
                raise InputError(said)
            warnings.warn(f"{said}. Taken as commands", InputWarning, stacklevel=2)

    def outputs(self, inputs: Reals, fresh: bool) -> Reals:
        state = None if fresh else self._state
        begun = np.full(len(inputs), fresh)
        action, self._state = self._model.predict(inputs, state, begun, deterministic=True)
        return np.asarray(action, dtype=float)


def _kind_of_policy(path: Path) -> str:
    """The module of the agent's policy class, read without unpickling anything."""
    check_file(path, "an agent of Stable-Baselines3")
    try:
        with zipfile.ZipFile(path) as archive:
            return str(json.loads(archive.read("data"))["policy_class"]["__module__"])
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError):
        raise InputError(f"{path}: is no agent as Stable-Baselines3 saves one (model.save)") from None


#: What loads an agent, by the library and the module of its policy; PPO, TRPO and A2C share theirs, and so do DDPG and TD3.
_ALGORITHMS = {
    "sb3_contrib": {"recurrent": "RecurrentPPO", "tqc": "TQC", "crossq": "CrossQ", "ars": "ARS"},
    "stable_baselines3": {"sac": "SAC", "td3": "TD3", "common": "PPO"},
}


def _algorithm(path: Path, policy: str) -> Any:
    """The class that loads agents with policies of this module."""
    name = "sb3_contrib" if policy.startswith("sb3_contrib") else "stable_baselines3"
    library = import_module(name)
    found = [kind for part, kind in _ALGORITHMS[name].items() if f".{part}." in policy]
    if not found:
        raise InputError(f"{path}: agents with policies of {policy} are not known")
    return getattr(library, found[0])
