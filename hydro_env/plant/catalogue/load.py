"""Effects of what the motor drives."""

from functools import partial
from math import pi

from ..parameters import MOTOR_SIZE, Parameter, assumed
from ..vector_math import clip, sin
from .effect import Effect, State

_effect = partial(Effect, port="load")


def _load_bias(torque, bias):
    return torque - bias


LOAD_BIAS = _effect(
    name="load_bias",
    title="a constant load that was not logged",
    summary="a constant load torque that nobody logged",
    signature="same sign in both directions",
    source="weights, belts, seals",
    parameters=(
        assumed("bias", "N m", 0.0, low=-3.0, high=3.0, typical=0.4, scaling=MOTOR_SIZE, note="torque against positive speed"),
    ),
    laws={"torque": _load_bias},
    separated_by={
        "motor_coulomb_friction": "the same slow ramp in both directions of rotation: friction changes its sign, a load does not",
    },
)  # fmt: skip


def _eccentric_load(torque, angle, amplitude, phase):
    return torque - amplitude * sin(angle + phase)


ECCENTRIC_LOAD = _effect(
    name="eccentric_load",
    title="an unbalanced load",
    summary="unbalanced weight on the shaft",
    signature="line at the shaft speed",
    source="statics: m g r sin(theta + phase)",
    parameters=(
        assumed("amplitude", "N m", 0.0, low=0.0, high=2.0, typical=0.3, scaling=MOTOR_SIZE, note="largest torque"),
        Parameter("phase", "rad", 0.0, low=-pi, high=pi, role="phase", note="angle at the start", source="unknown beforehand"),
    ),
    laws={"torque": _eccentric_load},
)  # fmt: skip


def _contact_torque(twist, speed, load_speed, gap, stiffness, damping):
    half = 0.5 * gap
    wound = twist - clip(twist, -half, half)
    # The damper grows over the first 20 mrad of winding, so that a blow begins smoothly.
    contact = stiffness * wound + damping * (speed - load_speed) * clip(abs(wound) * 50.0, 0.0, 1.0)
    return contact if contact * wound > 0.0 else 0.0


def _backlash_torque(torque, twist, speed, load_speed, gap, stiffness, damping, load, inertia):
    contact = _contact_torque(twist, speed, load_speed, gap, stiffness, damping)
    # The logged load acts behind the coupling.
    return torque - contact + (load if inertia > 0.0 else 0.0)


def _twist_rate(twist, speed, load_speed, inertia):
    return speed - load_speed if inertia > 0.0 else 0.0


def _load_speed_rate(load_speed, twist, speed, gap, stiffness, damping, load, inertia):
    contact = _contact_torque(twist, speed, load_speed, gap, stiffness, damping)
    return (contact - load) / inertia if inertia > 0.0 else 0.0


SHAFT_BACKLASH = _effect(
    name="shaft_backlash",
    title="backlash of the coupling",
    summary="part of the inertia sits behind an elastic coupling with a gap",
    signature="jump at reversal, anti-resonance",
    source="Nordin and Gutman 2002, dead-zone model of backlash",
    parameters=(
        assumed("inertia", "kg m2", 0.0, low=1e-4, high=1e-2, typical=2e-3, log=True, scaling=MOTOR_SIZE, part_of="J",
            note="inertia behind the coupling"),
        assumed("gap", "rad", 0.0, low=0.0, high=0.1, typical=0.05, note="play of the coupling"),
        assumed("stiffness", "N m/rad", 300.0, low=20.0, high=2000.0, log=True, scaling=MOTOR_SIZE,
            note="stiffness of the coupling in contact"),
        assumed("damping", "N m s/rad", 0.3, low=0.01, high=2.0, log=True, scaling=MOTOR_SIZE,
            note="damping of the coupling in contact"),
    ),
    laws={"torque": _backlash_torque},
    states=(
        State("twist", _twist_rate, scale=2e-4),
        State("load_speed", _load_speed_rate, scale=0.2),
    ),
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (LOAD_BIAS, ECCENTRIC_LOAD, SHAFT_BACKLASH)
