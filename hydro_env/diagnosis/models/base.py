"""What a diagnosis needs of a model of the rig: channels, unknowns, candidates, and simulated measurements.

Two models exist: `dynamic_rig.DynamicRig`, the dynamic plant, and `steady_valve.SteadyValve`, the reduced model for axes of
which only command and speed (and perhaps pressure) are known. Everything after this file works on either.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite, isnan
from typing import Any, Self

import numpy as np

from ...plant import CATALOGUE, Effect, Parameter, PlantModel, scales_of
from ...plant.catalogue.form_corrections import follows
from ...units import BAR, LPM, MILLIMETRE, RPM
from ..input.parts import Part

#: What was simulated of each channel: samples (n,) in the order of its segments.
Samples = dict[int, np.ndarray]
#: Rows of one log and signal that a fit looks at, at most, those of 12 s at 500 Hz; the proof looks at all of them.
MAX_ROWS = 6000
#: Length of the blocks that have a variance of their own, s: shorter than the shaft's memory (`estimation.uncertainty`).
BLOCK_S = 0.1
#: Signals that a model may predict, with the unit they are shown in and its size in SI.
UNITS = {
    "speed": ("rpm", RPM),
    "current": ("A", 1.0),
    "pressure": ("bar", BAR),
    "spool": ("mm", MILLIMETRE),
    "flow": ("lpm", LPM),
    "mean_line_pressure": ("bar", BAR),
    "motor_pressure": ("bar", BAR),
}
#: The SI units of these.
SI = {"rpm": "rad/s", "A": "A", "bar": "Pa", "mm": "m", "lpm": "m3/s"}
#: Called with the number of simulations done, where wanted.
Progress = Callable[[int], None] | None
#: Signals of which only changes are compared: the level of the mean line pressure is that of the supply and of two sensors.
LEVEL_FREE = ("mean_line_pressure",)


@dataclass(frozen=True)
class Request:
    """One simulation that is wanted: parameter values of `channel` (0, 1), each a number, or of the whole rig (None), each a
    pair, in which NaN is the value of the model as given. `like`: another one with the same names, whose steps it takes; so their
    difference is that of the parameters, without that of the steps' errors."""

    channel: int | None
    values: Mapping[str, Any]
    like: "Request | None" = None

    def on(self, channel: int) -> Mapping[str, float]:
        """The values that are wanted on a channel, by name."""
        if self.channel is not None:
            return self.values if self.channel == channel else {}
        pairs = ((name, value[channel]) for name, value in self.values.items())
        return {n: v for n, v in pairs if not isnan(v)}

    @cached_property
    def effects(self) -> frozenset[str]:
        """The effects of which a parameter is given."""
        return frozenset(name.split(".", 1)[0] for name in self.values if "." in name)


