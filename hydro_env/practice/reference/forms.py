"""Constants of the "different" forms of the effects: what real valves and motors have in many sizes.

A parameter of an effect says how large it is, a form how it looks: how sharp a corner is, over which travel friction builds
up, how many elements make a loop. Nobody knows these of a rig, so a practice rig draws them (`draw`), each from a range that
its reason explains; none is shared with what is fitted to its logs. `MIDDLE` has the median of each, for simulations that
want one fixed rig.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...plant.scales import Scales
from ...reading import shipped_yaml

#: Constants of a rig: numbers by name, and of the loop's stops `stop_travels` and `stop_shares`, (STOPS,) each.
Constants = Mapping[str, float | tuple[float, ...]]

#: Effects that move the mean pressure of both lines; the supply pressure is that of the first of them that acts.
OF_BOTH_LINES = ("external_leakage", "anti_cavitation", "case_drain")
#: Stop operators of the magnetic loop, and play operators of the valve's input.
STOPS, PLAYS = 6, 3
#: Greatest slope of the loop at a turn, over amplitude / width: from 2 on, a loop as narrow as `width` allows would have
#: more current mean less force, which no magnet does.
_MAX_SLOPE = 1.8


@dataclass(frozen=True)
class FormConstant:
    """One constant: drawn between `low` and `high`, evenly or (`log`) by factors, for a stated reason."""

    name: str
    unit: str
    low: float
    high: float
    log: bool
    reason: str

    def at(self, share: float) -> float:
        """The value below which this share of the draws is."""
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + (self.high - self.low) * share)


#: Those that are drawn before the stops of the loop, and those that are drawn after them.
_EARLY, _LATER = (
    tuple(FormConstant(name, **row) for name, row in rows.items())
    for rows in shipped_yaml(__package__, "form_constants.yaml").values()
)
#: Every constant but the stops.
CONSTANTS = (*_EARLY, *_LATER)
#: Unit of every constant.
UNITS = {**{c.name: c.unit for c in CONSTANTS}, "stop_travels": "1", "stop_shares": "1"}

_MAX_REACH = 8.0  # widest over narrowest stop, at most


def _stops(reach: float, places: np.ndarray, weights: np.ndarray) -> dict[str, tuple[float, ...]]:
    """Travels of the stops, over the loop's width, and their shares of its amplitude.

    `places` (STOPS,) in 0 to 1 lie on a logarithmic scale. The mean travel is `reach`, or what keeps the slope at a turn.
    """
    shares = weights / weights.sum()
    travels = _MAX_REACH**places
    travels *= reach / (shares @ travels)
    travels *= max(1.0, (shares / travels).sum() / _MAX_SLOPE)
    order = np.argsort(travels)
    return {"stop_travels": tuple(travels[order].tolist()), "stop_shares": tuple(shares[order].tolist())}


def draw(rng: np.random.Generator) -> dict[str, Any]:
    """The constants of one rig."""
    found: dict[str, Any] = {c.name: c.at(rng.random()) for c in _EARLY}
    found |= _stops(found["stop_reach"], rng.random(STOPS), rng.gamma(2.0, size=STOPS))
    return found | {c.name: c.at(rng.random()) for c in _LATER}


def scaled(constants: Constants, scales: Scales) -> dict[str, float | tuple[float, ...]]:
    """The same for a rig of another size: radii, pressures, flows and speeds over which a form turns grow with it."""
    return {n: v if isinstance(v, tuple) else scales.factor(UNITS[n]) * v for n, v in constants.items()}


#: Constants at which an equation of the different forms is the catalogue's.
SAME: Constants = {
    **dict.fromkeys(("clearance", "driver_knee", "saturation_knee", "drag_transition", "line_transition"), 0.0),
    **dict.fromkeys(("ripple_second", "drift_bend"), 0.0), **dict.fromkeys(("notch_power", "stop_power"), 1.0),
    "shaft_stribeck": 2.0,
}  # fmt: skip
_MEDIANS = {c.name: c.at(0.5) for c in CONSTANTS}
#: The median of every constant, stops evenly spread.
MIDDLE: Constants = {
    **_MEDIANS, **_stops(_MEDIANS["stop_reach"], (np.arange(STOPS) + 0.5) / STOPS, np.ones(STOPS))
}  # fmt: skip


def checked(constants: Constants | None) -> Constants:
    """`MIDDLE` where nothing is given. InputError for a name that is missing or unknown."""
    if constants is None:
        return MIDDLE
    for name in sorted({*constants} ^ {*MIDDLE}):
        raise InputError(f"form constants: {name!r} is {'unknown' if name in constants else 'missing'}")
    return constants
