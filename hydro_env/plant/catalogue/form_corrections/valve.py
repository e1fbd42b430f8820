"""Corrections of the forms of driver, opening, flow and spool."""

from math import inf

from ...parameters import SPOOL_FORCE, SPOOL_TRAVEL
from ...vector_math import bell, clip, positive, sign, sqrt, tanh
from ..driver import INPUT_HYSTERESIS
from ..effect import State
from ..force import MAGNETIC_HYSTERESIS, turning_width
from .correction import amount, correction, fitted, repeated, taken


# --- driver -----------------------------------------------------------------------------------------------------------
def _knee(voltage, command, drop, reach, voltage_limit):
    # What the output lacks falls with the third power of the distance from the limit.
    away = positive(1.0 - abs(abs(command) / voltage_limit - 1.0) / reach)
    lack = drop * voltage_limit * away * away * away
    return voltage - sign(command) * (lack if drop > 0.0 else 0.0)


KNEE_FORM = correction(
    name="knee_form", port="driver", summary="the driver gives less than is asked for even before its limit",
    parameters=(
        amount("drop", "1", 0.02, "share of the limit that is lacking when the limit is asked for", 0.0),
        fitted("reach", "1", 0.15, 0.03, 0.6, "share of the limit, both ways, from which on it lacks", 0.15, log=True),
        repeated("voltage_limit", "V", 1e9, 1.0, 1e9),
    ),
    laws={"voltage": _knee},
    corrects={"driver_saturation": {"voltage_limit": "voltage_limit"}},
)  # fmt: skip


# The play of the catalogue's law, half of which two other plays replace.
(_PLAY,) = INPUT_HYSTERESIS.states


def _three_plays(voltage, command, as_before, narrow, wide, spread, width):
    half = 0.5 * width
    less = half * (1.0 - spread)
    more = half * (1.0 + spread)
    held = 0.5 * (clip(command - narrow, -less, less) + clip(command - wide, -more, more))
    return voltage + (0.5 * (clip(command - as_before, -half, half) - held) if spread > 0.0 else 0.0)


def _spread_rate(play, command, part, spread, width):
    half = 0.5 * width * (1.0 + part * spread)
    gap = command - play
    return (gap - clip(gap, -half, half)) / 1e-4


PLAY_FORM = correction(
    name="play_form", port="driver", summary="a quarter of the command passes a narrower play, a quarter a wider one",
    parameters=(
        fitted("spread", "1", 0.0, 0.0, 1.0, "by how much these plays are narrower and wider", 0.4),
        repeated("width", "V", 0.0, 0.0, 1e3),
    ),
    laws={"voltage": _three_plays},
    corrects={"input_hysteresis": {"width": "width"}},
    states=(
        State("as_before", _PLAY.rate, given={"follower": "as_before"}),
        State("narrow", _spread_rate, given={"play": "narrow", "part": -1.0}),
        State("wide", _spread_rate, given={"play": "wide", "part": 1.0}),
    ),
)  # fmt: skip


# --- opening ----------------------------------------------------------------------------------------------------------
def _rounded(opening, spool, rounding, turn, corner_positive, corner_negative):
    # A parabola within `rounding` of either corner in the place of the bend.
    near = positive(rounding - abs(spool - corner_positive))
    far = positive(rounding - abs(spool + corner_negative))
    return opening + 0.25 * turn * (near * near - far * far) / (rounding if rounding > 1e-9 else 1e-9)


CORNER_FORM = correction(
    name="corner_form", port="opening", summary="corners of the opening are rounded",
    parameters=(
        # A radial clearance rounds an overlap by micrometres, round ports a saturation by a large part of the travel.
        fitted("rounding", "m", 0.0, 0.0, 3e-4, "half the travel over which a corner is rounded", 1e-5, scaling=SPOOL_TRAVEL),
        repeated("turn", "1", 1.0, -1.0, 1.0),
        repeated("corner_positive", "m", 0.0, 0.0, inf, scaling=SPOOL_TRAVEL),
        repeated("corner_negative", "m", 0.0, 0.0, inf, scaling=SPOOL_TRAVEL),
    ),
    laws={"opening": _rounded},
    corrects={
        "dead_zone": {"turn": 1.0, "corner_positive": "overlap_positive", "corner_negative": "overlap_negative"},
        "flow_saturation": {"turn": -1.0, "corner_positive": "opening_limit", "corner_negative": "opening_limit"},
    },
)  # fmt: skip


def _next_knot(curve, change, t):
    # Between two knots, an octave apart, t (1.343 - 0.343 t) of t = share / knot - 1 goes from 0 to 1 as the logarithm does.
    t = clip(t, 0.0, 1.0)
    return curve + change * t * (1.343 - 0.343 * t)


