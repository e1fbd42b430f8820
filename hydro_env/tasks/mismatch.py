"""How the two valves of a rig differ: splits, distributions and named pairs, and the drawing of pairs from them.

A mismatch is a named split or pair of `splits.yaml`, a YAML file, or a mapping from parameters to what they are: a number,
one for each of the two valves, or a range from which each valve is drawn by itself.

    {"Kq": {"loguniform": [0.31, 0.476]}, "dead_zone.overlap_positive": [70e-6, 0.0], "R": 100.0}

With `base` it is a split or pair of `splits.yaml` with these parameters changed or added: {"base": "train", "R": 100.0}.

A range may name the plant it is meant for, {"R": {"uniform": [90, 110], "meant_for": 100}}: on a plant whose own R is
31.2 Ohm it then is 28.1 to 34.3 Ohm.

Parameters are those of the plant ("Kq", "dead_zone.overlap_positive", ...) and of the speed sensors, see
`SENSOR_PARAMETERS`; values are SI. A value that no component has is refused; one that is unusual for such a rig gives a
warning (`InputWarning`).
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, Strict, model_validator

from ..arrays import AnyArray, Floats, Integers
from ..errors import InputError, InputWarning, check_known, located, shown, suggestion
from ..plant import CATALOGUE, PAPER, Parameter, PlantModel, parameter_of, scales_of
from ..plant.model_files import values_set_by
from ..reading import read_yaml, shipped_yaml
from ..streams import Component, Streams
from ..units import with_unit
from ..validation import FileTable, Number, checked, known, two_numbers
from .rigs import DERIVED, PACE, QUANTITIES, paced, rig_values

#: Faults of the speed sensors, which act on the measurement alone and so are no part of the plant.
SENSOR_PARAMETERS = {
    "speed_sensor.stuck_from": Parameter("stuck_from", "s", inf, 0.0, inf, typical=1.0, source="assumed",
        note="time of the episode from which on the reading stays"),
    "speed_sensor.noise_factor": Parameter("noise_factor", "1", 1.0, 0.0, 100.0, typical=20.0, log=True, source="assumed",
        note="noise over the usual noise"),
}  # fmt: skip

_RIG_EFFECTS = [effect for effect in CATALOGUE.values() if effect.scope == "rig"]
#: Parameters that both channels share.
_OF_RIG = {f"{effect.name}.{p.name}" for effect in _RIG_EFFECTS for p in effect.parameters}
#: The name of no mismatch at all: the plant's own pair of valves.
OWN = "own"
#: Cases of successive episodes of one seed lie this far apart, so that the rows of a batch meet different ones.
CASE_STRIDE = 389
#: Times that a pair is drawn again until it lies outside the ranges that it is to leave.
MAX_DRAWS = 10_000


_Ends = Annotated[list[Number], Field(min_length=2, max_length=2)]


class Range(FileTable):
    """What one parameter may be, as in a file: `fixed` (a number, or one for each channel), or from low to high, evenly
    (`uniform`) or evenly in its logarithm (`loguniform`).

    `at_most` names a parameter drawn before that lowers the upper end. `common`: both valves have the same value. `meant_for`
    says for which plant the range holds, on others what is drawn is scaled: "paper" for the paper's rig, by the size of the plant
    (`Scales`); a number is the value of the plant's own parameter, which is divided by it.
    """

    fixed: Annotated[Any, AfterValidator(two_numbers)] = None
    uniform: _Ends | None = None
    loguniform: _Ends | None = None
    at_most: str | None = None
    common: bool = False
    meant_for: Literal["paper"] | Annotated[Number, Field(gt=0.0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _numbers(cls, data: Any) -> Any:
        return data if isinstance(data, Mapping | Range) else {"fixed": two_numbers(data)}

    @model_validator(mode="after")
    def _one_range(self) -> "Range":
        if [self.fixed, self.uniform, self.loguniform].count(None) != 2:
            raise ValueError("expected a number, a pair, or uniform or loguniform: [low, high]")
        low, high = self.ends
        if not self.fixed and low > high:
            raise ValueError(f"[{low:g}, {high:g}] is no range from low to high")
        if self.loguniform and low <= 0.0:
            raise ValueError(f"loguniform needs a low end above zero, found {low:g}")
        return self

    @property
    def ends(self) -> tuple[float, float]:
        """The values of both channels, or the ends of the range."""
        low, high = self.fixed or self.uniform or self.loguniform or (nan, nan)
        return low, high

    @property
    def low(self) -> tuple[float, float]:
        """The lower ends of both channels."""
        return self.fixed or (self.ends[0],) * 2

    @property
    def high(self) -> tuple[float, float]:
        """The upper ends of both channels."""
        return self.fixed or (self.ends[1],) * 2

    def value(self, share: Floats, drawn: Mapping[str, Floats]) -> Floats:
        """Values (n, 2) for shares (n, 2) or (n, 1) in [0, 1) of the range, given the parameters `drawn` before."""
        low, high = np.array(self.low), np.array(self.high)
        if self.common:
            share = share[:, :1].repeat(share.shape[1], axis=1)
        if (low == high).all():
            return np.broadcast_to(low, (len(share), 2)).copy()
        if self.at_most is not None:
            high = np.minimum(high, drawn[self.at_most])
        if self.loguniform:
            return low * np.exp(share * np.log(high / low))
        return low + share * (high - low)

    def scaled(self, name: str, drawn: Floats, model: PlantModel) -> Floats:
        """What was drawn (n, 2), as it is on a plant of this model."""
        if self.meant_for is None:
            return drawn
        if self.meant_for == "paper":
            return drawn * [scales_of(model, c).factor(parameter_of(name).unit) for c in (0, 1)]
        return drawn * (np.array(model.pair(name)) / self.meant_for)

    def check(self, name: str, before: "Mapping[str, Range]") -> None:
        """InputError for a range that this parameter, behind those above it, cannot have."""
        _check_bounds(name, self.ends)
        if self.fixed and name in _OF_RIG and self.fixed[0] != self.fixed[1]:
            raise InputError("both channels share this value; one number expected")
        if self.at_most is not None and self.at_most not in before:
            raise InputError(f"at_most: {shown(self.at_most)} is not among the parameters above it")
        if self.at_most is not None and min(before[self.at_most].low) < self.ends[0]:
            raise InputError(f"at_most: {self.at_most} may be lower than the low end {self.ends[0]:g}")
        if self.meant_for is not None and name in SENSOR_PARAMETERS:
            raise InputError("meant_for: a sensor's fault does not depend on the plant")


@dataclass(frozen=True)
class Pairs:
    """Drawn pairs: `values` maps parameters to (n, 2), `fault` names the fault of each pair ("" for none)."""

    values: dict[str, Floats]
    fault: tuple[str, ...]


#: The named splits and pairs of `splits.yaml`.
SPLITS: "dict[str, Mismatch]" = {}
NAMED_PAIRS: "dict[str, Mismatch]" = {}


def _shared(ranges: dict[str, Range]) -> dict[str, Range]:
    """The ranges; what both channels share has one value."""
    shared = {*_OF_RIG, *QUANTITIES, PACE}
    return {
        name: each.model_copy(update={"common": each.common or name in shared})
        for name, each in ranges.items()
    }


Ranges = Annotated[dict[str, Range], AfterValidator(_shared)]


class Mismatch(FileTable):
    """A distribution of pairs, with the keys of `splits.yaml` in files.

    `cases` is the length of a fixed list (None: endless). `outside` names a split: at least one value of each pair lies outside
    its ranges. `faults` maps the name of a fault to what its parameters become on one channel; without `healthy`, the share of
    pairs that have none, pairs have the faults in turn. `rig` has the quantities by which whole rigs are drawn, or `pace` alone
    (see `rigs`).
    """

    name: str
    summary: str = ""
    entropy: Annotated[int, Strict(), Field(ge=0, lt=2**128)] = 0
    cases: Annotated[int, Strict(), Field(ge=1, lt=2**128)] | None = None
    outside: Annotated[str, known("split", SPLITS)] | None = None
    ranges: Annotated[Ranges, Field(alias="parameters")]
    faults: dict[str, Ranges] = Field(default_factory=dict)
    healthy: Annotated[Number, Field(ge=0.0, le=1.0)] | None = None
    rig: Ranges = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits(self) -> "Mismatch":
        parts = {"": self.ranges} | {f"faults.{fault}: ": changed for fault, changed in self.faults.items()}
        for part, ranges in parts.items():
            for place, (name, each) in enumerate(ranges.items()):
                with located(f"{part}{name}"):
                    each.check(name, dict(list(ranges.items())[:place]))
        self._check_rig()
        inside = [(each, self.ranges[name]) for name, each in self._left.items()]
        if self.outside and all(r.low <= own.low and own.high <= r.high for r, own in inside):
            raise ValueError(f"outside: no range reaches beyond those of {self.outside!r}")
        return self

    def _check_rig(self) -> None:
        """ValueError for quantities of a rig that are unknown, lacking or not above zero."""
        check_known("rig: unknown quantity", self.rig, (*QUANTITIES, PACE))
        for name, each in self.rig.items():
            if min(each.low) <= 0.0:
                raise ValueError(f"rig: {name} should be above zero")
        whole = self.rig.keys() - {PACE}
        for name in QUANTITIES if whole else ():
            if name not in self.rig:
                raise ValueError(f"rig: {name} is missing ({QUANTITIES[name]})")
        if whole and "Fs" not in self.ranges:
            raise ValueError("rig: the bristles of the spool need a range of Fs among the parameters")

    @property
    def _left(self) -> dict[str, Range]:
        """The ranges outside of which at least one value of each pair lies."""
        bounds = SPLITS[self.outside].ranges if self.outside else {}
        return {name: each for name, each in bounds.items() if name in self.ranges}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters that a pair of this mismatch may set."""
        of_faults = (name for fault in self.faults.values() for name in fault)
        of_rig = DERIVED if len(self.rig) > 1 else ()
        return tuple(dict.fromkeys((*self.ranges, *of_rig, *of_faults)))

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the plant that these parameters need."""
        named = {name.partition(".")[0] for name in self.parameters}
        return tuple(name for name in CATALOGUE if name in named)

    def case(self, seed: int, episode: int) -> int:
        """Number of the case that an episode of a seed meets, `seed` modulo the list in the first; -1 if endless."""
        return -1 if self.cases is None else (seed + CASE_STRIDE * episode) % self.cases

    def draw(
        self, seeds: Sequence[int], episodes: Sequence[int], cases: Sequence[int], model: PlantModel
    ) -> Pairs:
        """One pair for each seed and episode, or for each case where these are not negative: all are or none.

        `model` supplies the healthy values of parameters that only a fault changes. A pair depends on nothing but its
        own seed and episode, or its case.
        """
        count = len(seeds)
        if self.rig and scales_of(model) != PAPER:
            raise InputError(f"mismatch {self.name!r} draws whole rigs: take the plant paper_dead_zone")
        if cases[0] >= 0:
            streams = Streams(Component.CASE, [0] * count, cases, self.entropy)
        else:
            streams = Streams(Component.PAIR, seeds, episodes, self.entropy)
        values, rows = self._draw(streams), np.arange(count if self.outside else 0)
        for _ in range(MAX_DRAWS):
            rows = self._inside(values, rows)
            if not rows.size:
                break
            for name, redrawn in self._draw(streams, rows).items():
                values[name][rows] = redrawn
        else:
            raise InputError(f"mismatch {self.name!r}: no pair of {MAX_DRAWS} lies outside {self.outside!r}")
        quantities = {name: values.pop(name) for name in self.rig}
        values = {name: self.ranges[name].scaled(name, drawn, model) for name, drawn in values.items()}
        if len(self.rig) > 1:
            values |= rig_values(quantities, values["Fs"], model)
        fault = ("",) * count
        if self.faults:
            values, fault = self._with_faults(values, streams, cases, model)
        if PACE in self.rig:
            values |= paced(quantities[PACE], values, model)
        return Pairs(values, fault)

    def _draw(self, streams: Streams, rows: Integers | slice = slice(None)) -> dict[str, Floats]:
        ranges = {**self.rig, **self.ranges}
        shares = streams.random((len(ranges), 2), rows)
        values: dict[str, Floats] = {}
        for column, (name, each) in enumerate(ranges.items()):
            values[name] = each.value(shares[:, column], values)
        return values

    def _inside(self, values: Mapping[str, Floats], rows: Integers) -> AnyArray:
        """Those of some rows whose values all lie in the ranges that they are to leave."""
        for name, bounds in self._left.items():
            drawn = values[name][rows]
            rows = rows[((drawn >= bounds.low) & (drawn <= bounds.high)).all(axis=1)]
        return rows

    def _with_faults(
        self, values: dict[str, Floats], streams: Streams, cases: Sequence[int], model: PlantModel
    ) -> tuple[dict[str, Floats], tuple[str, ...]]:
        """The values with a fault in one channel, and the faults' names."""
        names = list(self.faults)
        for name in self.parameters:
            if name not in values:
                values[name] = np.tile(own_values(name, model), (len(cases), 1))
        in_turn = self.healthy is None and cases[0] >= 0
        chosen = cases if in_turn else (streams.random(1)[:, 0] * 2 * len(names)).astype(int)
        every = np.full(len(cases), True)
        sick = every if self.healthy is None else streams.random(1)[:, 0] >= self.healthy
        shares = streams.random((max(map(len, self.faults.values())), 1, 2))
        drawn = []
        for row, number in enumerate(chosen):
            fault, channel = names[number % len(names)], number // len(names) % 2
            faulty: dict[str, Floats] = {}
            for (name, each), share in zip(self.faults[fault].items(), shares[row], strict=False):
                faulty[name] = each.value(share, faulty)
                if sick[row]:
                    changed = each.scaled(name, faulty[name], model)[0, channel]
                    if len(self.rig) > 1 and name in DERIVED:  # the rig has a value of its own
                        changed *= values[name][row, channel] / model.pair(name)[channel]
                    values[name][row, channel] = changed
            drawn.append(fault if sick[row] else "")
        return values, tuple(drawn)


