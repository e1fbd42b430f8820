"""Localisation: every component replayed with measured neighbours, and the conditions under which it errs.

coil         measured current against the simulated one (only the command acts on it)
shaft        measured speed against the shaft driven by the measured pressure and the logged load, with the displacement, inertia
             and friction that explain it best: those of the calibrated model make up for what is missing elsewhere
valve_flow   flow that the measured speed and pressure need against the flow that the model's valve gives

A component whose own replay errs by more than its noise owns part of the residual. Only what the logs hold can be replayed; with
speed alone the whole residual is the valve's and motor's together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter, savgol_filter

from ...units import BAR, RPM
from ..estimation import Estimate, effective_samples, noise_floor
from ..estimation.box import minimum_in_box
from ..input.parts import filled
from ..models.base import RigModel
from ..models.shaft import shaft_speed
from ..state import Estimates, State

__all__ = ["Location", "Shape", "locate", "run", "shape"]

_FLOW = ("command, V", "flow over displacement, rpm", RPM)
#: Base parameters of the shaft.
_SHAFT = ("D", "J", "B")
#: An equation errs if its mean square error is above so many times the noise's; from what share of all equations it is listed.
ERRS, LISTED = 1.1, 0.02
#: A regime is named if its mean square error is so many times that of all, and it holds neither next to nothing nor nearly all.
CONTRAST, LEAST_ROWS, MOST_ROWS = 1.3, 0.03, 0.9


@dataclass(frozen=True)
class Shape:
    """The error as a curve over the quantity that its equation depends on, see `shape`."""

    over: str
    error: str
    points: list[list[float]]
    explains: float
    with_direction: float


@dataclass(frozen=True)
class Location:
    """An equation that errs on a channel: its share of the residual, in which regime, with what shape, and the windows that hold
    most of it, `logs` the number of the fit log that each window is in."""

    equation: str
    channel: int
    share: float
    regime: str
    windows: list[tuple[float, float]]
    shape: Shape
    logs: list[int]

    def as_dict(self) -> dict[str, object]:
        return {
            "equation": self.equation, "channel": str(self.channel + 1), "share_of_gap": round(self.share, 3),
            "regime": self.regime,
            "windows_s": [[round(a, 3), round(b, 3)] for a, b in self.windows], "windows_log": self.logs,
            "shape": vars(self.shape),
        }  # fmt: skip


@dataclass
class _Replay:
    equation: str
    error: np.ndarray
    noise: float
    time: np.ndarray
    log: np.ndarray
    regimes: dict[str, np.ndarray]
    over: np.ndarray
    units: tuple[str, str, float]  # of `over`, of `error`, size of the latter in SI

    @property
    def ratio(self) -> float:
        return float(np.sqrt(np.mean(self.error**2)) / max(self.noise, 1e-30))


def run(state: State) -> State:
    """Locates what the calibrated model leaves, where effects are missing."""
    if state.verdict in ("none", "calibration"):
        return state
    return replace(state, locations=locate(state.rig, state.calibrated))


def locate(rig: RigModel, estimates: Estimates) -> list[Location]:
    """The equations that err beside the models `estimates` on the fit logs, largest share first."""
    found = []
    for channel, estimate in estimates.items():
        replays = _replays(rig, estimate, channel)
        excess = {r.equation: max(r.ratio**2 - ERRS, 0.0) for r in replays}
        whole = sum(excess.values())
        for r in replays:
            if whole > 0.0 and excess[r.equation] > LISTED * whole and r.ratio > ERRS:
                windows, logs = _windows(r)
                form, share = shape(r.over, r.error, *r.units), excess[r.equation] / whole
                found.append(Location(r.equation, channel, share, _regime(r), windows, form, logs))
    return sorted(found, key=lambda p: (p.channel, -p.share))


def _replays(rig: RigModel, estimate: Estimate, channel: int) -> list[_Replay]:
    """Replays of the components over all fit logs, one behind the other."""
    by_equation: dict[str, list[_Replay]] = {}
    shafts = _shafts(rig, channel) if rig.has_hidden_states else {}
    best = _best_shaft(estimate, rig, channel, list(shafts.values()))
    for number in range(len(rig.parts)):
        for replay in _replays_of_log(rig, estimate, channel, number, shafts.get(number), best):
            replay.log[:] = number
            by_equation.setdefault(replay.equation, []).append(replay)
    return [_joined(replays) for replays in by_equation.values()]


def _replays_of_log(
    rig: RigModel, estimate: Estimate, channel: int, number: int, shaft: _Shaft | None, best: dict[str, float]
) -> list[_Replay]:
    """What can be replayed of the signals of one log; the shaft with the values `best`."""
    part = rig.parts[number]
    mine = {s.signal: s for s in rig.segments[channel] if s.log == number}
    speed = mine["speed"]
    simulated = {n: estimate.simulated[channel][s.place] for n, s in mine.items()}
    used, period, time = speed.used, speed.period, part.log.time_s[speed.rows]
    command, rated = part.log.command_V[speed.rows, channel], rig.model.value("u_rated", channel)
    openings, speeds = _openings(command, rated), _speeds(speed.measured)
    found: list[_Replay] = []
    if "current" in mine:
        error = mine["current"].measured - simulated["current"]
        late = time > time[0] + 0.6 * (time[-1] - time[0])
        regimes = {"large current": np.abs(command) > 0.6 * rated, "late in the log": late}
        units = ("command, V", "current, A", 1.0)
        found.append(_replay("coil", error, period, time, regimes, used, command, units))
    if "mean_line_pressure" in mine:
        error = mine["mean_line_pressure"].measured - simulated["mean_line_pressure"]
        units = ("command, V", "mean line pressure, bar", BAR)
        found.append(_replay("lines", error, period, time, {**openings, **speeds}, used, command, units))
    if shaft is not None:
        units = ("speed, rpm", "speed lost or gained within a second, rpm", RPM)
        error = shaft.error(best)
        found.append(_replay("shaft", error, period, time, speeds, shaft.used, shaft.speed / RPM, units))
        value = estimate.values(channel)
        numbers = {n: value.get(n, rig.model.value(n, channel)) for n in ("D", "Km", "V", "beta")}
        missing = _missing_flow(shaft, simulated, numbers)
        found.append(_replay("valve_flow", missing, period, time, openings, shaft.used, command, _FLOW))
    else:
        name = "valve and motor" if rig.has_hidden_states else "valve_flow"
        motor = rig.parts[0].log.kinds[channel] == "motor"
        units = _FLOW if motor else ("command, V", "speed, mm/s", 1e-3)
        error = speed.measured - simulated["speed"]
        found.append(_replay(name, error, period, time, {**openings, **speeds}, used, command, units))
    return found


def _openings(command: np.ndarray, rated: float) -> dict[str, np.ndarray]:
    """Regimes (n,) of the valve by its command."""
    size = np.abs(command)
    return {
        "opening near zero": size < 0.25 * rated, "medium opening": (size >= 0.25 * rated) & (size < 0.6 * rated),
        "large opening": size >= 0.6 * rated,
        "opening positive": command > 0.02 * rated, "opening negative": command < -0.02 * rated,
    }  # fmt: skip


def _speeds(speed: np.ndarray) -> dict[str, np.ndarray]:
    """Regimes (n,) of the shaft."""
    fast = float(np.nanmax(np.abs(speed)))
    return {
        "speed near zero": np.abs(speed) < 0.15 * fast,
        "positive speed": speed > 0.0,
        "negative speed": speed < 0.0,
    }


@dataclass
class _Shaft:
    """What drives a shaft in one log, and how it turned: pressure (n,), load (n,) and speed (n,), SI, every `period`."""

    pressure: np.ndarray
    load: np.ndarray
    speed: np.ndarray
    used: np.ndarray
    period: float

    def error(self, numbers: dict[str, float]) -> np.ndarray:
        """What the shaft loses or gains against measurement within a second (n,), so that errors do not pile up."""
        own = {"displacement": numbers["D"], "inertia": numbers["J"], "friction": numbers["B"]}
        replayed = shaft_speed(self.pressure, self.load, self.period, **own)
        forget = float(np.exp(-self.period / 1.0))
        steps = np.diff(self.speed - replayed, prepend=0.0)
        return np.asarray(lfilter([(1.0 + forget) / 2.0], [1.0, -forget], steps))


def _shafts(rig: RigModel, channel: int) -> dict[int, _Shaft]:
    """The shaft of a channel in the logs that hold speed and pressure, by the number of the log."""
    found = {}
    for number, part in enumerate(rig.parts):
        mine = {s.signal: s for s in rig.segments[channel] if s.log == number}
        if "pressure" in mine:
            speed, pressure = mine["speed"], mine["pressure"].measured
            load = np.zeros(speed.rows.size)
            if part.log.load is not None and part.log.has("load", channel):
                load = np.nan_to_num(part.log.load[speed.rows, channel])
            used = speed.used & np.isfinite(pressure)
            found[number] = _Shaft(filled(pressure), load, filled(speed.measured), used, speed.period)
    return found


def _best_shaft(
    estimate: Estimate, rig: RigModel, channel: int, shafts: list[_Shaft], turns: int = 6
) -> dict[str, float]:
    """Displacement, inertia and friction that explain the shaft alone best, inside their plausible ranges and with their priors:
    Gauss-Newton steps from the calibrated ones."""
    every = {u.name: (u, q) for u, q in zip(estimate.unknowns, estimate.q, strict=True)}
    own = [every[n][0] for n in _SHAFT if n in every]
    given = {n: rig.model.value(n, channel) for n in _SHAFT}
    q = np.array([every[u.name][1] for u in own])
    low, high = np.array([u.bounds for u in own]).reshape(-1, 2).T
    noise = [max(noise_floor(s.error(given), s.used, s.period), 1e-12) for s in shafts]

    def values(q: np.ndarray) -> dict[str, float]:
        return given | {u.name: u.value(x) for u, x in zip(own, q, strict=True)}

    def misfit(q: np.ndarray) -> np.ndarray:
        errors = [s.error(values(q))[s.used] / n for s, n in zip(shafts, noise, strict=True)]
        return np.concatenate([q, *errors])

    for _ in range(turns if own and shafts else 0):
        now, step = misfit(q), 0.05
        away = np.where(q + step > high, -step, step)
        slopes = np.array(
            [(misfit(q + a * e) - now) / a for a, e in zip(away, np.eye(q.size), strict=True)]
        ).T
        moved = q + minimum_in_box(slopes.T @ slopes, -slopes.T @ now, low - q, high - q)
        if not np.sum(misfit(moved) ** 2) < np.sum(now**2):
            break
        q = moved
    return values(q)


def _missing_flow(shaft: _Shaft, simulated: dict[str, np.ndarray], numbers: dict[str, float]) -> np.ndarray:
    """The flow over displacement (n,) that measured speed and pressure need, less what the model's valve gives."""
    h = shaft.period
    width = max(5, 2 * round(0.01 / h) + 1)

    def flow(w: np.ndarray, dp: np.ndarray) -> np.ndarray:
        squeezed = numbers["V"] / numbers["beta"] * savgol_filter(dp, width, 2, deriv=1, delta=h)
        level = numbers["D"] * savgol_filter(w, width, 2) + numbers["Km"] * savgol_filter(dp, width, 2)
        return np.asarray(level + squeezed)

    missing: np.ndarray = flow(shaft.speed, shaft.pressure) - flow(simulated["speed"], simulated["pressure"])
    return missing / numbers["D"]


