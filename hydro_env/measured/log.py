"""The rig log: what was commanded and measured on a rig, in SI."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hydro_env.errors import located
from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import CHANNEL_SIGNALS, RIG_SIGNALS
from hydro_env.measured.table import check_size

#: Signals that are held until the next row; everything else is sampled.
HELD = ("command", "load", "setpoint")


def field_of(signal: str) -> str:
    """The attribute of `RigLog` that holds a signal."""
    return {"command": "command_V", "time": "time_s"}.get(signal, signal)


@dataclass(frozen=True)
class RigLog:
    """A log of T rows: row n holds what was measured at `time_s[n]` and the command held until `time_s[n + 1]`.

    Channel signals are (T, 2), column 0 = channel 1; a channel that is not in the log is NaN there, a signal that no
    channel has is None. `setpoint`, `supply`, `temperature` are (T,) or None. Single missing samples are NaN.
    `late` (T,), if there: how much later than `time_s` the measurements of a row were taken, see `resample`.
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
    motor_pressure: np.ndarray | None = None
    setpoint: np.ndarray | None = None
    supply: np.ndarray | None = None
    temperature: np.ndarray | None = None
    late: np.ndarray | None = None
    name: str = ""
    sha256: str = ""
    kinds: tuple[str, str] = ("motor", "motor")
    #: m3/rad, or m2 for a cylinder, where known
    displacement: tuple[float | None, float | None] = (None, None)
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

    def of(self, signal: str, channel: int | None) -> np.ndarray | None:
        """The samples (T,) of `signal` of channel 0 or 1, or of the rig (None), or None; a view, not a copy."""
        values = self.get(signal)
        return values if values is None or channel is None else values[:, channel]

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels in the log, counted from 0: those with a command and a speed."""
        return tuple(c for c in (0, 1) if self.has("command", c) and self.has("speed", c))

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signals that at least one channel, or the rig, has."""
        return tuple(signal for signal in (*CHANNEL_SIGNALS, *RIG_SIGNALS) if self.has(signal))

    @cached_property
    def period(self) -> float:
        """The sample period in s: the mean step if rows come evenly, else the step of the even grid about which they lie, with
        some missing."""
        steps, passed = np.diff(self.time_s), self.time_s - self.time_s[0]
        median = period = float(np.median(steps))
        mean = float(passed[-1]) / len(steps)
        if abs(mean - median) < 1e-4 * median:
            period = mean
        elif float(np.quantile(np.abs(steps - median), 0.9)) < median:
            period = float(passed[-1]) / max(float(np.round(steps / median).sum()), 1.0)
            # The longer the stretch, the better the period, by which the rows of the next one are numbered.
            rows = 64
            while rows < 2 * len(passed):
                time = passed[:rows]
                number = np.round(time / period - _phase(time / period))
                apart = number - number.mean()
                period = float(apart @ time / max(float(apart @ apart), 1.0))
                rows *= 2
            if abs(period - median) > 0.05 * median:
                period = median
        # Time stamps carry rounding; a period that is a whole number of microseconds but for that is meant to be one.
        whole = round(period * 1e6) / 1e6
        return whole if whole > 0 and abs(whole - period) <= 1e-6 * period else period

    @cached_property
    def uniform(self) -> bool:
        """Whether all steps equal the period to 1 %."""
        steps = np.diff(self.time_s)
        return bool(np.all(np.abs(steps - np.median(steps)) <= 0.01 * np.median(steps) + 1e-9))

    def window(self, start: float, end: float) -> "RigLog":
        """A copy of the rows with start <= time_s < end (s); ValueError where fewer than two are left."""
        keep = np.flatnonzero((self.time_s >= start) & (self.time_s < end))
        if len(keep) < 2:
            raise ValueError(f"fewer than two rows between {start:g} s and {end:g} s")
        return self._with_rows(lambda values, _: values[keep[0] : keep[-1] + 1].copy())

    def first(self, rows: int) -> "RigLog":
        """The first `rows` rows."""
        return self._with_rows(lambda values, _: values[:rows])

    def resample(self, lead: float | np.ndarray = 0.0, even: bool = False) -> "RigLog":
        """The log on an even grid of its own period. Commands, loads and set-points are the mean of what is held within each
        step, so that they act from their own times on. Measurements stay as they are: those of the row nearest to a grid point,
        NaN if none is within half a step, and `late` says how much later than `time_s` they were taken.

        `lead`, of all rows or by row (T,): commands begin by this share of the step to the row before earlier. `even`: rows are
        taken as on the grid, their time stamps as uneven. InputError where the grid would have more rows than any log.
        """
        number, start, count = self._numbered()
        grid = np.arange(count)
        at = np.clip(np.searchsorted(number, grid), 1, len(number) - 1)
        near = np.where(grid - number[at - 1] <= number[at] - grid, at - 1, at)
        late = number[near] - grid
        known = np.abs(late) <= 0.5 + 1e-6

        def put(values: np.ndarray, signal: str) -> np.ndarray:
            if signal == "time":
                return start + self.period * grid
            if signal in HELD:
                return self.held(values, lead, even)
            return np.where(known if values.ndim == 1 else known[:, None], values[near], np.nan)

        return replace(self._with_rows(put), late=np.where(known & (not even), late * self.period, 0.0))

    def held(
        self, values: np.ndarray, lead: float | np.ndarray = 0.0, even: bool = False, finer: int = 1
    ) -> np.ndarray:
        """The mean of a signal (T,) or (T, 2) that is held, within each of `finer` parts of every step of the grid that
        `resample` makes with `lead` and `even`."""
        if values.ndim == 2:
            return np.column_stack([self.held(column, lead, even, finer) for column in values.T])
        number, _, count = self._numbered()
        if even:
            number = np.round(number)
        starts = number - lead * np.diff(number, prepend=number[0])
        knots = np.concatenate([[min(starts[0], 0.0)], starts, [max(starts[-1], count) + 1.0]])
        sums = np.concatenate([[0.0], np.cumsum(np.diff(knots) * np.concatenate([values[:1], values]))])
        return finer * np.diff(np.interp(np.arange(count * finer + 1) / finer, knots, sums))

    def _numbered(self) -> tuple[np.ndarray, float, int]:
        """Where the rows are on an even grid, in steps (T,), and the first time and number of points of that grid."""
        period = self.period
        span = self.time_s[-1] - self.time_s[0]
        with located(self.name):
            check_size(int(min(span / period, 1e18)) * (1 + 2 * len(self.signals)))
        number = (self.time_s - self.time_s[0]) / period
        # Rows lie about the grid, not behind it: its phase is the mean of theirs on the circle.
        phase = _phase(number)
        phase = 0.0 if abs(phase) < 1e-6 else phase  # rounding
        number -= phase
        return number, float(self.time_s[0]) + period * phase, int(np.floor(number[-1] + 0.5)) + 1

    def _with_rows(self, put: Any) -> "RigLog":
        changed: dict[str, Any] = {}
        for signal in ("time", "late", *CHANNEL_SIGNALS, *RIG_SIGNALS):
            values = self.get(signal)
            if values is not None:
                changed[field_of(signal)] = put(values, signal)
        return replace(self, **changed)


def _phase(number: np.ndarray) -> float:
    """What rows (T,), in steps of a grid, are behind it on the average, from -0.5 to 0.5."""
    return float(np.angle(np.mean(np.exp(2j * np.pi * number)))) / (2.0 * np.pi)
