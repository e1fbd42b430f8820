"""Effects of the motor; its published loss models are in `losses`."""

from functools import partial

from ..parameters import MOTOR_SIZE, Parameter, assumed
from ..vector_math import cos, exp, tanh
from .effect import Effect

_effect = partial(Effect, port="motor")


def _speed_dependent_leakage(leakage, speed, coefficient):
    return leakage + coefficient * speed


SPEED_DEPENDENT_LEAKAGE = _effect(
    name="speed_dependent_leakage",
    title="leakage that grows with speed",
    summary="leakage that grows with speed (filling losses, churning)",
    signature="speed loss at no load, seen in the flow balance",
    source="neglected by the paper in its own words; Wilson 1948, Schloesser 1961",
    parameters=(
        Parameter("coefficient", "m3/rad", 0.0, low=0.0, high=6e-7, typical=1.5e-7, scaling=MOTOR_SIZE,
            note="leakage per speed", source="up to 45 % of the displacement"),
    ),
    laws={"leakage": _speed_dependent_leakage},
)  # fmt: skip


def _motor_coulomb_friction(torque, speed, coulomb, static, stribeck_speed):
    slip = speed / stribeck_speed
    return torque - (coulomb + (static - coulomb) * exp(-slip * slip)) * tanh(speed * 10.0)


MOTOR_COULOMB_FRICTION = _effect(
    name="motor_coulomb_friction",
    title="dry friction of the motor",
    summary="dry friction of the motor with a Stribeck peak, smooth within 0.1 rad/s",
    signature="step of torque with the sign of the speed, sticking at reversal",
    source="Armstrong-Helouvry 1991; Olsson 1973 for hydraulic motors",
    parameters=(
        Parameter("coulomb", "N m", 0.0, low=0.0, high=2.0, typical=0.3, scaling=MOTOR_SIZE,
            note="Coulomb friction", source="3-10 % of the nominal torque are usual"),
        assumed("static", "N m", 0.0, low=0.0, high=3.0, typical=0.4, scaling=MOTOR_SIZE, not_below="coulomb",
            note="static friction"),
        assumed("stribeck_speed", "rad/s", 3.0, low=0.2, high=20.0, log=True, note="Stribeck speed"),
    ),
    laws={"torque": _motor_coulomb_friction},
)  # fmt: skip


def _quadratic_drag(torque, speed, coefficient):
    return torque - coefficient * speed * abs(speed)


QUADRATIC_DRAG = _effect(
    name="quadratic_drag",
    title="drag that grows with speed squared",
    summary="hydrodynamic torque loss growing with speed squared",
    signature="curvature of torque over speed",
    source="Schloesser 1961, hydrodynamic loss",
    parameters=(
        assumed("coefficient", "N m s2/rad2", 0.0, low=0.0, high=8e-4, typical=1e-4, scaling=MOTOR_SIZE,
            note="torque per speed squared"),
    ),
    laws={"torque": _quadratic_drag},
    indistinguishable_from=("line_loss",),
)  # fmt: skip


def _displacement_ripple(displacement, angle, amplitude, order):
    return displacement * (1.0 + amplitude * cos(order * angle))


DISPLACEMENT_RIPPLE = _effect(
    name="displacement_ripple",
    title="displacement ripple of the motor",
    summary="displacement varies with the shaft angle, in flow and in torque",
    signature="line at `order` times the shaft speed",
    source="kinematics of gear and orbit motors, Ivantysyn and Ivantysynova 2001",
    parameters=(
        Parameter("amplitude", "1", 0.0, low=0.0, high=0.3, typical=0.05,
            note="relative ripple of the displacement", source="1-10 % are usual"),
        Parameter("order", "1", 7.0, low=3.0, high=13.0, role="order", note="periods in a turn", source="number of chambers"),
    ),
    laws={"displacement": _displacement_ripple},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (SPEED_DEPENDENT_LEAKAGE, MOTOR_COULOMB_FRICTION, QUADRATIC_DRAG, DISPLACEMENT_RIPPLE)
