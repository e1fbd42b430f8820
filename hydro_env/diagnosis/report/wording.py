"""The words and units of a report: names that a fluid-power engineer uses, numbers in the units of the bench.

diagnosis.json stays in the catalogue's names and in SI; everything that a person reads goes through here.
"""

import math
from collections.abc import Sequence

from ...plant import CATALOGUE, PARAMETERS, PlantModel
from ...plant.parameters import SPOOL_FORCE, SPOOL_TRAVEL
from ...units import BAR, DEGREE, LPM, MICROMETRE, MILLIAMPERE, MILLIMETRE, MILLISECOND, RPM
from ..models.base import RigModel
from ..stages.values import Interval

#: Equations of a place.
EQUATIONS = {
    "coil": "the coil (current from the command)", "valve_flow": "the valve (flow from command and pressure)",
    "shaft": "the shaft (speed from pressure and load)", "lines": "the lines (mean of both line pressures)",
    "valve and motor": "valve and motor together (no pressure logged)",
}  # fmt: skip
#: Signals of the logs.
SIGNALS = {
    "speed": "speed", "current": "coil current", "pressure": "pressure difference", "spool": "spool position", "flow": "flow",
    "mean_line_pressure": "mean line pressure", "motor_pressure": "pressure difference at the motor",
}  # fmt: skip
#: Units that the keys of diagnosis.json spell otherwise.
KEY_UNITS = {"mm_per_s": "mm/s", "lpm": "l/min"}


def plain(name: str) -> str:
    """A name of the catalogue without its underscores."""
    return name.replace("_", " ")


def title(effect: str) -> str:
    """An effect as one would say it: "spool overlap (dead zone)"."""
    return CATALOGUE[effect].title if effect in CATALOGUE else plain(effect)


def where(channel: str) -> str:
    """ "1", "2", "both" or "rig" in words."""
    return {"rig": "the whole rig", "both": "both channels"}.get(channel, f"channel {channel}")


def listed(words: Sequence[str]) -> str:
    """ "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def unit_of(unit: str, size: float) -> tuple[str, float]:
    """The unit in which a value (SI, of magnitude `size`) reads best, and its size in SI."""
    for_unit = {
        "m": ("mm", MILLIMETRE) if size >= 1e-3 else ("um", MICROMETRE),
        "s": ("s", 1.0) if size >= 0.5 else ("ms", MILLISECOND),
        "A": ("A", 1.0) if size >= 0.1 else ("mA", MILLIAMPERE), "Pa": ("bar", BAR), "rad/s": ("rpm", RPM),
        "m/s": ("mm/s", MILLIMETRE), "rad": ("deg", DEGREE),
    }  # fmt: skip
    return for_unit.get(unit, ("" if unit == "1" else unit, 1.0))


def number(value: float, digits: int = 3) -> str:
    """This many digits, without an exponent where that reads well."""
    if not math.isfinite(value):
        return "none"
    if value == 0.0:
        return "0"
    after = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{value:.{max(after, 0)}f}" if -3 <= math.log10(abs(value)) < 6 else f"{value:.{digits}g}"


def interval(entry: Interval) -> str:
    """ "47.0 um (40.2 to 53.7)", with as many digits as it takes to see the interval."""
    values = [entry.value, entry.low, entry.high]
    sizes = [abs(v) for v in values if math.isfinite(v)]
    unit, size = unit_of(entry.unit, max(sizes, default=0.0))
    for digits in (3, 4, 5):
        value, low, high = (number(v / size, digits) for v in values)
        if low != high:
            break
    return f"{value}{' ' if unit else ''}{unit} ({low} to {high})"


def known(symbol: str, c: int, value: float, rig: RigModel) -> str:
    """A base parameter of channel c in words; of a flow gain also the flow that full command would give."""
    effect, _, own = symbol.rpartition(".")
    if effect:
        return f"{title(effect)}: {CATALOGUE[effect].parameter(own).title}"
    text = {**PARAMETERS, **rig.own}[symbol].title
    if symbol == "Kq":
        alpha, rated, resistance, spring = (rig.model.value(n, c) for n in ("alpha", "u_rated", "R", "k"))
        stroke = alpha * rated / (resistance * spring)
        text += f" ({number(value * stroke / LPM)} l/min at full command)"
    return text


def of_command(effect: str, name: str, value: float, model: PlantModel, channel: int) -> str:
    """A spool position or a force on the spool, a parameter of an effect, in volts and as a share of full command, or nothing.

    `model` is the calibrated one: logs without spool and current fix such shares, not the travel in metres."""
    described = CATALOGUE[effect].parameter(name)
    rated = model.value("u_rated", channel)
    force = model.value("alpha", channel) * rated / model.value("R", channel)
    if described.unit == "m" and described.scaling == SPOOL_TRAVEL:
        share = value * model.value("k", channel) / force
    elif described.unit == "N" and described.scaling == SPOOL_FORCE:
        share = value / force
    elif described.unit == "V":
        return f"{100.0 * value / rated:.3g} % of full command"
    else:
        return ""
    return f"{number(share * rated)} V, {100.0 * share:.3g} % of full command"
