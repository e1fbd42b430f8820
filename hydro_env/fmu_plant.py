"""A foreign FMU as the plant: two commands in, two speeds out, driven by the benchmark and the environment like any rig.

An FMU is a program: `load_fmu` asks that its origin be trusted. FMI 2.0 and 3.0 for co-simulation; needs FMPy (extra `fmu`). A
mapping file says which variables are meant, unless they have the names of `hydro-env export fmu`:

    schema: hydro_env/fmu_mapping/1
    rated: 10                                # value of the command variables at full command, unless the FMU has u_rated
    start: {supply.p: 1.0e+7}                # optional: parameters of the FMU
    model: my_rig.yaml                       # optional: preset or model file, as large as the rig; else it counts as the paper's
    channel_1:
      command: {variable: valve1.u}
      speed: {variable: motor1.w, unit: rpm, sign: -1}
      pressure: {variable: motor1.dp, unit: bar}     # optional, as current, angle, load and measured_speed are
    channel_2: ...

What is not mapped reads zero, but the angle is integrated from the speed, and the speed is what its sensor shows. Noise is the
environment's. An FMU has valves of its own, so there is nothing to draw: the split is `own`.
"""

import hashlib
import tempfile
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, DTypeLike
from pydantic import BeforeValidator, Field

from hydro_env.arrays import Floats
from hydro_env.errors import InputError, located, shown, suggestion
from hydro_env.plant import PARAMETERS, PlantModel, load_model, preset_names
from hydro_env.plant.plant import Lost, grid_points
from hydro_env.reading import check_file, read_yaml
from hydro_env.units import UNITS, unit
from hydro_env.validation import FileTable, Number, checked, known

SCHEMA = "hydro_env/fmu_mapping/1"

#: Signals of a channel: SI unit, and whether they go in.
_SIGNALS = {
    "command": ("V", True), "load": ("N m", True), "speed": ("rad/s", False), "measured_speed": ("rad/s", False),
    "pressure": ("Pa", False), "current": ("A", False), "angle": ("rad", False),
}  # fmt: skip
_NEEDED = ("command", "speed")
#: Rows of the memory: what a `Plant` shows the environment, and the rated commands.
_ROWS = (
    "speed", "angle", "measured_speed", "current", "pressure", "diverged", "mean_line_pressure", "peak_difference", "u_rated",
)  # fmt: skip


@dataclass(frozen=True)
class Link:
    """A variable of the FMU: SI value = `factor` * value."""

    variable: str
    factor: float = 1.0


@dataclass(frozen=True)
class FmuModel(PlantModel):
    """An FMU in the place of a model: its file, and what its variables mean, by (signal, channel 0 or 1). `rig` has what is
    known of its parameters, from which its size follows."""

    file: str = ""
    rig: PlantModel = field(default_factory=PlantModel)
    links: Mapping[tuple[str, int], Link] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    dtype = "float64"
    """What an FMU computes in."""

    def value(self, name: str, channel: int) -> float:
        """As `PlantModel.value`; what the FMU does not show is that of `rig`."""
        return super().value(name, channel) if name in self.values else self.rig.value(name, channel)

    def to_dict(self, source: str | Mapping[str, str] = "") -> dict[str, Any]:
        """What tells it from others, the FMU's content included."""
        digest = hashlib.sha256(Path(self.file).read_bytes()).hexdigest()
        links = {f"{name}_{c + 1}": [link.variable, link.factor] for (name, c), link in self.links.items()}
        return {
            **super().to_dict(),
            "fmu": digest,
            "links": links,
            "start": dict(self.start),
            "rig": self.rig.to_dict(),
        }

    def make_plant(self, num_rigs: int, dtype: DTypeLike = np.float64) -> "FmuRigs":
        """Rigs of this kind. InputError if the FMU cannot be loaded, and for another dtype than float64."""
        if np.dtype(dtype) != self.dtype:
            raise InputError(f"{self.name}: an FMU computes in float64; {np.dtype(dtype)} is not possible")
        return FmuRigs(self, num_rigs)


def is_fmu(plant: object) -> bool:
    """Whether a plant is named that is an FMU."""
    return isinstance(plant, str | Path) and Path(plant).suffix == ".fmu"


