"""The rig of two channels: commands and loads go in, the signals of both come out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ...plant.catalogue import BUILT_IN, CATALOGUE
from ...plant.model import PlantModel
from ...plant.model_files import load_model
from .equations import outputs
from .forms import Constants, checked
from .solver import STATES, Group

Array = NDArray[np.float64]

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
        self._rated = self.model.pair("u_rated")
        self.reset()

    def reset(self) -> None:
        """Puts the rig to rest at time zero."""
        coupled = any(self.model.pair("supply_droop.relative_drop"))
        sets: tuple[tuple[int, ...], ...] = ((0, 1),) if coupled else ((0,), (1,))
        self._groups = [Group(self.model, members, self.forms, self.constants) for members in sets]
        self.time = 0.0
        # (when, voltage) on its way, by channel
        self._coming: tuple[list[tuple[float, float]], ...] = ([], [])

    def signals(self) -> dict[str, Array]:
        """All `REFERENCE_SIGNALS` now, each (2,)."""
        out = {name: np.empty((1, 2)) for name in REFERENCE_SIGNALS}
        for group in self._groups:
            self._store(group, group.state[None, :], out, np.array([0]))
        return {name: values[0] for name, values in out.items()}

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
        for c in (0, 1):
            voltage = min(max(float(command[c]), -self._rated[c]), self._rated[c])
            self._coming[c].append((start + self._delays[c], voltage))
        instants = np.linspace(start, end, samples + 1)[1:]
        out = {name: np.empty((samples, 2)) for name in REFERENCE_SIGNALS}
        for group in self._groups:
            for p, c in zip(group.channels, group.members, strict=True):
                p["load"] = load[c]
            self._run(group, start, end, instants, out)
        self.time = end
        return out

    def _run(self, group: Group, start: float, end: float, instants: Array, out: dict[str, Array]) -> None:
        now = start
        while now < end - _INSTANT:
            until = end
            for p, c in zip(group.channels, group.members, strict=True):
                coming = self._coming[c]
                while coming and coming[0][0] <= now + _INSTANT:
                    p["command"] = coming.pop(0)[1]
                if coming and coming[0][0] < until - _INSTANT:
                    until = coming[0][0]
            rows = np.flatnonzero((instants > now + _INSTANT) & (instants <= until + _INSTANT))
            times = np.concatenate(([now], np.minimum(instants[rows], until)))
            if times[-1] < until - _INSTANT:
                times = np.append(times, until)
            states = group.integrate(times, self.method, self.tolerance)
            self._store(group, states[1 : 1 + rows.size], out, rows)
            now = until

    @staticmethod
    def _store(group: Group, states: Array, out: dict[str, Array], rows: NDArray[np.intp]) -> None:
        states = np.ascontiguousarray(states)
        seen = np.empty((4, len(rows), len(group.members)))
        outputs(states, group.channels, *seen)
        for j, c in enumerate(group.members):
            at = int(group.channels["at_states"][j])
            every = *states[:, at : at + len(STATES)].T, *seen[:, :, j]
            for name, values in zip(REFERENCE_SIGNALS, every, strict=True):
                out[name][rows, c] = values


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
    length = command.shape[0]
    out = {name: np.empty((length, 2)) for name in REFERENCE_SIGNALS}
    for name, value in rig.signals().items():
        out[name][:1] = value
    changes = 1 + np.flatnonzero(np.diff(np.hstack([command, load]), axis=0).any(axis=1))
    starts = np.concatenate(([0], changes))
    ends = np.concatenate((changes, [length - 1]))  # the last row's command acts only after the log
    for first, last in zip(starts, ends, strict=True):
        if last > first:
            part = rig.advance(command[first], load[first], (last - first) * period, int(last - first))
            for name, values in part.items():
                out[name][first + 1 : last + 1] = values
    return out