def own_values(name: str, model: PlantModel) -> tuple[float, float]:
    """The values of a parameter where no mismatch sets it: the model's, and healthy sensors."""
    if name in SENSOR_PARAMETERS:
        return (SENSOR_PARAMETERS[name].nominal,) * 2
    return model.pair(name)


def draw_pairs(
    mismatch: str | Mapping[str, Any] | Mismatch, cases: int | Iterable[int], *, seed: int = 0,
    model: PlantModel | None = None,
) -> Pairs:  # fmt: skip
    """The first `cases` pairs, or those with these numbers.

    Of a split with a fixed list these are its cases, whatever the seed; of an endless one those which an environment
    seeded with `seed` meets in its episodes of these numbers. InputError for a number beyond the list.
    """
    source = load_mismatch(mismatch)
    assert source is not None
    numbers = list(range(cases)) if isinstance(cases, int) else [int(number) for number in cases]
    if source.cases is not None and any(not 0 <= number < source.cases for number in numbers):
        raise InputError(f"split {source.name!r}: a case beyond 0 ... {source.cases - 1} is asked for")
    listed = [-1] * len(numbers) if source.cases is None else numbers
    return source.draw([seed] * len(numbers), numbers, listed, model or PlantModel())


# --- reading ----------------------------------------------------------------------------------------------------------
def load_mismatch(source: str | Path | Mapping[str, Any] | Mismatch | None) -> Mismatch | None:
    """A mismatch from its name, a YAML file, a mapping, or a mismatch (returned as it is); None, the plant's own pair, for
    None and `own`.

    InputError, in one line that names file and key, for anything that is not right.
    """
    if source is None or isinstance(source, Mismatch):
        return source
    if isinstance(source, Mapping):
        return _read_own("mismatch", source, "mismatch")
    shipped = {**SPLITS, **NAMED_PAIRS}
    if not isinstance(source, str | Path):
        raise InputError(f"mismatch is {shown(source)}, expected {', '.join(shipped)}, a file or a mapping")
    text, named = str(source), {**shipped, OWN: None}
    if text in named:
        return named[text]
    path = Path(source)
    if path.suffix in (".yaml", ".yml"):
        data = read_yaml(path, "a mismatch in YAML")
        if not isinstance(data, dict):
            raise InputError(f"{path}: expected `parameter: value` lines")
        return _read_own(path.stem, data, str(path))
    raise InputError(f"unknown mismatch {shown(text)}: {suggestion(text, named)}, or the path of a YAML file")


