"""Corrections of the forms of supply, line, motor, load, fluid and sensor."""

from math import inf

from ...parameters import MOTOR_SIZE
from ...vector_math import clip, cos, exp, positive, sign, sin, tanh
from ..effect import State
from ..fluid import drifted
from ..line import BOTH_LINES
from ..load import SHAFT_BACKLASH
from ..sensor import SENSOR_LAG
from ..supply import SUPPLY_DROOP, steady_droop
from .correction import amount, correction, fitted, repeated


# --- supply -----------------------------------------------------------------------------------------------------------
# Two lags whose time constants have the effect's as their sum, which stays the mean delay, whatever the form.
def _late_drive(drive, droop, second, share):
    return drive + (droop - second if share > 0.0 else 0.0)


def _first_droop(first, own_flow, other_flow, relative_drop, time_constant, share):
    return (steady_droop(own_flow, other_flow, relative_drop) - first) / (time_constant * (1.0 - share))


def _second_rate(second, first, time_constant, share):
    lag = time_constant * share
    return (first - second) / (lag if lag > 1e-5 else 1e-5)


SUPPLY_FORM = correction(
    name="supply_form", port="supply", summary="the supply follows the flow with two lags of the same sum",
    parameters=(fitted("share", "1", 0.0, 0.0, 0.5, "share of the memory in the second lag", 0.2),),
    laws={"drive": _late_drive},
    corrects={"supply_droop": {}},
    states=(State("first", _first_droop, scale=0.1), State("second", _second_rate, scale=0.1)),
    scope="rig",
    shares=SUPPLY_DROOP,
)  # fmt: skip


# --- line -------------------------------------------------------------------------------------------------------------
def _softness_curve(bulk_modulus, pressure, soft_0, soft_1, soft_2, soft_3, soft_4):
    p = abs(pressure)
    curve = soft_0 + (soft_1 - soft_0) * clip(p * (1.0 / 1e5), 0.0, 1.0)
    curve = curve + (soft_2 - soft_1) * clip((p - 1e5) * (1.0 / 1.5e5), 0.0, 1.0)
    curve = curve + (soft_3 - soft_2) * clip((p - 2.5e5) * (1.0 / 3.5e5), 0.0, 1.0)
    curve = curve + (soft_4 - soft_3) * clip((p - 6e5) * (1.0 / 14e5), 0.0, 1.0)
    return bulk_modulus * exp(-curve)


SOFTNESS_FORM = correction(
    name="softness_form", port="line", summary="softness of the fluid as a curve over the pressure",
    parameters=tuple(
        amount(f"soft_{n}", "1", 0.15, f"log of the relative softness at {p:g} bar") for n, p in enumerate((0, 1, 2.5, 6, 20))
    ),
    laws={"bulk_modulus": _softness_curve},
    corrects={"entrained_air": {}},
)  # fmt: skip


def _override(leakage, pressure, rounding, steepening, relief_pressure, conductance):
    # A parabola within `rounding` of the setting in the place of the bend, and a slope that changes with the excess.
    excess = abs(pressure) - relief_pressure
    near = positive(rounding - abs(excess))
    excess = positive(excess)
    # A slope that falls with the excess falls to zero; the flow does not turn back.
    turn = 0.5e6 / -steepening if steepening < 0.0 else excess
    excess = excess if excess < turn else turn
    more = 0.25 * near * near / (rounding if rounding > 1.0 else 1.0) + steepening * excess * excess * 1e-6
    return leakage + sign(pressure) * conductance * more


OVERRIDE_FORM = correction(
    name="override_form", port="line", summary="relief valves crack gradually, and their slope changes with the excess",
    parameters=(
        amount("rounding", "Pa", 5e4, "half the range of pressure over which they crack", 0.0),
        fitted("steepening", "1/MPa", 0.0, -0.5, 2.0, "growth of the slope with the excess", 0.3),
        repeated("relief_pressure", "Pa", inf, 5e5, inf),
        repeated("conductance", "m3/(s Pa)", 1e-9, 1e-10, 3e-9, scaling=MOTOR_SIZE),
    ),
    laws={"leakage": _override},
    corrects={"crossport_relief": {"relief_pressure": "relief_pressure", "conductance": "conductance"}},
)  # fmt: skip


# The leaking line's pressure over half the supply's, where the conductance is that of the leak.
def _share_of_half(pressure, mean_pressure, conductance, supply_pressure):
    return positive(1.0 + mean_pressure + sign(conductance) * pressure / supply_pressure)


