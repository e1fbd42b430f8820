"""Mapping files: how the columns of somebody else's log become the signals of a rig log (`hydro_env/mapping/1`).

A mapping says for each signal which column holds it, in which unit, and with which sign, scale and offset:

    SI value = to_si(sign * (scale * cell + offset), unit)            and, for `minus`, less the second column's value

    schema: hydro_env/mapping/1
    name: crane_main
    table: {delimiter: ";", decimal: ",", encoding: utf-8, skip_rows: 0, si_suffixes: false}     # all optional
    time: {column: t, unit: ms}               # or, without a usable column:  {sample_rate: 100}  (rows per second)
    supply: {column: Ps, unit: bar}           # of the whole rig: setpoint, supply, temperature
    channel_1:
      actuator: cylinder                      # or motor (the default)
      displacement: {value: 12.06, unit: cm2} # optional: piston area; of a motor, volume per angle (cm3/rev)
      command: {column: U, unit: fraction, full_scale: 10}   # 10 V at full scale: the log then holds volts
      pressure: {column: pA, unit: bar, minus: {column: pB, unit: bar, scale: 0.61}}      # load pressure
      pressure_a: {column: pA, unit: bar}     # optional: both lines, above the tank's; a drives in the positive direction
      pressure_b: {column: pB, unit: bar}     # with both and no load pressure, that of a motor is a - b
      motor_pressure: {column: pM, unit: bar} # optional: load pressure at the ports of the motor
      speed: {column: v, unit: mm/s, sign: -1}               # a unit of position (deg, rev, mm): its slope is the speed

A column without a name, or with one that stands there twice, is called by its number: "1" is the first.
A cylinder is treated as a motor whose displacement is its piston area: its speed is in m/s, its load a force in N,
its displacement in m2; everything else is the same. A model that a diagnosis writes keeps the displacement of the
model that was given, with a flow gain `Kq` that makes its rad/s the m/s of the log. A channel that is not named is absent.
"""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, NamedTuple, TypeVar

from pydantic import AfterValidator, Field, model_validator

from hydro_env.errors import InputError, nearest
from hydro_env.measured.finding import Finding
from hydro_env.reading import read_yaml
from hydro_env.units import to_si, unit
from hydro_env.validation import FileTable, Number, checked

#: How the command of a channel, and a signal, is described in a file.
C = TypeVar("C")
S = TypeVar("S")

#: A unit in any of the usual spellings, kept by its name.
UnitName = Annotated[str, AfterValidator(lambda given: unit(given).name)]

SCHEMA = "hydro_env/mapping/1"
#: Pressures of the two lines of a channel: the one that drives in the positive direction, and the other.
LINES = ("pressure_a", "pressure_b")

# The columns of the rig log itself: signal -> (ending of the column name, unit).
CONTRACT = {
    "command": ("V", "V"), "current": ("A", "A"), "pressure": ("bar", "bar"), "speed": ("rpm", "rpm"),
    "load": ("Nm", "N m"), "spool": ("mm", "mm"), "flow": ("lpm", "l/min"), "pressure_a": ("bar", "bar"),
    "pressure_b": ("bar", "bar"), "motor_pressure": ("bar", "bar"),
}  # fmt: skip
CONTRACT_RIG = {
    "setpoint": ("setpoint_rpm", "rpm"), "supply": ("supply_bar", "bar"), "temperature": ("temperature_C", "degC"),
}  # fmt: skip
CHANNEL_SIGNALS, RIG_SIGNALS = tuple(CONTRACT), tuple(CONTRACT_RIG)
CHANNELS = ("channel_1", "channel_2")
#: What is measured on a cylinder where a motor has the former.
_LINEAR = {"angular speed": "linear speed", "angle": "length", "torque": "force", "displacement": "area"}
#: A speed may be given as the position whose slope it is.
_POSITIONS = {"angular speed": "angle", "linear speed": "length"}
#: The unit in which an engineer reads a quantity.
USUAL_UNITS = {
    "voltage": "V", "current": "A", "pressure": "bar", "length": "mm", "flow": "l/min", "temperature": "degC", "time": "s",
    "angular speed": "rpm", "linear speed": "mm/s", "torque": "N m", "force": "N", "displacement": "cm3/rev", "area": "cm2",
}  # fmt: skip


def quantity_of(signal: str, actuator: str) -> str:
    """What a signal, or the displacement, is measured as on a motor or a cylinder."""
    found = signal if signal == "displacement" else unit((CONTRACT | CONTRACT_RIG)[signal][1]).quantity
    return found if actuator == "motor" else _LINEAR.get(found, found)


