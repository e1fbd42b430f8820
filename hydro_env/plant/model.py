"""A model of the rig: which values its parameters have and which effects act."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from ..errors import InputError, check_known
from ..files import write_text
from ..units import RPM
from .catalogue.effect import CATALOGUE, parameter_of
from .parameters import PARAMETERS
from .validation import check_channel, wrong_values

SCHEMA = "hydro_env/model/1"
#: Error of a speed, rad/s, by which a model that says nothing else chooses its steps: 0.1 rpm.
TOLERANCE = 0.1 * RPM
#: Base parameters that belong to a valve rather than to motor and line.
VALVE_PARAMETERS = (
    "m", "R", "L", "alpha", "k", "C", "Kq", "Fc", "Fs", "vs", "s0", "s1", "s2", "x_max", "k_stop", "v_stop", "u_rated",
)  # fmt: skip
#: Ports whose effects belong to a valve. Driver, supply and orifice law (its supply pressure) are the rig's.
VALVE_PORTS = ("coil", "force", "opening")


def ranges_of(
    ranges: Mapping[str, tuple[float, float]], values: Mapping[str, Sequence[float]]
) -> dict[str, tuple[float, float]]:
    """The ranges, by name, that hold the values of that name, if there are any."""
    return {
        n: (low, high)
        for n, (low, high) in ranges.items()
        if all(low <= v <= high for v in values.get(n, ()))
    }


@dataclass(frozen=True)
class PlantModel:
    """Values of a rig. `values` maps "Kq" or "dead_zone.overlap_positive" to a pair (channel 1, channel 2), SI.

    Only what differs from the nominal or neutral value need be there. An effect acts if it is in `effects`; it may be
    there with neutral values (then it may be varied later). `tolerance` is the error of a speed, rad/s, by which the steps of
    the integrator are chosen. `ranges` are what is known beforehand of some of the values, (least, greatest) on either channel; a
    value that is changed to one outside loses its range. InputError for unknown names, values that are no numbers, those outside
    of what a component can have (`Parameter.possible`), and a range that does not hold its value.
    """

    name: str = "nominal"
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    declared: tuple[str, ...] = ()
    tolerance: float = TOLERANCE
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 1e-6 * RPM <= self.tolerance <= 1e3 * RPM:
            raise InputError(
                f"model {self.name!r}: tolerance_rpm is {self.tolerance / RPM:g}, expected 1e-6 to 1000 rpm"
            )
        clean = {name: (float(pair[0]), float(pair[1])) for name, pair in self.values.items()}
        check_known(f"model {self.name!r}: unknown effect", self.declared, CATALOGUE)
        named = {n.split(".", 1)[0] for n in clean if "." in n} | set(self.declared)
        object.__setattr__(self, "values", clean)
        for name, _, wrong in wrong_values(self, clean):
            raise InputError(f"model {self.name!r}: {name}: {wrong}")
        object.__setattr__(self, "declared", tuple(n for n in CATALOGUE if n in named))
        for channel in (0, 1):
            check_channel(self, channel, f"model {self.name!r}")
        for name in self.ranges:
            self._check_range(name)

    def _check_range(self, name: str) -> None:
        effect, _, _ = name.rpartition(".")
        parameter_of(name)
        if effect and effect not in self.declared:
            raise InputError(f"ranges: {name}: the model does not have the effect {effect!r}")
        low, high = self.ranges[name]
        if not low <= high:
            raise InputError(f"ranges: {name}: [{low:g}, {high:g}] is no range from low to high")
        for value in self.pair(name):
            if not low <= value <= high:
                raise InputError(
                    f"ranges: {name} is {value:g}, outside of its own range of {low:g} to {high:g}"
                )

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

    def with_values(self, values: Mapping[str, Any], name: str | None = None) -> "PlantModel":
        """A new model with some values changed; a single number stands for both channels."""
        changed = dict(self.values)
        for key, value in values.items():
            pair = tuple(value) if hasattr(value, "__len__") else (value, value)
            if len(pair) != 2:
                raise InputError(f"{key}: one number, or one for each of the two channels, not {len(pair)}")
            changed[key] = (float(pair[0]), float(pair[1]))
        ranges = ranges_of(self.ranges, changed)
        return replace(self, values=changed, name=self.name if name is None else name, ranges=ranges)

    def without(self, effect: str) -> "PlantModel":
        """A new model in which this effect does not act."""

        def rest(table: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
            return {name: pair for name, pair in table.items() if name.rpartition(".")[0] != effect}

        declared = tuple(name for name in self.declared if name != effect)
        return replace(self, values=rest(self.values), declared=declared, ranges=rest(self.ranges))

    def __deepcopy__(self, memo: dict[int, Any]) -> "PlantModel":
        """Itself: a model never changes."""
        return self

    def to_dict(self, source: str | Mapping[str, str] = "") -> dict[str, Any]:
        """The content of the model file; `load_model` of it gives an equal model. `source` says where its values are from: one
        text for all, or one by name or effect."""
        data: dict[str, Any] = {"schema": SCHEMA, "name": self.name}
        if self.tolerance != TOLERANCE:
            data["tolerance_rpm"] = self.tolerance / RPM
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
        if self.ranges:
            data["ranges"] = {name: list(map(float, ends)) for name, ends in self.ranges.items()}
        if source:
            names = (*(n for n in self.values if "." not in n), *self.declared)
            data["sources"] = dict.fromkeys(names, source) if isinstance(source, str) else dict(source)
        return data

    def to_yaml(self, path: str | Path, source: str | Mapping[str, str] = "") -> None:
        """Writes the model file (atomically); `source` as in `to_dict`."""
        write_text(Path(path), yaml.safe_dump(self.to_dict(source), sort_keys=False))
