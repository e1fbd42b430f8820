"""The plant's parameters: name, unit, nominal value, plausible range, source and reading.

A channel is one valve and its motor; the rig has two. Names are the symbols of the paper "Impact of
proportional valves' differences to ensure uniform motion of hydraulic motors" (Tables I-III), values are SI.
`low` and `high` bound what a careful engineer would still believe of such a component; calibration stays
inside them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import inf, isinf, isnan, nan

from ..units import BAR, REVOLUTION, RPM

#: Directions in which logs fix ratios of parameters only, or nearly so, named by a base parameter, with the reason. All
#: parameters with a power in `Parameter.scaling` may be multiplied by a common factor to that power.
SCALINGS = {
    "k": "twice the force on twice the mass, spring and friction moves a spool nearly alike",
    "Kq": "half the travel, by twice the stiffness and mass, gives the same flow with twice the gain",
    "D": "twice the displacement with twice the flow, leakage, inertia and damping, and half the bulk modulus, turns a shaft "
    "alike but for the load",
}
#: Scaling of what is a force on the spool, a travel of the spool, or a torque, flow, inertia ... that grows with the motor.
SPOOL_FORCE = {"k": 1.0}
SPOOL_TRAVEL = {"Kq": -1.0}
MOTOR_SIZE = {"D": 1.0}

#: What a parameter is in the law of its effect, see `Parameter`.
ROLES = ("size", "limit", "shape", "phase", "order", "time_constant")


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    `nominal` is the value of the base plant; for the parameter of an effect it is the `neutral` value, at which
    the effect vanishes, and `typical` is a medium severity (`nominal` unless given). `low` and `high` are the plausible
    bounds. `title`, the first clause of `note` up to a semicolon, is what the parameter is called in words.
    `log` says that the parameter is naturally varied by factors rather than by differences.

    `role` is what the parameter of an effect is in its law: "size" and "limit" carry the amount of the effect, all others
    only shape it. A "limit" is a size whose neutral value is infinite. A "phase" (rad) may be anywhere in a turn, an
    "order" is a whole number, and a "time_constant" belongs to a memory that may be longer than a log. Unless given it is
    "limit" or "size" where `typical` differs from `nominal`, else "shape".
    `scaling` has the parameter's power in the directions `SCALINGS`. `part_of` names the base parameter whose calibrated
    value contains this one, as the inertia of the shaft contains what sits behind a coupling. `not_below` names another
    parameter of the effect that this one is never less than, as static friction is never less than sliding friction. `starts` are
    the values of a shape that are worth a first look where the effect may not act at the neutral one.

    `possible` are the values that a model may have, beside the neutral one: for the parameter of an effect the plausible
    bounds unless given, for a base parameter those that are simulated correctly. What is usual on the paper's
    rig is scaled to others by the unit (`scales`), unless it is `absolute`: a property of the fluid, or what makes the size of a
    rig itself. `per` is the unit of a quantity of the paper's rig to which one without unit is relative.

    ValueError for an unknown role or direction, or a size that has no size.
    """

    name: str
    unit: str
    nominal: float
    low: float
    high: float
    source: str
    note: str = ""
    typical: float = nan
    log: bool = False
    role: str = ""
    scaling: Mapping[str, float] = field(default_factory=dict, hash=False)
    part_of: str = ""
    not_below: str = ""
    starts: tuple[float, ...] = ()
    possible: tuple[float, float] = (nan, nan)
    absolute: bool = False
    per: str = ""

    def __post_init__(self) -> None:
        if isnan(self.typical):
            object.__setattr__(self, "typical", self.nominal)
        if isnan(self.possible[0]):
            object.__setattr__(self, "possible", (self.low, self.high))
        if not self.role:
            amount = "limit" if isinf(self.nominal) else "size"
            object.__setattr__(self, "role", amount if self.typical != self.nominal else "shape")
        for wrong in self._wrong():
            raise ValueError(f"parameter {self.name!r}: {wrong}")

    def _wrong(self) -> Iterator[str]:
        """What cannot be."""
        if self.role not in ROLES:
            yield f"role {self.role!r} is none of {', '.join(ROLES)}"
        if self.carries_size and self.typical == self.nominal:
            yield f"a {self.role} needs a typical value besides its neutral one"
        if not self.carries_size and self.typical != self.nominal:
            yield f"a {self.role} has no typical value"
        for direction in self.scaling:
            if direction not in SCALINGS:
                yield f"scaling {direction!r} is none of {', '.join(SCALINGS)}"

    @property
    def neutral(self) -> float:
        """The value at which an effect vanishes (the nominal value of a base parameter)."""
        return self.nominal

    @property
    def carries_size(self) -> bool:
        """Whether the parameter carries the amount of its effect, so that the effect vanishes at its neutral value."""
        return self.role in ("size", "limit")

    @property
    def title(self) -> str:
        """What the parameter is called in words."""
        return self.note.split(";")[0] or self.name.replace("_", " ")


