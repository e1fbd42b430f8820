"""The catalogue of effects: everything a real rig does that the paper's equations leave out.

An effect is a term of the one right-hand side (`rhs.py`) that vanishes at its neutral value. It is described once,
here: name, port, parameters (unit, neutral value, bounds, typical size, source) and its law. The same description
extends the plant, randomises the mismatch, hides effects in practice logs and supplies the candidates of the
diagnosis.

A *law* is a scalar function. Its name is the quantity of `rates` that it changes and its first argument is that
quantity; every further argument is looked up by name among the effect's own parameters and states, the signals and
parameters of `rates`, and `other_flow`, the valve flow of the rig's other channel. It returns the changed quantity,
*exactly* unchanged when the parameters are neutral. It may use +, -, *, /, comparisons, conditional expressions, `abs`
and the functions of `vector_math`.

A *state* is memory of an effect: a rate (law of the same kind) and, where it is fast, its decay rate -d(rate)/d(state),
which the implicit integrator then uses. Several states may share their laws, each with arguments of its own (`given`).

A law that reads a function's own arguments only is what makes user effects possible: see `register`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf, pi

from ..parameters import Parameter
from ..vector_math import clip, cos, exp, sign, sin, tanh

__all__ = ["BUILT_IN", "CATALOGUE", "PORTS", "QUANTITIES", "Effect", "State", "register", "unregister"]

#: Ports in the order in which the signal passes them.
PORTS = ("driver", "coil", "force", "opening", "flow", "supply", "line", "motor", "load", "fluid", "sensor")

#: Quantities of `rates` (and of the sensor) that a law may change, and base parameters that an effect may add to.
QUANTITIES = (
    "voltage", "resistance", "force", "opening", "drive", "bulk_modulus", "displacement", "leakage_coefficient",
    "leakage", "viscous_friction", "motor_pressure", "torque", "measured_speed",
)  # fmt: skip


@dataclass(frozen=True)
class State:
    """Memory of an effect: `rate` is d(state)/dt, `decay` its own stiffness -d(rate)/d(state) in 1/s, or None.

    `given` says what arguments of the two are here, where several states share them: the name of what is looked up instead,
    or a number.
    """

    name: str
    rate: Callable[..., float]
    decay: Callable[..., float] | None = None
    given: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect of the catalogue; see the module's text for what laws and states are.

    `corner` says, by a law that may also ask for `substep` (s), whether a channel is about to pass a bend of the effect that
    is too sharp for a whole substep, or wants short ones everywhere; it then takes the substep in
    `corner_parts` parts. It must be false when the effect is neutral.
    `adds_to` names base parameters of the channel that one of the effect's parameters is simply added to.
    `scope` is "channel" (each valve and motor has its own) or "rig" (both share the same values).
    `indistinguishable_from` lists effects that no data of the usual channels separate from this one.
    `family` names a group of effects that compete with each other and with simpler ones; the diagnosis tries a member only
    if the model as given lists it among its effects.
    """

    name: str
    port: str
    parameters: tuple[Parameter, ...]
    summary: str
    signature: str
    source: str
    laws: Mapping[str, Callable[..., float]] = field(default_factory=dict)
    states: tuple[State, ...] = ()
    adds_to: Mapping[str, str] = field(default_factory=dict)
    corner: Callable[..., bool] | None = None
    corner_parts: int = 5
    scope: str = "channel"
    indistinguishable_from: tuple[str, ...] = ()
    family: str = ""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name; KeyError if there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def is_neutral(self, values: Mapping[str, float]) -> bool:
        """Whether the effect vanishes at these parameter values (missing ones count as neutral).

        An effect vanishes when the parameters that carry its size are neutral; the others only shape it.
        """
        return all(
            values.get(p.name, p.nominal) == p.nominal for p in self.parameters if p.typical != p.nominal
        )


CATALOGUE: dict[str, Effect] = {}