def _replay(
    equation: str,
    error: np.ndarray,
    period: float,
    time: np.ndarray,
    regimes: dict[str, np.ndarray],
    used: np.ndarray,
    over: np.ndarray,
    units: tuple[str, str, float],
) -> _Replay:
    noise = noise_floor(error, used, period)
    return _Replay(
        equation,
        error[used],
        noise,
        time[used],
        np.zeros(int(used.sum()), int),
        {n: m[used] for n, m in regimes.items()},
        over[used],
        units,
    )


def _joined(replays: list[_Replay]) -> _Replay:
    first = replays[0]
    error, time, log, over = (
        np.concatenate([getattr(r, name) for r in replays]) for name in ("error", "time", "log", "over")
    )
    regimes = {n: np.concatenate([r.regimes[n] for r in replays]) for n in first.regimes}
    noise = float(np.nanmin([r.noise for r in replays]))
    return _Replay(first.equation, error, noise, time, log, regimes, over, first.units)


def shape(
    over: np.ndarray, error: np.ndarray, over_unit: str, error_unit: str, size: float, bins: int = 15
) -> Shape:
    """The error as a curve over the quantity that its equation depends on: not physics, but what physics would have to give.

    `points` are [middle, mean, standard error] of bins with equally many rows; `explains` is the share of the error's
    power that the curve holds, `with_direction` the share that two curves hold, one for a rising and one for a falling quantity:
    much more means memory (hysteresis, play, lag). A small share of both means time, angle or another channel.
    """
    edges = np.unique(np.quantile(over, np.linspace(0.0, 1.0, bins + 1)))
    number = np.clip(np.searchsorted(edges, over, side="right") - 1, 0, max(len(edges) - 2, 0))
    # Whether the quantity rises, by its last change: commands come in steps.
    change = np.sign(np.diff(over, prepend=over[:1]))
    last = np.maximum.accumulate(np.where(change != 0.0, np.arange(change.size), 0))
    rising = change[last] > 0.0
    power = max(float(np.mean(error**2)), 1e-300)

    def held(groups: np.ndarray) -> float:
        counts = np.maximum(np.bincount(groups), 1)
        means = np.bincount(groups, error) / counts
        return float(np.sum(counts * means**2) / error.size / power)

    points = []
    for n in range(number.max() + 1 if number.size else 0):
        rows = number == n
        if rows.sum() > 1:
            mean, spread = float(np.mean(error[rows])), float(np.std(error[rows]))
            apart = spread / np.sqrt(effective_samples(error[rows]))
            points.append([float(f"{v:.4g}") for v in (np.mean(over[rows]), mean / size, apart / size)])
    explains, with_direction = round(held(number), 3), round(held(2 * number + rising), 3)
    return Shape(over_unit, error_unit, points, explains, with_direction)


