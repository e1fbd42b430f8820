"""Localisation: every component replayed with measured neighbours, and the conditions under which it errs.

coil         measured current against the simulated one (only the command acts on it)
shaft        measured speed against the shaft driven by the measured pressure and the logged load, with the displacement, inertia
             and friction that explain it best: those of the calibrated model make up for what is missing elsewhere
valve_flow   flow that the measured speed and pressure need against the flow that the model's valve gives

A component whose own replay errs by more than its noise owns part of the residual. Only what the logs hold can be replayed; with
speed alone the whole residual is the valve's and motor's together.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter, savgol_filter

from ...units import BAR, RPM
from ..estimation.estimate import Estimate, Estimates
from ..estimation.noise import effective_samples, noise_floor
from ..models.base import RigModel
from .shaft import SHAFT, Shaft, given_shaft, shaft_of
from .validation import AT_NOISE

_FLOW = ("command, V", "flow over displacement, rpm", RPM)
#: Steps to the shaft that explains measurement best: its equation is nearly linear in the three.
SHAFT_STEPS = 8
#: An equation is listed that has this share of what all of them leave above their noise: less is rounded to nothing.
LISTED = 0.02
#: Bins of the curve of an error: a picture and words only, no verdict depends on them.
BINS = 15
#: A regime is named if its mean square error is this many times that of all rows, and it holds neither next to nothing of them
#: nor nearly all. Words only: nothing else depends on them.
CONTRAST, MIN_ROWS, MAX_ROWS = 1.3, 0.03, 0.9


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
    most of it: the number of the fit log, and from when to when, s."""

    equation: str
    channel: int
    share: float
    regime: str
    windows: list[tuple[int, float, float]]
    shape: Shape

    def as_dict(self) -> dict[str, object]:
        return {
            "equation": self.equation, "channel": str(self.channel + 1), "share_of_gap": round(self.share, 3),
            "regime": self.regime,
            "windows_s": [[round(a, 3), round(b, 3)] for _, a, b in self.windows],
            "windows_log": [log for log, _, _ in self.windows],
            "shape": vars(self.shape),
        }  # fmt: skip


@dataclass
class _Replay:
    """A component alone in one log: its `error` (n,) every `period`, at these times (n,), with what it depends on (n,) and its
    regimes (n,); `units` are the names of that quantity and of the error, and the size of the latter's unit in SI."""

    equation: str
    units: tuple[str, str, float]
    log: int
    period: float
    used: np.ndarray
    time: np.ndarray
    error: np.ndarray
    over: np.ndarray
    regimes: dict[str, np.ndarray]


class _Component:
    """A component alone over the rows that count of all logs, one behind the other."""

    def __init__(self, replays: Sequence[_Replay]) -> None:
        first = replays[0]

        def joined(rows: Iterable[np.ndarray]) -> np.ndarray:
            return np.concatenate([values[r.used] for values, r in zip(rows, replays, strict=True)])

        self.equation, self.units = first.equation, first.units
        self.error, self.over = joined(r.error for r in replays), joined(r.over for r in replays)
        self.time = joined(r.time for r in replays)
        self.log = joined(np.full(r.time.size, r.log) for r in replays)
        self.regimes = {n: joined(r.regimes[n] for r in replays) for n in first.regimes}
        noise = float(np.nanmin([noise_floor(r.error, r.used, r.period) for r in replays]))
        #: The mean square error in units of the noise's.
        self.power = float(np.mean(self.error**2)) / max(noise, 1e-30) ** 2