def register(effect: Effect) -> Effect:
    """Adds an effect to the catalogue; it is at once simulated, hideable and diagnosable.

    ValueError if the name is taken, the port or a changed quantity is unknown.
    """
    if effect.name in CATALOGUE:
        raise ValueError(f"effect {effect.name!r} is in the catalogue already")
    if effect.port not in PORTS:
        raise ValueError(f"effect {effect.name!r}: port {effect.port!r} is none of {', '.join(PORTS)}")
    for quantity in effect.laws:
        if quantity not in QUANTITIES:
            raise ValueError(
                f"effect {effect.name!r}: a law changes {quantity!r}, none of {', '.join(QUANTITIES)}"
            )
    CATALOGUE[effect.name] = effect
    return effect


def unregister(name: str) -> None:
    """Takes an effect out of the catalogue (tests of user effects; KeyError if it is not there)."""
    del CATALOGUE[name]


# --- driver ---------------------------------------------------------------------------------------------------------
register(
    Effect(
        name="command_delay",
        port="driver",
        summary="the command reaches the coil late: u(t - delay)",
        signature="pure shift of the onset of every reaction",
        source="fieldbus and driver electronics; dead time, e.g. Merritt 1967",
        # The delay line itself lives in the kernel, which hands `rates` the delayed command.
        parameters=(
            Parameter(
                "delay", "s", 0.0, 0.0, 0.03, "one to three control periods of 10 ms", "dead time", 0.005
            ),
        ),
        indistinguishable_from=("sensor_lag",),
    )
)


def _driver_saturation(voltage, voltage_limit):
    return clip(voltage, -voltage_limit, voltage_limit)


register(
    Effect(
        name="driver_saturation",
        port="driver",
        summary="the driver cannot give more than a limited voltage",
        signature="clipped current at large commands",
        source="supply voltage of valve amplifiers (24 V less their own drop)",
        parameters=(
            Parameter("voltage_limit", "V", inf, 20.0, 73.0, "assumed", "limit of the output", 45.0),
        ),
        laws={"voltage": _driver_saturation},
    )
)


# --- coil -----------------------------------------------------------------------------------------------------------
def _heating_resistance(resistance, rise, heat):
    return resistance * (1.0 + rise * heat)


def _heating_rate(heat, R, current, u_rated, time_constant):
    # Power over its value at the rated command of the cold coil.
    rated_current = u_rated / R
    return (current * current / (rated_current * rated_current) - heat) / time_constant


register(
    Effect(
        name="coil_heating",
        port="coil",
        summary="the coil's resistance rises as the coil warms up",
        signature="slow loss of force at constant voltage, seen in the current",
        source="copper, 0.39 %/K; 60-100 K of coil temperature rise are usual for wet-pin solenoids",
        parameters=(
            Parameter(
                "rise",
                "1",
                0.0,
                0.0,
                0.5,
                "0.39 %/K over up to 130 K",
                "relative rise of R at rated power",
                0.25,
            ),
            Parameter(
                "time_constant", "s", 300.0, 2.0, 1200.0, "assumed", "thermal time constant", 300.0, log=True
            ),
        ),
        laws={"resistance": _heating_resistance},
        states=(State("heat", _heating_rate),),
    )
)


# --- force on the spool ---------------------------------------------------------------------------------------------
def _hysteresis_force(force, amplitude, loop):
    return force - amplitude * loop


def _loop_rate(loop, current_rate, amplitude, width, alpha):
    # Bouc-Wen with n = 1 and beta = gamma: rate-independent, saturates at +-1 (loop opposes the change of current).
    # Never so narrow that more current would mean less force, which no magnet does and which would not be stable.
    least = 2.0 * amplitude / alpha
    return (current_rate - abs(current_rate) * loop) / (width if width > least else least)


def _loop_decay(current_rate, amplitude, width, alpha):
    least = 2.0 * amplitude / alpha
    return abs(current_rate) / (width if width > least else least)


