"""A model of the rig: which values its parameters have and which effects act, as data.

Models are YAML files or presets of the package:

    schema: hydro_env/model/1
    name: my rig
    base: paper                       # optional: start from a preset
    substep: 1.0e-4                   # optional: longest step of the integrator, s
    both: {J: 0.0031}                 # base parameters of both channels
    channel_1: {Kq: 0.476}            # of one channel
    channel_2: {valve: valve_2}       # the valve of a preset or model file: its coil, spool and edges, with their effects
    effects:
      dead_zone:
        channel_1: {overlap_positive: 7.0e-5, overlap_negative: 7.0e-5}
      supply_droop:
        rig: {relative_drop: 0.3}     # `rig` (or `both`) stands for both channels
    sources: {J: drawing, dead_zone: valve bench}   # optional: where values are from, one by one or by effect

A valve is put in before the values of the same file, which may then change it. What belongs to a valve are the base
parameters `VALVE_PARAMETERS` and the effects of the ports `VALVE_PORTS`, as the named model has them on its channel 1.

Values are SI. Anything unknown, and a value that no such component has (`Parameter.possible`), is refused with a line that
names the file and the key. A base parameter beyond its plausible range gives a warning, unless `sources` says where it is from.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from ..errors import InputError, InputWarning, shown, suggestion
from ..files import write_text
from ..reading import parse_yaml, read_yaml
from .catalogue import CATALOGUE
from .parameters import PARAMETERS, Parameter
from .stiffness import LEAST_FRICTION, SPOOL, greatest_force, parts_wanted

__all__ = [
    "SUBSTEP", "VALVE_PARAMETERS", "VALVE_PORTS", "PlantModel", "load_model", "parameter_of", "preset_names",
    "preset_summary", "sources_of", "values_set_by",
]  # fmt: skip

SCHEMA = "hydro_env/model/1"
#: Longest substep of the integrator, s, for a model that says nothing else: every single effect at its strongest, and every
#: preset that does not ask for a shorter one, stays within 0.1 rpm of the reference.
SUBSTEP = 125e-6
#: Base parameters that belong to a valve rather than to motor and line.
VALVE_PARAMETERS = (
    "m", "R", "L", "alpha", "k", "C", "Kq", "Fc", "Fs", "vs", "s0", "s1", "s2", "x_max", "k_stop", "v_stop", "u_rated",
)  # fmt: skip
#: Ports whose effects belong to a valve. Driver, supply and orifice law (its supply pressure) are the rig's.
VALVE_PORTS = ("coil", "force", "opening")
#: A stiff channel takes a substep in at most 64 parts, of which the last third is a reserve.
_MOST_PARTS = 40.0
_CHANNELS = ("both", "channel_1", "channel_2")
#: Files that may build on each other: a model on its base or valve, that one on its own, ...
MOST_FILES = 5
_SIDES = {"channel_1": (0,), "channel_2": (1,), "both": (0, 1), "rig": (0, 1)}


def parameter_of(name: str) -> Parameter:
    """The description of "Kq" or "dead_zone.overlap_positive". InputError for an unknown name."""
    if "." in name:
        effect, own = name.split(".", 1)
        if effect not in CATALOGUE:
            raise InputError(f"unknown effect {effect!r}: {suggestion(effect, CATALOGUE)}")
        known = {p.name: p for p in CATALOGUE[effect].parameters}
        if own not in known:
            raise InputError(f"effect {effect!r} has no parameter {own!r}: {suggestion(own, known)}")
        return known[own]
    if name not in PARAMETERS:
        raise InputError(f"unknown parameter {name!r}: {suggestion(name, PARAMETERS)}")
    return PARAMETERS[name]


@dataclass(frozen=True)
class PlantModel:
    """Values of a rig. `values` maps "Kq" or "dead_zone.overlap_positive" to a pair (channel 1, channel 2), SI.

    Only what differs from the nominal or neutral value need be there. An effect acts if it is in `effects`; it may be
    there with neutral values (then it may be varied later). `substep` is the longest step of the integrator in s that
    the model is to be simulated with; a stiff channel takes it in parts. InputError for unknown names, values that are no
    numbers, and those outside of what is simulated correctly (`Parameter.possible`, `stiffness`).
    """

    name: str = "nominal"
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    declared: tuple[str, ...] = ()
    substep: float = SUBSTEP

    def __post_init__(self) -> None:
        if not 1e-7 <= self.substep <= 1e-3:
            raise InputError(f"model {self.name!r}: substep is {self.substep!r}, expected 1e-7 to 1e-3 s")
        clean: dict[str, tuple[float, float]] = {}
        for name, pair in self.values.items():
            parameter_of(name)
            first, second = float(pair[0]), float(pair[1])
            if math.isnan(first) or math.isnan(second):
                raise InputError(f"model {self.name!r}: {name} is not a number")
            for value in (first, second):
                if wrong := _out_of_range(value, parameter_of(name)):
                    raise InputError(f"model {self.name!r}: {name}: {wrong}")
            clean[name] = (first, second)
        for name in self.declared:
            if name not in CATALOGUE:
                raise InputError(
                    f"model {self.name!r}: unknown effect {name!r}: {suggestion(name, CATALOGUE)}"
                )
        named = {n.split(".", 1)[0] for n in clean if "." in n} | set(self.declared)
        object.__setattr__(self, "values", clean)
        object.__setattr__(self, "declared", tuple(n for n in CATALOGUE if n in named))
        for channel in (0, 1):
            _check_spool(self, channel, f"model {self.name!r}")

    @property
    def channels(self) -> tuple[dict[str, float], dict[str, float]]:
        """All base parameters of channel 1 and of channel 2, by symbol."""
        return tuple({n: self.value(n, c) for n in PARAMETERS} for c in (0, 1))  # type: ignore[return-value]

    @property
    def effects(self) -> dict[str, tuple[dict[str, float], dict[str, float]]]:
        """The effects that act, each with the parameters of channel 1 and of channel 2."""

        def of(name: str, channel: int) -> dict[str, float]:
            return {p.name: self.value(f"{name}.{p.name}", channel) for p in CATALOGUE[name].parameters}

        return {name: (of(name, 0), of(name, 1)) for name in self.declared}

    def value(self, name: str, channel: int) -> float:
        """The value of "Kq" or "dead_zone.overlap_positive" on channel 0 or 1, SI."""
        pair = self.values.get(name)
        return parameter_of(name).nominal if pair is None else pair[channel]

    def pair(self, name: str) -> tuple[float, float]:
        """The values of both channels."""
        return self.value(name, 0), self.value(name, 1)

    def with_values(self, values: Mapping[str, Any], name: str | None = None) -> PlantModel:
        """A new model with some values changed; a single number stands for both channels."""
        changed = dict(self.values)
        for key, value in values.items():
            pair = tuple(value) if hasattr(value, "__len__") else (value, value)
            if len(pair) != 2:
                raise InputError(f"{key}: one number, or one for each of the two channels, not {len(pair)}")
            changed[key] = (float(pair[0]), float(pair[1]))
        return replace(self, values=changed, name=self.name if name is None else name)

    def without(self, effect: str) -> PlantModel:
        """A new model in which this effect does not act."""
        kept = {n: v for n, v in self.values.items() if n.split(".", 1)[0] != effect or "." not in n}
        return replace(self, values=kept, declared=tuple(n for n in self.declared if n != effect))

    def to_dict(self) -> dict[str, Any]:
        """The content of the model file; `load_model` of it gives an equal model."""
        data: dict[str, Any] = {"schema": SCHEMA, "name": self.name}
        if self.substep != SUBSTEP:
            data["substep"] = self.substep
        effects: dict[str, Any] = {name: {} for name in self.declared}
        for name, pair in self.values.items():
            effect, _, own = name.rpartition(".")
            place = effects[effect] if effect else data
            whole = "rig" if effect and CATALOGUE[effect].scope == "rig" else "both"
            sides = {whole: pair[0]} if pair[0] == pair[1] else {"channel_1": pair[0], "channel_2": pair[1]}
            for side, value in sides.items():
                place.setdefault(side, {})[own] = value
        if effects:
            data["effects"] = effects
        return data

    def to_yaml(self, path: str | Path, source: str = "") -> None:
        """Writes the model file (atomically); `source` says where its values are from, if they have one source."""
        data = self.to_dict()
        if source:
            data["sources"] = dict.fromkeys(
                (*(n for n in self.values if "." not in n), *self.declared), source
            )
        write_text(Path(path), yaml.safe_dump(_exact(data), sort_keys=False))


class _Float(float):
    """A float that YAML reads back as one: `1e-05` would come back as text."""


def _represent(dumper: yaml.SafeDumper, value: _Float) -> yaml.Node:
    if math.isinf(value):
        text = ".inf" if value > 0 else "-.inf"
    else:
        text = repr(float(value))
        if "e" in text and "." not in text:
            text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


yaml.SafeDumper.add_representer(_Float, _represent)


def _exact(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _exact(value) for key, value in data.items()}
    return _Float(data) if isinstance(data, float) else data


# --- reading ----------------------------------------------------------------------------------------------------------
_FRICTION = ("Fc", "Fs")
#: Room for the rounding of a value that stands at an end.
_AT_END = 1e-9


def _out_of_range(value: float, p: Parameter) -> str:
    """What is wrong with a value that is not simulated correctly or that no component has, "" if nothing is."""
    low, high = p.possible
    room = _AT_END * max(abs(end) for end in (low, high) if math.isfinite(end))
    absent = p.name in _FRICTION and value == 0.0
    if value == p.neutral or absent or low - room <= value <= high + room:
        return ""
    ends = f"{low:g} to {_in_unit(high, p)}" if high < math.inf else f"{_in_unit(low, p)} or more"
    none = ", or 0 for none" if p.name in _FRICTION else ""
    return f"{_in_unit(value, p)} is out of range; {p.title} is {ends}{none}"


def _check_spool(model: PlantModel, channel: int, where: str) -> None:
    """InputError for a spool that no substep resolves or no stop holds: its friction, mass or stop is too small."""
    values = {name: model.value(name, channel) for name in SPOOL}
    for effect in map(CATALOGUE.__getitem__, model.declared):
        for base, own in effect.adds_to.items():
            values[base] += model.value(f"{effect.name}.{own}", channel)
    force = greatest_force(*(values[name] for name in ("alpha", "R", "k", "x_max", "u_rated")))
    least = force / values["x_max"] - 2.0 * values["k"]  # the stop yields by the stroke
    if values["k_stop"] < least:
        raise InputError(
            f"{where}: channel {channel + 1}: k_stop is {values['k_stop']:g}; against {force:.3g} N of the coil {least:.3g} N/m"
            " or more can be simulated"
        )
    friction = [values[name] for name in _FRICTION]
    if max(friction) <= _AT_END:
        return
    if min(friction) < (1.0 - _AT_END) * LEAST_FRICTION:
        raise InputError(
            f"{where}: channel {channel + 1} has {friction[0]:g} N of Coulomb and {friction[1]:g} N of static friction in all;"
            f" {LEAST_FRICTION:g} N or more can be simulated, or Fc and Fs 0 for none"
        )

    def parts(mass: float) -> float:
        return parts_wanted(model.substep, {**values, "m": mass})

    if parts(values["m"]) > _MOST_PARTS:
        low, high = values["m"], 1e6 * values["m"]
        for _ in range(60):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if parts(middle) > _MOST_PARTS else (low, middle)
        raise InputError(
            f"{where}: channel {channel + 1}: m is {values['m']:g}; with these Fc, Fs, s0, s1 and k_stop {high:.3g} kg or more"
            " can be simulated"
        )


def _number(value: object, where: str) -> float:
    try:
        number = (
            math.nan if isinstance(value, bool) or not isinstance(value, (int, float, str)) else float(value)
        )
    except (ValueError, OverflowError):
        number = math.nan
    if math.isnan(number):
        raise InputError(f"{where}: {shown(value)} is no number")
    return number


def _mapping(value: object, where: str) -> dict[Any, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: expected `name: value` lines, found {shown(value)}")
    return dict(value)


def _in_unit(value: float, parameter: Parameter) -> str:
    return f"{value:g}" if parameter.unit == "1" else f"{value:g} {parameter.unit}"


@dataclass
class _Draft:
    """A model while its file is read: the values by name, one for each channel, and the effects that were named; by the name
    of a value what is unusual about it."""

    values: dict[str, list[float]]
    declared: list[str]
    unusual: dict[str, str] = field(default_factory=dict)

    def take(self, name: str, side: str, given: object, where: str) -> None:
        """Sets a value that the file gives on one side. InputError if it is no number, or none that a component can have."""
        value, p = _number(given, where), parameter_of(name)
        if wrong := _out_of_range(value, p):
            raise InputError(f"{where}: {wrong}")
        if (
            value != 0.0
            and not p.low <= value <= p.high
            and name in PARAMETERS
            and value not in _shipped(name)
        ):
            self.unusual[name] = f"{name} {value:g} (usual {p.low:g} to {_in_unit(p.high, p)})"
        self.put(name, side, value)

    def put(self, name: str, side: str, value: float) -> None:
        """Sets a value on one side; the other channel keeps its own, or gets the nominal one."""
        for channel in _SIDES[side]:
            self.values.setdefault(name, [parameter_of(name).nominal] * 2)[channel] = value

    def put_valve(self, valve: PlantModel, side: str) -> None:
        """Gives a side the valve of another model's channel 1; effects that it lacks become neutral there."""
        self.declared += [name for name in valve.declared if CATALOGUE[name].port in VALVE_PORTS]
        for name in dict.fromkeys((*self.values, *valve.values)):
            if _of_valve(name):
                self.put(name, side, valve.value(name, 0))


