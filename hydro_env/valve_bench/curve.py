"""One recorded sweep of a valve: flow over signal, cut into rising and falling branches and averaged to one loop.

A sweep is a slow triangle of the signal. Where the signal turns, a branch ends; branches of the same direction are
averaged. Signals keep the unit of the valve's input (A, V, m, or a fraction); flows are m3/s.
"""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.stats import spearmanr

from hydro_env.arrays import Floats as Floats
from hydro_env.arrays import Integers
from hydro_env.errors import InputError
from hydro_env.units import LPM

#: Kinds of curve: flow that follows the signal, or internal leakage, which has a peak near the null.
FLOW, LEAKAGE = "flow", "leakage"
#: The signal counts as turned when it has come back by this share of its range.
TURN = 0.05
#: Samples that a branch needs.
MIN_SAMPLES = 5


@dataclass(frozen=True)
class Curve:
    """What was recorded: `signal` (T,) in `signal_unit`, `flow` (T,) in m3/s, `time` (T,) in s or None.

    `rated` is the rated signal, the 100 % of every figure. `travel_per_signal` (m per unit of signal), where it is
    known, turns a signal into the spool travel it stands for. `findings` says, in sentences, what was noticed or done.
    """

    name: str
    signal: Floats
    flow: Floats
    signal_unit: str
    rated: float
    time: Floats | None = None
    travel_per_signal: float | None = None
    findings: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """How long it took, s; 0 where that is not known."""
        return 0.0 if self.time is None else float(np.ptp(self.time))

    def percent(self, signal: Any) -> Any:
        """A signal, or an array of them, in percent of the rated one."""
        return 100.0 * signal / self.rated

    def refused(self, problem: str) -> InputError:
        """The error for a curve that cannot be used."""
        return InputError(f"{self.name}: {problem}")


def resolution(values: Floats) -> float:
    """The step in which values were recorded, as most of them show it; zero if they hardly repeat."""
    known, counts = np.unique(values, return_counts=True)
    if len(known) < 2 or len(known) > 0.5 * len(values):
        return 0.0
    gaps = np.diff(known)
    nearest = np.minimum(np.append(gaps, np.inf), np.insert(gaps, 0, np.inf))
    order = np.argsort(nearest)
    half = np.searchsorted(np.cumsum(counts[order]), 0.5 * len(values))
    return float(nearest[order][min(half, len(known) - 1)])


@dataclass(frozen=True)
class Branch:
    """Rows `start` to `stop` of a curve, in which the signal goes one way: `direction` is +1 or -1."""

    direction: int
    start: int
    stop: int


@dataclass(frozen=True)
class Monotone:
    """One direction of a loop: flow over signal as bin averages, both increasing.

    `signal`, `flow` and `count` (bins,); `noise` is the scatter of single samples around the averages, m3/s.
    """

    signal: Floats
    flow: Floats
    count: Floats
    noise: float
    smooth: Floats = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "smooth", isotonic_regression(self.flow, weights=self.count).x)

    def signal_at(self, flow: Floats | float) -> Floats:
        """The signal at which the branch has this flow."""
        # A level that the branch keeps for a while (dead zone, flat top) has no single signal; the least slope makes
        # it the far end of a flat part below and the near end of one above.
        span = float(self.smooth[-1] - self.smooth[0]) or 1.0
        ramp = self.smooth + 1e-9 * span * np.linspace(-0.5, 0.5, len(self.smooth))
        return np.asarray(np.interp(flow, ramp, self.signal))

    def largest(self, sign: int) -> float:
        """The largest flow in one direction (1, -1), m3/s."""
        return float(sign * self.smooth[-1 if sign > 0 else 0])

    def flow_at(self, signal: Floats | float) -> Floats:
        """The flow at this signal."""
        return np.asarray(np.interp(signal, self.signal, self.smooth))


@dataclass(frozen=True)
class Loop:
    """The rising and the falling branch of a curve, averaged; one of them is None if it was not recorded.

    Where the flow falls while the signal rises, the branches have its sign turned.
    """

    kind: str
    rising: Monotone | None
    falling: Monotone | None
    low: float
    high: float
    findings: tuple[str, ...] = ()

    @property
    def branches(self) -> tuple[Monotone, ...]:
        """The branches that there are."""
        return tuple(branch for branch in (self.rising, self.falling) if branch is not None)

    @property
    def noise(self) -> float:
        """Scatter of single samples, m3/s."""
        return max(branch.noise for branch in self.branches)

    @property
    def bin_noise(self) -> float:
        """Scatter of the average in a bin, m3/s."""
        return self.noise / float(np.sqrt(np.median(self.branches[0].count)))


