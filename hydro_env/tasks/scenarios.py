"""What is driven: set-point and loads as functions of time, on the control grid.

A scenario is one of `SCENARIOS`, a mapping of step tables, or a `Scenario`:

    {"duration": 3.0, "setpoint_rpm": [[0.2, 400], [1.5, -100]], "load_Nm": [[1.0, 0.5, 0.0]]}

Each row of a table is a time in s and what is in force from then on (zero before the first row); loads have one
column per channel. A load acts against positive speed. Loads of the scenarios here are shares of `NOMINAL_TORQUE`. Their speeds
and loads are those of the paper's rig; on another one they are scaled to its size, tables of one's own are not.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import pi
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from ..arrays import Floats
from ..errors import InputError, check_known, shown
from ..plant import PAPER, Scales
from ..streams import Component, Streams
from ..units import RPM
from ..validation import FileTable, Number, checked

#: Nominal load torque, N m; the paper gives none. At the rated command of 73 V a valve holds 600 rpm against
#: tau = D dp - B w with Km dp = Kq x - D w, x being what current and dead zone leave of the opening: 1.3 N m for the
#: paper's weaker valve V2 without dead zone, but only 0.8 N m for the weaker valve of the weakest twentieth of the
#: pairs of `train`. So nearly all pairs can do what the scenarios ask.
NOMINAL_TORQUE = 0.8
#: Largest time (s), set-point (rpm) and load (N m) of a step table.
LARGEST = 1e6


@dataclass(frozen=True)
class Reference:
    """A scenario on the control grid: `setpoint` (T + 1,) in rad/s, `load` (T + 1, 2) in N m, rows at n * period."""

    setpoint: Floats
    load: Floats


@dataclass(frozen=True)
class Scenario:
    """`duration` in s and `profile(time, stream)` -> set-point (len(time),) in rpm, loads (len(time), 2) in N m.

    A `random` scenario draws another profile in each episode from `stream`, a NumPy generator; the others must not use it. One
    that draws many `together` gets `Streams` of n episodes instead and returns set-points (n, len(time)), loads
    (n, len(time), 2). `speed` and `torque` are what the speeds and loads of the profile are multiplied by.
    """

    name: str
    summary: str
    duration: float
    profile: Callable[[Floats, Any], tuple[Floats, Floats]]
    random: bool = False
    together: bool = False
    speed: float = 1.0
    torque: float = 1.0

    def on(self, scales: Scales) -> "Scenario":
        """The scenario of the paper's rig on one of these scales, with 600 rpm there rounded to two digits here."""
        speed = float(f"{600.0 * scales.speed:.2g}") / 600.0
        if speed == scales.torque == 1.0:
            return self
        summary = f"{self.summary}; speeds times {speed:.3g}, loads times {scales.torque:.3g}"
        return replace(self, summary=summary, speed=speed, torque=scales.torque)

    def steps(self, period: float) -> int:
        """Number of control periods in an episode. InputError if not even one fits."""
        steps = round(self.duration / period)
        if steps < 1:
            raise InputError(f"scenario {self.name!r}: {self.duration:g} s is less than the control period")
        return steps

    def reference(self, period: float, stream: np.random.Generator | None = None) -> Reference:
        """The profile on the grid of a control period in s; a random one is drawn from `stream`."""
        if self.together and stream is not None:
            streams = Streams(Component.SCENARIO, [int(stream.integers(2**63))], [0])
            return Reference(*(each[0] for each in self.profiles(period, streams)))
        return Reference(*self._profile(period, stream))

    def profiles(self, period: float, streams: Streams) -> tuple[Floats, Floats]:
        """Set-points (n, T + 1) in rad/s and loads (n, T + 1, 2) in N m, each row as `reference` with its stream has it; of a
        scenario that is not random one row for all."""
        if self.together:
            return self._profile(period, streams)
        sources = [streams.generator(row) for row in range(len(streams))] if self.random else [None]
        setpoints, loads = zip(*(self._profile(period, source) for source in sources), strict=True)
        return np.stack(setpoints), np.stack(loads)

    def _profile(self, period: float, source: Any) -> tuple[Floats, Floats]:
        """What `profile` draws from a source, in SI and on this rig."""
        setpoint, load = self.profile(_grid(self.steps(period), period), source)
        return np.asarray(setpoint, float) * RPM * self.speed, np.asarray(load, float) * self.torque


