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
from .forms import CONSTANTS, OF_BOTH_LINES, PLAYS, STOPS, Constants

__all__ = ["STATES", "Group"]

Array = NDArray[np.float64]

#: What every channel has, in this order from `at_states` on.
STATES = ("current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle")
_SCALES = (0.1, 1e-4, 1e-2, 1e-6, 1e5, 1.0, 1.0)  # of these states, for absolute tolerances
_SHIFTS = (
    "heat",
    "loop",
    "second_bristle",
    "shaft_bristle",
    "twist",
    "lag",
    "droop",
    "play",
    "mean",
    "side",
    "lift",
)


def _fields() -> list[tuple[Any, ...]]:
    own = [(name, np.float64) for name in PARAMETERS]
    effects = [
        (f"{e.name}__{p.name}", np.float64)
        for e in map(CATALOGUE.__getitem__, BUILT_IN)
        for p in e.parameters
    ]
    forms = [(f"form_{c.name}", np.float64) for c in CONSTANTS]
    stops = [(f"form_{name}", np.float64, (STOPS,)) for name in ("stop_travels", "stop_shares")]
    places = [(f"at_{name}", np.int64) for name in ("states", *_SHIFTS)]
    return [
        *own,
        *effects,
        *forms,
        *stops,
        *places,
        ("lines_supply", np.float64),
        ("different", np.int64),
        ("lossy", np.int64),
    ]


class Group:
    """Channels that are integrated together: each alone, or both where they share the supply."""

    def __init__(self, model: PlantModel, members: tuple[int, ...], forms: str, constants: Constants) -> None:
        self.members = members
        self.channels = np.zeros(
            len(members), dtype=[*_fields(), ("command", np.float64), ("load", np.float64)]
        )
        different = forms == "different"
        scales: list[float] = []

        def place(*of_states: float) -> int:
            scales.extend(of_states)
            return len(scales) - len(of_states)

        for p, c in zip(self.channels, members, strict=True):
            for name in PARAMETERS:
                p[name] = model.value(name, c)
            for effect in map(CATALOGUE.__getitem__, BUILT_IN):
                for parameter in effect.parameters:
                    p[f"{effect.name}__{parameter.name}"] = model.value(f"{effect.name}.{parameter.name}", c)
            for name, constant in constants.items():
                p[f"form_{name}"] = constant
            p["different"] = different
            p["lossy"] = any(
                CATALOGUE[name].family == FAMILY and not CATALOGUE[name].is_neutral(pair[c])
                for name, pair in model.effects.items()
            )
            p["at_states"] = place(*_SCALES)
            for name in _SHIFTS:
                p[f"at_{name}"] = -1
            if p["coil_heating__rise"] != 0.0:
                p["at_heat"] = place(0.1)
            if p["magnetic_hysteresis__amplitude"] != 0.0:
                p["at_loop"] = place(*([1.0] * (STOPS if different else 1)))
            if p["input_hysteresis__width"] != 0.0:
                p["at_play"] = place(*([1.0] * (PLAYS if different else 1)))
            first = next((name for name in OF_BOTH_LINES if p[f"{name}__conductance"] != 0.0), "")
            if first:
                p["lines_supply"] = p[f"{first}__supply_pressure"]
                p["at_mean"] = place(0.1)
            if p["line_volume__conductance"] > 0.0:
                p["at_side"] = place(1e5)
            if p["crossport_relief__relief_pressure"] < np.inf:
                p["at_lift"] = place(1e5, 1e5)
            if different and max(p["spool_stiction__coulomb"], p["spool_stiction__static"]) > 0.0:
                p["at_second_bristle"] = place(1e-6)
            if (
                different
                and max(p["motor_coulomb_friction__coulomb"], p["motor_coulomb_friction__static"]) > 0.0
            ):
                p["at_shaft_bristle"] = place(1e-3)
            if p["shaft_backlash__inertia"] > 0.0:
                p["at_twist"] = place(1e-2, 1.0)
            if p["sensor_lag__time_constant"] > 0.0:
                p["at_lag"] = place(*([1.0] * (2 if different else 1)))
        if self.channels["supply_droop__relative_drop"].any():
            self.channels["at_droop"] = place(*([0.1] * (2 if different else 1)))
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
                rates,
                (times[0], times[-1]),
                self.state,
                method=method,
                t_eval=times,
                args=(self.channels,),
                **limits,
            )
            if not found.success:
                raise RuntimeError(
                    f"reference simulator: {found.message} at t = {found.t[-1] if found.t.size else times[0]}"
                )
            rows = found.y.T
        if not np.isfinite(rows[-1]).all():
            raise RuntimeError(f"reference simulator: a state is not finite after t = {times[0]:g} s")
        self.state = np.array(rows[-1])
        return np.asarray(rows)
