"""Corrections of form: bends, curves and second elements at the port of a named effect, which are no physics.

The law of an effect in the catalogue is one form of many that a real valve or motor may have: a corner is rounded, a gain is
no straight line, a lag has a second pole. What a form leaves can be put right by a correction with a few numbers once the
effect itself has a name. The corrections here are such: rounded corners, curves by straight lines between fixed knots, more
elements of the same kind, more terms of a series. Each is an effect like any other, described once and simulated by the
same kernel, exactly absent at its neutral value; so a model file can carry it. None is a candidate of the
diagnosis and none ever explains anything by itself.

They belong to the family `shape` and are no part of `BUILT_IN`: the reference simulator does not know them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf
from typing import Any

from ..parameters import MOTOR_SIZE, SPOOL_FORCE, SPOOL_TRAVEL, Parameter
from ..vector_math import bell, clip, cos, exp, sign, sin, tanh
from .effect import Effect, State
from .force import MAGNETIC_HYSTERESIS

__all__ = ["CORRECTIONS", "EFFECTS", "FAMILY", "follows"]

#: The family of these effects.
FAMILY = "shape"

_NO_PHYSICS = "a correction of form, fitted; no physics"


def _amount(
    name: str, unit: str, typical: float, note: str, low: float | None = None, scaling: Mapping[str, float] | None = None
) -> Parameter:  # fmt: skip
    """A number of a correction: neutral at 0, up to four times `typical` either way."""
    low = -4.0 * typical if low is None else low
    return Parameter(name, unit, 0.0, low, 4.0 * typical, _NO_PHYSICS, note, typical, scaling=scaling or {})


def _repeated(name: str, unit: str, nominal: float, low: float, high: float, **more: Any) -> Parameter:
    return Parameter(name, unit, nominal, low, high, _NO_PHYSICS, "repeats what is corrected", **more)


def _taken(name: str, unit: str, low: float, typical: float) -> Parameter:
    """What a correction takes away of a force to which the effect has added it."""
    note = "repeats what is corrected, taken away"
    return Parameter(name, unit, 0.0, low, 0.0, _NO_PHYSICS, note, -typical, scaling=SPOOL_FORCE)


def _correction(
    name: str, port: str, summary: str, parameters: tuple[Parameter, ...], laws: Mapping[str, Callable[..., float]],
    corrects: Mapping[str, Mapping[str, str | float]], states: tuple[State, ...] = (), **more: Any,
) -> Effect:  # fmt: skip
    return Effect(
        name=name, port=port, parameters=parameters, summary=summary, signature="what the form of a named effect leaves",
        source=_NO_PHYSICS, laws=laws, corrects=corrects, states=states, family=FAMILY, **more,
    )  # fmt: skip


# --- driver -----------------------------------------------------------------------------------------------------------
def _knee(voltage, command, drop, reach, voltage_limit):
    # What the output lacks falls with the third power of the distance from the limit.
    away = 1.0 - abs(abs(command) / voltage_limit - 1.0) / reach
    away = away if away > 0.0 else 0.0
    lack = drop * voltage_limit * away * away * away
    return voltage - sign(command) * (lack if drop > 0.0 else 0.0)


KNEE_SHAPE = _correction(
    "knee_shape", "driver", "the driver gives less than is asked for even before its limit",
    (
        _amount("drop", "1", 0.02, "share of the limit that is lacking when the limit is asked for", 0.0),
        Parameter(
            "reach", "1", 0.15, 0.03, 0.6, _NO_PHYSICS, "share of the limit, both ways, from which on it lacks", 0.15, log=True
        ),
        _repeated("voltage_limit", "V", 1e9, 1.0, 1e9),
    ),
    {"voltage": _knee},
    {"driver_saturation": {"voltage_limit": "voltage_limit"}},
)  # fmt: skip


# --- opening ----------------------------------------------------------------------------------------------------------
def _rounded(opening, spool, rounding, turn, corner_positive, corner_negative):
    # A parabola within `rounding` of either corner in the place of the bend.
    near = rounding - abs(spool - corner_positive)
    far = rounding - abs(spool + corner_negative)
    near = near if near > 0.0 else 0.0
    far = far if far > 0.0 else 0.0
    return opening + 0.25 * turn * (near * near - far * far) / (rounding if rounding > 1e-9 else 1e-9)


CORNER_SHAPE = _correction(
    "corner_shape", "opening", "corners of the opening are rounded",
    (
        _amount("rounding", "m", 1e-5, "half the travel over which a corner is rounded", 0.0, SPOOL_TRAVEL),
        _repeated("turn", "1", 1.0, -1.0, 1.0),
        _repeated("corner_positive", "m", 0.0, 0.0, inf, scaling=SPOOL_TRAVEL),
        _repeated("corner_negative", "m", 0.0, 0.0, inf, scaling=SPOOL_TRAVEL),
    ),
    {"opening": _rounded},
    {
        "dead_zone": {"turn": 1.0, "corner_positive": "overlap_positive", "corner_negative": "overlap_negative"},
        "flow_saturation": {"turn": -1.0, "corner_positive": "opening_limit", "corner_negative": "opening_limit"},
    },
)  # fmt: skip


def _gain_curve(opening, gain_0, gain_1, gain_2, gain_3, gain_4, gain_5, gain_6, alpha, u_rated, R, k):
    # Between two knots, an octave apart, t (1.343 - 0.343 t) of t = share / knot - 1 goes from 0 to 1 as the logarithm does.
    share = abs(opening) * (R * k / (alpha * u_rated))
    curve = gain_0
    t_1 = clip(share * 64.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_1 - gain_0) * t_1 * (1.343 - 0.343 * t_1)
    t_2 = clip(share * 32.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_2 - gain_1) * t_2 * (1.343 - 0.343 * t_2)
    t_3 = clip(share * 16.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_3 - gain_2) * t_3 * (1.343 - 0.343 * t_3)
    t_4 = clip(share * 8.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_4 - gain_3) * t_4 * (1.343 - 0.343 * t_4)
    t_5 = clip(share * 4.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_5 - gain_4) * t_5 * (1.343 - 0.343 * t_5)
    t_6 = clip(share * 2.0 - 1.0, 0.0, 1.0)
    curve = curve + (gain_6 - gain_5) * t_6 * (1.343 - 0.343 * t_6)
    return opening * (1.0 + curve)


OPENING_SHAPE = _correction(
    "opening_shape", "opening", "gain of the opening as a curve over the logarithm of the opening",
    tuple(
        # A gain may be several times another; it cannot lose more than all.
        Parameter(
            f"gain_{n}", "1", 0.0, -0.8, 3.0, _NO_PHYSICS, f"relative gain at 1/{2 ** (6 - n)} of the rated opening", 0.2
        )
        for n in range(7)
    ),
    {"opening": _gain_curve},
    {n: {} for n in ("flow_gain_nonlinearity", "dead_zone", "flow_saturation", "directional_gain", "null_offset")},
)  # fmt: skip


# --- force on the spool -----------------------------------------------------------------------------------------------
def _centring(force, spool, force_1, force_2, force_3, force_4, force_5):
    x = abs(spool)
    curve = force_1 * clip(x * 2e5, 0.0, 1.0)
    curve = curve + (force_2 - force_1) * clip((x - 5e-6) * 1e5, 0.0, 1.0)
    curve = curve + (force_3 - force_2) * clip((x - 1.5e-5) * (1.0 / 2e-5), 0.0, 1.0)
    curve = curve + (force_4 - force_3) * clip((x - 3.5e-5) * (1.0 / 4.5e-5), 0.0, 1.0)
    curve = curve + (force_5 - force_4) * clip((x - 8e-5) * (1.0 / 1.2e-4), 0.0, 1.0)
    return force - sign(spool) * curve


CENTRING_SHAPE = _correction(
    "centring_shape", "force", "centring force as a curve over the travel",
    tuple(
        _amount(f"force_{n}", "N", 0.15, f"centring force at {x} um of travel", scaling=SPOOL_FORCE)
        for n, x in enumerate((5, 15, 35, 80, 200), 1)
    ),
    {"force": _centring},
    {"spring_preload": {}, "flow_force": {}},
)  # fmt: skip


def _stops_force(
    force, height_1, height_2, height_3, height_4, amplitude, as_before, stop_1, stop_2, stop_3, stop_4
):
    moved = height_1 * (stop_1 - as_before) + height_2 * (stop_2 - as_before)
    moved = moved + height_3 * (stop_3 - as_before) + height_4 * (stop_4 - as_before)
    return force - amplitude * moved


def _stop_rate(stop, current_rate, times, amplitude, width, alpha):
    least = 2.0 * amplitude / alpha
    travel = times * (width if width > least else least)
    # Free on the way back; on the way on it gives way with the eighth power. A long step that goes beyond 1 is taken back.
    ahead = stop if current_rate > 0.0 else -stop
    inside = ahead if ahead < 1.0 else 1.0
    squared = inside * inside
    fourth = squared * squared
    free = 1.0 - fourth * fourth if ahead > 0.0 else 1.0
    return current_rate * free / travel - 2e4 * (stop - clip(stop, -1.0, 1.0))


def _stop_decay(stop, current_rate, times, amplitude, width, alpha):
    least = 2.0 * amplitude / alpha
    travel = times * (width if width > least else least)
    ahead = stop if current_rate > 0.0 else -stop
    inside = ahead if ahead < 1.0 else 1.0
    squared = inside * inside
    slope = 8.0 * squared * squared * squared * inside
    # Never less than what keeps a long step of the current from shooting far beyond the limit.
    return abs(current_rate) * (slope if slope > 1.0 else 1.0) / travel + (2e4 if ahead > 1.0 else 0.0)


#: Travels of the stops until they give way, over the width of the effect's own loop.
_STOPS = (0.25, 0.5, 1.0, 2.0)
# The loop of the catalogue's law, from which the stops take over.
(_LOOP,) = MAGNETIC_HYSTERESIS.states

STOP_SHAPE = _correction(
    "stop_shape", "force", "loop of the magnet from four stops that give way one after the other (Prandtl-Ishlinskii)",
    (
        *(
            _amount(f"height_{n}", "1", 0.25, f"share of the height held by the stop of {s:g} times the width")
            for n, s in enumerate(_STOPS, 1)
        ),
        _repeated("amplitude", "N", 0.0, 0.0, 2.0, scaling=SPOOL_FORCE),
        _repeated("width", "A", 0.03, 0.01, 0.2),
    ),
    {"force": _stops_force},
    {"magnetic_hysteresis": {"amplitude": "amplitude", "width": "width"}},
    (
        State("as_before", _LOOP.rate, _LOOP.decay, {"loop": "as_before"}),
        *(
            State(f"stop_{n}", _stop_rate, _stop_decay, {"stop": f"stop_{n}", "times": times})
            for n, times in enumerate(_STOPS, 1)
        ),
    ),
)  # fmt: skip


def _second_bristle(force, spool_speed, bristle_2, coulomb, static, firm, damping, stiffness, vs, s0, s1):
    slip = abs(spool_speed) / vs
    level = coulomb + (static - coulomb) * bell(slip)
    level = level if level > 1e-6 else 1e-6
    share = abs(bristle_2) * s0 * stiffness / level
    share = share if share < 1.0 else 1.0
    squared = share * share
    give = 1.0 - firm + (firm * squared * squared * squared if bristle_2 * spool_speed > 0.0 else 0.0)
    rate = spool_speed - give * abs(spool_speed) * s0 * stiffness / level * bristle_2
    held = s0 * stiffness * bristle_2 + damping * s1 * rate
    return force - (held if coulomb + static > 0.0 else 0.0)


def _bristle_rate(bristle_2, spool_speed, coulomb, static, firm, stiffness, vs, s0):
    slip = abs(spool_speed) / vs
    level = coulomb + (static - coulomb) * bell(slip)
    level = level if level > 1e-6 else 1e-6
    share = abs(bristle_2) * s0 * stiffness / level
    share = share if share < 1.0 else 1.0
    squared = share * share
    give = 1.0 - firm + (firm * squared * squared * squared if bristle_2 * spool_speed > 0.0 else 0.0)
    return spool_speed - give * abs(spool_speed) * s0 * stiffness / level * bristle_2


def _bristle_decay(spool_speed, coulomb, static, stiffness, vs, s0):
    slip = abs(spool_speed) / vs
    level = coulomb + (static - coulomb) * bell(slip)
    return abs(spool_speed) * s0 * stiffness / (level if level > 1e-6 else 1e-6)


BRISTLE_SHAPE = _correction(
    "bristle_shape", "force", "what friction the spool has more is held by a second bristle, which gives way late",
    (
        _amount("damping", "1", 0.5, "damping of the second bristle over the first one's", 0.0),
        Parameter("firm", "1", 0.5, 0.0, 1.0, _NO_PHYSICS, "0: creeps like the first one, 1: holds until near its limit", 0.5),
        Parameter(
            "stiffness", "1", 1.0, 0.2, 5.0, _NO_PHYSICS, "stiffness of the second bristle over the first one's", 1.0, log=True
        ),
        _repeated("coulomb", "N", 0.0, 0.0, 2.0, scaling=SPOOL_FORCE),
        _repeated("static", "N", 0.0, 0.0, 3.0, scaling=SPOOL_FORCE),
        _taken("coulomb_taken", "N", -2.0, 0.3),
        _taken("static_taken", "N", -3.0, 0.6),
    ),
    {"force": _second_bristle},
    {
        "spool_stiction": {
            "coulomb": "coulomb", "static": "static", "coulomb_taken": "-coulomb", "static_taken": "-static",
        }
    },
    (State("bristle_2", _bristle_rate, _bristle_decay),),
    adds_to={"Fc": "coulomb_taken", "Fs": "static_taken"},
)  # fmt: skip


# --- supply -----------------------------------------------------------------------------------------------------------
def _late_drive(drive, first, second, delay):
    return drive + (first - second if delay > 0.0 else 0.0)


def _first_rate(first, own_flow, other_flow, relative_drop, time_constant):
    return (relative_drop * (abs(own_flow) + abs(other_flow)) / 8.1778e-4 - first) / time_constant


def _second_rate(second, first, delay):
    return (first - second) / (delay if delay > 1e-5 else 1e-5)


def _second_decay(delay):
    return 1.0 / (delay if delay > 1e-5 else 1e-5)


SUPPLY_SHAPE = _correction(
    "supply_shape", "supply", "the supply follows the flow with a second lag",
    (
        _amount("delay", "s", 0.02, "time constant of the second lag", 0.0),
        _repeated("relative_drop", "1", 0.0, 0.0, 0.9),
        _repeated("time_constant", "s", 0.1, 0.01, 5.0),
    ),
    {"drive": _late_drive},
    {"supply_droop": {"relative_drop": "relative_drop", "time_constant": "time_constant"}},
    (State("first", _first_rate), State("second", _second_rate, _second_decay)),
    scope="rig",
)  # fmt: skip


# --- line -------------------------------------------------------------------------------------------------------------
def _softness_curve(bulk_modulus, pressure, soft_0, soft_1, soft_2, soft_3, soft_4):
    p = abs(pressure)
    curve = soft_0 + (soft_1 - soft_0) * clip(p * (1.0 / 1e5), 0.0, 1.0)
    curve = curve + (soft_2 - soft_1) * clip((p - 1e5) * (1.0 / 1.5e5), 0.0, 1.0)
    curve = curve + (soft_3 - soft_2) * clip((p - 2.5e5) * (1.0 / 3.5e5), 0.0, 1.0)
    curve = curve + (soft_4 - soft_3) * clip((p - 6e5) * (1.0 / 14e5), 0.0, 1.0)
    return bulk_modulus * exp(-curve)


SOFTNESS_SHAPE = _correction(
    "softness_shape", "line", "softness of the fluid as a curve over the pressure",
    tuple(
        _amount(f"soft_{n}", "1", 0.15, f"log of the relative softness at {p:g} bar") for n, p in enumerate((0, 1, 2.5, 6, 20))
    ),
    {"bulk_modulus": _softness_curve},
    {"entrained_air": {}},
)  # fmt: skip


def _override(leakage, pressure, rounding, steepening, relief_pressure, conductance):
    # A parabola within `rounding` of the setting in the place of the bend, and a slope that changes with the excess.
    excess = abs(pressure) - relief_pressure
    near = rounding - abs(excess)
    near = near if near > 0.0 else 0.0
    excess = excess if excess > 0.0 else 0.0
    more = 0.25 * near * near / (rounding if rounding > 1.0 else 1.0) + steepening * excess * excess * 1e-6
    return leakage + sign(pressure) * conductance * more


OVERRIDE_SHAPE = _correction(
    "override_shape", "line", "relief valves crack gradually, and their slope changes with the excess",
    (
        _amount("rounding", "Pa", 5e4, "half the range of pressure over which they crack", 0.0),
        Parameter("steepening", "1/MPa", 0.0, -0.5, 2.0, _NO_PHYSICS, "growth of the slope with the excess", 0.3),
        _repeated("relief_pressure", "Pa", inf, 5e5, inf),
        _repeated("conductance", "m3/(s Pa)", 1e-9, 1e-10, 3e-9, scaling=MOTOR_SIZE),
    ),
    {"leakage": _override},
    {"crossport_relief": {"relief_pressure": "relief_pressure", "conductance": "conductance"}},
)  # fmt: skip


# --- motor and load ---------------------------------------------------------------------------------------------------
def _torque_curve(torque, speed, torque_1, torque_2, torque_3, torque_4, torque_5, torque_6):
    w = abs(speed)
    curve = torque_1 * clip(w * 5.0, 0.0, 1.0)
    curve = curve + (torque_2 - torque_1) * clip((w - 0.2) * (1.0 / 0.5), 0.0, 1.0)
    curve = curve + (torque_3 - torque_2) * clip((w - 0.7) * (1.0 / 1.8), 0.0, 1.0)
    curve = curve + (torque_4 - torque_3) * clip((w - 2.5) * (1.0 / 5.5), 0.0, 1.0)
    curve = curve + (torque_5 - torque_4) * clip((w - 8.0) * (1.0 / 17.0), 0.0, 1.0)
    curve = curve + (torque_6 - torque_5) * clip((w - 25.0) * (1.0 / 55.0), 0.0, 1.0)
    return torque - sign(speed) * curve


TORQUE_SHAPE = _correction(
    "torque_shape", "motor", "torque that is lost as a curve over the speed",
    tuple(
        _amount(f"torque_{n}", "N m", 0.04, f"torque lost at {w:g} rad/s", scaling=MOTOR_SIZE)
        for n, w in enumerate((0.2, 0.7, 2.5, 8, 25, 80), 1)
    ),
    {"torque": _torque_curve},
    {"motor_coulomb_friction": {}, "quadratic_drag": {}, "line_loss": {}},
)  # fmt: skip


def _dahl_torque(torque, speed, rest, travel, damping, coulomb, static, stribeck_speed):
    slip = speed / stribeck_speed
    level = coulomb + (static - coulomb) * exp(-slip * slip)
    least = travel if travel > 1e-5 else 1e-5
    rate = (speed - abs(speed) * rest) / least
    moved = level * (tanh(speed * 10.0) - rest) - damping * coulomb * rate
    return torque + (moved if travel > 0.0 else 0.0)


def _rest_rate(rest, speed, travel):
    return (speed - abs(speed) * rest) / (travel if travel > 1e-5 else 1e-5)


def _rest_decay(speed, travel):
    return abs(speed) / (travel if travel > 1e-5 else 1e-5)


def _rest_corner(speed, travel):
    return travel > 0.0 and abs(speed) < 1.0


REST_SHAPE = _correction(
    "rest_shape", "motor", "dry friction builds up over a small turn (Dahl) in the place of a smooth step",
    (
        _amount("travel", "rad", 0.003, "turn over which the friction builds up", 0.0),
        Parameter("damping", "s", 0.002, 0.0, 0.02, _NO_PHYSICS, "damping while it builds up, over the friction", 0.002),
        _repeated("coulomb", "N m", 0.0, 0.0, 2.0, scaling=MOTOR_SIZE),
        _repeated("static", "N m", 0.0, 0.0, 3.0, scaling=MOTOR_SIZE),
        _repeated("stribeck_speed", "rad/s", 3.0, 0.2, 20.0),
    ),
    {"torque": _dahl_torque},
    {"motor_coulomb_friction": {n: n for n in ("coulomb", "static", "stribeck_speed")}},
    (State("rest", _rest_rate, _rest_decay),),
    corner=_rest_corner,
)  # fmt: skip


def _more_ripple(displacement, angle, sine_1, cosine_2, sine_2, cosine_3, sine_3, order, D):
    c = cos(order * angle)
    s = sin(order * angle)
    c2 = c * c - s * s
    s2 = 2.0 * s * c
    more = (
        sine_1 * s + cosine_2 * c2 + sine_2 * s2 + cosine_3 * (c2 * c - s2 * s) + sine_3 * (s2 * c + c2 * s)
    )
    return displacement + D * more


RIPPLE_SHAPE = _correction(
    "ripple_shape", "motor", "phase and harmonics of the ripple of the displacement",
    (
        *(
            _amount(n, "1", 0.01, f"{'co' * n.startswith('co')}sine of {n[-1]} times the ripple's order")
            for n in ("sine_1", "cosine_2", "sine_2", "cosine_3", "sine_3")
        ),
        _repeated("order", "1", 7.0, 3.0, 13.0),
    ),
    {"displacement": _more_ripple},
    {"displacement_ripple": {"order": "order"}},
)  # fmt: skip


def _more_turns(torque, angle, cosine_2, sine_2, cosine_3, sine_3):
    c = cos(angle)
    s = sin(angle)
    c2 = c * c - s * s
    s2 = 2.0 * s * c
    return torque - (cosine_2 * c2 + sine_2 * s2 + cosine_3 * (c2 * c - s2 * s) + sine_3 * (s2 * c + c2 * s))


TURNING_SHAPE = _correction(
    "turning_shape", "load", "harmonics of a torque that turns with the shaft",
    tuple(
        _amount(n, "N m", 0.05, f"{'co' * n.startswith('co')}sine of {n[-1]} times the shaft's angle", scaling=MOTOR_SIZE)
        for n in ("cosine_2", "sine_2", "cosine_3", "sine_3")
    ),
    {"torque": _more_turns},
    {"eccentric_load": {}},
)  # fmt: skip


# --- fluid ------------------------------------------------------------------------------------------------------------
def _second_drift_leakage(leakage_coefficient, more, time, time_constant):
    return leakage_coefficient * exp(-more * (1.0 - exp(-time / time_constant)))


def _second_drift_friction(viscous_friction, more, time, time_constant):
    return viscous_friction * exp(more * (1.0 - exp(-time / time_constant)))


DRIFT_SHAPE = _correction(
    "drift_shape", "fluid", "a second, faster or slower part of the drift",
    (
        _amount("more", "1", 0.2, "log of final over initial viscosity, second part"),
        Parameter("time_constant", "s", 3.0, 0.3, 3000.0, _NO_PHYSICS, "time constant of the second part", 3.0, log=True),
    ),
    {"leakage_coefficient": _second_drift_leakage, "viscous_friction": _second_drift_friction},
    {"viscosity_drift": {}},
    scope="rig",
)  # fmt: skip


# --- sensor -----------------------------------------------------------------------------------------------------------
def _late_speed(measured_speed, first, second, delay):
    return measured_speed + (second - first if delay > 0.0 else 0.0)


def _sensor_first(first, speed, time_constant):
    return (speed - first) / (time_constant if time_constant > 1e-5 else 1e-5)


def _sensor_first_decay(time_constant):
    return 1.0 / (time_constant if time_constant > 1e-5 else 1e-5)


SENSOR_SHAPE = _correction(
    "sensor_shape", "sensor", "the sensor follows with a second lag",
    (
        _amount("delay", "s", 0.005, "time constant of the second lag", 0.0),
        _repeated("time_constant", "s", 0.0, 0.0, 0.1),
    ),
    {"measured_speed": _late_speed},
    {"sensor_lag": {"time_constant": "time_constant"}},
    (State("first", _sensor_first, _sensor_first_decay), State("second", _second_rate, _second_decay)),
)  # fmt: skip


# fmt: off
#: In the order in which they act.
EFFECTS = (
    KNEE_SHAPE, CORNER_SHAPE, OPENING_SHAPE, CENTRING_SHAPE, STOP_SHAPE, BRISTLE_SHAPE, SUPPLY_SHAPE, SOFTNESS_SHAPE,
    OVERRIDE_SHAPE, TORQUE_SHAPE, REST_SHAPE, RIPPLE_SHAPE, TURNING_SHAPE, DRIFT_SHAPE, SENSOR_SHAPE,
)
# fmt: on

#: Corrections that fit an effect, by the effect's name; see `Effect.corrects` for what belongs to each.
CORRECTIONS: dict[str, dict[str, Mapping[str, str | float]]] = {}
for _effect in EFFECTS:
    for _corrected, _repeats in _effect.corrects.items():
        CORRECTIONS.setdefault(_corrected, {})[_effect.name] = _repeats


def follows(correction: str, effect: str) -> dict[str, str | float]:
    """The parameters of a correction that are not its own: by full name the full name (with a minus where they repeat
    its opposite), or the number, that they repeat."""
    found: dict[str, str | float] = {}
    for own, source in CORRECTIONS[effect][correction].items():
        if isinstance(source, str):
            source = f"-{effect}.{source[1:]}" if source.startswith("-") else f"{effect}.{source}"
        found[f"{correction}.{own}"] = source
    return found
