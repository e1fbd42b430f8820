"""Layout of the states and their integration by SciPy's stiff solvers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import odeint, solve_ivp

from ...plant.catalogue import BUILT_IN, CATALOGUE
from ...plant.catalogue.losses import FAMILY
from ...plant.model import PlantModel
from ...plant.parameters import PARAMETERS
from .equations import rates
from .forms import CONSTANTS, OF_BOTH_LINES, PLAYS, SAME, STOPS, Constants

Array = NDArray[np.float64]

#: What every channel has, in this order from `at_states` on.
STATES = ("current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle")
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
    return [
        *((name, np.float64) for name in numbers), *stops, *((name, np.int64) for name in (*places, "different", "lossy"))
    ]  # fmt: skip


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
            p["lossy"] = any(
                CATALOGUE[name].family == FAMILY and not CATALOGUE[name].is_neutral(pair[c])
                for name, pair in model.effects.items()
            )
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

    def integrate(self, times: Array, method: str, tolerance: float) -> Array:
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
