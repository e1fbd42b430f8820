"""Shape corrections: bends, curves and second elements at the port of a named effect, which are no physics.

The law of an effect in the catalogue is one form of many that a real valve or motor may have: a corner is rounded, a gain is
no straight line, a lag has a second pole. What a form leaves can be put right by a correction with a few numbers once the
effect itself has a name. The corrections here are such: rounded corners, curves by straight lines between fixed knots, more
elements of the same kind, more terms of a series. Each is an effect like any other, described once and simulated by the
same kernel, exactly absent at its neutral value; so a model file can carry it. None is a candidate of the
diagnosis and none ever explains anything by itself. Parameters with the remark "as NAME" repeat those of the effect that is
corrected.

They belong to the family `shape` and are no part of `BUILT_IN`: the reference simulator does not know them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf

from .effects import Effect, State, register
from .lanemath import clip, cos, exp, sign, sin
from .parameters import Parameter

__all__ = ["CORRECTIONS", "FAMILY", "follows"]

#: The family of these effects.
FAMILY = "shape"

#: Corrections that fit an effect, by the effect's name, each with the parameters that repeat something of that effect:
#: the name of one of its parameters, or a number.
CORRECTIONS: dict[str, dict[str, Mapping[str, str | float]]] = {}

_NO_PHYSICS = "a correction of form, fitted; no physics"


def _amount(name: str, unit: str, typical: float, note: str, low: float | None = None) -> Parameter:
    """A number of a correction: neutral at 0, up to four times `typical` either way."""
    return Parameter(
        name, unit, 0.0, -4.0 * typical if low is None else low, 4.0 * typical, _NO_PHYSICS, note, typical
    )


def _repeated(name: str, unit: str, nominal: float, low: float, high: float) -> Parameter:
    return Parameter(name, unit, nominal, low, high, _NO_PHYSICS, "repeats what is corrected", nominal)


def _correction(
    name: str, port: str, summary: str, parameters: tuple[Parameter, ...], laws: Mapping[str, Callable[..., float]],
    of: Mapping[str, Mapping[str, str | float]], states: tuple[State, ...] = (), scope: str = "channel",
) -> None:  # fmt: skip
    register(
        Effect(
            name=name, port=port, parameters=parameters, summary=summary, signature="what the form of a named effect leaves",
            source=_NO_PHYSICS, laws=laws, states=states, scope=scope, family=FAMILY,
        )
    )  # fmt: skip
    for effect, repeated in of.items():
        CORRECTIONS.setdefault(effect, {})[name] = repeated


def follows(correction: str, effect: str) -> dict[str, str | float]:
    """The parameters of a correction that are not its own: by full name the full name, or the number, that they repeat."""
    return {
        f"{correction}.{own}": f"{effect}.{source}" if isinstance(source, str) else source
        for own, source in CORRECTIONS[effect][correction].items()
    }


# --- opening ----------------------------------------------------------------------------------------------------------
def _rounded(opening, spool, rounding, turn, corner_positive, corner_negative):
    # A parabola within `rounding` of either corner in the place of the bend.
    near = rounding - abs(spool - corner_positive)
    far = rounding - abs(spool + corner_negative)
    near = near if near > 0.0 else 0.0
    far = far if far > 0.0 else 0.0
    return opening + 0.25 * turn * (near * near - far * far) / (rounding if rounding > 1e-9 else 1e-9)


_correction(
    "corner_shape", "opening", "corners of the opening are rounded",
    (
        _amount("rounding", "m", 1e-5, "half the travel over which a corner is rounded", 0.0),
        _repeated("turn", "1", 1.0, -1.0, 1.0),
        _repeated("corner_positive", "m", 0.0, 0.0, inf),
        _repeated("corner_negative", "m", 0.0, 0.0, inf),
    ),
    {"opening": _rounded},
    {
        "dead_zone": {"turn": 1.0, "corner_positive": "overlap_positive", "corner_negative": "overlap_negative"},
        "flow_saturation": {"turn": -1.0, "corner_positive": "opening_limit", "corner_negative": "opening_limit"},
    },
)  # fmt: skip


def _gain_curve(opening, gain_0, gain_1, gain_2, gain_3, gain_4, gain_5, alpha, u_rated, R, k):
    share = abs(opening) * (R * k / (alpha * u_rated))
    curve = gain_0 + (gain_1 - gain_0) * clip((share - 0.02) * (1.0 / 0.03), 0.0, 1.0)
    curve = curve + (gain_2 - gain_1) * clip((share - 0.05) * (1.0 / 0.07), 0.0, 1.0)
    curve = curve + (gain_3 - gain_2) * clip((share - 0.12) * (1.0 / 0.18), 0.0, 1.0)
    curve = curve + (gain_4 - gain_3) * clip((share - 0.3) * (1.0 / 0.3), 0.0, 1.0)
    curve = curve + (gain_5 - gain_4) * clip((share - 0.6) * (1.0 / 0.4), 0.0, 1.0)
    return opening * (1.0 + curve)


_correction(
    "opening_shape", "opening", "gain of the opening as a curve over the opening",
    tuple(
        _amount(f"gain_{n}", "1", 0.1, f"relative gain at {100 * s:g} % of the rated opening")
        for n, s in enumerate((0.02, 0.05, 0.12, 0.3, 0.6, 1.0))
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


_correction(
    "centring_shape", "force", "centring force as a curve over the travel",
    tuple(
        _amount(f"force_{n}", "N", 0.15, f"centring force at {x} um of travel") for n, x in enumerate((5, 15, 35, 80, 200), 1)
    ),
    {"force": _centring},
    {"spring_preload": {}, "flow_force": {}},
)  # fmt: skip


def _loops_force(force, wide, narrow, wide_loop, narrow_loop):
    return force - wide * wide_loop - narrow * narrow_loop


def _wide_rate(wide_loop, current_rate, width, blunt):
    # Currents keep it between -1 and 1; beyond, a rate that grew with the cube would run away in a long step.
    squared = wide_loop * wide_loop
    squared = squared if squared < 1.0 else 1.0
    return (current_rate - abs(current_rate) * wide_loop * (blunt + (1.0 - blunt) * squared)) / (width * 2.5)


def _wide_decay(wide_loop, current_rate, width, blunt):
    squared = wide_loop * wide_loop
    squared = squared if squared < 1.0 else 1.0
    return abs(current_rate) * (blunt + 3.0 * (1.0 - blunt) * squared) / (width * 2.5)


def _narrow_rate(narrow_loop, current_rate, width, blunt):
    squared = narrow_loop * narrow_loop
    squared = squared if squared < 1.0 else 1.0
    return (current_rate - abs(current_rate) * narrow_loop * (blunt + (1.0 - blunt) * squared)) / (
        width * 0.8
    )


def _narrow_decay(narrow_loop, current_rate, width, blunt):
    squared = narrow_loop * narrow_loop
    squared = squared if squared < 1.0 else 1.0
    return abs(current_rate) * (blunt + 3.0 * (1.0 - blunt) * squared) / (width * 0.8)


_correction(
    "loop_shape", "force", "two more loops of the magnet, one wide and one narrow",
    (
        _amount("wide", "N", 0.15, "half height of the wide loop", 0.0),
        _amount("narrow", "N", 0.15, "half height of the narrow loop", 0.0),
        Parameter("blunt", "1", 0.5, 0.0, 1.0, _NO_PHYSICS, "1: loops that saturate slowly, 0: sharply", 0.5),
        _repeated("width", "A", 0.03, 0.01, 0.2),
    ),
    {"force": _loops_force},
    {"magnetic_hysteresis": {"width": "width"}},
    (State("wide_loop", _wide_rate, _wide_decay), State("narrow_loop", _narrow_rate, _narrow_decay)),
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


_correction(
    "supply_shape", "supply", "the supply follows the flow with a second lag",
    (
        _amount("delay", "s", 0.02, "time constant of the second lag", 0.0),
        _repeated("relative_drop", "1", 0.0, 0.0, 0.9),
        _repeated("time_constant", "s", 0.1, 0.01, 5.0),
    ),
    {"drive": _late_drive},
    {"supply_droop": {"relative_drop": "relative_drop", "time_constant": "time_constant"}},
    (State("first", _first_rate), State("second", _second_rate, _second_decay)),
    "rig",
)  # fmt: skip


# --- line -------------------------------------------------------------------------------------------------------------
def _softness_curve(bulk_modulus, pressure, soft_0, soft_1, soft_2, soft_3, soft_4):
    p = abs(pressure)
    curve = soft_0 + (soft_1 - soft_0) * clip(p * (1.0 / 1e5), 0.0, 1.0)
    curve = curve + (soft_2 - soft_1) * clip((p - 1e5) * (1.0 / 1.5e5), 0.0, 1.0)
    curve = curve + (soft_3 - soft_2) * clip((p - 2.5e5) * (1.0 / 3.5e5), 0.0, 1.0)
    curve = curve + (soft_4 - soft_3) * clip((p - 6e5) * (1.0 / 14e5), 0.0, 1.0)
    return bulk_modulus * exp(-curve)


_correction(
    "softness_shape", "line", "softness of the fluid as a curve over the pressure",
    tuple(
        _amount(f"soft_{n}", "1", 0.15, f"log of the relative softness at {p:g} bar") for n, p in enumerate((0, 1, 2.5, 6, 20))
    ),
    {"bulk_modulus": _softness_curve},
    {"entrained_air": {}},
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


_correction(
    "torque_shape", "motor", "torque that is lost as a curve over the speed",
    tuple(
        _amount(f"torque_{n}", "N m", 0.04, f"torque lost at {w:g} rad/s") for n, w in enumerate((0.2, 0.7, 2.5, 8, 25, 80), 1)
    ),
    {"torque": _torque_curve},
    {"motor_coulomb_friction": {}, "quadratic_drag": {}, "line_loss": {}},
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


_correction(
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


_correction(
    "turning_shape", "load", "harmonics of a torque that turns with the shaft",
    tuple(
        _amount(n, "N m", 0.05, f"{'co' * n.startswith('co')}sine of {n[-1]} times the shaft's angle")
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


_correction(
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


_correction(
    "sensor_shape", "sensor", "the sensor follows with a second lag",
    (
        _amount("delay", "s", 0.005, "time constant of the second lag", 0.0),
        _repeated("time_constant", "s", 0.0, 0.0, 0.1),
    ),
    {"measured_speed": _late_speed},
    {"sensor_lag": {"time_constant": "time_constant"}},
    (State("first", _sensor_first, _sensor_first_decay), State("second", _second_rate, _second_decay)),
)  # fmt: skip
