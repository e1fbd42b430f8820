"""Effects of the line between valve and motor: fluid, hoses, relief valves."""

from __future__ import annotations

from math import inf

from ..parameters import MOTOR_SIZE, Parameter
from ..vector_math import sign
from .effect import Effect

__all__ = ["EFFECTS"]


def _entrained_air(bulk_modulus, pressure, fraction):
    absolute = 101325.0 + abs(pressure)
    return bulk_modulus / (1.0 + fraction * bulk_modulus * 101325.0 / (absolute * absolute))


def _entrained_air_corner(pressure, fraction):
    # The fluid is soft within some bar of zero only, which a hard-driven line crosses in a tenth of a millisecond.
    return fraction > 0.0 and abs(pressure) < 4e5


ENTRAINED_AIR = Effect(
    name="entrained_air",
    port="line",
    title="air in the oil",
    summary="free air makes the fluid soft at low pressure",
    signature="slow first pressure rise",
    source="isothermal air in parallel with the liquid, Manring 2005",
    parameters=(
        Parameter(
            "fraction",
            "1",
            0.0,
            low=0.0,
            high=0.1,
            typical=0.02,
            note="share of free air; by volume at 1 atm",
            source="0.5-5 % at atmospheric pressure are usual",
        ),
    ),
    laws={"bulk_modulus": _entrained_air},
    corner=_entrained_air_corner,
)


def _line_loss(motor_pressure, displacement, speed, coefficient):
    motor_flow = displacement * speed
    return motor_pressure - coefficient * motor_flow * abs(motor_flow)


LINE_LOSS = Effect(
    name="line_loss",
    port="line",
    title="pressure loss in the lines",
    summary="turbulent pressure loss between valve and motor",
    signature="loss only at high flow",
    source="Darcy-Weisbach, fittings; dp = c Q |Q|",
    parameters=(
        Parameter(
            "coefficient",
            "Pa s2/m6",
            0.0,
            low=0.0,
            high=3e14,
            typical=4e13,
            scaling={"D": -2.0},
            note="pressure loss per flow squared",
            source="assumed",
        ),
    ),
    laws={"motor_pressure": _line_loss},
    indistinguishable_from=("quadratic_drag",),
    separated_by={
        "quadratic_drag": (
            "drive the motor from outside with the valve closed and both ports connected: drag acts, line "
            "loss does not; or measure the pressure at the motor's ports"
        )
    },
)


def _crossport_relief(leakage, pressure, relief_pressure, conductance):
    excess = abs(pressure) - relief_pressure
    return leakage + sign(pressure) * conductance * (excess if excess > 0.0 else 0.0)


def _crossport_relief_corner(pressure, relief_pressure):
    # About to open or to close.
    return abs(abs(pressure) - relief_pressure) < 4e5


CROSSPORT_RELIEF = Effect(
    name="crossport_relief",
    port="line",
    title="opening of the cross-port relief valves",
    summary="relief valves between the ports open above their setting",
    signature="clipped pressure difference",
    source="crossport relief valves; linear override",
    parameters=(
        Parameter(
            "relief_pressure",
            "Pa",
            inf,
            low=5e5,
            high=350e5,
            typical=15e5,
            log=True,
            note="setting of the relief valves",
            source="assumed",
        ),
        Parameter(
            "conductance",
            "m3/(s Pa)",
            1e-9,
            low=1e-10,
            high=3e-9,
            log=True,
            scaling=MOTOR_SIZE,
            note="slope of the open relief valves",
            source="assumed",
        ),
    ),
    laws={"leakage": _crossport_relief},
    corner=_crossport_relief_corner,
)


#: In the order in which they act.
EFFECTS = (
    ENTRAINED_AIR,
    LINE_LOSS,
    CROSSPORT_RELIEF,
)
