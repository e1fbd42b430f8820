"""The rig of two channels: commands and loads go in, the signals of both come out."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...plant.catalogue import BUILT_IN, CATALOGUE
from ...plant.model import PlantModel
from ...plant.model_files import load_model
from .equations import outputs
from .forms import Constants, checked
from .solver import STATES, Array, Group

#: "same": the equations of the catalogue; "different": another shape with the same meaning of every parameter.
FORMS = ("same", "different")
#: What the simulator returns.
REFERENCE_SIGNALS = (*STATES, "flow", "measured_speed", "mean_line_pressure", "motor_pressure")
_INSTANT = 1e-9  # s; what lies closer together happens at once


class ReferenceRig:
    """One rig of two channels, at rest at time zero.

    `forms` as in `FORMS`, with these `constants` (`forms.draw`; default: `forms.MIDDLE`) where they are "different"; `method`
    one of SciPy's "LSODA" (fast), "BDF", "Radau" (the strictest); `tolerance` is the relative one, absolute ones follow from
    the scale of each state. The integration restarts at every change of a command or load, so no solver steps over a
    jump. InputError for an unknown model or one with a user's effect, for which there are no independent equations;
    ValueError for an unknown form.
    """

    def __init__(
        self, model: str | Path | Mapping[str, Any] | PlantModel, *, forms: str = "same",
        constants: Constants | None = None, method: str = "LSODA", tolerance: float = 1e-7,
    ) -> None:  # fmt: skip
        if forms not in FORMS:
            raise ValueError(f"forms is {forms!r}, expected one of {', '.join(FORMS)}")
        self.model, self.forms, self.method, self.tolerance = load_model(model), forms, method, tolerance
        for name, acts in self.model.effects.items():
            if name not in BUILT_IN and not all(CATALOGUE[name].is_neutral(values or {}) for values in acts):
                raise InputError(
                    f"{name}: the reference simulator has no equations for this user's effect; use hydro_env.plant.simulate"
                )
        self.constants = checked(constants)
        self._delays = self.model.pair("command_delay.delay")
        self._rated = np.array(self.model.pair("u_rated"))
        coupled = any(self.model.pair("supply_droop.relative_drop"))
        sets: tuple[tuple[int, ...], ...] = ((0, 1),) if coupled else ((0,), (1,))
        self._groups = [Group(self.model, members, self.forms, self.constants) for members in sets]
        self.time = 0.0
        # (when, voltage) on its way, by channel
        self._coming: tuple[list[tuple[float, float]], ...] = ([], [])

    def signals(self) -> dict[str, Array]:
        """All `REFERENCE_SIGNALS` now, each (2,)."""
        out = np.empty((len(REFERENCE_SIGNALS), 1, 2))
        for group in self._groups:
            self._store(group, group.state[None, :], out)
        return dict(zip(REFERENCE_SIGNALS, out[:, 0], strict=True))

    def advance(
        self, command_V: ArrayLike, load_Nm: ArrayLike, duration: float, samples: int = 1
    ) -> dict[str, Array]:
        """Holds commands and loads, each (2,), over `duration` s.

        Returns `REFERENCE_SIGNALS`, each (samples, 2), at `samples` evenly spaced instants of which the last is the end.
        Commands beyond the rated one are clipped.
        """
        command = np.broadcast_to(np.asarray(command_V, dtype=float), (2,))
        load = np.broadcast_to(np.asarray(load_Nm, dtype=float), (2,))
        start, end = self.time, self.time + duration
        voltages = np.clip(command, -self._rated, self._rated)
        for coming, delay, voltage in zip(self._coming, self._delays, voltages, strict=True):
            coming.append((start + delay, voltage))
        instants = np.linspace(start, end, samples + 1)[1:]
        out = np.empty((len(REFERENCE_SIGNALS), samples, 2))
        for group in self._groups:
            for p, c in zip(group.channels, group.members, strict=True):
                p["load"] = load[c]
            self._run(group, start, end, instants, out)
        self.time = end
        return dict(zip(REFERENCE_SIGNALS, out, strict=True))

    def _run(self, group: Group, start: float, end: float, instants: Array, out: Array) -> None:
        now = start
        while now < end - _INSTANT:
            until = end
            for p, c in zip(group.channels, group.members, strict=True):
                coming = self._coming[c]
                while coming and coming[0][0] <= now + _INSTANT:
                    p["command"] = coming.pop(0)[1]
                if coming and coming[0][0] < until - _INSTANT:
                    until = coming[0][0]
            begin, stop = np.searchsorted(instants, (now + _INSTANT, until + _INSTANT), side="right")
            times = np.array([now, *np.minimum(instants[begin:stop], until)])
            if times[-1] < until - _INSTANT:
                times = np.append(times, until)
            states = group.integrate(times, self.method, self.tolerance)
            self._store(group, states[1 : 1 + stop - begin], out[:, begin:stop])
            now = until

    @staticmethod
    def _store(group: Group, states: Array, out: Array) -> None:
        """Writes the signals of a group's channels, an instant for each of the `states`, to `out` (signals, instants, 2)."""
        states = np.ascontiguousarray(states)
        seen = np.empty((4, len(states), len(group.members)))
        outputs(states, group.channels, *seen)
        for j, c in enumerate(group.members):
            at = int(group.channels["at_states"][j])
            out[:, :, c] = *states[:, at : at + len(STATES)].T, *seen[:, :, j]


def simulate_reference(
    model: str | Path | Mapping[str, Any] | PlantModel, command_V: ArrayLike, load_Nm: ArrayLike | None, period: float,
    **options: Any,
) -> dict[str, Array]:  # fmt: skip
    """Simulates a command sequence from rest: `command_V` and `load_Nm` (T, 2), each row held over `period` s.

    Returns `REFERENCE_SIGNALS`, each (T, 2): row n at the instant at which command n begins to act. Options as in
    `ReferenceRig`. ValueError for wrong shapes or values that are not finite.
    """
    command = np.asarray(command_V, dtype=float)
    load = np.zeros_like(command) if load_Nm is None else np.asarray(load_Nm, dtype=float)
    if command.ndim != 2 or command.shape[1] != 2 or load.shape != command.shape:
        raise ValueError(f"command_V {command.shape} and load_Nm {load.shape} must both be (T, 2)")
    if not (np.isfinite(command).all() and np.isfinite(load).all()):
        raise ValueError("a command or load is not finite")
    rig = ReferenceRig(model, **options)
    parts = [rig.signals()]
    changes = 1 + np.flatnonzero(np.diff(np.hstack([command, load]), axis=0).any(axis=1))
    # The last row's command acts only after the log.
    for first, last in pairwise([0, *changes.tolist(), len(command) - 1]):
        if last > first:
            parts.append(rig.advance(command[first], load[first], (last - first) * period, last - first))
    return {name: np.vstack([part[name] for part in parts])[: len(command)] for name in REFERENCE_SIGNALS}
