"""What a policy's network sees of the rig, and how its outputs become valve commands.

The same code runs in training (`agents`) and in the shipped controllers, so that what was trained is what runs.
`FramesView` shows the last observations as they are, and the outputs are the commands: nothing is built in.
`hydro_env.controllers.mpc` has the two interfaces on top of a control law.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hydro_env.errors import InputError

__all__ = ["FramesView", "View", "make_view"]

Floats = NDArray[np.floating[Any]]
Rows = NDArray[Any]


class View(Protocol):
    """Stands between the observations of a batch of rigs and a network.

    `rows_per_rig`: how many inputs the network gets for each rig; `num_features`, `num_actions`: their and the outputs'
    number. Inputs have the shape (num_rigs * rows_per_rig, num_features).
    """

    rows_per_rig: int
    num_features: int
    num_actions: int

    def start(self, observation: Floats, period: float) -> Floats:
        """Inputs at the first observation of all rigs; forgets everything before."""

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        """Inputs at the first observation of some rigs (indices), whose episodes begin anew."""

    def see(self, observation: Floats) -> Floats:
        """Inputs at the next observation of all rigs, a control period later."""

    def command(self, outputs: Floats) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for the network's outputs at the inputs seen last."""

    def settings(self) -> dict[str, Any]:
        """What `make_view` needs to build the same view."""


def _settings(view: type[Any]) -> list[str]:
    """The settings of a view, with those that it hands on to the view it is built on."""
    given = inspect.signature(view).parameters.values()
    own = [each.name for each in given if each.kind is not each.VAR_KEYWORD]
    on = _settings(view.__base__) if len(own) < len(given) and view.__base__ is not None else []
    return list(dict.fromkeys([*own, *on]))


def make_view(settings: Any) -> View:
    """A view from its settings, `{"kind": "plan" | "flow" | "frames", ...}`; the plain observation without any.

    InputError for anything that is not right.
    """
    if settings is not None and not isinstance(settings, Mapping):
        raise InputError(f"should be a table with a key 'kind', found {type(settings).__name__}")
    given = dict(settings or {"kind": "frames"})
    from hydro_env.controllers.mpc.flow_controller import FlowView
    from hydro_env.controllers.mpc.planning_controller import PlanningView

    kinds: dict[str, type[Any]] = {
        "frames": FramesView, "flow": FlowView, "plan": PlanningView,
    }  # fmt: skip
    kind = given.pop("kind", None)
    if kind not in kinds:
        raise InputError(f"kind {kind!r} is unknown; there are {', '.join(kinds)}")
    known = _settings(kinds[str(kind)])
    for key, value in given.items():
        if key not in known:
            raise InputError(f"{key!r} is unknown; known for kind {kind!r} are {', '.join(known)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e5:
            raise InputError(f"{key} {value!r} should be a number from 0 to 100000")
    made: View = kinds[str(kind)](**given)
    return made


class FramesView:
    """The last `frames` observations of `width` numbers each, newest last; the outputs are the commands."""

    rows_per_rig = 1
    num_actions = 2

    def __init__(self, frames: int = 1, width: int = 9) -> None:
        self.frames, self.width = int(frames), int(width)
        self.num_features = self.frames * self.width

    def settings(self) -> dict[str, Any]:
        return {"kind": "frames", "frames": self.frames, "width": self.width}

    def start(self, observation: Floats, period: float) -> Floats:
        self._seen = np.tile(self._newest(observation), (1, self.frames))
        return self._seen.copy()

    def restart(self, rows: Rows, observation: Floats) -> Floats:
        self._seen[rows] = np.tile(self._newest(observation), (1, self.frames))
        return self._seen[rows]

    def see(self, observation: Floats) -> Floats:
        self._seen = np.concatenate([self._seen[:, self.width :], self._newest(observation)], axis=1)
        return self._seen.copy()

    def _newest(self, observation: Floats) -> NDArray[np.float32]:
        """The newest frame, whatever history the environment adds."""
        return np.asarray(observation, dtype=np.float32)[:, -self.width :]

    def command(self, outputs: Floats) -> Floats:
        return np.clip(outputs, -1.0, 1.0)
