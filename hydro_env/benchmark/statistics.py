"""Statistics of scores: interquartile mean, bootstrap interval, CVaR and probability of improvement.

The set follows Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice"
(NeurIPS 2021): a mean that outliers do not carry, an interval that says what the number of cases allows,
and a figure for the worst cases, which decide whether a controller may run a machine. A metric is a cost,
smaller is better, unless `more` is.

`scipy.stats.bootstrap` has no strata and draws again for every metric; the other
figures are not in SciPy.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.arrays import Floats, Integers
from hydro_env.validation import Count, FileTable, Number


def iqm(values: ArrayLike) -> float:
    """Interquartile mean of values (n,): the mean of what is left after a quarter is cut off at either end.

    `floor(n / 4)` values are cut at each end, as `scipy.stats.trim_mean(values, 0.25)` and rliable do, so
    up to three values are simply averaged.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    if not ordered.size:
        raise ValueError("the interquartile mean needs at least one value")
    cut = ordered.size // 4
    return float(np.mean(ordered[cut : ordered.size - cut]))


def cvar(values: ArrayLike, level: float = 0.95) -> float:
    """Conditional value at risk: the mean of the worst (largest) `1 - level` of the values.

    Where that share is not a whole number of values, the last one counts with the fraction that is left,
    which makes it equal to Rockafellar and Uryasev's minimum over c of `c + mean(max(x - c, 0)) / (1 -
    level)`.
    """
    if not 0.0 <= level < 1.0:
        raise ValueError(f"level must lie in [0, 1), not {level}")
    worst_first = np.sort(np.asarray(values, dtype=float).ravel())[::-1]
    share = (1.0 - level) * worst_first.size
    weights = np.clip(share - np.arange(worst_first.size), 0.0, 1.0)
    counted = weights > 0.0  # keeps an infinite value with weight 0 from turning into NaN
    return float(np.sum(weights[counted] * worst_first[counted]) / share)


def bootstrap_interval(
    values: ArrayLike, *, strata: ArrayLike | None = None, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval, 95 %, of the interquartile mean; see `resampled`."""
    return _interval(resampled(values, strata=strata, seed=seed))


def _interval(means: Floats) -> tuple[float, float]:
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def resampled(
    values: ArrayLike, *, strata: ArrayLike | None = None, resamples: int = 2000, seed: int = 0
) -> Floats:
    """Interquartile means (resamples,) of values that are drawn again.

    With `strata` (one label per value) every stratum is resampled by itself and keeps its size, so that a
    suite made of, say, six faults is not resampled into one without the worst of them. Deterministic for a
    given seed.
    """
    sample = np.asarray(values, dtype=float).ravel()
    labels = np.zeros(sample.size) if strata is None else np.asarray(strata).ravel()
    if labels.size != sample.size:
        raise ValueError(f"{labels.size} strata for {sample.size} values")
    members = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    drawn = _drawn(tuple(tuple(each.tolist()) for each in members), resamples, seed)
    # Ranks sort several times faster than the values they stand for, and give the same means.
    order = np.argsort(sample, kind="stable")
    rank = np.empty(sample.size, np.uint16 if sample.size < 2**16 else np.int64)
    rank[order] = np.arange(sample.size)
    cut = sample.size // 4
    middle = np.sort(rank[drawn], axis=1, kind="stable")[:, cut : sample.size - cut]
    return np.mean(sample[order][middle], axis=1)


@lru_cache(maxsize=8)
def _drawn(strata: tuple[tuple[int, ...], ...], resamples: int, seed: int) -> Integers:
    """Which values make up every resample (resamples, n). Kept, since every metric of a suite asks for the same."""
    rng = np.random.default_rng(seed)
    drawn = [np.array(each)[rng.integers(0, len(each), (resamples, len(each)))] for each in strata]
    return np.concatenate(drawn, axis=1)


def probability_of_improvement(ours: ArrayLike, theirs: ArrayLike) -> float:
    """Share of cases (the same valves, the same noise) in which `ours` is the smaller cost; ties count half."""
    a, b = np.asarray(ours, dtype=float).ravel(), np.asarray(theirs, dtype=float).ravel()
    if a.size != b.size:
        raise ValueError(f"{a.size} values cannot be paired with {b.size}")
    return float(np.mean((a < b) + 0.5 * (a == b)))


class Summary(FileTable):
    """One cell of a score board, also in files."""

    iqm: Number
    ci95: tuple[Number, Number]
    cvar95: Number
    n: Count

    @property
    def row(self) -> dict[str, Any]:
        """As scores.json has it."""
        return self.model_dump(mode="json")


def summarise(values: ArrayLike, *, strata: ArrayLike | None = None, more: bool = False) -> Summary:
    """Interquartile mean with its 95 % interval, CVaR at 95 % and the number of cases; where `more` is better the worst cases are
    those with the smallest values."""
    sample = np.asarray(values, dtype=float).ravel()
    interval, sign = bootstrap_interval(sample, strata=strata), -1.0 if more else 1.0
    return Summary(iqm=iqm(sample), ci95=interval, cvar95=sign * cvar(sign * sample), n=sample.size)


def mean_of(parts: Sequence[Summary], samples: Sequence[tuple[ArrayLike, ArrayLike, int]]) -> Summary:
    """The mean of parts of a suite, each with equal weight; `samples` are the values behind them, their strata and a seed. Parts
    of the same seed and strata are resampled alike."""
    middle, worst = (float(np.mean([getattr(part, of) for part in parts])) for of in ("iqm", "cvar95"))
    means = [resampled(values, strata=strata, seed=seed) for values, strata, seed in samples]
    interval = _interval(np.mean(means, axis=0))
    return Summary(iqm=middle, ci95=interval, cvar95=worst, n=sum(part.n for part in parts))


def scaled(values: ArrayLike, ends: tuple[float, float]) -> Floats:
    """Values on a scale that is 0 at the first of `ends` and 100 at the second."""
    low, high = ends
    return 100.0 * ((np.asarray(values) - low) / (high - low))


def normalised(summary: Summary, ends: tuple[float, float]) -> Summary:
    """A summary on such a scale."""
    middle, low, high, worst = scaled((summary.iqm, *summary.ci95, summary.cvar95), ends)
    return Summary(iqm=middle, ci95=(low, high), cvar95=worst, n=summary.n)
