"""The rig log: what was commanded and measured on a rig, in SI."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import CHANNEL_SIGNALS, RIG_SIGNALS
from hydro_env.measured.table import check_size

__all__ = ["HELD", "RigLog", "field_of"]

#: Signals that are held until the next row; everything else is sampled.
HELD = ("command", "load", "setpoint")


def field_of(signal: str) -> str:
    """The attribute of `RigLog` that holds a signal."""
    return {"command": "command_V"}.get(signal, signal)


@dataclass(frozen=True)
class RigLog:
    """A log of T rows: row n holds what was measured at `time_s[n]` and the command held until `time_s[n + 1]`.

    Channel signals are (T, 2), column 0 = channel 1; a channel that is not in the log is NaN there, a signal that no
    channel has is None. `setpoint`, `supply`, `temperature` are (T,) or None. Single missing samples are NaN.
    Units: s, V, A, Pa, m, m3/s, K; a motor's speed is rad/s and its load N m, a cylinder's m/s and N (`kinds`).
    """

    time_s: np.ndarray
    command_V: np.ndarray
    speed: np.ndarray
    current: np.ndarray | None = None
    pressure: np.ndarray | None = None
    load: np.ndarray | None = None
    spool: np.ndarray | None = None
    flow: np.ndarray | None = None
    pressure_a: np.ndarray | None = None
    pressure_b: np.ndarray | None = None
    setpoint: np.ndarray | None = None
    supply: np.ndarray | None = None
    temperature: np.ndarray | None = None
    name: str = ""
    sha256: str = ""
    kinds: tuple[str, str] = ("motor", "motor")
    displacement: tuple[float | None, float | None] = (
        None,
        None,
    )  # m3/rad, or m2 for a cylinder, where known
    findings: tuple[Finding, ...] = field(default=(), compare=False)
    #: (column, unit) that a signal was read from and as, by "speed_1", ...
    read_as: dict[str, tuple[str, str]] = field(default_factory=dict, compare=False)

    def __len__(self) -> int:
        return len(self.time_s)

    def get(self, signal: str) -> np.ndarray | None:
        """The array of `signal` ("command", "speed", ..., "setpoint"), or None."""
        return getattr(self, field_of(signal))

    @property
    def mean_line_pressure(self) -> np.ndarray | None:
        """Mean of both line pressures (T, 2), Pa; None unless both are there."""
        if self.pressure_a is None or self.pressure_b is None:
            return None
        return 0.5 * (self.pressure_a + self.pressure_b)

    def has(self, signal: str, channel: int | None = None) -> bool:
        """Whether `signal` was recorded (of channel 0 or 1, where given)."""
        values = self.get(signal)
        if values is None or channel is None or values.ndim == 1:
            return values is not None
        return not bool(np.isnan(values[:, channel]).all())

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels in the log, counted from 0: those with a command and a speed."""
        return tuple(
            channel for channel in (0, 1) if self.has("command", channel) and self.has("speed", channel)
        )

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signals that at least one channel, or the rig, has."""
        return tuple(signal for signal in (*CHANNEL_SIGNALS, *RIG_SIGNALS) if self.has(signal))

    @cached_property
    def period(self) -> float:
        """The sample period in s: the mean step of a uniform log, the median step of another."""
        return _period(self.time_s)

    @cached_property
    def uniform(self) -> bool:
        """Whether all steps equal the period to 1 %."""
        steps = np.diff(self.time_s)
        return bool(np.all(np.abs(steps - np.median(steps)) <= 0.01 * np.median(steps) + 1e-9))

    def window(self, start: float, end: float) -> RigLog:
        """A copy of the rows with start <= time_s < end (s); ValueError where fewer than two are left."""
        keep = np.flatnonzero((self.time_s >= start) & (self.time_s < end))
        if len(keep) < 2:
            raise ValueError(f"fewer than two rows between {start:g} s and {end:g} s")
        return self._with_rows(lambda values, _: values[keep[0] : keep[-1] + 1].copy())

    def first(self, rows: int) -> RigLog:
        """The first so many rows."""
        return self._with_rows(lambda values, _: values[:rows])

    def resample(self, period: float) -> RigLog:
        """The log on an even grid of `period` s: commands, loads and set-points held, measurements interpolated, and
        NaN inside gaps (steps of more than 1.75 median ones).

        No filter is applied: noise above the new rate folds back. InputError where the grid would have more rows than any log.
        """
        if not period > 0.0:
            raise ValueError("the period must be positive")
        span = self.time_s[-1] - self.time_s[0]
        check_size(Path(self.name), int(min(span / period, 1e18)) * (1 + 2 * len(self.signals)))
        grid = self.time_s[0] + period * np.arange(int(np.floor(span / period + 1e-6)) + 1)
        # A grid point that misses a row by rounding alone must see that row's command.
        held = np.searchsorted(self.time_s, grid + 1e-6 * period, side="right") - 1
        steps = np.diff(self.time_s)
        wide = np.append(steps > 1.75 * float(np.median(steps)), False)
        gap = wide[held] & (grid > self.time_s[held] + 1e-6 * period)

        def put(values: np.ndarray, signal: str) -> np.ndarray:
            if signal == "time":
                return grid
            if signal in HELD:
                return values[held]
            if values.ndim == 1:
                return np.interp(grid, self.time_s, values)
            columns = np.column_stack([np.interp(grid, self.time_s, column) for column in values.T])
            columns[gap] = np.nan
            return columns

        return self._with_rows(put)

    def _with_rows(self, put: Any) -> RigLog:
        changed: dict[str, Any] = {"time_s": put(self.time_s, "time")}
        for signal in (*CHANNEL_SIGNALS, *RIG_SIGNALS):
            values = self.get(signal)
            if values is not None:
                changed[field_of(signal)] = put(values, signal)
        return replace(self, **changed)


def _period(time_s: np.ndarray) -> float:
    steps = np.diff(time_s)
    median = float(np.median(steps))
    mean = float(time_s[-1] - time_s[0]) / len(steps)
    period = mean if abs(mean - median) < 0.01 * median else median
    # Time stamps carry rounding; a period that is a whole number of microseconds but for that is meant to be one.
    whole = round(period * 1e6) / 1e6
    return whole if whole > 0 and abs(whole - period) <= 1e-6 * period else period
