"""The plant's parameters: name, unit, nominal value, plausible range, source and reading.

A channel is one valve and its motor; the rig has two. Names are the symbols of the paper "Impact of
proportional valves' differences to ensure uniform motion of hydraulic motors" (Tables I-III), values are SI.
`low` and `high` bound what a careful engineer would still believe of such a component; calibration stays
inside them.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi

from hydro_env.units import BAR, RPM

__all__ = ["PARAMETERS", "Parameter"]


@dataclass(frozen=True)
class Parameter:
    """One number of the model.

    `nominal` is the value of the base plant; for the parameter of an effect it is the `neutral` value, at which
    the effect vanishes, and `typical` is a medium severity. `low` and `high` are the plausible bounds.
    The first clause of `note`, up to a semicolon, is what the parameter is called in words.
    `log` says that the parameter is naturally varied by factors rather than by differences.
    """

    name: str
    unit: str
    nominal: float
    low: float
    high: float
    source: str
    note: str = ""
    typical: float | None = None
    log: bool = False

    @property
    def neutral(self) -> float:
        """The value at which an effect vanishes (the nominal value of a base parameter)."""
        return self.nominal


_ROWS = (
    # --- hydraulic motor: equations (1)-(3), Table I -----------------------------------------------------------
    Parameter(
        "D",
        "m3/rad",
        8.47e-6 / (2 * pi),
        0.9 * 8.47e-6 / (2 * pi),
        1.1 * 8.47e-6 / (2 * pi),
        "paper, Table I: 8.47 cm3/rev",
        "displacement of the motor",
        log=True,
    ),
    Parameter("J", "kg m2", 0.0028, 0.0014, 0.0056, "paper, Table I", "inertia of motor and load", log=True),
    Parameter(
        "B",
        "N m s/rad",
        0.00045 / RPM,
        0.0,
        0.02,
        "paper, Table I: 0.00045 N m/rpm",
        "viscous friction of the motor",
        log=True,
    ),
    Parameter(
        "Km",
        "m3/(s Pa)",
        15.92e-6 / BAR,
        15.92e-6 / BAR / 100,
        15.92e-6 / BAR * 3,
        "paper, Table I: 15.92 cm3/bar",
        "internal leakage of the motor; the paper leaves out the time unit. Read as cm3/(s bar): with it both published "
        "loops are stable and Ti nearly cancels the motor's pole, as a PID tuner does; read per minute the published gains "
        "are unstable",
        log=True,
    ),
    Parameter(
        "beta", "Pa", 12670e5, 4e8, 1.9e9, "paper, Table I: 12670 bar", "bulk modulus of the fluid", log=True
    ),
    Parameter(
        "V",
        "m3",
        1e-4,
        2e-5,
        1e-3,
        "assumed: the paper gives no value",
        "volume under pressure; results hardly depend on it",
        log=True,
    ),
    # --- valve: equations (5), (6), (8), Table II --------------------------------------------------------------
    Parameter("m", "kg", 0.4, 0.2, 0.8, "paper, Table II", "mass of spool and solenoid core", log=True),
    Parameter(
        "R",
        "Ohm",
        100.0,
        80.0,
        125.0,
        "paper, Table II; (6) prints R_i for R i",
        "resistance of the coil",
        log=True,
    ),
    Parameter("L", "H", 0.1, 0.05, 0.2, "paper, Table II", "inductance of the coil", log=True),
    Parameter(
        "alpha",
        "N/A",
        20.0,
        14.0,
        28.0,
        "paper, Table II: 20 V s/m",
        "force of the coil per current; also its back-EMF",
        log=True,
    ),
    Parameter(
        "k", "N/m", 17000.0, 12000.0, 24000.0, "paper, Table II", "rate of the centring springs", log=True
    ),
    Parameter(
        "C",
        "N s/m",
        0.2,
        0.0,
        40.0,
        "paper, Table II: 0.2 without unit, read as N s/m",
        "viscous damping of the spool",
    ),
    Parameter(
        "Kq",
        "m2/s",
        476106e-6,
        0.15,
        0.75,
        "paper, Table II: 476106 (V1), 315000 (V2), no unit",
        "flow gain of the valve; flow per opening, read as cm3/s per m, which gives 24.5 l/min at 730 mA on V1, the class of "
        "this valve",
        log=True,
    ),
    # --- friction of the spool: LuGre, equations (9)-(11), Table II --------------------------------------------
    Parameter("Fc", "N", 0.1, 0.02, 1.0, "paper, Table II", "Coulomb friction of the spool", log=True),
    Parameter(
        "Fs",
        "N",
        0.2,
        0.02,
        1.5,
        "paper, Table II: 0.2 (V1), 0.15 (V2)",
        "static friction of the spool",
        log=True,
    ),
    Parameter(
        "vs",
        "m/s",
        0.007,
        1e-4,
        2e-2,
        "paper, Table II: 0.007 (V1), 0.0001 (V2)",
        "Stribeck speed of the spool",
        log=True,
    ),
    Parameter(
        "s0",
        "N/m",
        1e5,
        3e4,
        3e5,
        "paper, Table II, which prints N s/m",
        "stiffness of the spool's bristles",
        log=True,
    ),
    Parameter(
        "s1", "N s/m", 470.0, 100.0, 1000.0, "paper, Table II", "damping of the spool's bristles", log=True
    ),
    Parameter("s2", "N s/m", 0.2, 0.0, 40.0, "paper, Table II", "viscous friction of the spool"),
    # --- limits of the real valve, which the paper's equations leave out ----------------------------------------
    Parameter(
        "x_max",
        "m",
        1e-3,
        0.9e-3,
        1.2e-3,
        "assumed: the rated spool position is 0.86 mm",
        "half stroke between the end stops; without stops full-range random commands reach 0.4-0.7 m/s",
    ),
    Parameter(
        "k_stop",
        "N/m",
        5e5,
        1e5,
        5e6,
        "assumed",
        "stiffness of the end stops: the coil's full force compresses them by 30 um",
        log=True,
    ),
    Parameter(
        "v_stop",
        "m/s",
        0.05,
        0.01,
        0.2,
        "assumed: squeeze film, hardly any rebound",
        "greatest rebound speed of the end stops",
        log=True,
    ),
    Parameter(
        "u_rated",
        "V",
        73.0,
        1.0,
        inf,
        "paper, Fig. 2: 730 mA over R = 100 Ohm",
        "limit of the command, both ways",
    ),
)

#: The base parameters of a channel, by symbol.
PARAMETERS: dict[str, Parameter] = {row.name: row for row in _ROWS}