def _gain_curve(opening, gain_0, gain_1, gain_2, gain_3, gain_4, gain_5, gain_6, alpha, u_rated, R, k):
    share = abs(opening) * (R * k / (alpha * u_rated))
    curve = _next_knot(gain_0, gain_1 - gain_0, share * 64.0 - 1.0)
    curve = _next_knot(curve, gain_2 - gain_1, share * 32.0 - 1.0)
    curve = _next_knot(curve, gain_3 - gain_2, share * 16.0 - 1.0)
    curve = _next_knot(curve, gain_4 - gain_3, share * 8.0 - 1.0)
    curve = _next_knot(curve, gain_5 - gain_4, share * 4.0 - 1.0)
    curve = _next_knot(curve, gain_6 - gain_5, share * 2.0 - 1.0)
    return opening * (1.0 + curve)


OPENING_FORM = correction(
    name="opening_form", port="opening", summary="gain of the opening as a curve over the logarithm of the opening",
    parameters=tuple(
        # A gain may be several times another; it cannot lose more than all.
        fitted(f"gain_{n}", "1", 0.0, -0.8, 3.0, f"relative gain at 1/{2 ** (6 - n)} of the rated opening", 0.2)
        for n in range(7)
    ),
    laws={"opening": _gain_curve},
    corrects={n: {} for n in ("flow_gain_nonlinearity", "dead_zone", "flow_saturation", "directional_gain", "null_offset")},
)  # fmt: skip


# --- flow -------------------------------------------------------------------------------------------------------------
def _orifice(flow, opening, drive, transition, laminar, Kq):
    drop = abs(drive)
    least = transition if transition > 1e-6 else 1e-6
    turbulent = sqrt(drop) * tanh(2.0 * sqrt(drop / least))
    # A gap in series takes a drop in proportion to the flow: drop = (1 - laminar) root^2 + laminar root.
    rest = 1.0 - laminar
    root = 0.5 * (sqrt(laminar * laminar + 4.0 * rest * turbulent * turbulent) - laminar) / rest
    # A line above the supply passes back.
    more = Kq * opening * (sign(drive) * root - sqrt(positive(drive)))
    return flow + (more if transition + laminar > 0.0 else 0.0)


ORIFICE_FORM = correction(
    name="orifice_form", port="flow",
    summary="edges are laminar at small drops, with a gap in series, and pass back what is above the supply",
    parameters=(
        # Up to some bar: sharp edges are turbulent from Reynolds numbers of 10 to 260 on (Merritt 1967, ch. 3).
        fitted("transition", "1", 0.0, 0.0, 0.3, "pressure drop over the supply's below which it is laminar", 0.03),
        fitted("laminar", "1", 0.0, 0.0, 0.8, "share of the whole drop that a laminar gap in series takes", 0.03),
    ),
    laws={"flow": _orifice},
    corrects={"pressure_dependent_flow": {}},
)  # fmt: skip


# --- force on the spool -----------------------------------------------------------------------------------------------
def _preload_over(force, spool, travel, preload):
    # The catalogue's preload takes hold over 20 um; with that travel nothing changes, to the last bit.
    return force - preload * (tanh(spool * (2e-5 / travel) * 5e4) - tanh(spool * 5e4))


PRELOAD_FORM = correction(
    name="preload_form", port="force", summary="preload takes hold over less or more travel",
    parameters=(
        fitted("travel", "m", 2e-5, 1e-6, 2e-4, "travel over which the preload takes hold", 1e-5, log=True),
        repeated("preload", "N", 0.0, 0.0, 6.0, scaling=SPOOL_FORCE),
    ),
    laws={"force": _preload_over},
    corrects={"spring_preload": {"preload": "preload"}},
)  # fmt: skip


def _centring(force, spool, force_1, force_2, force_3, force_4, force_5):
    x = abs(spool)
    curve = force_1 * clip(x * 2e5, 0.0, 1.0)
    curve = curve + (force_2 - force_1) * clip((x - 5e-6) * 1e5, 0.0, 1.0)
    curve = curve + (force_3 - force_2) * clip((x - 1.5e-5) * (1.0 / 2e-5), 0.0, 1.0)
    curve = curve + (force_4 - force_3) * clip((x - 3.5e-5) * (1.0 / 4.5e-5), 0.0, 1.0)
    curve = curve + (force_5 - force_4) * clip((x - 8e-5) * (1.0 / 1.2e-4), 0.0, 1.0)
    return force - sign(spool) * curve


CENTRING_FORM = correction(
    name="centring_form", port="force", summary="centring force as a curve over the travel",
    parameters=tuple(
        amount(f"force_{n}", "N", 0.15, f"centring force at {x} um of travel", scaling=SPOOL_FORCE)
        for n, x in enumerate((5, 15, 35, 80, 200), 1)
    ),
    laws={"force": _centring},
    corrects={"spring_preload": {}, "flow_force": {}},
)  # fmt: skip


def _stops_force(
    force, height_1, height_2, height_3, height_4, amplitude, as_before, stop_1, stop_2, stop_3, stop_4
):
    moved = height_1 * (stop_1 - as_before) + height_2 * (stop_2 - as_before)
    moved = moved + height_3 * (stop_3 - as_before) + height_4 * (stop_4 - as_before)
    return force - amplitude * moved


