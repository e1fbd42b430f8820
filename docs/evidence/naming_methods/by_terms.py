"""Effects named by the terms that explain the errors of the equations: sparse regression, and localisation with a test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from hydro_env.diagnosis.estimation.noise import effective_samples
from hydro_env.experiments.naming_benchmark.methods import Start
from hydro_env.plant import CATALOGUE

from .equations import Equation, equations

Array = NDArray[np.float64]
Named = list[dict[str, Any]]

#: False-discovery rate of `certify`.
FALSE_DISCOVERIES = 0.05
#: Thresholds that `sindy` chooses among by Schwarz' criterion: least RMS contribution of a term, in the noise of its equation.
THRESHOLDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
#: Regimes of `certify`: command as a fraction of the rated one, from and to.
REGIMES = {
    "negative": (-9.0, -0.25), "near zero": (-0.25, 0.25), "positive": (0.25, 9.0), "everywhere": (-9.0, 9.0),
}  # fmt: skip


def chosen_by_regression(found: Sequence[Equation]) -> dict[str, float]:
    """Effects of a sparse regression of the errors on all terms, each with its share of the explained power."""
    import pysindy

    keys, design, error = _stacked(found)
    if not keys:
        return {}
    size = np.sqrt(np.mean(design**2, axis=0))
    samples = sum(effective_samples(e.error) for e in found)
    best: tuple[float, Array] = (samples * float(np.log(np.mean(error**2))), np.zeros(len(keys)))
    for threshold in THRESHOLDS:
        fitted = pysindy.STLSQ(threshold=threshold, alpha=1e-3).fit(design / size, error[:, None])
        weights = np.asarray(fitted.coef_).ravel()
        left = float(np.mean((error - design / size @ weights) ** 2))
        count = int(np.count_nonzero(weights))
        criterion = samples * float(np.log(left)) + count * float(np.log(samples))
        if criterion < best[0]:
            best = (criterion, weights)
    power = best[1] ** 2
    shares: dict[str, float] = {}
    for (name, _), own in zip(keys, power, strict=True):
        if own > 0.0:
            shares[name] = shares.get(name, 0.0) + float(own / power.sum())
    return shares


def _stacked(found: Sequence[Equation]) -> tuple[list[tuple[str, str]], Array, Array]:
    """Terms that every equation has and one feels, as columns (n, terms), and the errors (n,)."""
    keys = [k for k in found[0].terms if all(k in e.terms for e in found)]
    columns = {k: np.concatenate([e.terms[k] for e in found]) for k in keys}
    keys = [k for k in keys if np.mean(columns[k] ** 2) > 1e-6]
    error = np.concatenate([e.error for e in found])
    return keys, np.column_stack([columns[k] for k in keys]) if keys else np.zeros((error.size, 0)), error


def certified_terms(found: Sequence[Equation]) -> list[tuple[float, float, str]]:
    """(p, explained power, effect) of a term for every equation and regime: chosen on the first log, tested on the second,
    after LISDD (arXiv 2606.23215).

    The F-test compares the error with and without the term, whose coefficient is refitted, on as many samples as the
    error is worth.
    """
    tests = []
    for name in dict.fromkeys(e.name for e in found):
        logs = {e.log: e for e in found if e.name == name}
        first, second = (logs[n] for n in sorted(logs)[:2])
        for low, high in REGIMES.values():
            rows, other = ((e.command >= low) & (e.command < high) for e in (first, second))
            if min(rows.sum(), other.sum()) < 50:
                continue
            gains = {
                k: _explained(first.error[rows], t[rows]) for k, t in first.terms.items() if k in second.terms
            }
            if not gains:
                continue
            term = max(gains, key=lambda k: gains[k])
            error = second.error[other]
            power = float(error @ error)
            explained = _explained(error, second.terms[term][other])
            free = max(effective_samples(error) - 1.0, 1.0)
            ratio = explained / max(power - explained, 1e-30) * free
            tests.append((float(f_distribution.sf(ratio, 1, free)), explained, term[0]))
    return tests


def _explained(error: Array, term: Array) -> float:
    """Power of the error (n,) that a term (n,) explains."""
    power = float(term @ term)
    return float(error @ term) ** 2 / power if power > 1e-12 * term.size else 0.0


def false_discovery(p: Sequence[float], rate: float) -> float:
    """The largest p-value that Benjamini and Hochberg (1995) accept at this rate; -1 for none."""
    ordered = sorted(p)
    accepted = [v for n, v in enumerate(ordered, 1) if v <= rate * n / len(ordered)]
    return max(accepted, default=-1.0)


def by_regression(start: Start) -> Named:
    """What `sindy` names."""
    named: Named = []
    for c in start.open:
        for name, share in chosen_by_regression(equations(start, c)).items():
            named.append({"name": name, "channel": str(c + 1), "probability": share})
    return _joined(named)


def by_certification(start: Start) -> Named:
    """What `certify` names."""
    tests = {c: certified_terms(equations(start, c)) for c in start.open}
    limit = false_discovery([p for own in tests.values() for p, _, _ in own], FALSE_DISCOVERIES)
    named: Named = []
    for c, own in tests.items():
        passed = [(explained, name, p) for p, explained, name in own if p <= limit]
        if passed:
            _, name, p = max(passed)
            named.append({"name": name, "channel": str(c + 1), "probability": 1.0 - p})
    return _joined(named)


def _joined(named: Named) -> Named:
    """The same effect on both channels as one; what acts on the whole rig as such."""
    found: dict[str, dict[str, Any]] = {}
    for effect in named:
        known = found.get(effect["name"])
        if CATALOGUE[effect["name"]].scope == "rig":
            effect = {**effect, "channel": "rig"}
        elif known is not None:
            effect = {**effect, "channel": "both"}
        probability = max(effect["probability"], known["probability"] if known else 0.0)
        found[effect["name"]] = {**effect, "probability": min(max(float(probability), 0.0), 1.0)}
    return list(found.values())