def load_fmu(file: str | Path, mapping: str | Path | None = None, *, trust: bool = False) -> FmuModel:
    """The model for a foreign FMU; `mapping` a file as above.

    InputError for a file that is not trusted, no FMU for co-simulation, or lacks a variable; ModuleNotFoundError without FMPy.
    """
    check_file(file, "an FMU")
    if not trust:
        raise InputError(f"{file}: is a program: using it runs code from the file; with --trust it is used")
    variables = {v.name: v for v in _description(str(file)).modelVariables}
    given = _Mapping(**_own_names(variables)) if mapping is None else _read(mapping)
    links, start = _links(given, mapping, variables), given.start
    for (name, channel), link in links.items():
        _check(file, variables, link.variable, f"{name} of channel {channel + 1}", _SIGNALS[name][1])
    for name in start:
        _check(file, variables, name, "start")
    for name, channel in product(_NEEDED, (0, 1)):
        if (name, channel) not in links:
            lacking = f"{name} of channel {channel + 1} is missing"
            raise InputError(f"{mapping or file}: {lacking}; name its variable in --mapping")
    own = _own_values(variables, start)
    rated = own.get("u_rated") if given.rated is None else (given.rated, given.rated)
    if rated is None:
        raise InputError(f"{mapping or file}: rated is missing: the value of the commands at full command")
    name, values = Path(file).stem, {"u_rated": rated}
    rig = PlantModel(name)
    if given.model:
        like = given.model if given.model in preset_names() else Path(str(mapping)).parent / given.model
        rig = load_model(like)
    rig = rig.with_values({"R": _coils(rig, rated)} | own | values)
    return FmuModel(name, values, (), file=str(file), rig=rig, links=links, start=start)


def _coils(rig: PlantModel, rated: tuple[float, float]) -> tuple[float, float]:
    """Resistances by which these commands drive the currents of a rig: in whatever unit they are, its valves open as far."""
    least, most = PARAMETERS["R"].possible
    one, two = (rig.value("R", c) * rated[c] / rig.value("u_rated", c) for c in (0, 1))
    return min(max(one, least), most), min(max(two, least), most)


