"""Loss models of the motor: the published ones whose equations can be stated, each as one effect of the catalogue.

The base plant has the simplest loss model there is, which is the paper's: laminar leakage Km dp and viscous drag B w. A
loss model adds its terms to these, so that all its coefficients at zero leave the base plant bit for bit. A motor that
is to have the losses of a publication *alone* takes Km = 0 and B = 0 beside the coefficients, or, where the model has
the same term, keeps Km in place of Cs D/mu and B in place of Cv D mu: they are the same numbers.

All models act in all four quadrants. Leakage has the sign of the pressure difference and friction that of the speed, so
that none ever gives power. Where a publication has a jump at standstill there is a steep line here, as in
`motor_coulomb_friction`: sign(w) is tanh(10 w), full from 0.3 rad/s; and the square root of turbulent leakage is smooth
within 0.1 bar. docs/reference/losses.md has equations, sources, published coefficients, and what is missing of the others.
Where a publication lets a coefficient depend on the operating point and its formula is not known here, a growth that is
ours stands for it; it is zero unless given.
"""

from functools import partial

from ..parameters import MOTOR_SIZE, Parameter, assumed
from ..vector_math import exp, sqrt, tanh
from .effect import Effect

#: Effects of this family compete with the simpler terms of the catalogue for the same facts, so the diagnosis takes them
#: as candidates only when the model as given lists them.
FAMILY = "motor_losses"

#: Effects that logs of pressure and speed hardly distinguish from them.
_ALIKE = ("motor_coulomb_friction", "quadratic_drag", "speed_dependent_leakage")

_VISCOSITY = Parameter(
    "viscosity", "Pa s", 0.040, 0.005, 0.4, "ISO VG 46 at 40 °C: 46 mm2/s (ISO 3448) times 870 kg/m3", "dynamic viscosity",
    log=True,
)  # fmt: skip
_DENSITY = Parameter(
    "density", "kg/m3", 870.0, 800.0, 1200.0, "mineral oil; up to 1200 for phosphate esters", "density", log=True
)  # fmt: skip
_SLIP = Parameter(
    "slip", "1", 0.0, 0.0, 5e-6, "the paper's Km is 4.7e-6; piston machines have 1e-9 to 1e-8",
    "Cs: laminar leakage Cs D dp/mu", 1.5e-6,
)  # fmt: skip
_DRAG = Parameter(
    "drag", "1", 0.0, 0.0, 1.6e5, "the paper's B is 8.0e4; piston machines have 2e4 to 6e4", "Cv: drag Cv D mu w", 2e4
)  # fmt: skip
_FRICTION = Parameter(
    "friction", "1", 0.0, 0.0, 0.2, "0.007 to 0.06 for piston machines, more for gear and orbit motors",
    "Cf: friction Cf D dp, against the motion", 0.05,
)  # fmt: skip
_CONSTANT = Parameter(
    "constant_torque", "N m", 0.0, 0.0, 0.5, "assumed: seals and springs, some per cent of the nominal torque",
    "Tc: friction that depends on nothing, against the motion", 0.1, scaling=MOTOR_SIZE,
)  # fmt: skip
_HYDRODYNAMIC = Parameter(
    "hydrodynamic", "m5", 0.0, 0.0, 2e-7, "Ch D^(5/3)/2, with Ch about 50 for a piston machine 4e-9 m5",
    "torque over density and speed squared", 5e-8, scaling=MOTOR_SIZE,
)  # fmt: skip


_loss_model = partial(Effect, port="motor", indistinguishable_from=_ALIKE, family=FAMILY)


# --- Wilson -----------------------------------------------------------------------------------------------------------
def _wilson_leakage(leakage, pressure, slip, viscosity, D):
    return leakage + slip * D / viscosity * pressure


def _wilson_torque(torque, motor_pressure, speed, drag, friction, constant_torque, viscosity, D):
    sliding = friction * D * abs(motor_pressure) + constant_torque
    return torque - drag * D * viscosity * speed - sliding * tanh(speed * 10.0)


WILSON_LOSSES = _loss_model(
    name="wilson_losses",
    title="Wilson's losses of the motor",
    summary="Wilson's losses: laminar slip, viscous drag, friction with pressure, constant friction",
    signature="torque lost with the sign of the speed, growing with pressure",
    source="Wilson, Positive-Displacement Pumps and Fluid Motors, 1950; Merritt 1967, section 4-3",
    parameters=(_SLIP, _DRAG, _FRICTION, _CONSTANT, _VISCOSITY),
    laws={"leakage": _wilson_leakage, "torque": _wilson_torque},
)