def _stop_rate(stop, current_rate, times, amplitude, width, alpha):
    travel = times * turning_width(amplitude, width, alpha)
    # Free on the way back; on the way on it gives way with the eighth power. A long step that goes beyond 1 is taken back.
    ahead = stop if current_rate > 0.0 else -stop
    inside = ahead if ahead < 1.0 else 1.0
    squared = inside * inside
    fourth = squared * squared
    free = 1.0 - fourth * fourth if ahead > 0.0 else 1.0
    return current_rate * free / travel - 2e4 * (stop - clip(stop, -1.0, 1.0))


#: Travels of the stops until they give way, over the width of the effect's own loop.
_STOPS = (0.25, 0.5, 1.0, 2.0)
# The loop of the catalogue's law, from which the stops take over.
(_LOOP,) = MAGNETIC_HYSTERESIS.states

STOP_FORM = correction(
    name="stop_form", port="force",
    summary="loop of the magnet from four stops that give way one after the other (Prandtl-Ishlinskii)",
    parameters=(
        *(
            amount(f"height_{n}", "1", 0.25, f"share of the height held by the stop of {s:g} times the width")
            for n, s in enumerate(_STOPS, 1)
        ),
        repeated("amplitude", "N", 0.0, 0.0, 2.0, scaling=SPOOL_FORCE),
        repeated("width", "A", 0.03, 0.01, 0.2),
    ),
    laws={"force": _stops_force},
    corrects={"magnetic_hysteresis": {"amplitude": "amplitude", "width": "width"}},
    states=(
        State("as_before", _LOOP.rate, scale=0.1, given={"loop": "as_before"}),
        *(
            State(f"stop_{n}", _stop_rate, scale=0.1, given={"stop": f"stop_{n}", "times": times})
            for n, times in enumerate(_STOPS, 1)
        ),
    ),
)  # fmt: skip


# No stiffer than the weaker friction allows over 0.2 um of travel: no substep follows less, nor does anyone see it.
def _stiffness_left(coulomb, static, stiffness, s0):
    most = (coulomb if coulomb < static else static) / (2e-7 * s0)
    return most if most < stiffness else stiffness


def _second_bristle(
    force, spool_speed, bristle_2, coulomb, static, firm, damping, stiffness, stribeck, vs, s0, s1
):
    stiff = _stiffness_left(coulomb, static, stiffness, s0)
    rate = _bristle_rate(bristle_2, spool_speed, coulomb, static, firm, stiffness, stribeck, vs, s0)
    damped = damping if stiff == stiffness else damping * stiff / stiffness
    held = s0 * stiff * bristle_2 + damped * s1 * rate
    return force - (held if coulomb + static > 0.0 else 0.0)


def _bristle_rate(bristle_2, spool_speed, coulomb, static, firm, stiffness, stribeck, vs, s0):
    stiff = _stiffness_left(coulomb, static, stiffness, s0)
    slip = abs(spool_speed) / (vs * stribeck)
    level = coulomb + (static - coulomb) * bell(slip)
    level = level if level > 1e-6 else 1e-6
    share = abs(bristle_2) * s0 * stiff / level
    share = share if share < 1.0 else 1.0
    over = clip((share - firm) / (1.0 - firm), 0.0, 1.0)
    give = over * over * (3.0 - 2.0 * over) if bristle_2 * spool_speed > 0.0 else 0.0
    return spool_speed - give * abs(spool_speed) * s0 * stiff / level * bristle_2


BRISTLE_FORM = correction(
    name="bristle_form", port="force",
    summary="what friction the spool has more is held by a second bristle, which gives way late",
    parameters=(
        amount("damping", "1", 1.0, "damping of the second bristle over the first one's", 0.0),
        fitted("firm", "1", 0.5, 0.0, 0.95, "share of its limit from which on the second bristle gives way", 0.5),
        fitted("stiffness", "1", 1.0, 0.2, 5.0, "stiffness of the second bristle over the first one's", 1.0, log=True),
        fitted("stribeck", "1", 1.0, 0.2, 5.0, "Stribeck speed of the second bristle over the first one's", 1.0, log=True),
        repeated("coulomb", "N", 0.0, 0.0, 2.0, scaling=SPOOL_FORCE),
        repeated("static", "N", 0.0, 0.0, 3.0, scaling=SPOOL_FORCE),
        taken("coulomb_taken", -2.0, 0.3),
        taken("static_taken", -3.0, 0.6),
    ),
    laws={"force": _second_bristle},
    corrects={
        "spool_stiction": {
            "coulomb": "coulomb", "static": "static", "coulomb_taken": "-coulomb", "static_taken": "-static",
        }
    },
    states=(State("bristle_2", _bristle_rate, scale=2e-6),),
    adds_to={"Fc": "coulomb_taken", "Fs": "static_taken"},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (
    PLAY_FORM, KNEE_FORM, CORNER_FORM, OPENING_FORM, ORIFICE_FORM, PRELOAD_FORM, CENTRING_FORM, STOP_FORM,
    BRISTLE_FORM,
)  # fmt: skip
