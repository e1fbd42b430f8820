"""Several sweep rates of one valve: is the loop lag, which shrinks with the rate, or hysteresis, which does not?

At every height of the curve the width of the loop is fitted by

    width = hysteresis + 2 lag rate

with the rate of the signal per second: a time `lag` behind, the rising branch is `lag * rate` too high and the falling
one as much too low. The heights fall into blocks; the scatter of the blocks gives 95 % intervals (Student's t). Beside the fit
stands a bound that needs no fit at all: the hysteresis is no wider than the narrowest loop that was seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from hydro_env.valve_bench.curve import FLOW, Branch, Curve, Floats, branches_of, loop_of
from hydro_env.valve_bench.figures import widths
from hydro_env.valve_bench.leakage import flank_signals, flanks_of

#: A mean with the ends of its 95 % interval.
Interval = tuple[float, float, float]

#: Rates must differ by this factor to tell anything.
APART = 1.5
#: Heights of the flow at which loops are compared, and the number of blocks they fall into on each side.
HEIGHTS, BLOCKS = np.linspace(0.1, 0.9, 80), 4
#: A part of the loop that is surely below this share of the widest loop does not enter the verdict; it is reported.
MINOR = 0.2
#: A loop narrower than this share of the rated signal is none.
NO_LOOP = 5e-4


@dataclass(frozen=True)
class Sweep:
    """The loop of one sweep: signal per second, and the width of the loop in blocks of the flow (unit of the signal)."""

    rate: float
    blocks: Floats
    resolution: float

    @property
    def width(self) -> float:
        """Mean width of the loop."""
        return float(np.mean(self.blocks))


@dataclass(frozen=True)
class RateCheck:
    """What several sweeps say. `verdict`: "lag", "hysteresis", "both", "no loop" or "undecided"; `reason` says why.

    Intervals are of 95 %; hysteresis in percent of the rated signal, lag in s. `share` is the part of the widest loop that
    does not depend on the rate.
    """

    verdict: str
    reason: str
    sweeps: tuple[Sweep, ...] = ()
    rated: float = 1.0
    hysteresis_percent: Interval | None = None
    lag_s: Interval | None = None
    share: Interval | None = None
    bound_percent: float | None = None
    exponent: float | None = None
    findings: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The check as plain data: values with `low` and `high`."""

        def triple(value: Interval | None, unit: str) -> dict[str, Any] | None:
            return value and dict(zip(("value", "low", "high", "unit"), (*value, unit), strict=True))

        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "sweeps": [
                {
                    "rate_percent_per_s": None if np.isnan(sweep.rate) else 100.0 * sweep.rate / self.rated,
                    "loop_percent": 100.0 * sweep.width / self.rated,
                    "blocks_percent": (100.0 * sweep.blocks / self.rated).tolist(),
                }
                for sweep in self.sweeps
            ],
            "hysteresis": triple(self.hysteresis_percent, "% of rated signal"),
            "lag": triple(self.lag_s, "s"),
            "rate_independent_share": triple(self.share, "1"),
            "hysteresis_at_most_percent": self.bound_percent,
            "loop_grows_as_rate_to_the_power": self.exponent,
            "findings": list(self.findings),
        }


def sweeps_of(curve: Curve) -> list[Sweep]:
    """The sweeps in a curve: one, or several where its branches go at clearly different rates."""
    found = branches_of(curve)
    if curve.time is None:
        return [_sweep(curve, found, np.nan)]
    rates = np.array([_rate(curve.signal, curve.time, branch) for branch in found])
    order = np.argsort(rates)
    faster = rates[order[1:]] > APART * rates[order[:-1]]
    groups = np.split(order, np.flatnonzero(faster) + 1)
    sweeps = []
    for group in groups:
        own = [found[n] for n in group]
        if {branch.direction for branch in own} == {1, -1}:
            sweeps.append(_sweep(curve, own, float(np.mean(rates[group]))))
    return sweeps


def _rate(signal: Floats, time: Floats, branch: Branch) -> float:
    """Of the signal per second."""
    # The middle half of the branch: at the turns a generator is slower, and a recording may wait there.
    quarter = (branch.stop - branch.start) // 4
    first, last = branch.start + quarter, branch.stop - 1 - quarter
    passed = float(time[last] - time[first])
    return abs(float(signal[last] - signal[first])) / passed if passed > 0.0 else float("nan")


def _sweep(curve: Curve, branches: list[Branch], rate: float) -> Sweep:
    loop = loop_of(curve, branches)
    if loop.rising is None or loop.falling is None:
        raise curve.refused("a loop needs a rising and a falling branch; sweep the signal back again")
    span, samples = float(np.ptp(loop.rising.flow)) or 1.0, float(np.sum(loop.rising.count))
    # What the scatter of the samples leaves uncertain in the mean width.
    uncertain = 2.0 * loop.noise / np.sqrt(max(samples, 1.0)) * float(np.ptp(loop.rising.signal)) / span
    if loop.kind != FLOW:
        flanks = flanks_of(loop)
        sides = list(flank_signals(*flanks[1]) - flank_signals(*flanks[-1]))
    else:
        whole = max(branch.largest(sign) for sign in (1, -1) for branch in loop.branches)
        tops = [(sign, min(branch.largest(sign) for branch in loop.branches)) for sign in (1, -1)]
        used = [sign * top for sign, top in tops if top > 0.05 * whole]
        sides = [widths(loop.rising, loop.falling, top * HEIGHTS) for top in used]
    blocks = [float(part.mean()) for wide in sides for part in np.array_split(wide, BLOCKS)]
    return Sweep(rate, np.array(blocks), uncertain)


