"""What a practice rig is asked to do: manoeuvres on the grid of control periods, each seed with its own.

Amplitudes, levels, times and order are drawn, set-points and loads for a rig of the paper's size (`Plan.scaled` for another). A
round of a run lasts `ROUND` s; a longer log has more rounds with other
values, a shorter one the beginning of the first.

    fit_1   valve bench, open loop: slow and fast triangles, steps of many sizes both ways, steps under load, small loops
            about a bias, a sine of rising frequency, full steps; each channel in its own order
    fit_2   operation, closed loop: set-point steps, staircase, reversing sine, load steps both ways
    sealed  other values, order and mixture of both

Or it plays commands from a table, such as the next experiment that a diagnosis proposes (`plans_of`).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats
from ..errors import InputError, located
from ..measured.formats import read_table
from ..waveforms import triangle

Stream = np.random.Generator

#: Length of a round, and the longest log that is played from a table, s.
ROUND, MAX_DURATION = 12.0, 3600.0
#: Columns of such a table, besides `time_s`.
_COMMANDS, _LOADS = ("command_1_V", "command_2_V"), ("load_1_Nm", "load_2_Nm")


class Plan(NamedTuple):
    """What one channel is asked to do: `value` is a set-point in rpm where `closed`, else a fraction of the rated command;
    `load` is in N m. Each (T,), one row for a control period."""

    value: Floats
    closed: Bools
    load: Floats

    @staticmethod
    def join(parts: "Iterable[Plan]") -> "Plan":
        """One after the other."""
        return Plan(*map(np.concatenate, zip(*parts, strict=True)))

    def scaled(self, speed: float, torque: float) -> "Plan":
        """The same with set-points and loads times as large."""
        return Plan(np.where(self.closed, speed, 1.0) * self.value, self.closed, torque * self.load)

    def ramped(self, command: float, setpoint: float) -> "Plan":
        """The same with commands and set-points that change by so much from row to row at most."""
        value, now = self.value.copy(), 0.0
        for n, (wanted, closed) in enumerate(zip(self.value, self.closed, strict=True)):
            now = 0.0 if n and closed != self.closed[n - 1] else now
            step = setpoint if closed else command
            value[n] = now = now + min(max(wanted - now, -step), step)
        return Plan(value, self.closed, self.load)


# --- profiles: arrays over a number of periods ---------------------------------------------------------------------------
def _hold(levels: Sequence[float] | Floats, rows: int) -> Floats:
    """Levels of equal length, which fill the rows."""
    at = np.arange(rows) * len(levels) // rows
    return np.asarray(levels, dtype=float)[at]


def _triangle(middle: float, amplitude: float, cycles: float, rows: int) -> Floats:
    return middle + amplitude * triangle(np.arange(rows) * cycles / rows)


def _sweep(middle: float, amplitude: float, low: float, high: float, rows: int, dt: float) -> Floats:
    """Sine of rising frequency (Hz)."""
    t, duration = np.arange(rows) * dt, rows * dt
    phase = 2.0 * math.pi * low * duration / math.log(high / low) * (np.power(high / low, t / duration) - 1.0)
    return middle + amplitude * np.sin(phase)


def _open(value: Floats, load: Floats | float = 0.0, *, closed: bool = False) -> Plan:
    return Plan(value, np.full(value.size, closed), np.broadcast_to(load, value.shape))


_closed = partial(_open, closed=True)


def _rows(rng: Stream, usual: Sequence[float], dt: float) -> list[int]:
    """Rows of the parts of a round: up to 35 % longer or shorter than usual (s) against each other."""
    lengths = np.asarray(usual) * rng.uniform(0.65, 1.35, len(usual))
    return [max(1, round(s / dt)) for s in lengths * (ROUND / lengths.sum())]


def _sign(rng: Stream) -> float:
    return float(rng.choice([-1.0, 1.0]))


# --- parts of the valve bench: fractions of the rated command ------------------------------------------------------------
def _slow_triangle(rng: Stream, rows: int, dt: float) -> Plan:
    return _open(_triangle(0.0, _sign(rng) * rng.uniform(0.45, 0.9), 1.0, rows))


def _fast_triangle(rng: Stream, rows: int, dt: float) -> Plan:
    return _open(_triangle(0.0, _sign(rng) * rng.uniform(0.35, 0.75), 1.0, rows))


def _steps(rng: Stream, rows: int, dt: float) -> Plan:
    """Steps of many sizes both ways in random order, every third back to zero. Sizes are log-uniform within equal parts of their
    range."""
    sizes = 0.08 * (0.9 / 0.08) ** ((np.arange(4) + rng.random(4)) / 4)
    sizes = rng.permutation(np.concatenate([sizes, -sizes]))
    return _open(_hold(np.insert(sizes, [2, 4, 6, 8], 0.0), rows))


def _full_steps(rng: Stream, rows: int, dt: float) -> Plan:
    sign = _sign(rng)
    return _open(_hold([sign, -sign, 0.0], rows))


def _loaded_steps(rng: Stream, rows: int, dt: float) -> Plan:
    """Steps while a load is on, with it and against it."""
    lift = _sign(rng) * rng.uniform(0.35, 0.85)
    one, other = rng.uniform(0.25, 0.75, 3), -rng.uniform(0.25, 0.75, 3)
    levels = [one[0], one[0], one[1], one[2], other[0], other[0], other[1], other[2]]
    weight = np.array([0.0, lift, lift, lift, 0.0, -lift, -lift, -lift])
    return _open(_hold(levels, rows), _hold(weight, rows))


def _small_loops(rng: Stream, rows: int, dt: float) -> Plan:
    bias = _sign(rng) * rng.uniform(0.25, 0.55)
    return _open(_triangle(bias, rng.uniform(0.06, 0.16), 2.0, rows))


def _rising_sine(rng: Stream, rows: int, dt: float) -> Plan:
    bias = _sign(rng) * rng.uniform(0.25, 0.45)
    return _open(_sweep(bias, rng.uniform(0.1, 0.2), rng.uniform(0.7, 1.5), rng.uniform(9.0, 18.0), rows, dt))


def _random_steps(rng: Stream, rows: int, dt: float) -> Plan:
    return _open(_hold(rng.uniform(-0.8, 0.8, 10), rows))


def _steps_on_load(rng: Stream, rows: int, dt: float) -> Plan:
    return _open(_hold(_sign(rng) * rng.uniform(0.2, 0.65, 4), rows), rng.uniform(0.3, 0.7))


#: A part of the bench and its usual length, s.
_BENCH = (
    (_slow_triangle, 3.2), (_steps, 2.9), (_loaded_steps, 2.0), (_full_steps, 0.9), (_small_loops, 1.0),
    (_rising_sine, 1.4), (_fast_triangle, 0.7),
)  # fmt: skip
_REST = 0.2


# --- the runs: plans from draws that both channels share and draws of the channel's own ----------------------------------
def _bench(_: Stream, own: Stream, dt: float) -> Plan:
    """Open loop; each channel in its own order, so that the supply sees many pairs."""
    rest, *rows = _rows(own, (_REST, *(usual for _, usual in _BENCH)), dt)
    parts = [make(own, n, dt) for (make, _), n in zip(_BENCH, rows, strict=True)]
    return Plan.join([_open(np.zeros(rest)), *(parts[n] for n in own.permutation(len(parts)))])


def _operation(common: Stream, own: Stream, dt: float) -> Plan:
    """Closed loop: set-points as in the paper's experiments, slow reversals, load steps both ways.

    Both channels follow the same set-point, as on the rig; their loads differ.
    """
    rest, jumping, holding, waving, climbing, backing = _rows(common, (_REST, 3.0, 2.0, 2.6, 2.4, 2.0), dt)
    sign = _sign(common)
    jumps = sign * np.array([1.0, -1.0, 1.0]) * common.uniform(150.0, 690.0, 3)
    up = common.uniform([40.0, 110.0, 240.0], [110.0, 240.0, 380.0])
    stairs = sign * np.array([*up, -up[0], -up[1], 0.0])
    held = _sign(common) * common.uniform(250.0, 550.0, 2) * np.array([1.0, -1.0])
    amplitude, low, high = common.uniform(150.0, 330.0), common.uniform(0.3, 0.7), common.uniform(1.0, 2.0)
    wave = _sweep(0.0, amplitude, low, high, waving, dt)
    order = common.permutation(5)
    lift = _sign(own) * own.uniform(0.35, 0.75)
    pushes = own.permutation([lift, 0.3 * lift, -0.5 * lift, 0.0])
    parts = [
        _closed(_hold(jumps, jumping)),
        _closed(np.full(holding, held[0]), _hold([0.0, *pushes], holding)),
        _closed(wave),
        _closed(_hold(stairs, climbing)),
        _closed(np.full(backing, held[1]), _hold([0.0, *-pushes], backing)),
    ]
    return Plan.join([_closed(np.zeros(rest)), *(parts[n] for n in order)])


def _proof(common: Stream, own: Stream, dt: float) -> Plan:
    """Other values and another mixture of both: four parts of a bench about one in closed loop, which comes at the same time
    on both channels."""
    rest, moving, *opened = _rows(common, (_REST, 4.5, 2.7, 1.3, 2.1, 1.6), dt)
    before = common.integers(0, len(opened) + 1)
    signs = _sign(common) * np.array([1.0, -1.0, 1.0, 1.0, -1.0])
    levels = common.uniform(120.0, 650.0, 5) * signs
    lift, late = own.uniform(0.3, 0.7), own.uniform(0.3, 0.7)
    jumps = _hold(levels, moving)
    within = (np.arange(moving) * len(levels) / moving) % 1.0
    closed = _closed(jumps, np.where(within > late, lift, 0.0) * np.sign(jumps))
    kinds = own.permutation(np.array([_random_steps, _steps_on_load, _slow_triangle, _rising_sine]))
    parts = [make(own, rows, dt) for make, rows in zip(kinds, opened, strict=True)]
    return Plan.join([_open(np.zeros(rest)), *parts[:before], closed, *parts[before:]])


#: Makes a round of a channel's plan.
RUNS: dict[str, Callable[[Stream, Stream, float], Plan]] = {
    "fit_1": _bench, "fit_2": _operation, "sealed": _proof,
}  # fmt: skip


def plans(run: str, seeds: np.random.SeedSequence, dt: float, steps: int) -> Iterator[Plan]:
    """The plan of each channel in a run of `RUNS` of `steps` control periods of `dt` s."""
    shared, *own = seeds.spawn(3)
    for alone in map(np.random.default_rng, own):
        common = np.random.default_rng(
            shared
        )  # from its beginning for each channel: both draw the same from it
        rounds = [RUNS[run](common, alone, dt)]
        while sum(r.value.size for r in rounds) < steps:
            rounds.append(RUNS[run](common, alone, dt))
        whole = Plan.join(rounds)
        yield Plan(whole.value[:steps], whole.closed[:steps], whole.load[:steps])


# --- commands from a table -----------------------------------------------------------------------------------------------
def plans_of(path: str | Path, rated_V: tuple[float, float], period: float) -> list[Plan]:
    """The plan of each channel from a CSV file with `time_s` and `command_1_V`, `command_2_V` or both; `load_1_Nm` and
    `load_2_Nm` may be there.

    Each row holds until the next one, the last as long as the one before it; a channel without a column is at rest. Rows are
    taken at every `period` s. InputError for a file that cannot be read, a column that is missing, a value that is no number
    or beyond the rated command, and times that do not rise.
    """
    table = read_table(Path(path), _understood)
    with located(path):
        for name, values in table.columns.items():
            for n in np.flatnonzero(np.isnan(values))[:1]:
                raise table.refused(name, "no number; write one in every row", n)
        time = table.columns["time_s"]
        if len(time) < 2:
            raise InputError("one row; expected at least two rows with rising time_s")
        for n in np.flatnonzero(np.diff(time) <= 0.0)[:1]:
            raise table.refused("time_s", "does not rise; each row must be later than the one before", n + 1)
        end = 2.0 * time[-1] - time[-2] - time[0]
        if end > MAX_DURATION:
            raise InputError(f"{end:g} s of commands; expected {MAX_DURATION:g} s at most")
        at = np.arange(max(1, round(end / period))) * period
        rows = np.searchsorted(time - time[0], at + 1e-9 * period, side="right") - 1
        nothing = np.zeros(len(time))
        found = []
        for command, load, rated in zip(_COMMANDS, _LOADS, rated_V, strict=True):
            volts = table.columns.get(command, nothing)
            for n in np.flatnonzero(np.abs(volts) > rated * (1.0 + 1e-9))[:1]:
                raise table.refused(command, f"{volts[n]:g} is beyond the rated command of {rated:g} V", n)
            found.append(_open((volts / rated)[rows], table.columns.get(load, nothing)[rows]))
    return found


def _understood(names: Sequence[str]) -> list[str]:
    """The columns of a table of commands that are read."""
    found = [name for name in ("time_s", *_COMMANDS, *_LOADS) if name in names]
    if "time_s" not in found or not {*found} & {*_COMMANDS}:
        raise InputError("columns time_s and command_1_V, command_2_V or both are needed")
    return found