class Part(FileTable):
    """One column in one unit; `full_scale` (SI) is the value at fraction 1 where the unit is fraction or percent."""

    column: str
    unit: UnitName
    sign: Literal[1, -1] = 1
    scale: Number = 1.0
    offset: Number = 0.0
    full_scale: Number | None = None

    @model_validator(mode="after")
    def _sensible(self) -> "Part":
        quantity = unit(self.unit).quantity
        if self.scale == 0.0:
            raise ValueError("scale is 0, so the signal would vanish; use sign: -1 to reverse it")
        if quantity == "fraction" and self.full_scale is None:
            raise ValueError("a fraction needs `full_scale`: the value (V, A or m) at fraction 1")
        if quantity != "fraction" and self.full_scale is not None:
            raise ValueError(f"`full_scale` goes with the units fraction and percent, not with {self.unit}")
        return self

    def si(self, cells: Any) -> Any:
        """The column's cells (T,) in SI."""
        value = to_si(self.sign * (self.scale * cells + self.offset), self.unit)
        return value if self.full_scale is None else value * self.full_scale


class Source(Part):
    """Where a signal comes from: one column, less another one where `minus` is given (a pressure difference)."""

    minus: Part | None = None

    @property
    def parts(self) -> list[Part]:
        """The columns that are needed."""
        return [self] if self.minus is None else [self, self.minus]


class Mapped(NamedTuple):
    """A signal of channel 0 or 1, or of the rig (None), and where it comes from."""

    signal: str
    channel: int | None
    source: Source

    @property
    def column(self) -> str:
        return self.source.column

    @property
    def number(self) -> int | None:
        """The channel as users count, from 1."""
        return None if self.channel is None else self.channel + 1

    def finding(
        self, code: str, message: str, hint: str = "", row: int | None = None, sure: bool = False,
        right: dict[str, Any] | None = None,
    ) -> Finding:  # fmt: skip
        """A finding about the signal; `right` is what a mapping would have to say of it."""
        where = self.signal, self.number, self.column
        fix: dict[str, Any] = {self.signal: right}
        fix = fix if self.number is None else {f"channel_{self.number}": fix}
        return Finding(code, message, hint, *where, row, sure, fix if right else None)


class Quantity(FileTable):
    """A number with its unit."""

    value: Number
    unit: str


class Time(FileTable):
    """The clock: a column of numbers, or rows at a fixed rate (rows per second)."""

    column: str | None = None
    unit: str = "s"
    sample_rate: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None

    @model_validator(mode="after")
    def _one_clock(self) -> "Time":
        if (self.column is None) == (self.sample_rate is None):
            raise ValueError("give either `column` (with its unit) or `sample_rate` (rows per second)")
        quantity = unit(self.unit).quantity
        if quantity != "time":
            raise ValueError(f"{self.unit} is a unit of {quantity}; time is in s, ms or us")
        return self


class TableStyle(FileTable):
    """How a CSV file is written; None is recognised from the file."""

    delimiter: Annotated[str, Field(min_length=1, max_length=1)] | None = None
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    skip_rows: Annotated[int, Field(ge=0)] = 0
    si_suffixes: bool = False


class ChannelTable(FileTable, Generic[C, S]):
    """The command and the signals of a channel in a file; those that are not there are left out."""

    command: C
    speed: S
    current: S | None = None
    pressure: S | None = None
    load: S | None = None
    spool: S | None = None
    flow: S | None = None
    pressure_a: S | None = None
    pressure_b: S | None = None
    motor_pressure: S | None = None


class ChannelMapping(ChannelTable[Source, Source]):
    """One valve and its actuator."""

    actuator: Literal["motor", "cylinder"] = "motor"
    displacement: Quantity | None = None

    @property
    def size(self) -> float | None:
        """The displacement, m3/rad, or the area, m2, where it is known."""
        known = self.displacement
        return float(to_si(known.value, known.unit)) if known else None

    @model_validator(mode="after")
    def _units_fit(self) -> "ChannelMapping":
        _check_units(self, CHANNEL_SIGNALS, self.actuator)
        if self.displacement is not None:
            _check_unit("displacement", self.displacement.unit, self.actuator)
        return self


def _check_unit(what: str, given: str, actuator: str) -> None:
    """ValueError for a unit of something else than the signal, or the displacement, is measured in."""
    quantity = unit(given).quantity
    wanted = {each: quantity_of(what, each) for each in ("motor", "cylinder")}
    slope_of = _POSITIONS if what == "speed" else {}
    fitting = [each for each, own in wanted.items() if quantity in (own, slope_of.get(own))]
    shared = quantity == "fraction" and what in ("command", "current", "spool")
    if not shared and actuator not in fitting:
        told = f"{given} is a unit of {quantity}; use {USUAL_UNITS[wanted[actuator]]}"
        hint = f", or say `actuator: {fitting[0]}`" if fitting and what != "displacement" else ""
        raise ValueError(f"{what} of a {actuator}: {told}{hint}")


