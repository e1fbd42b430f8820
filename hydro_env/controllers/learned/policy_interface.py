"""What a policy's network sees of the rig, and how its outputs become valve commands.

In training the environment does the same by its arguments `history`, `increment` and `errors`: see `env_kwargs`.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, StrictBool

from hydro_env.arrays import Reals, Singles
from hydro_env.controllers.input_guard import InputGuard, guarded
from hydro_env.envs.observation import ERRORS, FRAME, with_errors
from hydro_env.validation import Count, FileTable, Number, checked


class InterfaceTable(FileTable):
    """The table of an interface in a policy or training file; `width` is that of an observation."""

    kind: Literal["frames"] = "frames"
    frames: Annotated[Count, Field(le=999)] = 1
    width: Annotated[Count, Field(ge=FRAME, le=FRAME)] = FRAME
    increment: Annotated[Number, Field(ge=0.0, le=2.0)] = 0.0
    errors: StrictBool = False


def make_interface(table: Any, where: str = "interface") -> "FramesInterface":
    """An interface from its table in a policy or training file; the plain observation without any. InputError, which begins with
    `where`, for anything that is not right."""
    given = checked(InterfaceTable, {} if table is None else table, where)
    return FramesInterface(given.frames, given.increment, given.errors)


@dataclass
class FramesInterface:
    """Stands between the observations of a batch of rigs and a network.

    The network sees the last `frames` observations, newest last. Its outputs are the commands; with `increment` they are
    changes of the commands, in fractions of it, and the commands so far are the newest frame's last two numbers. `errors`: see
    `hydro_env.envs.observation.with_errors`.

    Inputs of the network have the shape (num_rigs, `num_features`), its outputs (num_rigs, `num_actions`).
    """

    frames: int = 1
    increment: float = 0.0
    errors: bool = False
    num_actions: ClassVar[int] = 2

    @property
    def num_features(self) -> int:
        return self.frames * (FRAME + ERRORS * self.errors)

    def table(self) -> dict[str, Any]:
        """What `make_interface` needs to build the same interface."""
        table: dict[str, Any] = {"kind": "frames", "frames": self.frames, "width": FRAME}
        changed = {"increment": self.increment, "errors": self.errors}
        return table | {key: value for key, value in changed.items() if value}

    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of an environment whose observations are the network's inputs and whose actions are its outputs."""
        return {"history": self.frames, "increment": self.increment or None, "errors": self.errors}

    def start(self, observation: Reals) -> Reals:
        """Inputs at the first observation of all rigs; forgets everything before."""
        self.seen = np.tile(self._newest(observation), (1, self.frames))
        return self._inputs()

    def see(self, observation: Reals) -> Reals:
        """Inputs at the next observation of all rigs, a control period later."""
        self.seen = np.concatenate([self.seen[:, FRAME:], self._newest(observation)], axis=1)
        return self._inputs()

    def _inputs(self) -> Reals:
        return with_errors(self.seen) if self.errors else self.seen

    def _newest(self, observation: Reals) -> Singles:
        """The newest frame, whatever history the environment adds."""
        return np.asarray(observation, dtype=np.float32)[:, -FRAME:]

    def command(self, outputs: Reals) -> Reals:
        """Commands (num_rigs, 2) in [-1, 1] for the network's outputs at the inputs seen last."""
        outputs = np.clip(outputs, -1.0, 1.0)
        return np.clip(self.seen[:, -2:] + self.increment * outputs, -1.0, 1.0) if self.increment else outputs


class Policy:
    """A network behind an interface as a controller: `reset`, then `act` once a control period, one row per rig.

    Subclasses implement `outputs` and keep in `memory` the states of recurrent layers. `needs` and `plant` as in
    `hydro_env.controllers.base.Controller`: it knows nothing but the measurements. With a `trained_period` (s) it decides as
    nearly that often as whole control periods allow, and holds its commands between (a multirate loop; Franklin, Powell and
    Workman, Digital control of dynamic systems, 1998).
    """

    needs = "measurements"
    plant: str | None = None
    trained_period: float | None = None
    name: str
    interface: FramesInterface

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Forgets the last episode; `control_period` in s."""
        self._fresh = True
        self.memory: list[Reals] = []
        self._every = max(1, round((self.trained_period or control_period) / control_period))
        self.guard = InputGuard(int(num_rigs), control_period)

    @guarded
    def act(self, observation: Reals) -> Reals:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n) as the environment gives them."""
        if self._fresh:
            self._held = self.interface.command(self.outputs(self.interface.start(observation), True))
            self._fresh, self._ago = False, np.zeros((len(observation), 1), int)
            return self._held
        seen, memory = self.interface.seen, list(self.memory)
        command = self.interface.command(self.outputs(self.interface.see(observation), False))
        if self._every == 1:
            return command
        # Masks, not branches, since this is exported as well.
        later = self._ago + 1
        due = later == self._every
        self._ago = np.where(due, 0, later)
        self.interface.seen = np.where(due, self.interface.seen, seen)
        self.memory = [np.where(due, new, old) for new, old in zip(self.memory, memory, strict=True)]
        self._held = np.where(due, command, self._held)
        return self._held

    def outputs(self, inputs: Reals, fresh: bool) -> Reals:
        """What the network gives for its inputs, which are `fresh` where an episode begins."""
        raise NotImplementedError