# --- Schloesser -------------------------------------------------------------------------------------------------------
def _schloesser_leakage(leakage, pressure, slip, turbulent_area, viscosity, density, D):
    turbulent = turbulent_area * sqrt(2.0 / density) * pressure / sqrt(sqrt(pressure * pressure + 1e8))
    return leakage + slip * D / viscosity * pressure + turbulent


def _schloesser_torque(
    torque, motor_pressure, speed, drag, friction, hydrodynamic, constant_torque, viscosity, density, D
):
    sliding = friction * D * abs(motor_pressure) + constant_torque
    fluid = drag * D * viscosity + hydrodynamic * density * abs(speed)
    return torque - fluid * speed - sliding * tanh(speed * 10.0)


SCHLOESSER_LOSSES = _loss_model(
    name="schloesser_losses",
    title="Schloesser's losses of the motor",
    summary="Schloesser's losses: Wilson's, turbulent slip, and a hydrodynamic loss with speed squared",
    signature="leakage with the root of pressure, torque curved over speed",
    source="Schloesser, Mathematical model for displacement pumps and motors, Hydraulic Power Transmission, 1961",
    parameters=(
        _SLIP,
        Parameter("turbulent_area", "m2", 0.0, 0.0, 5e-7, "assumed; Cst D^(2/3), of the order 1e-9 m2 for a piston machine",
            "area of the orifice that the gaps make", 1e-7, scaling=MOTOR_SIZE),
        _DRAG, _FRICTION, _HYDRODYNAMIC, _CONSTANT, _VISCOSITY, _DENSITY,
    ),
    laws={"leakage": _schloesser_leakage, "torque": _schloesser_torque},
)  # fmt: skip


# --- Dorey ------------------------------------------------------------------------------------------------------------
def _dorey_leakage(leakage, pressure, speed, slip, slip_growth, compression, viscosity, D, beta):
    size = abs(pressure)
    laminar = slip * (1.0 + slip_growth * size) * D / viscosity
    return leakage + (laminar + compression * D * abs(speed) / beta) * pressure


def _dorey_torque(torque, motor_pressure, speed, drag, friction, boundary, boundary_speed, viscosity, D):
    sliding = friction * (1.0 + boundary * exp(-abs(speed) / boundary_speed)) * D * abs(motor_pressure)
    return torque - drag * D * viscosity * speed - sliding * tanh(speed * 10.0)


DOREY_LOSSES = _loss_model(
    name="dorey_losses",
    title="Dorey's losses of the motor",
    summary="Dorey's losses: Wilson's linear model with coefficients that depend on pressure and speed, and compression",
    signature="slip grows faster than pressure, friction falls with speed",
    source="McCandlish and Dorey, Proc. IMechE 198B, 1984; Dorey, Bath Fluid Power Workshop, 1988; linear part and "
    "compression as OpenHydraulics has them after the former. How the coefficients depend on pressure and speed is measured "
    "for each machine: slip_growth and boundary are the simplest such dependences and ours",
    parameters=(
        _SLIP,
        Parameter("slip_growth", "1/Pa", 0.0, 0.0, 1e-6, "assumed", "relative growth of Cs with pressure", 1e-7),
        Parameter("compression", "1", 0.0, 0.0, 10.0, "1 + Vr; a public library after McCandlish and Dorey has Vr = 0.54",
            "volume that is compressed in every turn over the displacement", 1.54),
        _DRAG, _FRICTION,
        Parameter("boundary", "1", 0.0, 0.0, 10.0, "assumed", "Cf at standstill over Cf at speed, less one", 2.0),
        Parameter("boundary_speed", "rad/s", 10.0, 1.0, 100.0, "assumed", "speed over which Cf falls", log=True),
        _VISCOSITY,
    ),
    laws={"leakage": _dorey_leakage, "torque": _dorey_torque},
)  # fmt: skip


# --- Jeong ------------------------------------------------------------------------------------------------------------
def _jeong_leakage(leakage, pressure, slip, gap_growth, viscosity, D):
    gap = 1.0 + gap_growth * abs(pressure)
    return leakage + slip * gap * gap * gap * D / viscosity * pressure