def branches_of(curve: Curve) -> list[Branch]:
    """The branches of a curve in order; InputError if the signal hardly moves."""
    signal = curve.signal
    span = float(np.ptp(signal)) if len(signal) else 0.0
    if len(signal) < MIN_SAMPLES or span <= 0.0:
        span_of = f"{np.min(signal, initial=np.inf):g} to {np.max(signal, initial=-np.inf):g}"
        told = f"{len(signal)} samples with a signal from {span_of}"
        raise curve.refused(f"{told}; a curve needs {MIN_SAMPLES} samples over a range of the signal")
    # Every `stride`th row is enough to find a turn.
    stride = max(1, len(signal) // 20_000)
    turns = [0]
    direction, extreme = 0, 0
    values = signal[::stride].tolist()
    lowest = highest = 0
    for n, value in enumerate(values):
        if direction == 0:
            lowest = n if value < values[lowest] else lowest
            highest = n if value > values[highest] else highest
            for way, end in ((1, lowest), (-1, highest)):
                if way * (value - values[end]) > TURN * span:
                    direction, extreme, turns = way, n, sorted({0, end})
                    break
        elif direction * (value - values[extreme]) >= 0.0:
            extreme = n
        elif direction * (values[extreme] - value) > TURN * span:
            turns.append(extreme)
            direction, extreme = -direction, n
    ends = [*(stride * n for n in turns), len(signal)]
    found = []
    for start, stop in itertools.pairwise(ends):
        step = signal[stop - 1] - signal[start]
        if stop - start >= MIN_SAMPLES and abs(step) > TURN * span:
            found.append(Branch(1 if step > 0.0 else -1, start, stop))
    if not found:
        raise curve.refused(f"no branch with {MIN_SAMPLES} samples; record a slow triangle with more samples")
    return found


def _average(signal: Floats, flow: Floats, low: float, high: float) -> Monotone:
    """Averages samples of one direction over equal bins of the signal; few samples stay as they are."""
    few = len(signal) <= 400
    # With 20,000 bins few samples stay as they are.
    bins = 20_000 if few else int(np.clip(len(signal) / 8, 100, 400))
    place = np.clip(((signal - low) / (high - low) * bins).astype(int), 0, bins - 1)
    count = np.bincount(place, minlength=bins).astype(float)
    used = count > 0
    x = np.bincount(place, signal, bins)[used] / count[used]
    q = np.bincount(place, flow, bins)[used] / count[used]
    # Scatter around the average, less what the slope inside a bin explains.
    slope = np.gradient(q, x) if len(x) > 2 else np.zeros_like(q)
    index = np.cumsum(used)[place] - 1
    rest = flow - q[index] - slope[index] * (signal - x[index])
    free = max(1.0, float(len(signal) - used.sum()))
    # Robust: the bend at the edge of a dead zone is no scatter.
    rough = float(np.sqrt(np.sum(rest**2) / free))
    noise = min(rough, 1.4826 * float(np.median(np.abs(rest))) * np.sqrt(len(signal) / free))
    if few:
        noise = float(np.median(np.abs(np.diff(q, 2)))) / 1.65 if len(q) > 4 else 0.0
    return Monotone(x, q, count[used], noise)


def loop_of(curve: Curve, rows: list[Branch] | None = None) -> Loop:
    """The loop of a curve, from all its branches or from those given.

    InputError if the flow has nothing to do with the signal.
    """
    found = branches_of(curve) if rows is None else rows
    low, high = float(curve.signal.min()), float(curve.signal.max())
    notes: list[str] = []
    kind, polarity = _kind(curve, found)
    if polarity < 0:
        notes.append("the flow falls while the signal rises; its sign is turned for the figures")
    sides: dict[str, Monotone | None] = {"rising": None, "falling": None}
    for direction, word, other in ((1, "rising", "falling"), (-1, "falling", "rising")):
        own = [branch for branch in found if branch.direction == direction]
        if own:
            index = _rows(own)
            sides[word] = _average(curve.signal[index], polarity * curve.flow[index], low, high)
        else:
            notes.append(f"only {other} branches, no {word} one; hysteresis cannot be measured")
    gap = abs(curve.signal[0] - curve.signal[-1]) / (high - low)
    if None not in sides.values() and gap > 0.02 and len(found) < 3:
        told = f"the sweep does not close, it ends {100.0 * gap:.0f} % of its range from where it began"
        notes.append(f"{told}; only the part that both branches cover tells the hysteresis")
    return Loop(kind, **sides, low=low, high=high, findings=tuple(notes))


def _rows(branches: list[Branch]) -> Integers:
    return np.concatenate([np.arange(branch.start, branch.stop) for branch in branches])


def _kind(curve: Curve, found: list[Branch]) -> tuple[str, int]:
    """What kind of curve it is, and the sign with which the flow follows the signal."""
    index = _rows(found)
    index = index[:: max(1, len(index) // 5000)]
    signal, flow = curve.signal[index], curve.flow[index]
    if float(np.ptp(flow)) == 0.0:
        raise curve.refused(f"the flow is {flow[0] / LPM:g} l/min all the time; name the column of the flow")
    rank = float(spearmanr(signal, flow).statistic)
    if abs(rank) > 0.8:
        return FLOW, 1 if rank > 0.0 else -1
    if len(flow) >= 21 and np.all(flow >= -0.05 * flow.max()):
        # A peak inside, low at both ends: internal leakage of a valve that passes its null.
        parts = np.array_split(flow[np.argsort(signal)], 7)
        levels = np.array([np.median(part) for part in parts])
        rise = float(levels[2:5].max() - levels.min())
        ends = max(levels[0], levels[-1]) - levels.min()
        if ends < 0.6 * rise and rise > 0.5 * float(np.median([np.std(part) for part in parts])):
            return LEAKAGE, 1
    told = f"the flow does not follow the signal (rank correlation {rank:.2f})"
    hint = "name the columns of signal and flow"
    raise curve.refused(f"{told} and is no leakage with a peak near the null; {hint}")