@dataclass
class Segment:
    """One signal of one channel in one log: the measured samples (n,), which rows of the log they are, and how many rows later
    they were taken (None: none); the simulation has `finer` points a row."""

    log: int
    channel: int
    signal: str
    measured: np.ndarray
    rows: np.ndarray
    inside: np.ndarray
    period: float
    place: slice = field(default_factory=lambda: slice(0, 0))
    late: np.ndarray | None = None
    finer: int = 1

    @property
    def step(self) -> int:
        """Rows of the log from one sample to the next."""
        return int(self.rows[1] - self.rows[0]) if self.rows.size > 1 else 1

    @cached_property
    def used(self) -> np.ndarray:
        """Which rows count (n,)."""
        return self.inside & np.isfinite(self.measured)

    @cached_property
    def filled(self) -> np.ndarray:
        """The measured samples (n,), 0 where there is none."""
        return np.nan_to_num(self.measured)

    def taken(self, simulated: np.ndarray, every: int = 1) -> np.ndarray:
        """The samples (n,) at the times of the rows, of a simulation that has one in `every` rows; if rows are late, of one
        with `finer` points a row. Moved to the level of the measurement if the level of this signal means nothing."""
        if self.late is None:
            found = simulated[:: self.step // every][: self.rows.size]
        else:
            # From the points before: the command of a row acts only after its measurement.
            place = self.finer * (self.rows + self.late)
            point = np.clip(np.floor(place + 1e-6).astype(int), 1, simulated.size - 1)
            found = simulated[point] + (place - point) * (simulated[point] - simulated[point - 1])
        level_free = self.signal in LEVEL_FREE and self.used.any()
        return found + np.mean(self.measured[self.used] - found[self.used]) if level_free else found

    @cached_property
    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """The first row of every block (b,), and how many rows of it count (b,)."""
        first = np.arange(0, self.rows.size, max(10, round(BLOCK_S / self.period)))
        return first, np.add.reduceat(self.used.astype(float), first)

    def stretches(self, stretch_s: float) -> np.ndarray:
        """The number of the stretch of `stretch_s` seconds that each row is in (n,)."""
        return (np.arange(self.rows.size) * self.period / stretch_s).astype(int)

    def error(self, simulated: np.ndarray) -> np.ndarray:
        """Measured less simulated (n,), 0 where a row does not count."""
        return np.where(self.used, self.filled - simulated[self.place], 0.0)

    def left(self, simulated: np.ndarray) -> np.ndarray:
        """Measured less simulated over the rows that count."""
        return (self.measured - simulated[self.place])[self.used]


@dataclass(frozen=True)
class Joined:
    """The samples of all segments of a channel, one behind the other: `filled` and `used` (n,), the first row of every block of
    `BLOCK_S` and how many rows of it count (b,), and by block the number of its signal in `signals`."""

    signals: tuple[str, ...]
    filled: np.ndarray
    used: np.ndarray
    first: np.ndarray
    count: np.ndarray
    signal: np.ndarray


class Segments(list[Segment]):
    """The segments of a channel, in the order of their places."""

    @cached_property
    def by_signal(self) -> dict[str, list[Segment]]:
        """The segments of each signal, in the order of the logs."""
        signals = dict.fromkeys(s.signal for s in self)
        return {signal: [s for s in self if s.signal == signal] for signal in signals}

    @cached_property
    def joined(self) -> Joined:
        signals = tuple(self.by_signal)
        samples = [s.filled for s in self], [s.used for s in self]
        blocks = [s.place.start + s.blocks[0] for s in self], [s.blocks[1] for s in self]
        numbers = [np.full(s.blocks[0].size, signals.index(s.signal)) for s in self]
        return Joined(signals, *map(np.concatenate, (*samples, *blocks, numbers)))


class RigModel:
    """A model of the rig with the logs it is fitted to: `parts` of logs, of which it predicts the `signals`, those of the ones
    given that are logged.

    `progress` is called with the number of rig simulations done, `without` are effects that are no candidates.

    `simulation_is_cheap`: every candidate may be refitted as far as it goes. `has_hidden_states`: friction and inertia make local
    minima, the parameters are those of a machine, and what is left of a signal can be its noise. `coupled`: the model has an
    effect of the whole rig, by which both channels act on each other, so they are estimated together. `followed` are the channels
    whose simulated speed follows the measured one. `own` are parameters that only this model has, or has with another range.
    """

    simulation_is_cheap = False
    has_hidden_states = True
    coupled = False
    followed: frozenset[int] = frozenset()
    notes: Sequence[str] = ()
    own: Mapping[str, Parameter] = {}

    def __init__(
        self, model: PlantModel, parts: list[Part], signals: Sequence[str], every_row: bool, progress: Progress,
        without: frozenset[str],
    ) -> None:  # fmt: skip
        self.model, self.parts, self.progress, self.without = model, parts, progress, without
        self.channels = tuple(c for c in (0, 1) if any(c in part.log.channels for part in parts))
        self.segments = {c: Segments(self._measured(c, signals, every_row)) for c in self.channels}
        logged = {s.signal for segments in self.segments.values() for s in segments}
        self.signals = tuple(s for s in signals if s in logged)

    def _measured(self, channel: int, signals: Sequence[str], every_row: bool) -> Iterator[Segment]:
        """The measurements of a channel, which lie one behind the other in a vector."""
        place = 0
        for number, part in enumerate(self.parts):
            log = part.log
            step = 1 if every_row else max(1, -(-len(log) // MAX_ROWS))
            rows, period = np.arange(0, len(log), step), log.period * step
            late = None if log.late is None else log.late[rows] / log.period
            for signal in (s for s in signals if log.has(s, channel)):
                measured, inside = getattr(log, signal)[rows, channel], part.inside[rows]
                where = slice(place, place + rows.size)
                yield Segment(
                    number, channel, signal, measured, rows, inside, period, where, late, part.finer
                )
                place = where.stop

    def base(self, channel: int) -> list[str]:
        """Names of the parameters that calibration may adjust, with those of effects that the model as given has there."""
        raise NotImplementedError

    def supported(self) -> list[str]:
        """Effects of the catalogue that this model and its logs can have."""
        raise NotImplementedError

    def candidates(self) -> list[str]:
        """Those of them that are sought: on one channel at least they are not given."""
        wanted = [n for n in self.supported() if n not in self.without]
        places = {n: self.channels if CATALOGUE[n].scope == "channel" else (None,) for n in wanted}
        return [n for n, on in places.items() if not all(self.has(n, c) for c in on)]

    def predict(self, requests: Sequence[Request]) -> list[Samples]:
        """For every request, by channel: the simulated samples (n,) in the order of `segments[channel]`."""
        raise NotImplementedError

    def with_parts(self, parts: list[Part], every_row: bool) -> "RigModel":
        """The same model on other logs, with the accuracy of the proof."""
        raise NotImplementedError

    def has(self, effect: str, channel: int | None) -> bool:
        """Whether the model as given has an effect on a channel (None: on any)."""
        acts, channels = self.model.effects.get(effect), self.channels if channel is None else (channel,)
        return acts is not None and any(not CATALOGUE[effect].is_neutral(acts[c]) for c in channels)

    def given(self, name: str, channel: int) -> float:
        """The value of a parameter in the model as given."""
        return self.model.value(name, channel)

    def written(self, values: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """Estimated values, a pair of both channels each, as they go to a model file of the plant."""
        return dict(values)

    def following(self, channels: Collection[int]) -> "RigModel":
        """The same model with the simulated speed of these channels drawn to the measured one; none: simulated freely."""
        return self

    def view(self, **changes: Any) -> Self:
        """The same model with other values of some attributes; its threads are shared."""
        twin = copy(self)
        vars(twin).update(changes)
        return twin


def given_effects(rig: RigModel, channel: int) -> list[Effect]:
    """The effects that the model as given has on a channel and logs can adjust: one of the whole rig acts by the flows of both
    channels, so both must be logged."""
    own = (CATALOGUE[e] for e in rig.model.declared if rig.has(e, channel))
    return [e for e in own if e.scope == "channel" or len(rig.channels) == 2]


def given_parameters(rig: RigModel, channel: int) -> list[str]:
    """The parameters of given effects on a channel, as "EFFECT.PARAMETER". A limit that is absent is not adjusted, and what a
    correction of form repeats follows its effect."""
    repeated = given_repeats(rig, channel)
    names = (f"{e.name}.{p.name}" for e in given_effects(rig, channel) for p in e.parameters)
    return [n for n in names if n not in repeated and isfinite(rig.given(n, channel))]


def given_repeats(rig: RigModel, channel: int) -> dict[str, str | float]:
    """What the corrections of form that the model as given has on a channel repeat, see `form_corrections.follows`."""
    found: dict[str, str | float] = {}
    for effect in given_effects(rig, channel):
        if corrected := next((e for e in effect.corrects if rig.has(e, channel)), None):
            found |= follows(effect.name, corrected)
    return found


def effect_in(rig: RigModel, name: str, channel: int | None) -> Effect:
    """An effect of the catalogue with the sizes that are usual on this rig; `channel` as in `Request`. First looks stand where
    many logs have shown them to lead to a minimum, so they do not move with what is about as large as on the paper's rig."""
    return scales_of(rig.model, channel).rough.effect(CATALOGUE[name])
