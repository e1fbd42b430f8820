"""Effects of the fluid that act on the whole rig."""

from ..parameters import Parameter, assumed
from ..vector_math import exp
from .effect import Effect


def drifted(change, time, time_constant):
    """A factor whose logarithm goes from 0 to `change`."""
    return exp(change * (1.0 - exp(-time / time_constant)))


def _drift_leakage(leakage_coefficient, change, time, time_constant):
    return leakage_coefficient * drifted(-change, time, time_constant)


def _drift_friction(viscous_friction, change, time, time_constant):
    return viscous_friction * drifted(change, time, time_constant)


VISCOSITY_DRIFT = Effect(
    name="viscosity_drift",
    port="fluid",
    title="drifting oil viscosity (temperature)",
    scope="rig",
    summary="the fluid warms up (or cools): leakage and viscous friction drift opposite ways",
    signature="slow opposite trends of leakage and friction",
    source="leakage ~ 1/viscosity, viscous friction ~ viscosity",
    parameters=(
        Parameter("change", "1", 0.0, low=-2.0, high=2.0, typical=-0.7,
            note="log of final over initial viscosity", source="20 K of warming halve the viscosity of HLP 46"),
        assumed("time_constant", "s", 100.0, low=3.0, high=3000.0, log=True, role="time_constant",
            note="time constant of the warming"),
    ),
    laws={"leakage_coefficient": _drift_leakage, "viscous_friction": _drift_friction},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (VISCOSITY_DRIFT,)
