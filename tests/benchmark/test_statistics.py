"""Score statistics against hand-computed, brute-force and SciPy values."""

from itertools import product

import numpy as np
import pytest
from scipy import stats

from hydro_env.benchmark.statistics import (
    bootstrap_interval,
    cvar,
    iqm,
    mean_of,
    normalised,
    probability_of_improvement,
    resampled,
    summarise,
)


def test_iqm_by_hand():
    assert iqm([1, 2, 3, 4, 5, 6, 7, 1000]) == pytest.approx(4.5)  # 3, 4, 5, 6 are left
    assert iqm([7.0]) == 7.0
    assert iqm([1, 2, 6]) == pytest.approx(3.0)  # too few to cut any


@pytest.mark.parametrize("n", [1, 4, 5, 10, 97])
def test_iqm_is_scipys_trimmed_mean(n):
    values = np.random.default_rng(n).normal(size=n)
    assert iqm(values) == pytest.approx(stats.trim_mean(values, 0.25))


def test_iqm_of_nothing_is_an_error():
    with pytest.raises(ValueError, match="at least one"):
        iqm([])


def test_cvar_by_hand():
    assert cvar(np.arange(1, 101)) == pytest.approx(98.0)  # mean of 96 .. 100
    assert cvar([1, 2, 3, 4, 5, 6, 7, 8, 9, 10]) == pytest.approx(10.0)  # half of the worst one
    assert cvar([1, 2, 3, 4], level=0.625) == pytest.approx((4 + 0.5 * 3) / 1.5)
    assert cvar([3, 5], level=0.0) == pytest.approx(4.0)


@pytest.mark.parametrize("n", [3, 20, 37])
def test_cvar_is_rockafellar_and_uryasevs_minimum(n):
    x = np.random.default_rng(n).gamma(2.0, size=n)
    candidates = [
        c + np.mean(np.maximum(x - c, 0.0)) / 0.05 for c in x
    ]  # the minimum lies at one of the values
    assert cvar(x) == pytest.approx(min(candidates))


def test_interval_against_all_resamples():
    """Every one of the 4^4 equally likely resamples, counted out."""
    values = np.array([1.0, 3.0, 4.0, 9.0])
    exact = np.sort([np.mean(sorted(draw)[1:3]) for draw in product(values, repeat=4)])
    low, high = np.quantile(resampled(values, resamples=40_000), [0.1, 0.9])
    assert low == pytest.approx(np.quantile(exact, 0.1), abs=0.26)
    assert high == pytest.approx(np.quantile(exact, 0.9), abs=0.26)


def test_interval_covers_and_shrinks():
    rng = np.random.default_rng(1)
    hits = 0
    for i in range(100):
        low, high = bootstrap_interval(rng.normal(5.0, 1.0, 40), seed=i)
        hits += low <= 5.0 <= high
    assert hits >= 85
    few, many = (np.diff(bootstrap_interval(rng.normal(size=n)))[0] for n in (20, 2000))
    assert many < few / 5


def test_strata_keep_their_size():
    """Two strata without spread leave nothing to resample; without strata the mixture varies."""
    values, faults = [1, 1, 1, 1, 9, 9, 9, 9], ["a"] * 4 + ["b"] * 4
    assert bootstrap_interval(values, strata=faults) == (5.0, 5.0)
    low, high = bootstrap_interval(values)
    assert low < 5.0 < high
    with pytest.raises(ValueError, match="3 strata for 8 values"):
        bootstrap_interval(values, strata=[1, 2, 3])


def test_interval_is_deterministic():
    values = np.random.default_rng(3).normal(size=30)
    assert bootstrap_interval(values, seed=4) == bootstrap_interval(values, seed=4)
    assert bootstrap_interval(values, seed=4) != bootstrap_interval(values, seed=5)


def test_probability_of_improvement():
    assert probability_of_improvement([1, 2, 3], [2, 2, 2]) == pytest.approx(
        0.5
    )  # one better, one tie, one worse
    assert probability_of_improvement([1, 1], [2, 3]) == 1.0
    with pytest.raises(ValueError, match="paired"):
        probability_of_improvement([1, 2], [1, 2, 3])


def test_summary():
    summary = summarise(np.arange(1, 101))
    assert summary.iqm == pytest.approx(50.5)
    assert summary.ci95[0] < 50.5 < summary.ci95[1]
    assert (summary.cvar95, summary.n) == (pytest.approx(98.0), 100)


def test_the_score_is_0_and_100_at_its_ends():
    returns = np.linspace(-90.0, -50.0, 12)
    ours = summarise(returns, more=True)
    assert normalised(ours, (ours.iqm, 0.0)).iqm == 0.0
    assert normalised(ours, (-200.0, ours.iqm)).iqm == 100.0
    scored = normalised(ours, (-100.0, 0.0))
    assert scored.iqm == pytest.approx(100.0 + ours.iqm) and scored.n == 12
    assert scored.ci95 == pytest.approx([100.0 + end for end in ours.ci95])
    assert scored.cvar95 == pytest.approx(10.0)  # the smallest return


def test_parts_of_a_suite_have_equal_weight():
    """However large their numbers of cases."""
    rng = np.random.default_rng(0)
    samples = [
        (rng.normal(1.0, 1.0, 400), ["a"] * 400, 0),
        (rng.normal(3.0, 1.0, 40), ["a"] * 20 + ["b"] * 20, 1),
    ]
    parts = [summarise(values, strata=strata) for values, strata, _ in samples]
    got = mean_of(parts, samples)
    assert got.iqm == pytest.approx(np.mean([part.iqm for part in parts])) and got.n == 440
    wide = [part.ci95[1] - part.ci95[0] for part in parts]
    assert got.ci95[0] < got.iqm < got.ci95[1]
    assert got.ci95[1] - got.ci95[0] == pytest.approx(np.hypot(*wide) / 2, rel=0.15)


def test_parts_of_the_same_cases_do_not_make_the_interval_narrower():
    """The same pairs of valves in two scenarios say as much as in one."""
    values, strata = np.random.default_rng(0).normal(0.0, 1.0, 100), ["a"] * 100
    part = summarise(values, strata=strata)
    assert mean_of([part, part], [(values, strata, 0)] * 2).ci95 == pytest.approx(part.ci95)