@lru_cache(maxsize=8)
def _grid(steps: int, period: float) -> Floats:
    """Instants of the rows, rounded so that a step at 2 s falls into the row 2 s on every grid."""
    time = np.round(np.arange(steps + 1) * period, 9)
    time.setflags(write=False)
    return time


def _held(time: Floats, table: Floats) -> Floats:
    """Values (len(time), n) of a step table (m, 1 + n), zero before its first row."""
    values = np.pad(table[:, 1:], ((1, 0), (0, 0)))
    return values[table[:, 0].searchsorted(time, side="right")]


def _tables(name: str, summary: str, duration: float, setpoint: ArrayLike, load: ArrayLike = ()) -> Scenario:
    """A scenario from step tables; loads in N m."""
    tables = np.asarray(setpoint, float).reshape(-1, 2), np.asarray(load, float).reshape(-1, 3)
    return Scenario(name, summary, duration, partial(_table_profile, *tables))


def _table_profile(setpoint: Floats, load: Floats, time: Floats, stream: None) -> tuple[Floats, Floats]:
    return _held(time, setpoint)[:, 0], _held(time, load)


def _share(rows: Sequence[tuple[float, float, float]]) -> Floats:
    """Loads given as shares of the nominal torque."""
    return np.asarray(rows) * np.array([1.0, NOMINAL_TORQUE, NOMINAL_TORQUE])


def _sine(time: Floats, stream: np.random.Generator | None) -> tuple[Floats, Floats]:
    return 400.0 * np.sin(2.0 * pi * 0.5 * time), np.zeros((time.size, 2))


def _disturbance(time: Floats, stream: np.random.Generator | None) -> tuple[Floats, Floats]:
    wave = 0.5 + 0.4 * np.sin(2.0 * pi * 1.5 * time)
    load = NOMINAL_TORQUE * np.stack([wave, 1.0 - wave], axis=1)
    load[time < 1.5] = 0.0
    return np.where(time < 0.2, 0.0, 400.0), load


def _held_together(time: Floats, changes: Floats, values: Floats) -> Floats:
    """Values (n, m) in force from the instants `changes` (n, m) on, in their order, zero before: (n, len(time))."""
    count, most = values.shape
    edges, padded = np.zeros((count, most + 2), np.int64), np.zeros((count, most + 1))
    edges[:, 1:-1], edges[:, -1] = time.searchsorted(changes), time.size
    padded[:, 1:] = values
    return np.repeat(padded.ravel(), (edges[:, 1:] - edges[:, :-1]).ravel()).reshape(count, time.size)


def _random_steps(time: Floats, streams: Streams) -> tuple[Floats, Floats]:
    # A set-point of up to 600 rpm either way every 0.3-2 s, standstill now and then; in two of three episodes each
    # motor has a load of its own that changes every 0.5-2 s.
    most = int(time[-1] / 0.3) + 2
    gaps, rests, levels = streams.random((3, most)).swapaxes(0, 1)
    first = np.zeros((len(gaps), 1))
    changes = 0.2 * gaps[:, :1] + np.concatenate([first, np.cumsum(0.3 + 1.7 * gaps[:, 1:], axis=1)], axis=1)
    setpoint = _held_together(time, changes, np.where(rests < 0.1, 0.0, 600.0 * (2.0 * levels - 1.0)))
    load = np.zeros((*setpoint.shape, 2))
    loaded = np.flatnonzero(streams.random(1)[:, 0] < 2.0 / 3.0)
    for channel in (0, 1):
        gaps, levels = streams.random((2, most), loaded).swapaxes(0, 1)
        torque = NOMINAL_TORQUE * (2.0 * levels - 1.0)
        load[loaded, :, channel] = _held_together(time, np.cumsum(0.5 + 1.5 * gaps, axis=1), torque)
    return setpoint, load


def _random_profiles(time: Floats, streams: Streams) -> tuple[Floats, Floats]:
    setpoint, load = _random_steps(time, streams)
    # In every second episode the set-point goes from level to level in ramps: a moving mean over 0.1-1 s.
    ramps, length = streams.random(2).T
    ramped = np.flatnonzero(ramps < 0.5)
    if time.size > 1:
        periods = (0.1 + 0.9 * length[ramped, None]) / (time[1] - time[0])
        window = np.maximum(1, np.rint(periods)).astype(np.int64)
        total = np.cumsum(setpoint[ramped], axis=1)
        back = np.arange(time.size) - window
        before = np.where(back < 0, 0.0, np.take_along_axis(total, np.maximum(back, 0), axis=1))
        setpoint[ramped] = (total - before) / window
    return setpoint, load