def locate(rig: RigModel, estimates: Estimates) -> list[Location]:
    """The equations that err beside the models `estimates` on the fit logs, largest share first."""
    found = []
    for channel, estimate in estimates.items():
        by_equation: dict[str, list[_Replay]] = {}
        for replay in _replays(rig, estimate, channel):
            by_equation.setdefault(replay.equation, []).append(replay)
        components = [_Component(replays) for replays in by_equation.values()]
        excess = {k.equation: k.power - 1.0 for k in components if k.power > AT_NOISE**2}
        for k in components:
            share = excess.get(k.equation, 0.0) / max(sum(excess.values()), 1e-30)
            if share > LISTED:
                form = shape(k.over, k.error, *k.units)
                found.append(Location(k.equation, channel, share, _regime(k), _windows(k), form))
    return sorted(found, key=lambda p: (p.channel, -p.share))


def _replays(rig: RigModel, estimate: Estimate, channel: int) -> Iterator[_Replay]:
    """What can be replayed of the signals of each log."""
    by_log = [{s.signal: s for s in rig.segments[channel] if s.log == n} for n in range(len(rig.parts))]
    dynamic, both = rig.has_hidden_states, zip(rig.parts, by_log, strict=True)
    shafts = [shaft_of(p, channel, step=own["speed"].step) if dynamic else None for p, own in both]
    best = _best_shaft(estimate, rig, channel, [s for s in shafts if s is not None])
    for number, (part, mine, shaft) in enumerate(zip(rig.parts, by_log, shafts, strict=True)):
        simulated = {n: estimate.simulated[channel][s.place] for n, s in mine.items()}
        speed = mine["speed"]
        time = part.log.time_s[speed.rows]
        command, rated = part.log.command_V[speed.rows, channel], rig.model.value("u_rated", channel)
        openings, speeds = _openings(command, rated), _speeds(speed.measured)
        about = number, speed.period, speed.used, time
        if "current" in mine:
            error = mine["current"].measured - simulated["current"]
            late = time > time[0] + 0.6 * (time[-1] - time[0])
            regimes = {"large current": np.abs(command) > 0.6 * rated, "late in the log": late}
            yield _Replay("coil", ("command, V", "current, A", 1.0), *about, error, command, regimes)
        if "mean_line_pressure" in mine:
            error = mine["mean_line_pressure"].measured - simulated["mean_line_pressure"]
            units = ("command, V", "mean line pressure, bar", BAR)
            yield _Replay("lines", units, *about, error, command, {**openings, **speeds})
        if shaft is not None:
            about = number, speed.period, speed.used & shaft.used, time
            units = ("speed, rpm", "speed lost or gained within a second, rpm", RPM)
            error = _lost_within_a_second(shaft, best)
            yield _Replay("shaft", units, *about, error, shaft.speed / RPM, speeds)
            value = estimate.values(channel)
            numbers = {n: value.get(n, rig.model.value(n, channel)) for n in ("D", "Km", "V", "beta")}
            missing = _missing_flow(shaft, simulated, numbers)
            yield _Replay("valve_flow", _FLOW, *about, missing, command, openings)
        else:
            name = "valve and motor" if rig.has_hidden_states else "valve_flow"
            units = _FLOW if part.log.kinds[channel] == "motor" else ("command, V", "speed, mm/s", 1e-3)
            error = speed.measured - simulated["speed"]
            yield _Replay(name, units, *about, error, command, {**openings, **speeds})


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
    slow = np.abs(speed) < 0.15 * float(np.nanmax(np.abs(speed)))
    return {"speed near zero": slow, "positive speed": speed > 0.0, "negative speed": speed < 0.0}


def _lost_within_a_second(shaft: Shaft, values: Mapping[str, float]) -> np.ndarray:
    """What a shaft loses or gains against measurement within a second (n,), so that errors do not pile up."""
    forget = float(np.exp(-shaft.period / 1.0))
    change = np.diff(shaft.speed - shaft.driven(values), prepend=0.0)
    return np.asarray(lfilter([(1.0 + forget) / 2.0], [1.0, -forget], change))