def default_mismatch(plant: Any, split: str = "train") -> str:
    """`own` for a plant file that sets itself one of the values that `split` would draw over it, else `split`. `plant` and
    errors as in `load_model`."""
    return OWN if values_set_by(plant) & SPLITS[split].ranges.keys() else split


def _check_bounds(name: str, pair: tuple[float, float]) -> None:
    """InputError for an unknown parameter, and for a value that no component has."""
    if name not in SENSOR_PARAMETERS:
        if name.startswith("speed_sensor."):
            raise InputError(f"the speed sensor has no such parameter: {suggestion(name, SENSOR_PARAMETERS)}")
        PlantModel(values={name: pair})
    elif min(pair) < 0.0:
        raise InputError(f"{min(pair):g} is below zero")


def _read_own(name: str, data: Mapping[str, Any], where: str) -> Mismatch:
    """A mismatch of the user's: the keys of a split, or parameters alone, and perhaps `base` beside them."""
    own = dict(data)
    base = own.pop("base", None)
    if "parameters" not in own:
        own = {"parameters": own}
    given = own["parameters"]
    if base is not None:
        check_known(f"{where}: base: unknown split or pair", [base], list(_SHIPPED))
        inherited = _SHIPPED[base]["parameters"]
        own = {**_SHIPPED[base], **own}
        own["parameters"] = {**inherited, **given} if isinstance(given, Mapping) else given
    mismatch = checked(Mismatch, {"name": name, **own}, where)
    parts = {key: mismatch.ranges[key] for key in given if key not in SENSOR_PARAMETERS}
    if unusual := [text for key, each in parts.items() if (text := _unusual(key, each))]:
        told = f"{where}: unusual for such a rig: {', '.join(unusual)}"
        other = "a range for another plant says by `meant_for` for which value"
        warnings.warn(f"{told}; {other}", InputWarning, stacklevel=3)
    return mismatch


def _unusual(name: str, given: Range) -> str:
    """What is beyond what the catalogue holds plausible, "" if nothing is; on the plant that the range is meant for."""
    p, ends = parameter_of(name), (min(given.low), max(given.high))
    size = given.meant_for / p.nominal if isinstance(given.meant_for, float) else 1.0
    if all(end in (0.0, p.neutral) or size * p.low <= end <= size * p.high for end in ends):
        return ""
    found = f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g} to {ends[1]:g}"
    return f"{name} {found} (usual {size * p.low:g} to {with_unit(size * p.high, p.unit)})"


def _read_package() -> dict[str, Any]:
    """The content of `splits.yaml` by name, from which `SPLITS` and `NAMED_PAIRS` are filled."""
    data = shipped_yaml(__package__, "splits.yaml")
    pairs = {name: {"parameters": what} for name, what in data["pairs"].items()}
    for read, tables in ((SPLITS, data["splits"]), (NAMED_PAIRS, pairs)):
        for name, what in tables.items():
            read[name] = checked(Mismatch, {"name": name, **what}, f"splits.yaml: {name}")
    return data["splits"] | pairs


_SHIPPED = _read_package()