register(
    Effect(
        name="magnetic_hysteresis",
        port="force",
        summary="rate-independent loop between current and magnetic force",
        signature="loop in flow over current whose width does not depend on the sweep rate",
        source="Bouc 1967, Wen 1976; Vaughan and Gamble 1996 for proportional solenoids",
        parameters=(
            Parameter(
                "amplitude",
                "N",
                0.0,
                0.0,
                2.0,
                "2-7 % of the rated force are usual",
                "half height of the loop",
                0.3,
            ),
            Parameter(
                "width",
                "A",
                0.03,
                0.01,
                0.2,
                "assumed",
                "change of current that turns the loop; at least 2 amplitude/alpha",
                0.03,
                log=True,
            ),
        ),
        laws={"force": _hysteresis_force},
        states=(State("loop", _loop_rate, _loop_decay),),
        indistinguishable_from=("spool_stiction",),
    )
)

register(
    Effect(
        name="spool_stiction",
        port="force",
        summary="more Coulomb and static friction on the spool (dirt, gum, side load)",
        signature="stick and jump, threshold for small signals",
        source="Olsson et al. 1998; adds to Fc and Fs of the paper's LuGre model",
        parameters=(
            Parameter("coulomb", "N", 0.0, 0.0, 2.0, "assumed", "more Coulomb friction", 0.3),
            Parameter("static", "N", 0.0, 0.0, 3.0, "assumed", "more static friction", 0.6),
        ),
        adds_to={"Fc": "coulomb", "Fs": "static"},
        indistinguishable_from=("magnetic_hysteresis",),
    )
)


def _preload_force(force, spool, preload):
    # Smooth over 20 um of spool travel.
    return force - preload * tanh(spool * 5e4)


def _preload_corner(preload):
    # Everywhere: a preloaded spool that is pushed over its centre magnifies errors made long before.
    return preload > 0.0


register(
    Effect(
        name="spring_preload",
        port="force",
        summary="centring springs are preloaded: a force threshold before the spool leaves its centre",
        signature="threshold in current, none in opening",
        source="construction of spring-centred directional valves",
        parameters=(
            Parameter(
                "preload", "N", 0.0, 0.0, 6.0, "assumed: up to 40 % of the rated force", "preload", 1.5
            ),
        ),
        laws={"force": _preload_force},
        corner=_preload_corner,
        corner_parts=10,
        indistinguishable_from=("dead_zone",),
    )
)


def _flow_force(force, spool, pressure, coefficient, supply_pressure):
    drop = supply_pressure - sign(spool) * pressure
    return force - coefficient * spool * (drop if drop > 0.0 else 0.0)


register(
    Effect(
        name="flow_force",
        port="force",
        summary="steady flow force, which closes the valve",
        signature="opening sags with the pressure drop over the valve",
        source="Merritt 1967, ch. 5: F = 0.43 w x dp for a sharp-edged spool",
        parameters=(
            Parameter(
                "coefficient",
                "m",
                0.0,
                0.0,
                1.2e-3,
                "0.43 times the area gradient w",
                "force per opening and pressure drop",
                3e-4,
            ),
            Parameter(
                "supply_pressure", "Pa", 100e5, 50e5, 350e5, "assumed", "supply pressure", 100e5, log=True
            ),
        ),
        laws={"force": _flow_force},
    )
)


# --- opening --------------------------------------------------------------------------------------------------------
def _null_offset(opening, offset):
    return opening + offset


register(
    Effect(
        name="null_offset",
        port="opening",
        summary="hydraulic centre beside the electrical one",
        signature="asymmetric onset, offset at zero command",
        source="ISO 10770-1, null bias",
        parameters=(
            Parameter("offset", "m", 0.0, -1.5e-4, 1.5e-4, "assumed", "opening at centred spool", 3e-5),
        ),
        laws={"opening": _null_offset},
    )
)


def _dead_zone(opening, overlap_positive, overlap_negative):
    return opening - clip(opening, -overlap_negative, overlap_positive)


register(
    Effect(
        name="dead_zone",
        port="opening",
        summary="positive overlap: no flow until the spool has passed it, each direction with its own",
        signature="flat flow around zero, each direction its own width",
        source="ISO 10770-1, dead band; the paper's Fig. 2 shows none below 300 mA",
        parameters=(
            Parameter(
                "overlap_positive",
                "m",
                0.0,
                0.0,
                4.5e-4,
                "Fig. 2: 300 mA are 353 um",
                "overlap, positive flow",
                1e-4,
            ),
            Parameter(
                "overlap_negative",
                "m",
                0.0,
                0.0,
                4.5e-4,
                "Fig. 2: 300 mA are 353 um",
                "overlap, negative flow",
                1e-4,
            ),
        ),
        laws={"opening": _dead_zone},
        indistinguishable_from=("spring_preload",),
    )
)