def _best_shaft(estimate: Estimate, rig: RigModel, channel: int, shafts: Sequence[Shaft]) -> dict[str, float]:
    """Displacement, inertia and friction that explain the shaft alone best, inside their plausible ranges and with their priors,
    from the calibrated ones."""
    given = given_shaft(rig, channel)
    own = [(u, q) for u, q in zip(estimate.unknowns, estimate.q, strict=True) if u.name in SHAFT]
    if not own or not shafts:
        return given | {u.name: u.value(q) for u, q in own}
    noise = [max(noise_floor(_lost_within_a_second(s, given), s.used, s.period), 1e-12) for s in shafts]

    def values(q: np.ndarray) -> dict[str, float]:
        return given | {u.name: u.value(x) for (u, _), x in zip(own, q, strict=True)}

    def misfit(q: np.ndarray) -> np.ndarray:
        errors = [_lost_within_a_second(s, values(q))[s.used] / n for s, n in zip(shafts, noise, strict=True)]
        return np.concatenate([q, *errors])

    low, high = np.array([u.bounds for u, _ in own]).T
    start = np.clip([q for _, q in own], low + 1e-9, high - 1e-9)
    return values(least_squares(misfit, start, bounds=(low, high), diff_step=1e-3, max_nfev=SHAFT_STEPS).x)


def _missing_flow(shaft: Shaft, simulated: dict[str, np.ndarray], numbers: dict[str, float]) -> np.ndarray:
    """The flow over displacement (n,) that measured speed and pressure need, less what the model's valve gives."""
    h = shaft.period
    width = max(5, 2 * round(0.01 / h) + 1)

    def flow(w: np.ndarray, dp: np.ndarray) -> np.ndarray:
        squeezed = numbers["V"] / numbers["beta"] * savgol_filter(dp, width, 2, deriv=1, delta=h)
        level = numbers["D"] * savgol_filter(w, width, 2) + numbers["Km"] * savgol_filter(dp, width, 2)
        return np.asarray(level + squeezed)

    missing: np.ndarray = flow(shaft.speed, shaft.pressure) - flow(simulated["speed"], simulated["pressure"])
    return missing / numbers["D"]


def shape(over: np.ndarray, error: np.ndarray, over_unit: str, error_unit: str, size: float) -> Shape:
    """The error as a curve over the quantity that its equation depends on: not physics, but what physics would have to give.

    `points` are [middle, mean, standard error] of bins with equally many rows; `explains` is the share of the error's
    power that the curve holds, `with_direction` the share that two curves hold, one for a rising and one for a falling quantity:
    much more means memory (hysteresis, play, lag). A small share of both means time, angle or another channel.
    """
    edges = np.unique(np.quantile(over, np.linspace(0.0, 1.0, BINS + 1)))
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


def _regime(component: _Component) -> str:
    """The condition under which the error is most above its mean."""
    power = component.error**2
    mean = max(float(np.mean(power)), 1e-30)
    some = {n: rows for n, rows in component.regimes.items() if MIN_ROWS < rows.mean() < MAX_ROWS}
    contrast = {name: float(np.mean(power[rows])) / mean for name, rows in some.items()}
    best = max(contrast, key=lambda name: contrast[name], default="everywhere")
    return best if contrast.get(best, 0.0) > CONTRAST else "everywhere"


def _windows(component: _Component, most: int = 3) -> list[tuple[int, float, float]]:
    """Up to `most` windows of a fortieth of the logs with the largest error, each with the log that it is in; neighbours are
    joined."""
    width = max(10, component.error.size // 40)
    count = component.error.size // width
    power = (component.error[: count * width] ** 2).reshape(count, width).mean(axis=1)
    found: list[tuple[int, float, float]] = []
    for i in sorted(np.argsort(power)[::-1][:most]):
        log, time = (values[i * width : (i + 1) * width] for values in (component.log, component.time))
        time = time[log == log[0]]
        start, end = float(time[0]), float(time[-1])
        if found and found[-1][0] == log[0] and start - found[-1][2] < 0.5 * (end - start) + 1e-9:
            start = found.pop()[1]
        found.append((int(log[0]), start, end))
    return found
