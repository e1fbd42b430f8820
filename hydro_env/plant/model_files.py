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
    ranges: {J: [0.002, 0.005]}       # optional: what is known beforehand of a value, which a diagnosis keeps to

A valve is put in before the values of the same file, which may then change it. What belongs to a valve are the base
parameters `VALVE_PARAMETERS` and the effects of the ports `VALVE_PORTS`, as the named model has them on its channel 1.

Values are SI. Anything unknown, and a value that no such component has (`Parameter.possible`), is refused with a line that
names the file and the key. A rig of an unusual speed, spool frequency or start gives a warning, unless `sources` says where the
values are from.
"""

import math
import os
import re
import warnings
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field

from ..errors import InputError, InputWarning, located, shown, suggestion
from ..reading import parse_yaml, read_yaml
from ..units import RPM
from ..validation import FileTable, Number, NumberOrInfinity, checked
from .catalogue import CATALOGUE
from .catalogue.effect import parameter_of
from .model import SCHEMA, VALVE_PARAMETERS, VALVE_PORTS, PlantModel, ranges_of
from .parameters import PARAMETERS
from .scales import rated
from .validation import wrong_values

_CHANNELS = ("both", "channel_1", "channel_2")
_SIDES = {"channel_1": (0,), "channel_2": (1,), "both": (0, 1), "rig": (0, 1)}
#: Files that may build on each other: a model on its base or valve, that one on its own, ...
MAX_FILES = 5


class _Channel(FileTable):
    """The valve and the base parameters of one channel, or of both."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, NumberOrInfinity] = Field(init=False)

    valve: str = ""

    @classmethod
    def known_keys(cls) -> Collection[str]:
        return ("valve", *PARAMETERS)


class _ModelFile(FileTable):
    """What stands in a model file."""

    FORMAT = SCHEMA

    name: str | None = None
    base: str | None = None
    tolerance_rpm: Number | None = None
    both: _Channel = _Channel()
    channel_1: _Channel = _Channel()
    channel_2: _Channel = _Channel()
    effects: dict[
        str, dict[Literal["both", "rig", "channel_1", "channel_2"], dict[str, NumberOrInfinity]]
    ] = Field(default_factory=dict)
    sources: dict[str, str] = Field(default_factory=dict)
    ranges: dict[str, tuple[NumberOrInfinity, NumberOrInfinity]] = Field(default_factory=dict)

    def values(self) -> Iterator[tuple[str, str, str, float]]:
        """Name, side, place in the file and value of all that it gives itself, in the order in which that counts."""
        for side in _CHANNELS:
            for name, value in (getattr(self, side).model_extra or {}).items():
                yield name, side, f"{side}.{name}", value
        for effect, sides in self.effects.items():
            for at, own_values in sides.items():
                for own, value in own_values.items():
                    yield f"{effect}.{own}", at, f"effects.{effect}.{at}.{own}", value

    def places(self) -> dict[tuple[str, int], str]:
        """Where it gives these values, by name and channel."""
        return {(name, c): place for name, side, place, _ in self.values() for c in _SIDES[side]}

    def valves(self) -> dict[str, str]:
        """The valves that it names, by side."""
        named = {side: getattr(self, side).valve for side in _CHANNELS}
        return {side: valve for side, valve in named.items() if valve}


@dataclass
class _Draft:
    """A model while its file is read: the values by name, one for each channel, and the effects that were named."""

    values: dict[str, list[float]]
    declared: list[str] = field(default_factory=list)

    def value(self, name: str, channel: int) -> float:
        """What it has so far, as `PlantModel.value`."""
        pair = self.values.get(name)
        return parameter_of(name).nominal if pair is None else pair[channel]

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

    def unusual(self, channel: int) -> Iterator[tuple[str, Collection[str]]]:
        """What is unusual of a channel, and the values that it follows from."""
        of, valve = rated(self, channel), ("Kq", "alpha", "k", "R", "u_rated", "x_max")
        speed = of["flow"] / of["displacement"]
        frequency = math.sqrt(self.value("k", channel) / self.value("m", channel))
        seconds = of["inertia"] * speed / (of["displacement"] * of["pressure"])
        if not 20.0 <= speed / RPM <= 20000.0:
            yield f"the open valve turns the motor at {speed / RPM:.3g} rpm", ("D", *valve)
        if not 2.0 <= frequency / (2.0 * math.pi) <= 1000.0:
            yield f"the spool swings at {frequency / (2.0 * math.pi):.3g} Hz", ("k", "m")
        if seconds > 60.0:
            yield f"the supply takes {seconds:.3g} s to bring the motor up to speed", ("J", "D", *valve)


def _of_valve(name: str) -> bool:
    """Whether a value belongs to the valve."""
    effect, _, _ = name.rpartition(".")
    return CATALOGUE[effect].port in VALVE_PORTS if effect else name in VALVE_PARAMETERS