def _check_units(table: FileTable, signals: tuple[str, ...], actuator: str) -> None:
    """ValueError for a unit of something else than what one of the signals of a table is measured in."""
    for signal in signals:
        source: Source | None = getattr(table, signal)
        for part in source.parts if source else ():
            _check_unit(signal, part.unit, actuator)


class Mapping(FileTable):
    """A whole mapping file."""

    FORMAT = SCHEMA

    name: str = ""
    description: str = ""
    table: TableStyle = TableStyle()
    time: Time
    setpoint: Source | None = None
    supply: Source | None = None
    temperature: Source | None = None
    channel_1: ChannelMapping | None = None
    channel_2: ChannelMapping | None = None

    @model_validator(mode="after")
    def _some_channel(self) -> "Mapping":
        present = [channel for channel in self.channels if channel is not None]
        if not present:
            raise ValueError("no channel: give channel_1, channel_2 or both, each with command and speed")
        _check_units(self, RIG_SIGNALS, present[0].actuator)
        return self

    @property
    def channels(self) -> tuple[ChannelMapping | None, ChannelMapping | None]:
        """Channel 1 and channel 2, None where absent."""
        return self.channel_1, self.channel_2

    def sources(self) -> Iterator[Mapped]:
        """All that is mapped: of the rig, then of each channel."""
        for channel in (None, 0, 1):
            for signal in RIG_SIGNALS if channel is None else CHANNEL_SIGNALS:
                if found := self.mapped(signal, channel):
                    yield found

    def mapped(self, signal: str, channel: int | None) -> Mapped | None:
        """A signal of channel 0 or 1, or of the rig (None), if it is mapped."""
        source = getattr(self if channel is None else self.channels[channel], signal, None)
        return None if source is None else Mapped(signal, channel, source)

    def columns(self) -> tuple[str, ...]:
        """Every column of the file that the mapping uses."""
        names = [self.time.column] if self.time.column else []
        names += [part.column for each in self.sources() for part in each.source.parts]
        return tuple(dict.fromkeys(names))


def load_mapping(path: str | Path) -> Mapping:
    """Reads a mapping file; `InputError` with one line naming file and key for anything that is wrong."""
    return checked(Mapping, read_yaml(path, "a mapping in YAML"), path)


def load_begun(path: str | Path) -> Mapping | dict[str, Any]:
    """A whole mapping file as a mapping; the content of one that lacks the time or every channel. InputError as above."""
    data = read_yaml(path, "a mapping in YAML")
    lacking = {key: value for key, value in _BLANK.items() if isinstance(data, dict) and key not in data}
    if lacking and "channel_2" in data:
        lacking.pop("channel_1", None)
    whole = checked(Mapping, data | lacking if lacking else data, path)
    return data if lacking else whole


#: Stands in for what is not yet said of a log.
_BLANK: dict[str, Any] = {
    "time": {"sample_rate": 1000},
    "channel_1": {"command": {"column": "?", "unit": "V"}, "speed": {"column": "?", "unit": "rpm"}},
}


def contract_columns() -> dict[str, tuple[str, int | None, str]]:
    """Every column that a rig log may have, in the order they are written: its signal, the channel and the unit."""
    rig = {column: (signal, None, symbol) for signal, (column, symbol) in CONTRACT_RIG.items()}
    found: dict[str, tuple[str, int | None, str]] = {"time_s": ("time", None, "s")}
    found["setpoint_rpm"] = rig["setpoint_rpm"]
    first = "command", "current", "pressure", "speed", "load"
    for group in (first, ("spool", "flow"), LINES, ("motor_pressure",)):
        for channel, signal in product((0, 1), group):
            ending, symbol = CONTRACT[signal]
            found[f"{signal}_{channel + 1}_{ending}"] = signal, channel, symbol
    return found | rig


def contract_mapping(names: tuple[str, ...]) -> Mapping:
    """The mapping of a log with the rig log's own header `names`; `InputError` where a required column is missing."""
    content: dict[str, Any] = {}
    known = contract_columns()
    for column, (signal, channel, symbol) in known.items():
        if column in names:
            owner = content if channel is None else content.setdefault(f"channel_{channel + 1}", {})
            owner[signal] = {"column": column, "unit": symbol}
    present = [key[-1] for key in CHANNELS if key in content] or ["1"]
    needed = [f"{signal}_{c}_{CONTRACT[signal][0]}" for c in present for signal in ("command", "speed")]
    missing = next((column for column in ("time_s", *needed) if column not in names), None)
    if missing is None:
        return Mapping.model_validate(content)
    if names and all(name.isdecimal() for name in names):
        told = "holds numbers where the header should be; add the line of column names"
        raise InputError(f"{told}, or say in a mapping file what the columns are, by their numbers")
    near = nearest(missing, (name for name in names if name not in known))
    hint = f"rename {near!r}, or " if near else ""
    shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    told = f"the required column {missing!r} is missing (found: {shown})"
    raise InputError(f"{told}; {hint}describe this log in a mapping file")