def _random_drives(time: Floats, streams: Streams) -> tuple[Floats, Floats]:
    # Up to 0.3 s of rest, then as random_profiles, but half of the episodes have no load and a quarter the same on both
    # motors: sudden loads on one motor alone make differences that nothing prevents and that drown all others.
    setpoint, load = _random_profiles(time, streams)
    rest, kind = streams.random(2).T
    setpoint[time < 0.3 * rest[:, None]] = 0.0
    load[kind < 0.75, :, 1] = load[kind < 0.75, :, 0]
    load[kind < 0.5] = 0.0
    return setpoint, load


#: The scenarios by name.
SCENARIOS: dict[str, Scenario] = {scenario.name: scenario for scenario in (
    _tables(
        "setpoint_steps", "the paper's section 4.1: 0 -> 600 -> -200 -> 600 rpm without load", 6.0,
        [[0.2, 600.0], [2.0, -200.0], [4.0, 600.0]],
    ),
    _tables(
        "load_step", "the paper's section 4.2: 600 rpm with 10 % of the nominal torque, 100 % from 2 s to 4 s", 6.0,
        [[0.2, 600.0]], _share([(0.2, 0.1, 0.1), (2.0, 1.0, 1.0), (4.0, 0.1, 0.1)]),
    ),
    _tables(
        "staircase", "up and down through standstill in small steps, one a second", 8.0,
        [[0.2, 150.0], [1.0, 300.0], [2.0, 450.0], [3.0, 300.0], [4.0, 150.0], [5.0, 0.0], [6.0, -150.0],
         [7.0, -300.0]],
    ),
    Scenario("sine", "400 rpm at 0.5 Hz through standstill, no load", 6.0, _sine),
    _tables(
        "unequal_load", "400 rpm; the nominal torque on one motor only, then on the other", 6.0,
        [[0.2, 400.0]], _share([(1.5, 1.0, 0.0), (3.5, 0.0, 1.0), (5.0, 0.0, 0.0)]),
    ),
    Scenario("disturbance", "400 rpm; from 1.5 s opposed loads that oscillate at 1.5 Hz", 5.0, _disturbance),
    Scenario("random_steps", "for training: random set-points, random loads on each motor", 6.0, _random_steps, True, True),
    Scenario("random_profiles", "random_steps with ramps for steps in every second episode", 6.0, _random_profiles, True, True),
    Scenario("random_drives", "random_profiles from rest, most without unequal loads", 6.0, _random_drives, True, True),
)}  # fmt: skip


def load_scenario(source: str | Mapping[str, Any] | Scenario, scales: Scales = PAPER) -> Scenario:
    """A scenario from its name, on a rig of these scales, from step tables, or a scenario: one of `SCENARIOS` too is
    scaled, others are returned as they are.

    InputError, in one line that names the key, for anything that is not right.
    """
    if isinstance(source, Scenario):
        return source.on(scales) if SCENARIOS.get(source.name) is source else source
    if isinstance(source, str):
        check_known("unknown scenario", [source], SCENARIOS)
        return SCENARIOS[source].on(scales)
    if not isinstance(source, Mapping):
        raise InputError(f"scenario is {shown(source)}, expected {', '.join(SCENARIOS)} or step tables")
    given = checked(_StepTables, source, "scenario")
    return _tables(given.name, "step tables", given.duration, given.setpoint_rpm, given.load_Nm)


def _rows(width: int) -> AfterValidator:
    """For a step table of `width` columns, whose times rise."""

    def check(rows: Any) -> Floats:
        try:
            table = np.asarray(rows, dtype=float).reshape(-1, width)
            fits = len(table) == len(rows)
        except (TypeError, ValueError, OverflowError):
            fits = False
        if not fits:
            columns = "[time, value]" if width == 2 else "[time, channel 1, channel 2]"
            raise ValueError(f"expected rows {columns}")
        if not (np.abs(table) <= LARGEST).all() or (np.diff(table[:, 0]) <= 0.0).any():
            raise ValueError(f"times must rise and all values lie within +-{LARGEST:g}")
        return table

    return AfterValidator(check)


class _StepTables(FileTable):
    """A scenario as users write it, times in s."""

    name: str = "custom"
    duration: Annotated[Number, Field(ge=1e-4, le=1e5)]
    setpoint_rpm: Annotated[Any, _rows(2)] = ()
    load_Nm: Annotated[Any, _rows(3)] = ()