def _regime(replay: _Replay) -> str:
    """The condition under which the error is most above its mean."""
    power = replay.error**2
    mean = float(np.mean(power))
    best, strongest = "everywhere", CONTRAST
    for name, rows in replay.regimes.items():
        if LEAST_ROWS < rows.mean() < MOST_ROWS:
            contrast = float(np.mean(power[rows])) / max(mean, 1e-30)
            if contrast > strongest:
                best, strongest = name, contrast
    return best


def _windows(replay: _Replay, most: int = 3) -> tuple[list[tuple[float, float]], list[int]]:
    """Up to `most` windows of a fortieth of the logs with the largest error, and the log that each is in; neighbours are
    joined."""
    width = max(10, replay.error.size // 40)
    count = replay.error.size // width
    power = (replay.error[: count * width] ** 2).reshape(count, width).mean(axis=1)
    found: list[tuple[float, float]] = []
    logs: list[int] = []
    last = -2
    for i in sorted(np.argsort(power)[::-1][:most]):
        rows = slice(i * width, (i + 1) * width)
        number = int(replay.log[rows.start])
        rows = slice(rows.start, rows.start + int((replay.log[rows] == number).sum()))
        start, end = float(replay.time[rows.start]), float(replay.time[rows.stop - 1])
        if (
            i == last + 1
            and logs
            and logs[-1] == number
            and start - found[-1][1] < 0.5 * (end - start) + 1e-9
        ):
            found[-1] = (found[-1][0], end)
        else:
            found.append((start, end))
            logs.append(number)
        last = i
    return found, logs