def _jeong_torque(
    torque, motor_pressure, speed, drag, friction, constant_torque, stribeck, stribeck_speed, hydrodynamic,
    viscosity, density, D,
):  # fmt: skip
    mixed = 1.0 + stribeck * exp(-abs(speed) / stribeck_speed)
    sliding = (friction * D * abs(motor_pressure) + constant_torque) * mixed
    fluid = drag * D * viscosity + hydrodynamic * density * abs(speed)
    return torque - fluid * speed - sliding * tanh(speed * 10.0)


JEONG_LOSSES = _loss_model(
    name="jeong_losses",
    title="Jeong's losses of the motor",
    summary="Jeong's kinds of loss, lumped: gaps that widen with pressure, mixed friction of the sliding pairs, momentum",
    signature="slip with the cube of a widening gap, Stribeck curve at any pressure",
    source="Jeong, J. Mech. Sci. Technol. 21, 2007 (two papers, with Kim); gap equations of Ivantysyn and Ivantysynova 2001",
    parameters=(
        _SLIP,
        Parameter("gap_growth", "1/Pa", 0.0, 0.0, 3e-7, "assumed", "relative widening of the gaps with pressure", 3e-8),
        _DRAG, _FRICTION, _CONSTANT,
        Parameter("stribeck", "1", 0.0, 0.0, 5.0, "assumed", "friction at standstill over friction at speed, less one", 1.0),
        assumed("stribeck_speed", "rad/s", 10.0, low=1.0, high=100.0, note="speed over which friction falls", log=True),
        _HYDRODYNAMIC, _VISCOSITY, _DENSITY,
    ),
    laws={"leakage": _jeong_leakage, "torque": _jeong_torque},
)  # fmt: skip


# --- Ivantysyn and Ivantysynova ---------------------------------------------------------------------------------------
def _ivantysyn_leakage(leakage, pressure, speed, flow_pp, flow_pw):
    return leakage + (flow_pp * abs(pressure) + flow_pw * abs(speed)) * pressure


def _ivantysyn_torque(torque, motor_pressure, speed, torque_0, torque_p, torque_ww, torque_pw):
    size = abs(motor_pressure)
    fluid = torque_ww * abs(speed) + torque_pw * size
    return torque - fluid * speed - (torque_0 + torque_p * size) * tanh(speed * 10.0)


IVANTYSYN_LOSSES = _loss_model(
    name="ivantysyn_losses",
    title="Ivantysyn and Ivantysynova's losses of the motor",
    summary="Ivantysyn and Ivantysynova's polynomials in pressure and speed, of second degree, for measured loss maps",
    signature="whatever the map shows",
    source="Ivantysyn and Ivantysynova, Hydrostatic Pumps and Motors, 2001 (POLYMOD); coefficients are fitted to each machine",
    parameters=(
        assumed("flow_pp", "m3/(s Pa2)", 0.0, low=0.0, high=1e-16, typical=3e-17, scaling=MOTOR_SIZE,
            note="leakage with pressure squared"),
        assumed("flow_pw", "m3/(rad Pa)", 0.0, low=0.0, high=1e-12, typical=3e-13, scaling=MOTOR_SIZE,
            note="leakage with pressure times speed"),
        assumed("torque_0", "N m", 0.0, low=0.0, high=0.5, note="constant friction", typical=0.1, scaling=MOTOR_SIZE),
        assumed("torque_p", "m3/rad", 0.0, low=0.0, high=2.7e-7, note="friction with pressure", typical=7e-8, scaling=MOTOR_SIZE),
        assumed("torque_ww", "N m s2/rad2", 0.0, low=0.0, high=2e-4, typical=5e-5, scaling=MOTOR_SIZE,
            note="drag with speed squared"),
        assumed("torque_pw", "m3 s/rad2", 0.0, low=0.0, high=2e-9, typical=5e-10, scaling=MOTOR_SIZE,
            note="drag with pressure times speed"),
    ),
    laws={"leakage": _ivantysyn_leakage, "torque": _ivantysyn_torque},
)  # fmt: skip


#: In the order in which they act.
EFFECTS = (WILSON_LOSSES, SCHLOESSER_LOSSES, DOREY_LOSSES, JEONG_LOSSES, IVANTYSYN_LOSSES)
