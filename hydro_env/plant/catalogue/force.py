"""Effects on the force that moves the spool."""

from functools import partial
from math import inf

from ..parameters import SPOOL_FORCE, SPOOL_TRAVEL, SUPPLY_PRESSURE, Parameter, assumed
from ..vector_math import positive, sign, tanh
from .effect import Effect, State

_effect = partial(Effect, port="force")


def _hysteresis_force(force, amplitude, loop):
    return force - amplitude * loop


def turning_width(amplitude, width, alpha):
    """The change of current that turns the loop, A."""
    # Never so narrow that more current would mean less force, which no magnet does and which would not be stable.
    least = 2.0 * amplitude / alpha
    return width if width > least else least


def _loop_rate(loop, current_rate, amplitude, width, alpha):
    # Bouc-Wen with n = 1 and beta = gamma: rate-independent, saturates at +-1 (loop opposes the change of current).
    return (current_rate - abs(current_rate) * loop) / turning_width(amplitude, width, alpha)


MAGNETIC_HYSTERESIS = _effect(
    name="magnetic_hysteresis",
    summary="rate-independent loop between current and magnetic force",
    signature="loop in flow over current whose width does not depend on the sweep rate",
    source="Bouc 1967, Wen 1976; Vaughan and Gamble 1996 for proportional solenoids",
    parameters=(
        Parameter("amplitude", "N", 0.0, low=0.0, high=2.0, typical=0.3, scaling=SPOOL_FORCE,
            note="half height of the loop", source="2-7 % of the rated force are usual"),
        assumed("width", "A", 0.03, low=0.01, high=0.2, log=True,
            note="width of the loop; change of current that turns it, at least 2 amplitude/alpha"),
    ),
    laws={"force": _hysteresis_force},
    states=(State("loop", _loop_rate, scale=0.1),),
    indistinguishable_from=("spool_stiction", "input_hysteresis"),
    separated_by={
        "spool_stiction": "triangles of +-60 % of the rated command with 0.5 s and 20 s per cycle, with the spool position: "
        "after a turn stiction holds it until the force exceeds it, magnetic hysteresis lets it move at once, on a smaller slope",
    },
)  # fmt: skip


SPOOL_STICTION = _effect(
    name="spool_stiction",
    title="sticking friction of the spool",
    summary="more Coulomb and static friction on the spool (dirt, gum, side load)",
    signature="stick and jump, threshold for small signals",
    source="Olsson et al. 1998; adds to Fc and Fs of the paper's LuGre model",
    parameters=(
        assumed("coulomb", "N", 0.0, low=0.0, high=2.0, typical=0.3, scaling=SPOOL_FORCE, note="more Coulomb friction"),
        assumed("static", "N", 0.0, low=0.0, high=3.0, typical=0.6, scaling=SPOOL_FORCE, not_below="coulomb",
            note="more static friction"),
    ),
    adds_to={"Fc": "coulomb", "Fs": "static"},
    indistinguishable_from=("magnetic_hysteresis", "input_hysteresis"),
)  # fmt: skip


def _preload_force(force, spool, preload):
    # Smooth over 20 um of spool travel.
    return force - preload * tanh(spool * 5e4)


SPRING_PRELOAD = _effect(
    name="spring_preload",
    title="preloaded centring springs",
    summary="centring springs are preloaded: a force threshold before the spool leaves its centre",
    signature="threshold in current, none in opening",
    source="construction of spring-centred directional valves",
    parameters=(
        Parameter("preload", "N", 0.0, low=0.0, high=6.0, typical=1.5, scaling=SPOOL_FORCE,
            note="preload of the springs", source="assumed: up to 40 % of the rated force"),
    ),
    laws={"force": _preload_force},
    indistinguishable_from=("dead_zone",),
)  # fmt: skip


def _flow_force(force, spool, pressure, coefficient, supply_pressure):
    return force - coefficient * spool * positive(supply_pressure - sign(spool) * pressure)


FLOW_FORCE = _effect(
    name="flow_force",
    title="flow force on the spool",
    summary="steady flow force, which closes the valve",
    signature="opening sags with the pressure drop over the valve",
    source="Merritt 1967, ch. 5: F = 0.43 w x dp for a sharp-edged spool",
    parameters=(
        Parameter("coefficient", "m", 0.0, low=0.0, high=1.2e-3, typical=3e-4, scaling=SPOOL_FORCE,
            note="force per opening and pressure drop", source="0.43 times the area gradient w"),
        SUPPLY_PRESSURE,
    ),
    laws={"force": _flow_force},
)  # fmt: skip


SPOOL_STOP = _effect(
    name="spool_stop",
    title="an end stop within the spool's travel",
    summary="the spool meets a stop (a stroke limiter, a stuck spring, dirt) before the end of its travel",
    signature="flat top at large commands; spool clipped, current not",
    source="stroke limiters of directional valves; stop as the end stops' (Hunt and Crossley 1975)",
    parameters=(
        Parameter("travel", "m", inf, low=1e-4, high=8.6e-4, typical=4e-4, log=True, scaling=SPOOL_TRAVEL,
            note="half stroke that is left", source="assumed: the rated spool position is 0.86 mm"),
    ),
    limits={"x_max": "travel"},
    indistinguishable_from=("driver_saturation", "flow_saturation"),
    separated_by={
        "driver_saturation": "record the current: a driver at its limit clips it, a stop does not",
        "flow_saturation": "record the spool position: a stop clips it, a saturated edge does not",
    },
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (MAGNETIC_HYSTERESIS, SPOOL_STICTION, SPOOL_STOP, SPRING_PRELOAD, FLOW_FORCE)