def _of_valve(name: str) -> bool:
    """Whether a value belongs to the valve."""
    effect, _, _ = name.rpartition(".")
    return CATALOGUE[effect].port in VALVE_PORTS if effect else name in VALVE_PARAMETERS


def _from_dict(data: object, where: str, above: tuple[str, ...] = ()) -> PlantModel:
    """The model of a file's content. `above` are the files that build on this one, which it may not build on in turn."""
    data = _mapping(data, where)
    known = {"schema", "name", "base", "substep", *_CHANNELS, "effects", "sources"}
    for key in data:
        if key not in known:
            raise InputError(f"{where}: unknown key {shown(key)}: {suggestion(key, known)}")
    if data.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is {shown(data.get('schema'))}, expected {SCHEMA!r}")
    if not isinstance(data.get("name", ""), str):
        raise InputError(f"{where}: name is {shown(data['name'])}, expected text")
    above = (*above, where)
    base = _built_on(data["base"], f"{where}: base", above) if "base" in data else PlantModel()
    draft = _Draft({name: list(pair) for name, pair in base.values.items()}, list(base.declared))
    _read_channels(data, draft, where, above)
    _read_effects(_mapping(data.get("effects", {}), f"{where}: effects"), draft, where)
    sources = _mapping(data.get("sources", {}), f"{where}: sources")
    _check_sources(sources, where)
    if unusual := [text for name, text in draft.unusual.items() if name not in sources]:
        told = f"{where}: unusual for such a rig: {', '.join(unusual)}; if that is meant, say under `sources` where it is from"
        warnings.warn(told, InputWarning, stacklevel=2)
    try:
        return PlantModel(
            name=str(data.get("name", base.name)),
            values={name: (pair[0], pair[1]) for name, pair in draft.values.items()},
            declared=tuple(draft.declared),
            substep=_number(data.get("substep", base.substep), f"{where}: substep"),
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _read_channels(data: Mapping[str, Any], draft: _Draft, where: str, above: tuple[str, ...]) -> None:
    """Valves first, then base parameters, which may change those of the valve."""
    for side in _CHANNELS:
        if "valve" in (own := _mapping(data.get(side, {}), f"{where}: {side}")):
            draft.put_valve(_built_on(own["valve"], f"{where}: {side}.valve", above), side)
    for side in _CHANNELS:
        for name, value in data.get(side, {}).items():
            if name == "valve":
                continue
            if name not in PARAMETERS:
                raise InputError(
                    f"{where}: {side}: unknown parameter {shown(name)}: {suggestion(name, PARAMETERS)}"
                )
            draft.take(name, side, value, f"{where}: {side}.{name}")


def _read_effects(effects: Mapping[Any, Any], draft: _Draft, where: str) -> None:
    for name, sides in effects.items():
        if name not in CATALOGUE:
            raise InputError(f"{where}: effects: unknown effect {shown(name)}: {suggestion(name, CATALOGUE)}")
        draft.declared.append(name)
        known = {p.name for p in CATALOGUE[name].parameters}
        for side, parameters in _mapping(sides, f"{where}: effects.{name}").items():
            if side not in _SIDES:
                raise InputError(
                    f"{where}: effects.{name}: unknown key {shown(side)}: {suggestion(side, _SIDES)}"
                )
            at = f"{where}: effects.{name}.{side}"
            for own, value in _mapping(parameters, at).items():
                if own not in known:
                    raise InputError(f"{at}: unknown parameter {shown(own)}: {suggestion(own, known)}")
                draft.take(f"{name}.{own}", side, value, f"{at}.{own}")


def _check_sources(sources: Mapping[Any, Any], where: str) -> None:
    for name, text in sources.items():
        if name not in CATALOGUE:
            try:
                parameter_of(str(name))
            except InputError as error:
                raise InputError(f"{where}: sources: {error}") from None
        if not isinstance(text, str):
            raise InputError(f"{where}: sources.{name}: expected text, found {shown(text)}")


def _built_on(source: object, where: str, above: tuple[str, ...]) -> PlantModel:
    """The preset or model file that another one names as its base or valve."""
    if not isinstance(source, str):
        raise InputError(f"{where}: expected the name of a preset or of a model file, found {shown(source)}")
    try:
        if source in preset_names():
            return _preset(source)
        data, own = _data(source)
        if own in above:
            raise InputError("a model cannot build on itself")
        if len(above) == MOST_FILES:
            raise InputError(f"at most {MOST_FILES} files build on each other")
        return _from_dict(data, own, above)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


# --- where values are from --------------------------------------------------------------------------------------------
def sources_of(source: str | Path | Mapping[str, Any]) -> dict[tuple[str, int], str]:
    """Where the values of a model come from, by name of the value and channel (0, 1): for all of `values`.

    What a file gives has its text under `sources`; what it takes from its base or a valve has theirs. `source` and errors
    as in `load_model`.
    """
    data, where = _data(source)
    model = _from_dict(data, where)
    given = _given(data)
    texts = data.get("sources", {})
    base = sources_of(data["base"]) if "base" in data else {}
    valves: dict[int, Any] = {}
    for side in _CHANNELS:
        for channel in _SIDES[side]:
            valves[channel] = data.get(side, {}).get("valve", valves.get(channel))
    found = {}
    for name in model.values:
        effect = name.split(".", 1)[0]
        for channel in (0, 1):
            text = base.get((name, channel))
            if _of_valve(name) and valves[channel] is not None:
                text = sources_of(valves[channel]).get((name, 0))
            if (name, channel) in given:
                text = texts.get(name, texts.get(effect, f"{where}, which does not say"))
            if text is None:
                text = "neutral" if "." in name else PARAMETERS[name].source
            found[name, channel] = text
    return found


def values_set_by(source: Any) -> frozenset[str]:
    """Names of the values that a plant file, or the content of one, sets itself; those of a valve that it names count, those
    of its base do not. None for a preset or a model. Errors as in `load_model`."""
    if not isinstance(source, str | Path | Mapping) or str(source) in preset_names():
        return frozenset()
    data, where = _data(source)
    _from_dict(data, where)
    valves = [data[side]["valve"] for side in _CHANNELS if "valve" in data.get(side, {})]
    of_valves = {name for valve in valves for name in load_model(valve).values if _of_valve(name)}
    return frozenset({name for name, _ in _given(data) if name != "valve"} | of_valves)


def _given(data: Mapping[str, Any]) -> set[tuple[str, int]]:
    """What a file gives itself: names of values and channels."""
    given = {(name, channel) for side in _CHANNELS for name in data.get(side, {}) for channel in _SIDES[side]}
    for effect, sides in data.get("effects", {}).items():
        given |= {
            (f"{effect}.{own}", channel) for side in sides for own in sides[side] for channel in _SIDES[side]
        }
    return given


# --- files ------------------------------------------------------------------------------------------------------------
def preset_names() -> list[str]:
    """Names of the presets that ship with the package."""
    folder = resources.files(__package__) / "presets"
    return sorted(
        entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")
    )


@cache
def _shipped(name: str) -> frozenset[float]:
    """The values of a base parameter in the presets, which say where they are from."""
    own = [_data(preset)[0] for preset in preset_names()]
    return frozenset(float(d[side][name]) for d in own for side in _CHANNELS if name in d.get(side, {}))


def preset_summary(name: str) -> str:
    """What a preset is, in a line: the first sentence of the comment that its file begins with."""
    text = (resources.files(__package__) / "presets" / f"{name}.yaml").read_text(encoding="utf-8")
    comment = " ".join(line.lstrip("# ") for line in text.partition("schema:")[0].splitlines())
    return re.split(r"\. (?=[A-Z])|;|\.$", comment)[0]


@cache
def _preset(name: str) -> PlantModel:
    return _from_dict(*_data(name))


def load_model(source: str | Path | Mapping[str, Any] | PlantModel) -> PlantModel:
    """A model from a preset's name, a YAML file, the content of one, or a model (returned as it is).

    InputError, in one line that names file and key, for anything that is not right.
    """
    if isinstance(source, PlantModel):
        return source
    if isinstance(source, str) and source in preset_names():
        return _preset(source)
    return _from_dict(*_data(source))


def _data(source: str | Path | Mapping[str, Any]) -> tuple[Any, str]:
    """The content of a model file as it stands, and what to call it in errors."""
    if isinstance(source, Mapping):
        return dict(source), "model"
    if not isinstance(source, str | Path):
        raise InputError(
            f"plant is {shown(source)}, expected a preset ({', '.join(preset_names())}), a YAML file, a mapping or a model"
        )
    text = str(source)
    if text in preset_names():
        file = resources.files(__package__) / "presets" / f"{text}.yaml"
        return parse_yaml(file.read_text(encoding="utf-8"), f"preset {text}"), f"preset {text}"
    path = Path(source)
    if path.suffix in (".yaml", ".yml") or os.path.exists(path):
        return read_yaml(path, "a model in YAML"), os.path.normpath(path)
    raise InputError(f"unknown plant {shown(text)}: no such file, and {suggestion(text, preset_names())}")
