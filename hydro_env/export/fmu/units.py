"""Units of the catalogue ("m3/(s Pa)") as exponents of the SI base units, and the units in which people read them."""

import re
from collections import Counter

from hydro_env.units import BAR, DEGREE, LPM, MILLIMETRE, RPM

#: Exponents of kg, m, s, A, rad, and a factor.
_KNOWN: dict[str, tuple[dict[str, int], float]] = {
    "1": ({}, 1.0),
    **{name: ({name: 1}, 1.0) for name in ("kg", "m", "s", "A", "K", "rad")},
    "N": ({"kg": 1, "m": 1, "s": -2}, 1.0),
    "Pa": ({"kg": 1, "m": -1, "s": -2}, 1.0),
    "MPa": ({"kg": 1, "m": -1, "s": -2}, 1e6),
    "V": ({"kg": 1, "m": 2, "s": -3, "A": -1}, 1.0),
    "Ohm": ({"kg": 1, "m": 2, "s": -3, "A": -2}, 1.0),
    "H": ({"kg": 1, "m": 2, "s": -2, "A": -2}, 1.0),
}

#: By SI unit: the unit that is shown, and how many of it one SI unit is.
DISPLAYED = {
    "rad/s": ("rpm", 1.0 / RPM), "Pa": ("bar", 1.0 / BAR), "m3/s": ("l/min", 1.0 / LPM), "m": ("mm", 1.0 / MILLIMETRE),
    "rad": ("deg", 1.0 / DEGREE), "A": ("mA", 1e3),
}  # fmt: skip


def base_unit(unit: str) -> tuple[dict[str, int], float]:
    """Exponents of the base units that are not zero, and the factor. ValueError for a unit that is not known."""
    above, _, below = unit.partition("/")
    exponents: Counter[str] = Counter()
    factor = 1.0
    for side, sign in ((above, 1), (below.strip("()"), -1)):
        for word in side.split():
            found = re.fullmatch(r"(1|[A-Za-z]+)(\d*)", word)
            if found is None or found[1] not in _KNOWN:
                raise ValueError(f"unit {unit!r}: {word!r} is not known")
            power = sign * int(found[2] or 1)
            own, scale = _KNOWN[found[1]]
            factor *= scale**power
            for name, exponent in own.items():
                exponents[name] += power * exponent
    return {name: exponent for name, exponent in exponents.items() if exponent}, factor