def _relative_leak(share, leak_0, leak_1, leak_2):
    curve = leak_0 + (leak_1 - leak_0) * clip(share * 8.0 - 1.0, 0.0, 1.0)
    curve = curve + (leak_2 - leak_1) * clip(share * 4.0 - 1.0, 0.0, 1.0)
    return curve - leak_2 * clip(share * 2.0 - 1.0, 0.0, 1.0)


def _leak_curve(leakage, pressure, mean_pressure, leak_0, leak_1, leak_2, conductance, supply_pressure):
    share = _share_of_half(pressure, mean_pressure, conductance, supply_pressure)
    curve = _relative_leak(share, leak_0, leak_1, leak_2)
    return leakage + 0.25 * conductance * supply_pressure * share * curve


def _drained_by_curve(
    mean_pressure, pressure, bulk_modulus, V, leak_0, leak_1, leak_2, conductance, supply_pressure
):
    share = _share_of_half(pressure, mean_pressure, conductance, supply_pressure)
    curve = _relative_leak(share, leak_0, leak_1, leak_2)
    return -bulk_modulus / (4.0 * V) * abs(conductance) * share * curve


LEAK_FORM = correction(
    name="leak_form", port="line", summary="the leak from a line as a curve over its pressure",
    parameters=(
        *(
            fitted(f"leak_{n}", "1", 0.0, -0.8, 3.0, f"relative leak at {x} of half the supply pressure", 0.2)
            for n, x in enumerate(("1/8", "1/4", "1/2"))
        ),
        repeated("conductance", "m3/(s Pa)", 0.0, -1e-10, 1e-10, scaling=MOTOR_SIZE),
        repeated("supply_pressure", "Pa", 1e7, 2e6, 35e6),
    ),
    laws={"leakage": _leak_curve},
    corrects={"external_leakage": {"conductance": "conductance", "supply_pressure": "supply_pressure"}},
    states=(State("mean_pressure", _drained_by_curve, scale=0.01),),
    shares=BOTH_LINES,
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


TORQUE_FORM = correction(
    name="torque_form", port="motor", summary="torque that is lost as a curve over the speed",
    parameters=tuple(
        amount(f"torque_{n}", "N m", 0.04, f"torque lost at {w:g} rad/s", scaling=MOTOR_SIZE)
        for n, w in enumerate((0.2, 0.7, 2.5, 8, 25, 80), 1)
    ),
    laws={"torque": _torque_curve},
    corrects={"motor_coulomb_friction": {}, "quadratic_drag": {}, "line_loss": {}},
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


REST_FORM = correction(
    name="rest_form", port="motor", summary="dry friction builds up over a small turn (Dahl) in the place of a smooth step",
    parameters=(
        amount("travel", "rad", 0.003, "turn over which the friction builds up", 0.0),
        fitted("damping", "s", 0.002, 0.0, 0.02, "damping while it builds up, over the friction", 0.002),
        repeated("coulomb", "N m", 0.0, 0.0, 2.0, scaling=MOTOR_SIZE),
        repeated("static", "N m", 0.0, 0.0, 3.0, scaling=MOTOR_SIZE),
        repeated("stribeck_speed", "rad/s", 3.0, 0.2, 20.0),
    ),
    laws={"torque": _dahl_torque},
    corrects={"motor_coulomb_friction": {n: n for n in ("coulomb", "static", "stribeck_speed")}},
    states=(State("rest", _rest_rate),),
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


RIPPLE_FORM = correction(
    name="ripple_form", port="motor", summary="phase and harmonics of the ripple of the displacement",
    parameters=(
        *(
            amount(n, "1", 0.01, f"{'co' * n.startswith('co')}sine of {n[-1]} times the ripple's order")
            for n in ("sine_1", "cosine_2", "sine_2", "cosine_3", "sine_3")
        ),
        repeated("order", "1", 7.0, 3.0, 13.0),
    ),
    laws={"displacement": _more_ripple},
    corrects={"displacement_ripple": {"order": "order"}},
)  # fmt: skip


def _more_turns(torque, angle, cosine_2, sine_2, cosine_3, sine_3):
    c = cos(angle)
    s = sin(angle)
    c2 = c * c - s * s
    s2 = 2.0 * s * c
    return torque - (cosine_2 * c2 + sine_2 * s2 + cosine_3 * (c2 * c - s2 * s) + sine_3 * (s2 * c + c2 * s))


TURNING_FORM = correction(
    name="turning_form", port="load", summary="harmonics of a torque that turns with the shaft",
    parameters=tuple(
        amount(n, "N m", 0.05, f"{'co' * n.startswith('co')}sine of {n[-1]} times the shaft's angle", scaling=MOTOR_SIZE)
        for n in ("cosine_2", "sine_2", "cosine_3", "sine_3")
    ),
    laws={"torque": _more_turns},
    corrects={"eccentric_load": {}},
)  # fmt: skip


# --- fluid ------------------------------------------------------------------------------------------------------------
def _second_drift_leakage(leakage_coefficient, more, time, time_constant):
    return leakage_coefficient * drifted(-more, time, time_constant)


def _second_drift_friction(viscous_friction, more, time, time_constant):
    return viscous_friction * drifted(more, time, time_constant)


DRIFT_FORM = correction(
    name="drift_form", port="fluid", summary="a second, faster or slower part of the drift",
    parameters=(
        amount("more", "1", 0.2, "log of final over initial viscosity, second part"),
        fitted("time_constant", "s", 3.0, 0.3, 3000.0, "time constant of the second part", 3.0, log=True),
    ),
    laws={"leakage_coefficient": _second_drift_leakage, "viscous_friction": _second_drift_friction},
    corrects={"viscosity_drift": {}},
    scope="rig",
)  # fmt: skip


# --- sensor -----------------------------------------------------------------------------------------------------------
def _late_speed(measured_speed, lagged_speed, second, share):
    return measured_speed + (second - lagged_speed if share > 0.0 else 0.0)


def _first_lag(first, speed, time_constant, share):
    lag = time_constant * (1.0 - share)
    return (speed - first) / (lag if lag > 1e-5 else 1e-5)


SENSOR_FORM = correction(
    name="sensor_form", port="sensor", summary="the sensor follows with two lags of the same sum",
    parameters=(fitted("share", "1", 0.0, 0.0, 0.5, "share of the lag in the second filter", 0.2),),
    laws={"measured_speed": _late_speed},
    corrects={"sensor_lag": {}},
    states=(State("first", _first_lag, scale=10.0), State("second", _second_rate, scale=10.0)),
    shares=SENSOR_LAG,
)  # fmt: skip


# --- coupling ---------------------------------------------------------------------------------------------------------
def _more_contact(twist, speed, load_speed, damper_1, damper_2, damper_3, gap, stiffness, damping):
    half = 0.5 * gap
    wound = twist - clip(twist, -half, half)
    w = abs(wound)
    curve = damper_1 * clip(w * 500.0, 0.0, 1.0) + (damper_2 - damper_1) * clip(w * 200.0 - 0.4, 0.0, 1.0)
    curve = curve - damper_2 * clip((w - 7e-3) * (1.0 / 13e-3), 0.0, 1.0)
    curve = curve + damper_3 * clip((w - 20e-3) * (1.0 / 30e-3), 0.0, 1.0)
    grown = clip(w * 50.0, 0.0, 1.0)
    corrected = positive(grown + curve)
    drag = damping * (speed - load_speed)
    before = stiffness * wound + grown * drag
    after = stiffness * wound + corrected * drag
    return (after if after * wound > 0.0 else 0.0) - (before if before * wound > 0.0 else 0.0)


def _torque_of_damper(
    torque, twist, speed, load_speed, damper_1, damper_2, damper_3, gap, stiffness, damping
):
    return torque - _more_contact(
        twist, speed, load_speed, damper_1, damper_2, damper_3, gap, stiffness, damping
    )


def _load_behind_damper(
    load_speed, twist, speed, damper_1, damper_2, damper_3, gap, stiffness, damping, inertia
):
    more = _more_contact(twist, speed, load_speed, damper_1, damper_2, damper_3, gap, stiffness, damping)
    return more / inertia if inertia > 0.0 else 0.0


COUPLING_FORM = correction(
    name="coupling_form", port="load", summary="the damper of a coupling as a curve over its winding",
    parameters=tuple(
        amount(f"damper_{n}", "1", 0.3, f"relative damping more at a winding of {w} mrad")
        for n, w in enumerate((2, 7, 50), 1)
    ),
    laws={"torque": _torque_of_damper},
    corrects={"shaft_backlash": {}},
    states=(State("load_speed", _load_behind_damper, scale=0.2),),
    shares=SHAFT_BACKLASH,
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (
    SUPPLY_FORM, SOFTNESS_FORM, OVERRIDE_FORM, LEAK_FORM, TORQUE_FORM, REST_FORM, RIPPLE_FORM, TURNING_FORM,
    DRIFT_FORM, COUPLING_FORM, SENSOR_FORM,
)  # fmt: skip
