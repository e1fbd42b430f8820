"""Units at the border: everything inside is SI, and a unit changes only where a value enters or leaves.

`BAR`, `RPM` ... are the size of one such unit in SI, so ``speed_rpm * RPM`` is rad/s and ``pressure / BAR`` is bar.
`unit("l/min")` looks a unit up by the name a file uses; `to_si` and `from_si` convert values, affine units
(degC, degF) included.

A table of our own rather than pint: that reads "U/min" (rpm in German headers) as enzyme units, "Nm" as a yarn number,
"1/min" and "Hz" without the factor of 2 pi, knows neither "lpm" nor "cm3/rev", suggests nothing for "baar", and takes a
second to import.
"""

import math
from dataclasses import dataclass
from typing import Any

from hydro_env.errors import InputError, suggestion

REVOLUTION = 2.0 * math.pi  # rad
RPM = REVOLUTION / 60.0  # rad/s
DEGREE = math.pi / 180.0  # rad
BAR = 1.0e5  # Pa
LPM = 1.0e-3 / 60.0  # m3/s
GPM = 3.785411784e-3 / 60.0  # m3/s, the US gallon of valve data sheets
MILLIMETRE = 1.0e-3  # m
MICROMETRE = 1.0e-6  # m
MILLISECOND = 1.0e-3  # s
MILLIAMPERE = 1.0e-3  # A
ZERO_CELSIUS = 273.15  # K


@dataclass(frozen=True)
class Unit:
    """A unit of `quantity`: SI value = value * `scale` + `offset`."""

    name: str
    quantity: str
    scale: float
    offset: float = 0.0


#: Size in SI, by the quantity.
_SCALES: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": MILLISECOND, "us": 1.0e-6, "min": 60.0, "h": 3600.0},
    "angular speed": {"rad/s": 1.0, "rpm": RPM, "deg/s": DEGREE, "Hz": REVOLUTION},
    "angle": {"rad": 1.0, "deg": DEGREE, "rev": REVOLUTION},
    "linear speed": {"m/s": 1.0, "mm/s": MILLIMETRE, "m/min": 1.0 / 60.0},
    "length": {"m": 1.0, "mm": MILLIMETRE, "um": MICROMETRE, "in": 0.0254},
    "voltage": {"V": 1.0, "mV": 1.0e-3},
    "current": {"A": 1.0, "mA": MILLIAMPERE},
    "pressure": {"Pa": 1.0, "kPa": 1.0e3, "MPa": 1.0e6, "bar": BAR, "mbar": 100.0, "psi": 6894.757293168361},
    "flow": {"m3/s": 1.0, "l/min": LPM, "l/s": 1.0e-3, "m3/h": 1.0 / 3600.0, "GPM": GPM},
    "torque": {"N m": 1.0, "kN m": 1.0e3},
    "force": {"N": 1.0, "kN": 1.0e3},
    "temperature": {"K": 1.0, "degC": 1.0, "degF": 5.0 / 9.0},
    "area": {"m2": 1.0, "mm2": 1.0e-6, "cm2": 1.0e-4},
    "displacement": {"m3/rad": 1.0, "cm3/rev": 1.0e-6 / REVOLUTION},
    "fraction": {"fraction": 1.0, "percent": 1.0e-2},
}
#: Zero of a unit in SI, where that is not zero.
_OFFSETS = {"degC": ZERO_CELSIUS, "degF": ZERO_CELSIUS - 32.0 * 5.0 / 9.0}
UNITS = {
    name: Unit(name, quantity, scale, _OFFSETS.get(name, 0.0))
    for quantity, scales in _SCALES.items()
    for name, scale in scales.items()
}

# Other spellings found in headers, folded to lower case without blanks, dots and middle dots.
_SPELLINGS = {
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "µs": "us", "μs": "us", "usec": "us",
    "r/min": "rpm", "1/min": "rpm", "min-1": "rpm", "rev/min": "rpm", "u/min": "rpm", "°/s": "deg/s", "°": "deg",
    "µm": "um", "μm": "um", "micron": "um",
    "lpm": "l/min", "lmin": "l/min", "gpm": "GPM", "usgpm": "GPM", "gal/min": "GPM", "m^3/s": "m3/s", "m³/s": "m3/s",
    "m^3/h": "m3/h",
    "nm": "N m", "n*m": "N m", "knm": "kN m", "°c": "degC", "celsius": "degC", "°f": "degF", "kelvin": "K",
    "m^2": "m2", "m²": "m2", "mm^2": "mm2", "mm²": "mm2", "cm^2": "cm2", "cm²": "cm2",
    "m^3/rad": "m3/rad", "cc/rev": "cm3/rev", "ml/rev": "cm3/rev",
    "%": "percent", "1": "fraction", "-": "fraction", "": "fraction", "volt": "V", "amp": "A", "ampere": "A",
}  # fmt: skip


def unit(name: str) -> Unit:
    """The unit called `name`, in any of the usual spellings; `InputError` for an unknown one.

    Case is significant only where it separates two units (mPa is not understood as MPa).
    """
    if name in UNITS:
        return UNITS[name]
    folded = name.strip().lower().replace(" ", "").replace("·", "").replace(".", "")
    if folded in _SPELLINGS:
        return UNITS[_SPELLINGS[folded]]
    same = [known for known in UNITS if known.lower().replace(" ", "") == folded]
    if len(same) == 1 and name[:2] != "mP":
        return UNITS[same[0]]
    raise InputError(f"unknown unit {name!r}; {suggestion(name, UNITS)} (of {', '.join(UNITS)})")


def to_si(value: Any, name: str) -> Any:
    """`value` (a number or an array) given in unit `name`, in SI."""
    known = unit(name)
    return value * known.scale + known.offset if known.offset else value * known.scale


def from_si(value: Any, name: str) -> Any:
    """`value` (a number or an array) given in SI, in unit `name`."""
    known = unit(name)
    return (value - known.offset) / known.scale if known.offset else value / known.scale


def with_unit(value: float, name: str, digits: int = 6) -> str:
    """A value as text with its unit; the unit "1" is not written."""
    return f"{value:.{digits}g} {'' if name == '1' else name}".rstrip()