def _flow_saturation(opening, opening_limit):
    return clip(opening, -opening_limit, opening_limit)


register(
    Effect(
        name="flow_saturation",
        port="opening",
        summary="the opening stops growing although the spool moves on",
        signature="flat top at large commands",
        source="ISO 10770-1, flow saturation",
        parameters=(
            Parameter("opening_limit", "m", inf, 1e-4, 8.6e-4, "assumed", "largest opening", 3e-4, log=True),
        ),
        laws={"opening": _flow_saturation},
    )
)


def _directional_gain(opening, ratio):
    return opening * (1.0 if opening > 0.0 else ratio)


register(
    Effect(
        name="directional_gain",
        port="opening",
        summary="the negative direction has another flow gain than the positive one",
        signature="gain split by the sign of the command",
        source="ISO 10770-1, symmetry",
        parameters=(
            Parameter(
                "ratio", "1", 1.0, 0.4, 2.5, "assumed", "negative over positive flow gain", 0.75, log=True
            ),
        ),
        laws={"opening": _directional_gain},
    )
)


def _flow_gain_nonlinearity(opening, curvature, alpha, u_rated, R, k):
    rated = alpha * u_rated / (R * k)
    share = abs(opening) / rated
    return opening * ((1.0 - curvature) + curvature * (share if share < 1.0 else 1.0))


register(
    Effect(
        name="flow_gain_nonlinearity",
        port="opening",
        summary="progressive control edge: little gain at small openings",
        signature="residual over opening only",
        source="V-notches of proportional spools; ISO 10770-1, linearity",
        parameters=(
            Parameter(
                "curvature",
                "1",
                0.0,
                -0.8,
                0.9,
                "assumed",
                "share of the gain that grows with the opening",
                0.5,
            ),
        ),
        laws={"opening": _flow_gain_nonlinearity},
    )
)


# --- flow and supply ------------------------------------------------------------------------------------------------
def _pressure_dependent_flow(drive, opening, pressure, supply_pressure):
    return drive - sign(opening) * pressure / supply_pressure


register(
    Effect(
        name="pressure_dependent_flow",
        port="flow",
        summary="orifice law: flow falls as the load takes its share of the supply pressure",
        signature="flow falls as load pressure rises",
        source="paper, (7), which it replaces by (8); Merritt 1967: sqrt((ps - sign(x) dp) / ps)",
        parameters=(
            Parameter(
                "supply_pressure", "Pa", inf, 20e5, 350e5, "assumed", "supply pressure", 100e5, log=True
            ),
        ),
        laws={"drive": _pressure_dependent_flow},
    )
)


def _supply_droop(drive, droop):
    return drive - droop


def _droop_rate(droop, own_flow, other_flow, relative_drop, time_constant):
    # 8.1778e-4 m3/s (49 l/min): two nominal valves at the rated command. It is the supply's own, the same for both channels.
    return (relative_drop * (abs(own_flow) + abs(other_flow)) / 8.1778e-4 - droop) / time_constant


def _droop_corner(relative_drop):
    # The other channel's flow is that of the substep before, which a supply as weak as this does not forgive.
    return relative_drop > 0.5


register(
    Effect(
        name="supply_droop",
        port="supply",
        scope="rig",
        summary="the supply pressure falls with the total flow of both valves, with memory",
        signature="both motors slow down together; needs the other channel's flow",
        source="pump and accumulator characteristics, Backe 1992",
        parameters=(
            Parameter(
                "relative_drop",
                "1",
                0.0,
                0.0,
                0.9,
                "assumed",
                "share of the supply pressure lost at 49 l/min, the rated flow of two nominal valves",
                0.5,
            ),
            Parameter("time_constant", "s", 0.1, 0.01, 5.0, "assumed", "memory of the supply", 0.1, log=True),
        ),
        laws={"drive": _supply_droop},
        states=(State("droop", _droop_rate),),
        corner=_droop_corner,
    )
)


