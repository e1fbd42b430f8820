"""What a policy's network sees of the rig, and how its outputs become valve commands.

The same code runs in training (`hydro_env.training`) and in the shipped controllers, so that what was trained is what runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.envs.observation import with_errors
from hydro_env.errors import InputError, shown
from hydro_env.limits import Limits

__all__ = ["FramesInterface", "make_interface"]

FRAMES = Limits(1, 999, whole=True)

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any]


def make_interface(table: Any) -> FramesInterface:
    """An interface from its table in a policy or training file, `{"kind": "frames", ...}`; the plain observation without any.

    InputError for anything that is not right.
    """
    if table is not None and not isinstance(table, Mapping):
        raise InputError(f"should be a table with a key 'kind', found {type(table).__name__}")
    given = dict(table or {"kind": "frames"})
    kind = given.pop("kind", None)
    if kind != "frames":
        raise InputError(f"kind {shown(kind)} is unknown; there is frames")
    limits = {"frames": FRAMES, "width": FRAMES, "increment": Limits(0.0, 2.0), "errors": None}
    for key, value in given.items():
        if key not in limits:
            raise InputError(f"{shown(key)} is unknown; known for kind 'frames' are {', '.join(limits)}")
        within = limits[key]
        if within is not None:
            given[key] = within.check(value, key)
        elif not isinstance(value, bool):
            raise InputError(f"{key} {shown(value)} should be true or false")
    return FramesInterface(**given)


class FramesInterface:
    """Stands between the observations of a batch of rigs and a network.

    The network sees the last `frames` observations of `width` numbers each, newest last. Its outputs are the commands; with
    `increment` they are changes of the commands, in fractions of it, and the commands so far are the newest frame's last two
    numbers. `errors`: see `hydro_env.envs.observation.with_errors`.

    Inputs of the network have the shape (num_rigs, `num_features`), its outputs (num_rigs, `num_actions`).
    """

    num_actions = 2

    def __init__(self, frames: int = 1, width: int = 9, increment: float = 0.0, errors: bool = False) -> None:
        self.frames, self.width, self.increment = int(frames), int(width), float(increment)
        self.errors = errors
        self.num_features = self.frames * (self.width + 3 * errors)

    def table(self) -> dict[str, Any]:
        """What `make_interface` needs to build the same interface."""
        table: dict[str, Any] = {"kind": "frames", "frames": self.frames, "width": self.width}
        changed = {"increment": self.increment, "errors": self.errors}
        return table | {key: value for key, value in changed.items() if value}

    def start(self, observation: Floats) -> Floats:
        """Inputs at the first observation of all rigs; forgets everything before."""
        self._seen = np.tile(self._newest(observation), (1, self.frames))
        return self._inputs(self._seen)

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        """Inputs at the first observation of some rigs (indices), whose episodes begin anew."""
        self._seen[rows] = np.tile(self._newest(observation), (1, self.frames))
        return self._inputs(self._seen[rows])

    def see(self, observation: Floats) -> Floats:
        """Inputs at the next observation of all rigs, a control period later."""
        self._seen = np.concatenate([self._seen[:, self.width :], self._newest(observation)], axis=1)
        return self._inputs(self._seen)

    def _inputs(self, seen: NDArray[np.float32]) -> Floats:
        return with_errors(seen) if self.errors else seen.copy()

    def _newest(self, observation: Floats) -> NDArray[np.float32]:
        """The newest frame, whatever history the environment adds."""
        return np.asarray(observation, dtype=np.float32)[:, -self.width :]

    def command(self, outputs: Floats) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for the network's outputs at the inputs seen last."""
        outputs = np.clip(outputs, -1.0, 1.0)
        return (
            np.clip(self._seen[:, -2:] + self.increment * outputs, -1.0, 1.0) if self.increment else outputs
        )
