"""Models in files: presets of the package and YAML files of users, and where their values are from.

    schema: hydro_env/model/1
    name: my rig
    base: paper                       # optional: start from a preset
    tolerance_rpm: 0.1                # optional: error of a speed by which the integrator chooses its steps
    both: {J: 0.0031, V: 1.0e-4}      # base parameters of both channels; V is half the volume of one line, valve to motor
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
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from ..errors import InputError, InputWarning, shown, suggestion
from ..reading import parse_yaml, read_yaml
from ..units import RPM
from .accepted import out_of_range, with_unit
from .catalogue import CATALOGUE
from .model import SCHEMA, VALVE_PARAMETERS, VALVE_PORTS, PlantModel, parameter_of
from .parameters import PARAMETERS

__all__ = ["load_model", "preset_names", "preset_summary", "sources_of", "values_set_by"]

_CHANNELS = ("both", "channel_1", "channel_2")
#: Files that may build on each other: a model on its base or valve, that one on its own, ...
MOST_FILES = 5
_SIDES = {"channel_1": (0,), "channel_2": (1,), "both": (0, 1), "rig": (0, 1)}


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


@dataclass
class _Draft:
    """A model while its file is read: the values by name, one for each channel, and the effects that were named; by the name
    of a base parameter the value that the file itself gives, and its channel."""

    values: dict[str, list[float]]
    declared: list[str]
    given: dict[str, tuple[float, int]] = field(default_factory=dict)

    def take(self, name: str, side: str, given: object, where: str) -> None:
        """Sets a value that the file gives on one side. InputError if it is no number, or none that a component can have."""
        value, p = _number(given, where), parameter_of(name)
        if wrong := out_of_range(value, p):
            raise InputError(f"{where}: {wrong}")
        if name in PARAMETERS and value != 0.0 and value not in _shipped(name):
            self.given[name] = value, _SIDES[side][0]
        self.put(name, side, value)

    def put(self, name: str, side: str, value: float) -> None:
        """Sets a value on one side; the other channel keeps its own, or gets the nominal one."""
        for channel in _SIDES[side]:
            self.values.setdefault(name, [parameter_of(name).nominal] * 2)[channel] = value

    def unusual(self, name: str) -> str:
        """What is unusual of a value that the file gives on a rig with its displacement; "" if nothing is."""
        p, (value, channel) = PARAMETERS[name], self.given[name]
        D = PARAMETERS["D"]
        low, high = p.plausible(1.0 if p is D else self.values.get("D", [D.nominal] * 2)[channel] / D.nominal)
        return "" if low <= value <= high else f"{name} {value:g} (usual {low:g} to {with_unit(high, p)})"

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
    known = {"schema", "name", "base", "tolerance_rpm", *_CHANNELS, "effects", "sources"}
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
    if unusual := [text for name in draft.given if name not in sources and (text := draft.unusual(name))]:
        told = f"{where}: unusual for such a rig: {', '.join(unusual)}; if that is meant, say under `sources` where it is from"
        warnings.warn(told, InputWarning, stacklevel=2)
    try:
        return PlantModel(
            name=str(data.get("name", base.name)),
            values={name: (pair[0], pair[1]) for name, pair in draft.values.items()},
            declared=tuple(draft.declared),
            tolerance=RPM
            * _number(data.get("tolerance_rpm", base.tolerance / RPM), f"{where}: tolerance_rpm"),
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
    """A model from a preset's name, a YAML file, the content of one, or a model.

    InputError, in one line that names file and key, for anything that is not right.
    """
    if isinstance(source, PlantModel):
        return source
    if isinstance(source, str) and source in preset_names():
        return _preset(source)
    return _from_dict(*_data(source))


def _called(source: str | Path | Mapping[str, Any]) -> str:
    """What to call a file, or the content of one, in errors."""
    return "model" if isinstance(source, Mapping) else os.path.normpath(source)


def _data(source: str | Path | Mapping[str, Any]) -> tuple[Any, str]:
    """The content of a model file as it stands, and what to call it in errors."""
    if isinstance(source, Mapping):
        return dict(source), _called(source)
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
        return read_yaml(path, "a model in YAML"), _called(path)
    raise InputError(f"unknown plant {shown(text)}: no such file, and {suggestion(text, preset_names())}")
