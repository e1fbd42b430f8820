"""Link files: how signals and commands of a rig are named on its OPC UA server or in its datagrams (`hydro_env/link/1`).

    schema: hydro_env/link/1
    protocol: udp                           # or opcua
    address: 192.168.0.10:5005              # of the rig; OPC UA: opc.tcp://192.168.0.10:4840
    listen: 0.0.0.0:5006                    # UDP alone: where its datagrams come to
    cycle_s: 0.01                           # from one sample to the next
    watchdog_s: 0.1                         # without a new sample for longer there is a fault; at least three cycles
    when_late: hold                         # the command while a sample is late: hold (default) or zero
    command_limit_percent: 20               # of the rated commands; 20 is the default and the most, more by --command-limit
    rate_limit: 2                           # rated commands a second, the default
    count: n                                # rises by one with every sample; needed for UDP
    time: {name: t, unit: ms}               # the rig's clock; without it rows are timed on arrival
    heartbeat: alive                        # is written, and rises by one with every command
    setpoint: {name: n_ref, unit: rpm, range: [-600, 600]}       # also supply, temperature
    channel_1:
      command: {name: u1, rated: 10, sign: -1}                   # rated: what is written for the rated command
      speed: {name: n1, unit: rpm, range: [-900, 900], frozen_s: 0.5}
      pressure: {name: p1, unit: bar, range: [-250, 250], scale: 0.01, offset: 0}
    channel_2: ...

A name is a node id (`ns=2;s=Rig.n1`) or a field of the datagrams, which are one JSON object each:

    rig to hydro_env:  {"n": 17, "t": 170, "n1": 101.5, "n2": 99.0}
    hydro_env to rig:  {"u1": -0.31, "u2": 0.29, "alive": 17}

A signal is sign * (scale * number + offset) in its unit. Outside its `range`, which a speed needs, there is a fault, and so there
is if it repeats itself to the last digit for `frozen_s` (of a speed 0.5 unless given) while its channel has a command. Signals
are those of a rig log. A number that is absent or not finite, or an OPC UA status that is not good, is a fault as well.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, model_validator

from hydro_env.measured.mapping import CHANNEL_SIGNALS, RIG_SIGNALS, USUAL_UNITS, ChannelTable, quantity_of
from hydro_env.reading import read_yaml
from hydro_env.units import from_si, to_si, unit, with_unit
from hydro_env.validation import FileTable, Number, checked

#: Largest command of a link file, per cent of the rated one.
FIRST_LIMIT = 20.0
#: How long a speed may repeat itself under command, s, unless the file says it.
FROZEN_S = 0.5
#: Signals of a channel that are read.
_READ = tuple(signal for signal in CHANNEL_SIGNALS if signal != "command")


class Sample(NamedTuple):
    """What a rig showed at one instant: its counter and clock (s), None where it has none, and the signals in SI by "speed_1",
    ..., "setpoint"; NaN for what is absent."""

    number: float | None
    time: float | None
    values: Mapping[str, float]


def _number(raw: Any) -> float:
    return float(raw) if isinstance(raw, int | float) and not isinstance(raw, bool) else math.nan


class Input(FileTable):
    """A signal that is read."""

    name: str
    unit: str
    sign: Literal[1, -1] = 1
    scale: Number = 1.0
    offset: Number = 0.0
    range: tuple[Number, Number] | None = None
    frozen_s: Annotated[Number, Field(gt=0.0)] | None = None

    @model_validator(mode="after")
    def _rising(self) -> "Input":
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError(f"range is {list(self.range)}, should be [lowest, highest]")
        if self.scale == 0.0:
            raise ValueError("scale is 0, so the signal would vanish; use sign: -1 to reverse it")
        return self

    def si(self, raw: Any) -> float:
        """The signal in SI; NaN for what is no number."""
        return float(to_si(self.sign * (self.scale * _number(raw) + self.offset), self.unit))

    def shown(self, value: float) -> str:
        """A value in SI as text, in the unit of the file."""
        return with_unit(from_si(value, self.unit), self.unit)

    @property
    def said(self) -> str:
        """The range in words."""
        return "{:g} to {:g}".format(*self.range) if self.range else "any"

    @property
    def ends(self) -> tuple[float, float]:
        """The range in SI."""
        low, high = self.range or (-math.inf, math.inf)
        return float(to_si(low, self.unit)), float(to_si(high, self.unit))


class Command(FileTable):
    """A command that is written."""

    name: str
    rated: Annotated[Number, Field(gt=0.0)]
    sign: Literal[1, -1] = 1


class Clock(FileTable):
    name: str
    unit: str = "s"


class Channel(ChannelTable[Command, Input]):
    """One valve and its motor."""

    @model_validator(mode="after")
    def _units_fit(self) -> "Channel":
        _check_units(self, _READ)
        if self.speed.range is None:
            raise ValueError("speed.range is missing: the lowest and highest speed that the sensor can show")
        return self


def _check_units(table: FileTable, signals: Iterable[str]) -> None:
    """ValueError for a unit of something else than what one of the signals of a table is."""
    for signal in signals:
        source, wanted = getattr(table, signal), quantity_of(signal, "motor")
        if source is not None and (found := unit(source.unit).quantity) != wanted:
            raise ValueError(f"{signal}: {source.unit} is a unit of {found}; use {USUAL_UNITS[wanted]}")


class Link(FileTable):
    """A whole link file."""

    FORMAT = "hydro_env/link/1"

    protocol: Literal["udp", "opcua"]
    address: str
    listen: str = ""
    cycle_s: Annotated[Number, Field(ge=1e-3, le=1.0)]
    watchdog_s: Annotated[Number, Field(le=10.0)]
    when_late: Literal["hold", "zero"] = "hold"
    command_limit_percent: Annotated[Number, Field(gt=0.0, le=FIRST_LIMIT)] = FIRST_LIMIT
    rate_limit: Annotated[Number, Field(gt=0.0, le=1000.0)] = 2.0
    count: str = ""
    time: Clock | None = None
    heartbeat: str = ""
    setpoint: Input | None = None
    supply: Input | None = None
    temperature: Input | None = None
    channel_1: Channel
    channel_2: Channel

    @model_validator(mode="after")
    def _whole(self) -> "Link":
        if self.watchdog_s < 3.0 * self.cycle_s:
            raise ValueError(f"watchdog_s is {self.watchdog_s:g}, should be at least three times cycle_s")
        if self.protocol == "udp":
            for key in ("address", "listen"):
                host_and_port(key, getattr(self, key))
            if not self.count:
                raise ValueError("count is missing: datagrams may be lost or come in another order")
        elif not self.address.startswith("opc.tcp://"):
            raise ValueError(f"address is {self.address!r}, should begin with opc.tcp://")
        if self.time is not None and unit(self.time.unit).quantity != "time":
            raise ValueError(f"time: {self.time.unit} is no unit of time; use s or ms")
        _check_units(self, RIG_SIGNALS)
        names = [*self.names, *(each.name for each in self.commands), *filter(None, [self.heartbeat])]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"the name {twice!r} stands for two things")
        return self

    @property
    def commands(self) -> tuple[Command, Command]:
        return self.channel_1.command, self.channel_2.command

    @property
    def inputs(self) -> dict[str, Input]:
        """What is read, by "setpoint", "speed_1", ..."""
        found = {signal: getattr(self, signal) for signal in RIG_SIGNALS}
        for n, channel in enumerate((self.channel_1, self.channel_2), 1):
            found |= {f"{signal}_{n}": getattr(channel, signal) for signal in _READ}
        return {key: source for key, source in found.items() if source is not None}

    @property
    def names(self) -> list[str]:
        """The names of all that is read."""
        clocks = [self.count, self.time.name if self.time else ""]
        return [*filter(None, clocks), *(source.name for source in self.inputs.values())]

    def frozen_after(self, key: str) -> float:
        """How long a signal may repeat itself under command, s."""
        return self.inputs[key].frozen_s or (FROZEN_S if key.startswith("speed") else math.inf)

    @property
    def stop_s(self) -> float:
        """Time within which any cause ends in zero commands, s; that of a frozen sensor counts from when it has been frozen for
        `frozen_after`."""
        return self.watchdog_s + 2.0 * self.cycle_s

    def warnings(self, limit: float) -> Iterator[str]:
        """Lines that an operator should read first. `limit`: the largest command, as a share of the rated one."""
        yield f"commands up to {100.0 * limit:g} % of the rated ones, {100.0 * self.rate_limit:g} % a second"
        frozen = max(self.frozen_after(f"speed_{c}") for c in (1, 2))
        end = f"{self.stop_s:g} s"
        yield f"zero within {end} of a fault; of a speed that is frozen within {end} after {frozen:g} s"
        if not self.heartbeat:
            yield "no heartbeat: the rig cannot tell when this program or the network is gone"
        if not self.count:
            yield "no count: a program of the rig that has stopped shows only in frozen signals"

    def sample(self, raw: Mapping[str, Any]) -> Sample:
        """What came from the rig, by name, as a sample."""
        values = {key: source.si(raw.get(source.name)) for key, source in self.inputs.items()}
        count = _number(raw.get(self.count)) if self.count else None
        time = float(to_si(_number(raw.get(self.time.name)), self.time.unit)) if self.time else None
        return Sample(count, time, values)

    def outputs(self, shares: Any, beat: int) -> dict[str, float]:
        """What is written, by name, for commands (2,) as shares of the rated ones."""
        found: dict[str, float] = {
            each.name: each.sign * each.rated * float(share)
            for each, share in zip(self.commands, shares, strict=True)
        }
        return found | ({self.heartbeat: beat} if self.heartbeat else {})


def host_and_port(key: str, text: str) -> tuple[str, int]:
    """`HOST:PORT` of a key. ValueError for anything else."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"{key} is {text!r}, should be HOST:PORT")
    return host, int(port)


def load_link(path: str | Path) -> Link:
    """Reads a link file; InputError with one line naming file and key for anything that is wrong."""
    return checked(Link, read_yaml(path, "a link to a rig in YAML"), path)
