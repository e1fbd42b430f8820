"""Constants of the "different" forms of the effects: what real valves and motors have in many sizes.

A parameter of an effect says how large it is, a form how it looks: how sharp a corner is, over which travel friction builds
up, how many elements make a loop. Nobody knows these of a rig, so a practice rig draws them (`draw`), each from a range that
its reason explains; none is shared with what is fitted to its logs. `MIDDLE` has the median of each, for simulations that
want one fixed rig.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ...plant.scales import Scales

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


#: name, unit, low, high, by factors, reason
_ROWS = (
    # --- driver ---
    ("driver_knee", "1", 6.0, 60.0, True, "exponent of the p-norm: an output stage lacks 11 to 1 % at its limit"),
    # --- opening ---
    ("clearance", "m", 1.5e-6, 1.5e-5, True, "radial clearance of spool and sleeve: 2 to 5 um new, more where edges wear"),
    ("saturation_knee", "1", 4.0, 40.0, True, "exponent of the p-norm: round ports lack 16 to 1.7 % at the limit"),
    ("gain_blend", "m", 3e-7, 1e-5, True, "opening over which the gains of the directions blend: of the edges' radius"),
    (
        "notch_power", "1", 0.5, 2.0, True,
        "power with which the gain grows with the opening: 0.5 for round grooves, 1 for triangular, 2 for parabolic ones",
    ),
    # --- flow and supply ---
    (
        "orifice_transition", "1", 0.003, 0.05, True,
        "pressure drop over the supply's below which an edge's flow is laminar: 0.3 to 5 bar of 100 bar",
    ),
    ("supply_share", "1", 0.5, 0.95, False, "share of the memory in the first of two lags, pump and line; 1 would be one lag"),
    # --- force on the spool ---
    ("stop_reach", "1", 0.75, 1.35, True, "mean travel of the loop's stops over its width: steels differ in their curves"),
    ("stop_softness", "1", 4.0, 30.0, True, "power with which a stop gives way: rounded to nearly square minor loops"),
    ("bristle_elastic", "1", 0.3, 0.95, False, "share of its limit up to which the second bristle is elastic (Dupont 2002)"),
    ("bristle_damping", "1", 0.1, 3.0, True, "damping of the second bristle over the first's: oil film to gum"),
    ("bristle_stiffness", "1", 0.3, 3.0, True, "stiffness of the second bristle over the first's: particles and varnish"),
    ("bristle_stribeck", "1", 0.3, 3.0, True, "Stribeck speed of the second bristle over the first's, set by the film"),
    ("preload_travel", "m", 3e-6, 3e-5, True, "travel over which a preloaded spring takes hold: play of its washers"),
    # --- line ---
    ("air_exponent", "1", 1.0, 1.4, False, "polytropic exponent of the air: isothermal to adiabatic"),
    ("line_transition", "m3/s", 2e-6, 4e-5, True, "flow below which a fitting is laminar: Re of 10 to 100 in 4 to 10 mm"),
    ("relief_rounding", "Pa", 1e4, 1.5e5, True, "pressure over which a poppet cracks: seat leakage and friction"),
    (
        "relief_growth", "1", 0.0, 1.0, False,
        "power of pressure over setting in the conductance: 0.5 for a poppet whose edge is an orifice, more with a wide cone",
    ),
    # --- motor and load ---
    ("drag_transition", "rad/s", 0.3, 10.0, True, "speed below which churning is laminar: 3 to 100 rpm"),
    ("shaft_travel", "rad", 5e-4, 2e-2, True, "turn over which the shaft's friction builds up: hard contacts to lip seals"),
    ("shaft_damping", "1", 0.1, 2.0, True, "damping of that bristle over critical with the inertia"),
    ("shaft_damping_speed", "rad/s", 0.1, 3.0, True, "speed over which that damping fades, so that sliding is not damped"),
    ("shaft_stribeck", "1", 1.0, 2.0, False, "power in the Stribeck curve: Tustin's 1 to Gauss' 2"),
    ("ripple_second", "1", 0.0, 0.5, False, "second harmonic of the ripple over the first"),
    ("ripple_phase", "rad", -math.pi, math.pi, False, "phase of the second harmonic, of no preference"),
    ("dry_speed", "rad/s", 0.03, 1.0, True, "speed over which the dry friction of loss models turns: 0.3 to 10 rpm"),
    ("gap_transition", "Pa", 2e3, 1e5, True, "pressure below which the turbulent leak of a gap is laminar"),
    ("backlash_damping", "rad", 1e-3, 3e-2, True, "twist at which a coupling's damping is half its own: its rubber wets"),
    # --- fluid and sensor ---
    ("drift_bend", "1", -0.5, 0.8, False, "how much faster (or slower) than a single exponential a tank warms at first"),
    ("lag_share", "1", 0.5, 0.95, False, "share of the lag in the first of two filters, gate and display; 1 would be one"),
)  # fmt: skip
#: Of effects that came later: drawn after the stops, so that a seed goes on meaning the same rig.
_LATER = (
    ("play_spread", "1", 0.1, 0.8, False, "widest and narrowest of three plays beside their mean: joints, brushes, feedback"),
    ("leak_power", "1", 0.5, 1.0, False, "power of the pressure in a leak: 0.5 for an orifice, 1 for a gap"),
    ("throttle_power", "1", 0.6, 1.0, False, "the same of the throttle before a volume"),
    ("relief_closing", "1", 1.0, 3.0, True, "lag of a closing relief valve over an opening one's: orifice before its spring"),
    ("stop_power", "1", 1.0, 1.5, False, "power of a spool stop's force: 1 for a spring, 1.5 for a round end (Hertz)"),
    ("stop_depth", "m", 1e-5, 4e-5, True, "depth at which that force is a spring's: what full force presses into a stop"),
    ("check_lift", "Pa", 5e3, 1e5, True, "pressure over which the poppet of a check valve lifts: soft to stiff springs"),
    ("check_power", "1", 0.5, 1.0, False, "power of the pressure in its flow: 0.5 at full lift, 1 while it lifts further"),
    (
        "bristle_yield", "1", 0.5, 2.0, True,
        "power of the course from elastic to plastic of the second bristle: gives way early or late",
    ),
)  # fmt: skip
#: Every constant but the stops.
CONSTANTS = tuple(FormConstant(*row) for row in (*_ROWS, *_LATER))
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


def draw(rng: np.random.Generator) -> dict[str, float | tuple[float, ...]]:
    """The constants of one rig."""
    count = len(_ROWS)
    found: dict[str, float | tuple[float, ...]] = {c.name: c.at(rng.random()) for c in CONSTANTS[:count]}
    reach = found["stop_reach"]
    assert isinstance(reach, float)
    found |= _stops(reach, rng.random(STOPS), rng.gamma(2.0, size=STOPS))
    return found | {c.name: c.at(rng.random()) for c in CONSTANTS[count:]}


def scaled(constants: Constants, scales: Scales) -> dict[str, float | tuple[float, ...]]:
    """The same for a rig of another size: radii, pressures, flows and speeds over which a form turns grow with it."""
    return {n: v if isinstance(v, tuple) else scales.factor(UNITS[n]) * v for n, v in constants.items()}


_MEDIANS = {c.name: c.at(0.5) for c in CONSTANTS}
#: The median of every constant, stops evenly spread.
MIDDLE: Constants = {
    **_MEDIANS, **_stops(_MEDIANS["stop_reach"], (np.arange(STOPS) + 0.5) / STOPS, np.ones(STOPS))
}  # fmt: skip


def checked(constants: Constants | None) -> Constants:
    """`MIDDLE` where nothing is given. InputError for a name that is missing or unknown."""
    if constants is None:
        return MIDDLE
    wrong = sorted({*constants} ^ {*MIDDLE})
    if wrong:
        raise InputError(
            f"form constants: {wrong[0]!r} is {'unknown' if wrong[0] in constants else 'missing'}"
        )
    return constants