def _own_values(variables: Mapping[str, Any], start: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """The base parameters of an FMU that `hydro-env export fmu` has made."""
    found = {}
    for name in (*PARAMETERS, "pressure_dependent_flow.supply_pressure"):
        own = [f"channel_{c}.{name}" for c in (1, 2)]
        one, two = (start.get(each, getattr(variables.get(each), "start", None)) for each in own)
        if one is not None and two is not None:
            found[name] = (float(one), float(two))
    return found


def _check(
    file: str | Path, variables: Mapping[str, Any], name: str, what: str, goes_in: bool = False
) -> None:
    """InputError for a variable that is not there, no number, or no input where it `goes_in`."""
    if name not in variables:
        raise InputError(f"{file}: has no variable {shown(name)} ({what}): {suggestion(name, variables)}")
    causality, kind = variables[name].causality, variables[name].type
    if goes_in and causality != "input":
        raise InputError(f"{file}: {shown(name)} ({what}) is {causality or 'local'}, expected an input")
    if kind not in ("Real", "Float64"):
        raise InputError(f"{file}: {shown(name)} ({what}) is of type {kind}, expected Real or Float64")


def _own_names(variables: Collection[str]) -> dict[str, Any]:
    """The content of a mapping file with the names that `hydro-env export fmu` gives, as far as they are there."""
    return {
        f"channel_{c}": {name: own for name in _SIGNALS if (own := f"{name}_{c}") in variables}
        for c in (1, 2)
    }


# --- mapping files ----------------------------------------------------------------------------------------------------
class _Variable(FileTable):
    """A variable of the FMU, and what its numbers are; those of a command are in the unit of `rated`."""

    variable: str
    unit: str = ""
    sign: Number = 1.0

    def link(self, signal: str, stated: str) -> Link:
        """What it is for a signal; `stated` is the unit of which the FMU speaks, if any. InputError for a unit of something else,
        and for another one than that."""
        si = _SIGNALS[signal][0]
        if signal == "command":
            if len(self.model_fields_set) > 1:
                raise InputError("a command has neither unit nor sign: `rated` is its value at full command")
            return Link(self.variable, self.sign)
        own, quantity = unit(self.unit or si), UNITS[si].quantity
        if own.quantity != quantity or own.offset:
            raise InputError(f"unit {own.name} is no unit of {quantity}")
        theirs = own
        with suppress(InputError):  # where the FMU states none that is known here, the mapping decides
            theirs = unit(stated)
        if theirs.quantity != quantity:
            theirs = own
        if self.unit and own.scale != theirs.scale:
            raise InputError(f"unit {own.name}: the FMU states {theirs.name} for {shown(self.variable)}")
        return Link(self.variable, theirs.scale * self.sign)


def _by_name(entry: Any) -> Any:
    """A variable's name alone stands for {variable: NAME}."""
    return {"variable": entry} if isinstance(entry, str) else entry


_Channel = dict[Annotated[str, known("signal", _SIGNALS)], Annotated[_Variable, BeforeValidator(_by_name)]]


class _Mapping(FileTable):
    FORMAT = SCHEMA

    rated: Annotated[Number, Field(gt=0.0)] | None = None
    start: dict[str, Number] = Field(default_factory=dict)
    model: str = ""
    channel_1: _Channel
    channel_2: _Channel


def _read(path: str | Path) -> _Mapping:
    return checked(_Mapping, read_yaml(path, "a mapping of an FMU in YAML"), path)


def _links(
    given: _Mapping, path: str | Path | None, of_unit: Mapping[str, Any]
) -> dict[tuple[str, int], Link]:
    """What the variables of a mapping, of the file `path`, mean; `of_unit` are all of the FMU."""
    links = {}
    for channel, variables in enumerate((given.channel_1, given.channel_2)):
        for signal, variable in variables.items():
            with located(f"{path}: channel_{channel + 1}.{signal}"):
                own = of_unit.get(variable.variable)
                stated = own and (own.unit or (own.declaredType and own.declaredType.unit))
                links[signal, channel] = variable.link(signal, stated or "")
    return links


# --- the unit at work ------------------------------------------------------------------------------------------------
@lru_cache(maxsize=4)
def _description(file: str) -> Any:
    import fmpy

    try:
        description = fmpy.read_model_description(file)
    except Exception as problem:
        raise InputError(f"{file}: is no FMU that FMPy can read: {problem}") from None
    if description.coSimulation is None:
        raise InputError(f"{file}: is not for co-simulation, which is needed")
    return description


@lru_cache(maxsize=4)
def _unpacked(file: str) -> tempfile.TemporaryDirectory[str]:
    """The content of an FMU, for as long as this process lives."""
    import fmpy

    room = tempfile.TemporaryDirectory(prefix="hydro_env_fmu_")
    fmpy.extract(file, unzipdir=room.name)
    return room


class _Unit:
    """One instance of the FMU."""

    def __init__(self, model: FmuModel) -> None:
        import fmpy

        self._model, description = model, _description(model.file)
        self._old = description.fmiVersion == "2.0"
        reference = {v.name: v.valueReference for v in description.modelVariables}
        links = [(key, reference[link.variable], link.factor) for key, link in model.links.items()]
        self._in = [link for link in links if _SIGNALS[link[0][0]][1]]
        self._out = [link for link in links if not _SIGNALS[link[0][0]][1]]
        self._start = [(reference[name], value) for name, value in model.start.items()]
        try:
            self._unit = fmpy.instantiate_fmu(_unpacked(model.file).name, description, "CoSimulation")
        except Exception as problem:
            raise InputError(f"{model.file}: cannot be started here: {problem}") from None
        self._get = self._unit.getReal if self._old else self._unit.getFloat64
        self._set = self._unit.setReal if self._old else self._unit.setFloat64
        self._begin()

    def _begin(self) -> None:
        self.time = 0.0
        if self._start:
            self._set([r for r, _ in self._start], [v for _, v in self._start])
        if self._old:
            self._unit.setupExperiment()
        self._unit.enterInitializationMode()
        self._unit.exitInitializationMode()

    def reset(self) -> None:
        """Back to time zero."""
        self._unit.reset()
        self._begin()

    def step(self, command: Floats, load: Floats, period: float) -> None:
        """Holds commands and loads, each (2,), over a period in s."""
        given = {"command": command, "load": load}
        self._set(
            [r for _, r, _ in self._in], [float(given[n][c]) / factor for (n, c), _, factor in self._in]
        )
        self._unit.doStep(currentCommunicationPoint=self.time, communicationStepSize=period)
        self.time += period

    def signals(self) -> dict[tuple[str, int], float]:
        """What comes out, SI."""
        values = self._get([r for _, r, _ in self._out])
        return {key: factor * float(v) for (key, _, factor), v in zip(self._out, values, strict=True)}


class FmuRigs:
    """Instances of an FMU, driven like a `Plant`: commands, loads and signals as there, but parameters belong to the FMU."""

    effects = ()
    angle_acts = True  # it is the FMU's own, or integrated here
    lost: tuple[Lost, ...] = ()  # a foreign FMU does not say what it cannot follow

    def __init__(self, model: FmuModel, num_rigs: int = 1) -> None:
        self.model, self.num_rigs = model, num_rigs
        self._units = [_Unit(model) for _ in range(num_rigs)]
        self.memory = np.zeros((1, len(_ROWS), 2 * num_rigs))
        #: The same by row, channel and rig.
        self._cells = self.memory.reshape(-1, 2, num_rigs)
        self._cells[self.row_of("u_rated")] = np.array(model.pair("u_rated"))[:, None]
        self.reset()

    def row_of(self, name: str) -> int:
        """Number of the row of `memory` that holds a signal or the rated commands. KeyError for anything else."""
        if name not in _ROWS:
            raise KeyError(f"{name}: an FMU shows {', '.join(_ROWS)} alone")
        return _ROWS.index(name)

    def get(self, name: str) -> Floats:
        """A signal of every rig, (num_rigs, 2), as a copy. KeyError for one that an FMU does not show."""
        return self._cells[self.row_of(name)].T.copy()

    def set_values(self, values: Mapping[str, ArrayLike], rows: ArrayLike | None = None) -> None:
        """InputError for any value: its parameters are the FMU's."""
        for name in values:
            told = f"an FMU has its own valves, {name} cannot be drawn; the split own is right"
            raise InputError(f"{self.model.name}: {told}")

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Puts all rigs, or `rows` (indices or mask), back to their start."""
        chosen = np.arange(self.num_rigs)[slice(None) if rows is None else np.asarray(rows)]
        for i in chosen.tolist():
            self._units[i].reset()
            self._cells[: self.row_of("u_rated"), :, i] = 0.0
            self._show(i, 0.0)

    def make_room(self, period: float) -> None:
        """Nothing: delays are the FMU's."""

    def hold(self, command_V: Floats, load_Nm: Floats, period: float) -> None:
        """Holds commands and loads (num_rigs, 2) over a period in s. InputError if the FMU refuses."""
        self.hold_rigs(slice(None), command_V, load_Nm, period)

    def hold_rigs(self, rigs: slice, command_V: Floats, load_Nm: Floats, period: float) -> None:
        """`hold` for a range of rigs."""
        for i in range(self.num_rigs)[rigs]:
            points, largest = grid_points(period), 0.0
            for _ in range(points):
                try:
                    self._units[i].step(command_V[i], load_Nm[i], period / points)
                except Exception as problem:
                    told = f"the FMU refuses a step at {self._units[i].time:g} s: {problem}"
                    raise InputError(f"{self.model.name}: {told}") from None
                self._show(i, period / points)
                largest = max(largest, float(np.ptp(self._cells[self.row_of("speed"), :, i])))
            self._cells[self.row_of("peak_difference"), :, i] = largest

    def turn(self, rows: int) -> None:
        """Nothing: delays are the FMU's."""

    def _show(self, i: int, period: float) -> None:
        """Puts what an instance shows after a period into the memory: zero for what it does not show or what is not finite."""
        seen, cells = self._units[i].signals(), dict(zip(_ROWS, self._cells[:, :, i], strict=True))
        before = cells["speed"].copy()
        for (name, c), value in seen.items():
            cells[name][c] = value
        for c in (0, 1):
            if ("angle", c) not in seen:
                cells["angle"][c] += 0.5 * period * (before[c] + cells["speed"][c])
            if ("measured_speed", c) not in seen:
                cells["measured_speed"][c] = cells["speed"][c]
        if not all(np.isfinite(value) for value in seen.values()):
            self._cells[: self.row_of("u_rated"), :, i] = 0.0
            cells["diverged"][:] = 1.0

    def copy(self) -> NoReturn:
        """InputError, as for `copy` and `pickle`."""
        self.__getstate__()

    def __getstate__(self) -> NoReturn:
        """InputError for whatever copies or pickles the rigs: the FMU need not be able to copy itself."""
        raise InputError(
            f"{self.model.name}: a foreign FMU cannot be put on the valve bench or copied; a controller that goes by"
            " measurements is right"
        )
