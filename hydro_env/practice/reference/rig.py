"""The rig of two channels: layout of the states, their integration by SciPy's stiff solvers, and the signals that come out."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import odeint, solve_ivp

from ...arrays import Floats
from ...errors import InputError
from ...plant.catalogue import BUILT_IN, CATALOGUE
from ...plant.model import PlantModel
from ...plant.model_files import load_model
from ...plant.parameters import PARAMETERS
from .equations import outputs, rates
from .forms import CONSTANTS, OF_BOTH_LINES, PLAYS, SAME, STOPS, Constants, checked

#: "same": the equations of the catalogue; "different": another shape with the same meaning of every parameter.
FORMS = ("same", "different")
_INSTANT = 1e-9  # s; what lies closer together happens at once
#: What every channel has, in this order from `at_states` on.
STATES = ("current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle")
#: What the simulator returns.
REFERENCE_SIGNALS = (*STATES, "flow", "measured_speed", "mean_line_pressure", "motor_pressure")
_SCALES = (0.1, 1e-4, 1e-2, 1e-6, 1e5, 1.0, 1.0)  # of these states, for absolute tolerances
#: Memories that a channel may have besides, in the order of their states: the parameters of which one must not be neutral, and
#: the scales of the states in the same and in the different form.
_MEMORIES: dict[str, tuple[tuple[str, ...], tuple[float, ...], tuple[float, ...]]] = {
    "heat": (("coil_heating__rise",), (0.1,), (0.1,)),
    "loop": (("magnetic_hysteresis__amplitude",), (1.0,), (1.0,) * STOPS),
    "play": (("input_hysteresis__width",), (1.0,), (1.0,) * PLAYS),
    "mean": (tuple(f"{name}__conductance" for name in OF_BOTH_LINES), (0.1,), (0.1,)),
    "side": (("line_volume__conductance",), (1e5,), (1e5,)),
    "lift": (("crossport_relief__relief_pressure",), (1e5, 1e5), (1e5, 1e5)),
    "second_bristle": (("spool_stiction__coulomb", "spool_stiction__static"), (), (1e-6,)),
    "shaft_bristle": (("motor_coulomb_friction__coulomb", "motor_coulomb_friction__static"), (), (1e-3,)),
    "twist": (("shaft_backlash__inertia",), (1e-2, 1.0), (1e-2, 1.0)),
    "lag": (("sensor_lag__time_constant",), (1.0,), (1.0, 1.0)),
}
#: Scales of the droop, which both channels share.
_DROOP = ((0.1,), (0.1, 0.1))
#: Parameters of every channel by their names in models; a record has them with two underscores for the dot.
_PARAMETERS = (*PARAMETERS, *(f"{name}.{p.name}" for name in BUILT_IN for p in CATALOGUE[name].parameters))


def _fields() -> list[tuple[Any, ...]]:
    """Fields of the record of a channel, see `equations`."""
    numbers = [name.replace(".", "__") for name in _PARAMETERS]
    numbers += [*(f"form_{c.name}" for c in CONSTANTS), "lines_supply", "command", "load"]
    stops = [(f"form_{name}", np.float64, (STOPS,)) for name in ("stop_travels", "stop_shares")]
    places = [f"at_{name}" for name in ("states", *_MEMORIES, "droop")]
    places.append("different")
    return [*((name, np.float64) for name in numbers), *stops, *((name, np.int64) for name in places)]


class Group:
    """Channels that are integrated together: each alone, or both where they share the supply."""

    def __init__(self, model: PlantModel, members: tuple[int, ...], forms: str, constants: Constants) -> None:
        self.members = members
        self.channels = np.zeros(len(members), dtype=_fields())
        different = forms == "different"
        scales: list[float] = []

        def place(of_states: tuple[float, ...]) -> int:
            """Number of the first of further states; -1 where there are none."""
            scales.extend(of_states)
            return len(scales) - len(of_states) if of_states else -1

        for p, c in zip(self.channels, members, strict=True):
            for name in _PARAMETERS:
                p[name.replace(".", "__")] = model.value(name, c)
            for name, constant in (constants if different else {**constants, **SAME}).items():
                p[f"form_{name}"] = constant
            p["different"] = different
            for name in [name for name in OF_BOTH_LINES if p[f"{name}__conductance"] != 0.0][:1]:
                p["lines_supply"] = p[f"{name}__supply_pressure"]
            p["at_states"] = place(_SCALES)
            for name, (sizes, *by_form) in _MEMORIES.items():
                acts = any(p[size] not in (0.0, np.inf) for size in sizes)
                p[f"at_{name}"] = place(by_form[different]) if acts else -1
        droops = self.channels["supply_droop__relative_drop"].any()
        self.channels["at_droop"] = place(_DROOP[different]) if droops else -1
        self.scales = np.array(scales)
        self.state = np.zeros(len(scales))

    def integrate(self, times: Floats, method: str, tolerance: float) -> Floats:
        """States at `times` (the first is now), (len(times), states); the last becomes the present state."""
        limits = {"rtol": tolerance, "atol": tolerance * self.scales}
        rows = None
        if method == "LSODA":
            rows, info = odeint(
                rates, self.state, times, args=(self.channels,), tfirst=True, full_output=True, mxstep=20000,
                printmessg=False, **limits,
            )  # fmt: skip
            if info["message"] != "Integration successful.":
                rows, method = None, "Radau"
        if rows is None:
            found = solve_ivp(
                rates, (times[0], times[-1]), self.state, method=method, t_eval=times, args=(self.channels,), **limits
            )  # fmt: skip
            if not found.success:
                reached = found.t[-1] if found.t.size else times[0]
                raise RuntimeError(f"reference simulator: {found.message} at t = {reached}")
            rows = found.y.T
        if not np.isfinite(rows[-1]).all():
            raise RuntimeError(f"reference simulator: a state is not finite after t = {times[0]:g} s")
        self.state = np.array(rows[-1])
        return np.asarray(rows)


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
        self.model, self.method, self.tolerance = load_model(model), method, tolerance
        for name, acts in self.model.effects.items():
            if name not in BUILT_IN and not all(CATALOGUE[name].is_neutral(values or {}) for values in acts):
                raise InputError(
                    f"{name}: the reference simulator has no equations for this user's effect; use hydro_env.plant.simulate"
                )
        known = checked(constants)
        self._delays = self.model.pair("command_delay.delay")
        self._rated = np.array(self.model.pair("u_rated"))
        coupled = any(self.model.pair("supply_droop.relative_drop"))
        sets: tuple[tuple[int, ...], ...] = ((0, 1),) if coupled else ((0,), (1,))
        self._groups = [Group(self.model, members, forms, known) for members in sets]
        self.time = 0.0
        # (when, voltage) on its way, by channel
        self._coming: tuple[list[tuple[float, float]], ...] = ([], [])

    def signals(self) -> dict[str, Floats]:
        """All `REFERENCE_SIGNALS` now, each (2,)."""
        out = np.empty((len(REFERENCE_SIGNALS), 1, 2))
        for group in self._groups:
            self._store(group, group.state[None, :], out)
        return dict(zip(REFERENCE_SIGNALS, out[:, 0], strict=True))

    def advance(
        self, command_V: ArrayLike, load_Nm: ArrayLike, duration: float, samples: int = 1
    ) -> dict[str, Floats]:
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

    def _run(self, group: Group, start: float, end: float, instants: Floats, out: Floats) -> None:
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
    def _store(group: Group, states: Floats, out: Floats) -> None:
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
) -> dict[str, Floats]:  # fmt: skip
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