def _model(file: _ModelFile, where: str, above: tuple[str, ...] = ()) -> PlantModel:
    """The model of a file. `above` are the files that build on this one, which it may not build on in turn."""
    above = (*above, where)
    base = PlantModel() if file.base is None else _built_on(file.base, f"{where}: base", above)
    draft = _Draft({name: list(pair) for name, pair in base.values.items()}, list(base.declared))
    for side, valve in file.valves().items():
        draft.put_valve(_built_on(valve, f"{where}: {side}.valve", above), side)
    draft.declared += file.effects
    with located(where):
        for name, side, _, value in file.values():
            draft.put(name, side, value)
        places = file.places()
        for name, channel, wrong in wrong_values(draft, dict.fromkeys(name for name, *_ in file.values())):
            if (name, channel) in places:
                raise InputError(f"{places[name, channel]}: {wrong}")
        for name in file.sources:
            if name not in CATALOGUE:
                parameter_of(name)
        tolerance = base.tolerance if file.tolerance_rpm is None else RPM * file.tolerance_rpm
        pairs = {name: (pair[0], pair[1]) for name, pair in draft.values.items()}
        ranges = {**ranges_of(base.ranges, pairs), **file.ranges}
        model = PlantModel(
            base.name if file.name is None else file.name, pairs, tuple(draft.declared), tolerance, ranges
        )
    doubtful = {name for name, _, _, _ in file.values() if name not in file.sources}
    found = (one for channel in (0, 1) for one in draft.unusual(channel))
    questioned = {text: sorted(doubtful.intersection(names)) for text, names in found}
    if unusual := [f"{text} (by {', '.join(names)})" for text, names in questioned.items() if names]:
        told = f"{where}: unusual: {'; '.join(unusual)}; if that is meant, say under `sources` where the values are from"
        warnings.warn(told, InputWarning, stacklevel=2)
    return model


def _built_on(source: str, where: str, above: tuple[str, ...]) -> PlantModel:
    """The preset or model file that another one names as its base or valve."""
    with located(where):
        return _built(source, above)


def _built(source: str | Path | Mapping[str, Any], above: tuple[str, ...] = ()) -> PlantModel:
    """A model that is built; `above` as for `_model`."""
    if isinstance(source, str) and source in preset_names():
        return _preset(source)
    file, own = _read(source)
    if own in above:
        raise InputError("a model cannot build on itself")
    if len(above) == MAX_FILES:
        raise InputError(f"at most {MAX_FILES} files build on each other")
    return _model(file, own, above)


# --- where values are from --------------------------------------------------------------------------------------------
def sources_of(source: str | Path | Mapping[str, Any]) -> dict[tuple[str, int], str]:
    """Where the values of a model come from, by name of the value and channel (0, 1): for all of `values`.

    What a file gives has its text under `sources`; what it takes from its base or a valve has theirs. `source` and errors
    as in `load_model`.
    """
    file, where = _read(source)
    model, given = _model(file, where), file.places()
    base = sources_of(file.base) if file.base is not None else {}
    valves = {c: sources_of(valve) for side, valve in file.valves().items() for c in _SIDES[side]}
    found = {}
    for name in model.values:
        effect = name.split(".", 1)[0]
        for channel in (0, 1):
            text = base.get((name, channel))
            if _of_valve(name) and channel in valves:
                text = valves[channel].get((name, 0))
            if (name, channel) in given:
                text = file.sources.get(name, file.sources.get(effect, f"{where}, which does not say"))
            if text is None:
                text = "neutral" if "." in name else PARAMETERS[name].source
            found[name, channel] = text
    return found


def values_set_by(source: Any) -> frozenset[str]:
    """Names of the values that a plant file, or the content of one, sets itself; those of a valve that it names count, those
    of its base do not. None for a preset or a model. Errors as in `load_model`."""
    if not isinstance(source, str | Path | Mapping) or str(source) in preset_names():
        return frozenset()
    file, where = _read(source)
    _model(file, where)
    of_valves = {n for valve in file.valves().values() for n in load_model(valve).values if _of_valve(n)}
    return frozenset({name for name, _ in file.places()} | of_valves)


# --- files ------------------------------------------------------------------------------------------------------------
def preset_names() -> list[str]:
    """Names of the presets that ship with the package."""
    folder = resources.files(__package__) / "presets"
    files = [entry.name for entry in folder.iterdir()]
    return sorted(name.removesuffix(".yaml") for name in files if name.endswith(".yaml"))


def preset_summary(name: str) -> str:
    """What a preset is, in a line: the first sentence of the comment that its file begins with."""
    comment = " ".join(line.lstrip("# ") for line in _preset_text(name).partition("schema:")[0].splitlines())
    return re.split(r"\. (?=[A-Z])|;|\.$", comment)[0]


def _preset_text(name: str) -> str:
    return (resources.files(__package__) / "presets" / f"{name}.yaml").read_text(encoding="utf-8")


@cache
def _preset(name: str) -> PlantModel:
    return _model(*_read(name))


def load_model(source: str | Path | Mapping[str, Any] | PlantModel) -> PlantModel:
    """A model from a preset's name, a YAML file, the content of one, or a model.

    InputError, in one line that names file and key, for anything that is not right.
    """
    return source if isinstance(source, PlantModel) else _built(source)


def _read(source: str | Path | Mapping[str, Any]) -> tuple[_ModelFile, str]:
    """What stands in a model file, and what to call it in errors."""
    text = str(source)
    if isinstance(source, Mapping):
        data, where = source, "model"
    elif not isinstance(source, str | Path):
        raise InputError(
            f"plant is {shown(source)}, expected a preset ({', '.join(preset_names())}), a YAML file, a mapping or a model"
        )
    elif text in preset_names():
        data, where = parse_yaml(_preset_text(text), f"preset {text}"), f"preset {text}"
    elif text.endswith((".yaml", ".yml")) or os.path.exists(text):
        data, where = read_yaml(Path(source), "a model in YAML"), os.path.normpath(source)
    else:
        raise InputError(f"unknown plant {shown(text)}: no such file, and {suggestion(text, preset_names())}")
    return checked(_ModelFile, data, where), where
