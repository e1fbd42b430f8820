"""modelDescription.xml: variables with units, bounds and what the catalogue says of them, for FMI 2.0 and 3.0.

Names: inputs `command_1` (V) and `load_1` (N m), outputs `speed_1`, `pressure_1` ..., parameters `channel_1.Kq`,
`channel_1.dead_zone.overlap_positive`, and `rig.supply_droop.relative_drop` where both channels share one. All SI.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as xml

from hydro_env.export.plant_source import PlantSource
from hydro_env.plant.catalogue import CATALOGUE
from hydro_env.plant.catalogue.effect import parameter_of
from hydro_env.plant.kernel.layout import with_shared
from hydro_env.units import BAR, DEGREE, LPM, MILLIMETRE, RPM

#: Value references: time, both commands, both loads, then all cells of the plant's memory.
TIME_REFERENCE, COMMAND_REFERENCE, LOAD_REFERENCE, FIRST_REFERENCE = 0, 1, 3, 16
#: Communication step that is proposed, s.
STEP = 0.01

_SIGNALS = {
    "current": ("A", "current of the coil"), "spool": ("m", "position of the spool"),
    "spool_speed": ("m/s", "speed of the spool"),
    "bristle": ("m", "deflection of the bristles of the spool's friction"),
    "pressure": ("Pa", "pressure difference over the motor"), "speed": ("rad/s", "speed of the shaft"),
    "angle": ("rad", "angle of the shaft since the start"), "flow": ("m3/s", "flow through the valve"),
    "measured_speed": ("rad/s", "speed of the shaft as its sensor shows it, without noise"),
    "diverged": ("1", "1 once the channel has diverged numerically and was put to rest"),
}  # fmt: skip

#: Units of the catalogue: exponents of kg, m, s, A, rad, and a factor.
_KNOWN_UNITS: dict[str, tuple[dict[str, int], float]] = {
    "1": ({}, 1.0),
    **{name: ({name: 1}, 1.0) for name in ("kg", "m", "s", "A", "K", "rad")},
    "N": ({"kg": 1, "m": 1, "s": -2}, 1.0),
    "Pa": ({"kg": 1, "m": -1, "s": -2}, 1.0),
    "MPa": ({"kg": 1, "m": -1, "s": -2}, 1e6),
    "V": ({"kg": 1, "m": 2, "s": -3, "A": -1}, 1.0),
    "Ohm": ({"kg": 1, "m": 2, "s": -3, "A": -2}, 1.0),
    "H": ({"kg": 1, "m": 2, "s": -2, "A": -2}, 1.0),
}
#: By SI unit: the unit that people read, and how many of it one SI unit is.
DISPLAYED = {
    "rad/s": ("rpm", 1.0 / RPM), "Pa": ("bar", 1.0 / BAR), "m3/s": ("l/min", 1.0 / LPM), "m": ("mm", 1.0 / MILLIMETRE),
    "rad": ("deg", 1.0 / DEGREE), "A": ("mA", 1e3),
}  # fmt: skip


@dataclass(frozen=True)
class Variable:
    """A variable of the unit. `causality`: independent, input, output or parameter; `bounds` only where finite."""

    name: str
    reference: int
    causality: str
    unit: str
    text: str
    start: float | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)


def variables(source: PlantSource) -> Iterator[Variable]:
    """All variables, in the order of the description."""
    yield Variable("time", TIME_REFERENCE, "independent", "s", "time")
    for c in (1, 2):
        text = f"command of valve {c}, held over a step and limited to +-u_rated"
        yield Variable(f"command_{c}", COMMAND_REFERENCE + c - 1, "input", "V", text, 0.0)
    for c in (1, 2):
        text = f"torque of the load on the shaft of motor {c}, held over a step"
        yield Variable(f"load_{c}", LOAD_REFERENCE + c - 1, "input", "N m", text, 0.0)
    effects = {effect.name: effect for effect in with_shared(CATALOGUE.values())}
    for name in source.outputs:
        unit, text = _SIGNALS.get(name, ("", ""))
        shown = name.replace("__", ".", 1)
        if not text:
            text = f"state of the effect {effects[name.split('__')[0]].title}"
        for c in (1, 2):
            place = FIRST_REFERENCE + source.places[name] + c - 1
            yield Variable(f"{shown}_{c}", place, "output", unit, f"{text}, channel {c}")
    for name in source.parameters:
        yield from _parameter(source, name)


def _parameter(source: PlantSource, name: str) -> Iterator[Variable]:
    """A parameter, once for each channel or once for the rig."""
    p = parameter_of(name)
    effect = f"{CATALOGUE[name.split('.')[0]].title}: " if "." in name else ""
    for c in (0,) if name in source.shared else (0, 1):
        start = source.model.value(name, c)
        least, greatest = source.parameters[name]
        bounds = min(least, p.nominal, start), max(greatest, p.nominal, start)
        place = FIRST_REFERENCE + source.places[name] + c
        owner = "rig" if name in source.shared else f"channel_{c + 1}"
        text = f"{effect}{p.title} ({p.source})" if p.source else f"{effect}{p.title}"
        yield Variable(f"{owner}.{name}", place, "parameter", p.unit, text, start, bounds)


def model_description(source: PlantSource, version: int, identifier: str, token: str, tool: str) -> bytes:
    """The XML of FMI 2.0 or 3.0 (`version` 2 or 3)."""
    root = xml.Element(
        "fmiModelDescription", fmiVersion=f"{version}.0", modelName=source.model.name,
        description="Two hydraulic motors, each behind its own proportional valve", generationTool=tool,
        variableNamingConvention="structured", license="MIT",
    )  # fmt: skip
    root.set("guid" if version == 2 else "instantiationToken", token)
    state = "FMUstate" if version == 2 else "FMUState"
    able = ("canHandleVariableCommunicationStepSize", f"canSerialize{state}", f"canGetAndSet{state}")
    interface = xml.SubElement(
        root, "CoSimulation", {"modelIdentifier": identifier, **dict.fromkeys(able, "true")}
    )
    if version == 2:
        files = xml.SubElement(interface, "SourceFiles")
        for name in ("plant.c", "fmi2.c"):
            xml.SubElement(files, "File", name=name)
    # In FMI 2.0 the time may be left out.
    every = [v for v in variables(source) if version == 3 or v.causality != "independent"]
    _units(xml.SubElement(root, "UnitDefinitions"), every)
    reason = {"name": "logStatusError", "description": "why a call was refused"}
    xml.SubElement(xml.SubElement(root, "LogCategories"), "Category", reason)
    xml.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(STEP))
    listed = xml.SubElement(root, "ModelVariables")
    for each in every:
        _variable(listed, each, version)
    _structure(xml.SubElement(root, "ModelStructure"), every, version)
    xml.indent(root)
    return xml.tostring(root, encoding="UTF-8", xml_declaration=True)


def base_unit(unit: str) -> tuple[dict[str, int], float]:
    """Exponents of the base units of a catalogue unit ("m3/(s Pa)"), and the factor. ValueError for a unit that is not known."""
    above, _, below = unit.partition("/")
    exponents: Counter[str] = Counter()
    factor = 1.0
    for side, sign in ((above, 1), (below.strip("()"), -1)):
        for word in side.split():
            found = re.fullmatch(r"(1|[A-Za-z]+)(\d*)", word)
            if found is None or found[1] not in _KNOWN_UNITS:
                raise ValueError(f"unit {unit!r}: {word!r} is not known")
            power = sign * int(found[2] or 1)
            own, scale = _KNOWN_UNITS[found[1]]
            factor *= scale**power
            for name, exponent in own.items():
                exponents[name] += power * exponent
    return {name: exponent for name, exponent in exponents.items() if exponent}, factor


def _units(parent: xml.Element, every: list[Variable]) -> None:
    for unit in dict.fromkeys(each.unit for each in every if each.unit):
        exponents, factor = base_unit(unit)
        given: dict[str, str] = {name: str(power) for name, power in exponents.items()}
        if factor != 1.0:
            given["factor"] = repr(factor)
        element = xml.SubElement(parent, "Unit", name=unit)
        xml.SubElement(element, "BaseUnit", given)
        if unit in DISPLAYED:
            shown, per = DISPLAYED[unit]
            xml.SubElement(element, "DisplayUnit", name=shown, factor=repr(per))


def _number(value: float) -> str:
    return "INF" if value == math.inf else "-INF" if value == -math.inf else repr(float(value))


def _variable(parent: xml.Element, each: Variable, version: int) -> None:
    variability = "tunable" if each.causality == "parameter" else "continuous"
    named = {
        "name": each.name, "valueReference": str(each.reference), "description": each.text, "causality": each.causality,
        "variability": variability,
    }  # fmt: skip
    if initial := {"output": "calculated", "parameter": "exact"}.get(each.causality):
        named["initial"] = initial
    typed: dict[str, Any] = {"unit": each.unit} if each.unit else {}
    if each.unit in DISPLAYED:
        typed["displayUnit"] = DISPLAYED[each.unit][0]
    typed |= {key: _number(v) for key, v in zip(("min", "max"), each.bounds, strict=True) if math.isfinite(v)}
    if each.start is not None:
        typed["start"] = _number(each.start)
    if version == 2:
        xml.SubElement(xml.SubElement(parent, "ScalarVariable", named), "Real", **typed)
    else:
        xml.SubElement(parent, "Float64", {**named, **typed})


def _structure(parent: xml.Element, every: list[Variable], version: int) -> None:
    """What outputs depend on: at an instant on no input, as everything passes a coil or a shaft first."""
    outputs = [(n, each) for n, each in enumerate(every, start=1) if each.causality == "output"]
    for tag, more in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
        if version == 2:
            listed = xml.SubElement(parent, f"{tag}s")
            for n, _ in outputs:
                xml.SubElement(listed, "Unknown", {"index": str(n), **more})
        else:
            for _, each in outputs:
                xml.SubElement(parent, tag, {"valueReference": str(each.reference), **more})