def check_rates(curves: Sequence[Curve]) -> RateCheck:
    """Decides between lag and hysteresis from all sweeps in these curves of one valve.

    InputError if a curve has no loop in it.
    """
    sweeps = sorted((sweep for curve in curves for sweep in sweeps_of(curve)), key=lambda each: each.rate)
    rated = curves[0].rated
    rates = np.array([sweep.rate for sweep in sweeps])
    if len({len(sweep.blocks) for sweep in sweeps}) != 1:
        reason = "the sweeps do not cover the same sides of the valve"
    elif not np.isfinite(rates).all():
        reason = "the rate of a sweep is unknown: give a column of time, the time between rows, or the length of the sweep"
    elif rates[-1] < APART * rates[0]:
        count = "one sweep rate" if len(sweeps) == 1 else "sweeps of nearly one rate"
        reason = f"{count} cannot tell lag from hysteresis: sweep again at a tenth of the rate"
    else:
        return _decide(tuple(sweeps), rates, rated)
    return RateCheck("undecided", reason, tuple(sweeps), rated)


def _decide(sweeps: tuple[Sweep, ...], rates: Floats, rated: float) -> RateCheck:
    wide = np.array([sweep.blocks for sweep in sweeps])
    means = np.abs(wide.mean(axis=1))
    resolution = max(sweep.resolution for sweep in sweeps)
    bound = 100.0 * float(means.min()) / rated
    if means.max() < max(NO_LOOP * rated, 2.0 * resolution):
        reason = f"the widest loop is {100.0 * means.max() / rated:.2g} % of the rated signal"
        return RateCheck("no loop", reason, sweeps, rated, bound_percent=bound)
    (hysteresis, lag), rest = _straight_line(wide, rates, resolution)
    widest = float(means.max())
    share = tuple(value / widest for value in hysteresis)
    lagging = tuple(2.0 * value * float(rates[-1]) / widest for value in lag)
    exponent = float(np.polyfit(np.log(rates), np.log(means), 1)[0]) if means.min() > 0.0 else None
    notes = []
    if len(rates) > 2 and np.max(np.abs(rest) / np.maximum(means, 0.05 * widest)) > 0.15:
        told = f"the loop grows as the rate to the power {exponent:.2f}, not along a straight line"
        notes.append(f"{told}: the intervals allow for it")
    first, last = 100.0 * means[0] / rated, 100.0 * means[-1] / rated
    story = f"the loop goes from {last:.3g} % at the fastest sweep to {first:.3g} % at the slowest"
    story += f", {rates[-1] / rates[0]:.3g} times slower"
    verdict = _verdict(share, lagging, float(means.min()) / widest)
    if verdict in ("lag", "both"):
        story += f"; of that at most {min(100.0 * hysteresis[2] / rated, bound):.3g} % is hysteresis"
        story += f", the lag is {lag[0]:.3g} s ({lag[1]:.3g} to {lag[2]:.3g})"
    percent = tuple(100.0 * value / rated for value in hysteresis)
    return RateCheck(verdict, story, sweeps, rated, percent, lag, share, bound, exponent, tuple(notes))  # type: ignore[arg-type]


def _straight_line(wide: Floats, rates: Floats, resolution: float) -> tuple[list[Interval], Floats]:
    """Width at rest and lag of a loop whose width grows along a line over the rate, and what the line leaves of the mean widths
    (rates,). `wide` is (rates, blocks of one sweep)."""
    means = np.abs(wide.mean(axis=1))
    # Weights by the inverse rate: what scatters about the line grows with the width of the loop.
    design = np.column_stack([np.ones_like(rates), 2.0 * rates])
    weight = 1.0 / np.maximum(means, 0.02 * means.max())
    fit = np.linalg.lstsq(design * weight[:, None], wide * weight[:, None], rcond=None)[0]
    rest = wide.mean(axis=1) - design @ fit.mean(axis=1)
    floor = np.linalg.inv((design * weight[:, None]).T @ (design * weight[:, None]))
    # The line's own lack of fit, seen only with three rates and more, widens both intervals.
    free = len(rates) - 2
    misfit = float(np.sum((rest * weight) ** 2)) / free if free > 0 else 0.0
    triples = []
    for row, values in enumerate(fit):
        spread = np.std(values, ddof=1) / np.sqrt(len(values)) if len(values) > 1 else 0.0
        margin = student.ppf(0.975, max(1, len(values) - 1)) * spread
        lacking = 2.0 * np.sqrt(misfit * floor[row, row])
        noise = resolution * np.sqrt(floor[row, row]) * float(weight.max())
        margin = float(np.sqrt(margin**2 + lacking**2 + noise**2))
        mean = float(np.mean(values))
        triples.append((mean, mean - margin, mean + margin))
    return triples, rest


def _verdict(share: tuple[float, ...], lagging: tuple[float, ...], narrowest: float) -> str:
    """What a loop is, from the shares (mean, low, high) of the widest loop that hysteresis and lag make up, and the share
    that the narrowest loop is of the widest."""
    if min(share[2], narrowest) <= MINOR and lagging[1] > 0.0:
        return "lag"
    if share[1] >= 1.0 - MINOR and abs(lagging[0]) <= MINOR:
        return "hysteresis"
    if share[1] > 0.0 and lagging[1] > 0.0:
        return "both"
    return "undecided"
