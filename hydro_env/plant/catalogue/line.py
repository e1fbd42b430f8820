"""Effects of the line between valve and motor: fluid, hoses, relief valves."""

from __future__ import annotations

from math import inf

from ..parameters import Parameter
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
    summary="free air makes the fluid soft at low pressure",
    signature="slow first pressure rise",
    source="isothermal air in parallel with the liquid, Manring 2005",
    parameters=(
        Parameter(
            "fraction",
            "1",
            0.0,
            0.0,
            0.1,
            "0.5-5 % at atmospheric pressure are usual",
            "volume share of air at 1 atm",
            0.02,
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
    summary="turbulent pressure loss between valve and motor",
    signature="loss only at high flow",
    source="Darcy-Weisbach, fittings; dp = c Q |Q|",
    parameters=(
        Parameter("coefficient", "Pa s2/m6", 0.0, 0.0, 3e14, "assumed", "loss per flow squared", 4e13),
    ),
    laws={"motor_pressure": _line_loss},
    indistinguishable_from=("quadratic_drag",),
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
    summary="relief valves between the ports open above their setting",
    signature="clipped pressure difference",
    source="crossport relief valves; linear override",
    parameters=(
        Parameter("relief_pressure", "Pa", inf, 5e5, 350e5, "assumed", "setting", 15e5, log=True),
        Parameter(
            "conductance",
            "m3/(s Pa)",
            1e-9,
            1e-10,
            3e-9,
            "assumed",
            "slope of the open valve",
            1e-9,
            log=True,
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