# --- line -----------------------------------------------------------------------------------------------------------
def _entrained_air(bulk_modulus, pressure, fraction):
    absolute = 101325.0 + abs(pressure)
    return bulk_modulus / (1.0 + fraction * bulk_modulus * 101325.0 / (absolute * absolute))


def _entrained_air_corner(pressure, fraction):
    # The fluid is soft within some bar of zero only, which a hard-driven line crosses in a tenth of a millisecond.
    return fraction > 0.0 and abs(pressure) < 4e5


register(
    Effect(
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
)


def _line_loss(motor_pressure, displacement, speed, coefficient):
    motor_flow = displacement * speed
    return motor_pressure - coefficient * motor_flow * abs(motor_flow)


register(
    Effect(
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
)


def _crossport_relief(leakage, pressure, relief_pressure, conductance):
    excess = abs(pressure) - relief_pressure
    return leakage + sign(pressure) * conductance * (excess if excess > 0.0 else 0.0)


def _crossport_relief_corner(pressure, relief_pressure):
    # About to open or to close.
    return abs(abs(pressure) - relief_pressure) < 4e5


register(
    Effect(
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
)


# --- motor ----------------------------------------------------------------------------------------------------------
def _speed_dependent_leakage(leakage, speed, coefficient):
    return leakage + coefficient * speed


register(
    Effect(
        name="speed_dependent_leakage",
        port="motor",
        summary="leakage that grows with speed (filling losses, churning)",
        signature="speed loss at no load, seen in the flow balance",
        source="neglected by the paper in its own words; Wilson 1948, Schloesser 1961",
        parameters=(
            Parameter(
                "coefficient",
                "m3/rad",
                0.0,
                0.0,
                6e-7,
                "up to 45 % of the displacement",
                "leakage per speed",
                1.5e-7,
            ),
        ),
        laws={"leakage": _speed_dependent_leakage},
    )
)


def _motor_coulomb_friction(torque, speed, coulomb, static, stribeck_speed):
    slip = speed / stribeck_speed
    return torque - (coulomb + (static - coulomb) * exp(-slip * slip)) * tanh(speed * 10.0)


def _motor_coulomb_friction_corner(speed, coulomb, static):
    # The step at standstill is passed within a substep, and where the shaft sticks depends on how.
    return coulomb + static > 0.0 and abs(speed) < 1.0


register(
    Effect(
        name="motor_coulomb_friction",
        port="motor",
        summary="dry friction of the motor with a Stribeck peak, smooth within 0.1 rad/s",
        signature="step of torque with the sign of the speed, sticking at reversal",
        source="Armstrong-Helouvry 1991; Olsson 1973 for hydraulic motors",
        parameters=(
            Parameter(
                "coulomb",
                "N m",
                0.0,
                0.0,
                2.0,
                "3-10 % of the nominal torque are usual",
                "Coulomb friction",
                0.3,
            ),
            Parameter("static", "N m", 0.0, 0.0, 3.0, "assumed", "static friction", 0.4),
            Parameter("stribeck_speed", "rad/s", 3.0, 0.2, 20.0, "assumed", "Stribeck speed", 3.0, log=True),
        ),
        laws={"torque": _motor_coulomb_friction},
        corner=_motor_coulomb_friction_corner,
    )
)


def _quadratic_drag(torque, speed, coefficient):
    return torque - coefficient * speed * abs(speed)


register(
    Effect(
        name="quadratic_drag",
        port="motor",
        summary="hydrodynamic torque loss growing with speed squared",
        signature="curvature of torque over speed",
        source="Schloesser 1961, hydrodynamic loss",
        parameters=(
            Parameter(
                "coefficient", "N m s2/rad2", 0.0, 0.0, 8e-4, "assumed", "torque per speed squared", 1e-4
            ),
        ),
        laws={"torque": _quadratic_drag},
        indistinguishable_from=("line_loss",),
    )
)


def _displacement_ripple(displacement, angle, amplitude, order):
    return displacement * (1.0 + amplitude * cos(order * angle))


def _displacement_ripple_corner(amplitude):
    # A ripple far beyond the usual nearly stalls the motor and magnifies errors a hundredfold there.
    return amplitude > 0.1


register(
    Effect(
        name="displacement_ripple",
        port="motor",
        summary="displacement varies with the shaft angle, in flow and in torque",
        signature="line at `order` times the shaft speed",
        source="kinematics of gear and orbit motors, Ivantysyn and Ivantysynova 2001",
        parameters=(
            Parameter("amplitude", "1", 0.0, 0.0, 0.3, "1-10 % are usual", "relative ripple", 0.05),
            Parameter("order", "1", 7.0, 3.0, 13.0, "number of chambers", "periods in a turn", 7.0),
        ),
        laws={"displacement": _displacement_ripple},
        corner=_displacement_ripple_corner,
        corner_parts=20,
    )
)


# --- load -----------------------------------------------------------------------------------------------------------
def _load_bias(torque, bias):
    return torque - bias


register(
    Effect(
        name="load_bias",
        port="load",
        summary="a constant load torque that nobody logged",
        signature="same sign in both directions",
        source="weights, belts, seals",
        parameters=(
            Parameter("bias", "N m", 0.0, -3.0, 3.0, "assumed", "torque against positive speed", 0.4),
        ),
        laws={"torque": _load_bias},
    )
)


def _eccentric_load(torque, angle, amplitude, phase):
    return torque - amplitude * sin(angle + phase)


register(
    Effect(
        name="eccentric_load",
        port="load",
        summary="unbalanced weight on the shaft",
        signature="line at the shaft speed",
        source="statics: m g r sin(theta + phase)",
        parameters=(
            Parameter("amplitude", "N m", 0.0, 0.0, 2.0, "assumed", "largest torque", 0.3),
            Parameter("phase", "rad", 0.0, -pi, pi, "unknown beforehand", "angle at the start", 0.0),
        ),
        laws={"torque": _eccentric_load},
    )
)


def _backlash_torque(torque, twist, speed, load_speed, gap, stiffness, damping, load, inertia):
    half = 0.5 * gap
    wound = twist - clip(twist, -half, half)
    # The damper grows over the first 20 mrad of winding, so that a blow begins smoothly.
    contact = stiffness * wound + damping * (speed - load_speed) * clip(abs(wound) * 50.0, 0.0, 1.0)
    contact = contact if contact * wound > 0.0 else 0.0
    # The logged load acts behind the coupling.
    return torque - contact + (load if inertia > 0.0 else 0.0)


def _twist_rate(twist, speed, load_speed, inertia):
    return speed - load_speed if inertia > 0.0 else 0.0


def _load_speed_rate(load_speed, twist, speed, gap, stiffness, damping, load, inertia):
    half = 0.5 * gap
    wound = twist - clip(twist, -half, half)
    # The damper grows over the first 20 mrad of winding, so that a blow begins smoothly.
    contact = stiffness * wound + damping * (speed - load_speed) * clip(abs(wound) * 50.0, 0.0, 1.0)
    contact = contact if contact * wound > 0.0 else 0.0
    return (contact - load) / inertia if inertia > 0.0 else 0.0


def _backlash_corner(inertia):
    # Everywhere, and finely: when the coupling strikes next depends on all that came before, and a gap that rattles
    # multiplies an error fivefold in a tenth of a second.
    return inertia > 0.0


register(
    Effect(
        name="shaft_backlash",
        port="load",
        summary="part of the inertia sits behind an elastic coupling with a gap",
        signature="jump at reversal, anti-resonance",
        source="Nordin and Gutman 2002, dead-zone model of backlash",
        parameters=(
            Parameter(
                "inertia", "kg m2", 0.0, 1e-4, 1e-2, "assumed", "inertia behind the coupling", 2e-3, log=True
            ),
            Parameter("gap", "rad", 0.0, 0.0, 0.1, "assumed", "play of the coupling", 0.05),
            Parameter(
                "stiffness",
                "N m/rad",
                300.0,
                20.0,
                2000.0,
                "assumed",
                "stiffness in contact",
                300.0,
                log=True,
            ),
            Parameter("damping", "N m s/rad", 0.3, 0.01, 2.0, "assumed", "damping in contact", 0.3, log=True),
        ),
        laws={"torque": _backlash_torque},
        states=(State("twist", _twist_rate), State("load_speed", _load_speed_rate)),
        corner=_backlash_corner,
        corner_parts=20,
    )
)


# --- fluid ----------------------------------------------------------------------------------------------------------
def _drift_leakage(leakage_coefficient, change, time, time_constant):
    return leakage_coefficient * exp(-change * (1.0 - exp(-time / time_constant)))


def _drift_friction(viscous_friction, change, time, time_constant):
    return viscous_friction * exp(change * (1.0 - exp(-time / time_constant)))


register(
    Effect(
        name="viscosity_drift",
        port="fluid",
        scope="rig",
        summary="the fluid warms up (or cools): leakage and viscous friction drift opposite ways",
        signature="slow opposite trends of leakage and friction",
        source="leakage ~ 1/viscosity, viscous friction ~ viscosity",
        parameters=(
            Parameter(
                "change",
                "1",
                0.0,
                -2.0,
                2.0,
                "20 K of warming halve the viscosity of HLP 46",
                "log of final over initial viscosity",
                -0.7,
            ),
            Parameter(
                "time_constant",
                "s",
                100.0,
                3.0,
                3000.0,
                "assumed",
                "time constant of the warming",
                100.0,
                log=True,
            ),
        ),
        laws={"leakage_coefficient": _drift_leakage, "viscous_friction": _drift_friction},
    )
)


# --- sensor ---------------------------------------------------------------------------------------------------------
def _sensor_lag(measured_speed, lagged_speed, time_constant):
    return lagged_speed if time_constant > 0.0 else measured_speed


def _lag_rate(lagged_speed, speed, time_constant):
    return (speed - lagged_speed) / (time_constant if time_constant > 1e-5 else 1e-5)


def _lag_decay(time_constant):
    return 1.0 / (time_constant if time_constant > 1e-5 else 1e-5)


register(
    Effect(
        name="sensor_lag",
        port="sensor",
        summary="the measured speed lags the true one (filter of first order)",
        signature="measured speed late against physics, torque balance broken",
        source="counter gates and filters of speed sensors",
        parameters=(Parameter("time_constant", "s", 0.0, 0.0, 0.1, "assumed", "time constant", 0.02),),
        laws={"measured_speed": _sensor_lag},
        states=(State("lagged_speed", _lag_rate, _lag_decay),),
        indistinguishable_from=("command_delay",),
    )
)


def _sensor_gain(measured_speed, gain):
    return measured_speed * gain


register(
    Effect(
        name="sensor_gain",
        port="sensor",
        summary="the speed sensor's scale is wrong",
        signature="redundancy check fails, physics does not",
        source="pulses per turn, calibration",
        parameters=(
            Parameter("gain", "1", 1.0, 0.7, 1.4, "assumed", "measured over true speed", 1.05, log=True),
        ),
        laws={"measured_speed": _sensor_gain},
    )
)


def _sensor_offset(measured_speed, offset):
    return measured_speed + offset


register(
    Effect(
        name="sensor_offset",
        port="sensor",
        summary="the speed sensor's zero is wrong",
        signature="redundancy check fails, physics does not",
        source="drift of analogue speed signals",
        parameters=(
            Parameter("offset", "rad/s", 0.0, -10.0, 10.0, "assumed", "measured speed at standstill", 1.0),
        ),
        laws={"measured_speed": _sensor_offset},
    )
)

# The loss models of the motor have a file of their own; they come last.
from . import losses  # noqa: E402, F401

#: The effects that ship with the package; any other one is a user's (see `register` and `effect_files`).
BUILT_IN = tuple(CATALOGUE)

# Corrections of form are effects of a model file as well, but none that a rig is known to have.
from . import form_corrections  # noqa: E402, F401