#: A parameter whose values nobody has published.
assumed = partial(Parameter, source="assumed")

# What is `possible` is simulated as the reference does it, from models that lie far apart (`python -m docs.evidence.accuracy`):
# of what makes the size of a rig, from 2 cm3 and 10 bar to 500 cm3 and 350 bar; of the rest ten times the plausible range either
# way on a rig of the paper's size, and less where a stop would rebound for ever. A cylinder axis is a motor whose `D` is the
# piston area, or whose `Kq` is as much smaller: both are far outside of what motors have, and are simulated as well, as long as
# mass and line do not ring too fast (`validation.check_channel`). Actions are fractions of `u_rated`.
_ROWS = (
    # --- hydraulic motor: equations (1)-(3), Table I ---
    Parameter("D", "m3/rad", 8.47e-6 / REVOLUTION, low=0.9 * 8.47e-6 / REVOLUTION, high=1.1 * 8.47e-6 / REVOLUTION,
        possible=(1e-7, 0.3), log=True, absolute=True, scaling={"D": 1.0},
        note="displacement of the motor", source="paper, Table I: 8.47 cm3/rev"),
    Parameter("J", "kg m2", 0.0028, low=0.0014, high=0.0056, log=True, absolute=True, scaling=MOTOR_SIZE,
        possible=(3e-6, 1e3), note="inertia of motor and load", source="paper, Table I"),
    Parameter("B", "N m s/rad", 0.00045 / RPM, low=0.0, high=0.02, log=True, scaling=MOTOR_SIZE,
        possible=(0.0, 0.2), note="viscous friction of the motor", source="paper, Table I: 0.00045 N m/rpm"),
    Parameter("Km", "m3/(s Pa)", 15.92e-6 / BAR, low=15.92e-6 / BAR / 100, high=15.92e-6 / BAR * 3, log=True, scaling=MOTOR_SIZE,
        possible=(0.0, 5e-9),
        note="internal leakage of the motor; the paper leaves out the time unit. Read as cm3/(s bar): with it both "
        "published loops are stable and Ti nearly cancels the motor's pole, as a PID tuner does; read per minute the published "
        "gains are unstable", source="paper, Table I: 15.92 cm3/bar"),
    Parameter("beta", "Pa", 12670 * BAR, low=4e8, high=1.9e9, log=True, absolute=True, scaling={"D": -1.0},
        possible=(4e7, 1.9e10), note="bulk modulus of the fluid", source="paper, Table I: 12670 bar"),
    Parameter("V", "m3", 1e-4, low=2e-5, high=1e-3, log=True,
        possible=(2e-6, 1e-2), note="half the oil volume of one line, from valve to motor; results hardly depend on it",
        source="assumed: the paper gives no value"),
    # --- valve: equations (5), (6), (8), Table II ---
    Parameter("m", "kg", 0.4, low=0.2, high=0.8, log=True, scaling={"k": 1.0, "Kq": 1.0},
        possible=(0.03, 8.0), note="mass of spool and solenoid core", source="paper, Table II"),
    Parameter("R", "Ohm", 100.0, low=80.0, high=125.0, log=True, absolute=True,
        possible=(0.1, 1e4), note="resistance of the coil", source="paper, Table II; (6) prints R_i for R i"),
    Parameter("L", "H", 0.1, low=0.05, high=0.2, log=True, absolute=True,
        possible=(1e-4, 100.0), note="inductance of the coil", source="paper, Table II"),
    Parameter("alpha", "N/A", 20.0, low=14.0, high=28.0, log=True, absolute=True, scaling=SPOOL_FORCE,
        possible=(0.1, 1e5), note="force of the coil per current; also its back-EMF", source="paper, Table II: 20 V s/m"),
    Parameter("k", "N/m", 17000.0, low=12000.0, high=24000.0, log=True, absolute=True, scaling={"k": 1.0, "Kq": 1.0},
        possible=(1e3, 1e6), note="rate of the centring springs", source="paper, Table II"),
    Parameter("C", "N s/m", 0.2, low=0.0, high=40.0,
        possible=(0.0, 1e3), note="viscous damping of the spool", source="paper, Table II: 0.2 without unit, read as N s/m"),
    Parameter("Kq", "m2/s", 476106e-6, low=0.15, high=0.75, log=True, absolute=True, scaling={"Kq": 1.0, "D": 1.0},
        possible=(1e-6, 100.0),
        note="flow gain of the valve; flow per opening, read as cm3/s per m, which gives 24.5 l/min at 730 mA on V1, the "
        "class of this valve", source="paper, Table II: 476106 (V1), 315000 (V2), no unit"),
    # --- friction of the spool: LuGre, equations (9)-(11), Table II ---
    Parameter("Fc", "N", 0.1, low=0.02, high=1.0, log=True, scaling=SPOOL_FORCE,
        possible=(0.0, 2.0), note="Coulomb friction of the spool", source="paper, Table II"),
    Parameter("Fs", "N", 0.2, low=0.02, high=1.5, log=True, scaling=SPOOL_FORCE,
        possible=(0.0, 2.0), note="static friction of the spool", source="paper, Table II: 0.2 (V1), 0.15 (V2)"),
    Parameter("vs", "m/s", 0.007, low=1e-4, high=2e-2, log=True, scaling=SPOOL_TRAVEL,
        possible=(1e-5, 0.2), note="Stribeck speed of the spool", source="paper, Table II: 0.007 (V1), 0.0001 (V2)"),
    Parameter("s0", "N/m", 1e5, low=3e4, high=3e5, log=True,
        possible=(3e3, 1e7), note="stiffness of the spool's bristles", source="paper, Table II, which prints N s/m"),
    Parameter("s1", "N s/m", 470.0, low=100.0, high=1000.0, log=True,
        possible=(10.0, 1e4), note="damping of the spool's bristles", source="paper, Table II"),
    Parameter("s2", "N s/m", 0.2, low=0.0, high=40.0,
        possible=(0.0, 400.0), note="viscous friction of the spool", source="paper, Table II"),
    # --- limits of the real valve, which the paper's equations leave out ---
    Parameter("x_max", "m", 1e-3, low=0.9e-3, high=1.2e-3, possible=(1e-4, 5e-3),
        note="half stroke between the end stops; without stops full-range random commands reach 0.4-0.7 m/s",
        source="assumed: the rated spool position is 0.86 mm"),
    Parameter("k_stop", "N/m", 5e5, low=1e5, high=5e6, log=True,
        possible=(1e4, 1e7), note="stiffness of the end stops: the coil's full force compresses them by 30 um", source="assumed"),
    Parameter("v_stop", "m/s", 0.05, low=0.01, high=0.2, log=True,
        possible=(1e-3, 0.5), note="greatest rebound speed of the end stops", source="assumed: squeeze film, hardly any rebound"),
    Parameter("u_rated", "V", 73.0, low=1.0, high=inf, absolute=True,
        possible=(0.1, 1e6), note="limit of the command, both ways", source="paper, Fig. 2: 730 mA over R = 100 Ohm"),
)  # fmt: skip

#: The base parameters of a channel, by symbol.
PARAMETERS: dict[str, Parameter] = {row.name: row for row in _ROWS}

#: A shape parameter of effects whose size depends on the pressure drop over single edges.
SUPPLY_PRESSURE = assumed(
    "supply_pressure", "Pa", 100e5, low=50e5, high=350e5, log=True, possible=(10e5, 350e5), note="supply pressure"
)  # fmt: skip
