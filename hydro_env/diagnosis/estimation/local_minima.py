"""Ways out of local minima: restarts with other friction, and fits to the beginning of the logs.

At the beginning there is one minimum, and a simulation costs little.

On whole logs a missing effect has pulled known parameters along, and a shaft that nearly comes to rest turns on this way or that,
from where it is revolutions off and dominates the remaining residual: no small step repairs it. What lies before determines the
parameters, and these carry the simulation past it. So an estimate that is far from the noise is fitted to more and more of the
logs (`grow_horizon`), and competing candidates from every size to their first half second (`best_on_early_window`).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ...plant import CATALOGUE
from ..models.base import RigModel, Segment, Segments, effect_in
from .estimate import Estimate
from .fit import Fit
from .gauss_newton import SETTLE_ITERATIONS, solve
from .unknowns import effect_starts

#: Times the noise from which on an estimate is fitted to the beginning of the logs first: three quarters of the power are left.
FAR = 2.0
#: The shares of the logs in turn, first longer by a half each, then by a tenth of the logs; still smaller ones changed no name
#: (docs/evidence/notes.md).
HORIZONS = (0.02, 0.04, 0.07, 0.11, 0.15, 0.22, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
#: Share up to which a beginning is short: it costs little, so there are more iterations, and it is too short to show the noise.
SHORT_HORIZON = 0.1
#: Iterations with each horizon, with a short one (as far as it goes, `SETTLE_ITERATIONS`), and with the whole logs.
ITERATIONS, SHORT_ITERATIONS, LAST_ITERATIONS = 2, SETTLE_ITERATIONS, 4
#: Residual (`Fit.level`) from which on a beginning is not followed: errors of 1.3 times the noise.
LOST_LEVEL = 0.3
#: Starts that are improved on the first horizon, and that go on from there: the estimate's and the given parameters'.
HORIZON_STARTS, KEPT_STARTS = 6, 2

#: For competing candidates: shares of the logs in turn, each twice as long as the one before (half a second of a log of 12 s,
#: which holds one movement, to 2.6 s), iterations with each, and the starts of each candidate that go on.
STAGES = ((0.04, 2, 2), (0.04, 6, 1), (0.11, 4, 1), (0.22, 3, 1))
#: Starts of each candidate that are improved, of all those that are simulated once: both signs of a size and one more.
FIRST_STARTS = 3
#: A candidate is dropped that is behind the best one by more than this, which pays for five parameters (`candidates.penalty`),
#: and by more than this share of what the best one gains over no effect.
FAR_BEHIND, OUT_OF_REACH = 100.0, 0.5


def early_window_of(rig: RigModel, share: float) -> RigModel:
    """The model with only this share of each log, from its beginning, of which it also simulates no more."""
    rows = [max(2, math.ceil(share * len(part.log))) for part in rig.parts]
    parts = [part.first(n) for part, n in zip(rig.parts, rows, strict=True)]
    return rig.view(parts=parts, segments={c: _first(own, rows) for c, own in rig.segments.items()})


def _first(segments: Sequence[Segment], rows: Sequence[int]) -> Segments:
    """The samples of the first `rows` of each log, which again lie one behind the other in a vector."""
    place, found = 0, Segments()
    for s in segments:
        n = int(np.searchsorted(s.rows, rows[s.log]))
        own = {name: getattr(s, name) for name in ("measured", "rows", "inside", "late")}
        cut = {name: values[:n] for name, values in own.items() if values is not None}
        found.append(replace(s, **cut, place=slice(place, place + n)))
        place += n
    return found


# --- one estimate, on a growing horizon -------------------------------------------------------------------------------------
def grow_horizon(fit: Fit, estimates: Sequence[Estimate]) -> list[Estimate]:
    """Improves in place those of `estimates` that are far from the noise; returns the ones that became better."""
    found = []
    for estimate in estimates:
        seen = fit.with_noise_seen_by(dict.fromkeys(fit.channels_of(estimate), estimate))
        if not seen.at_noise(estimate, FAR) and estimate.adopt(_grown(fit, seen, estimate)):
            found.append(estimate)
    return found


def _grown(fit: Fit, seen: Fit, estimate: Estimate) -> Estimate:
    """The best of several starts, where the estimate is and where the known parameters were given, there with other values of the
    effects too, fitted to more and more of the logs; on the way by the noise that is `seen`."""
    given = estimate.from_given()
    starts = [p.in_all_directions() for p in (estimate, given, *_elsewhere(fit.rig, given))]
    seen.on(early_window_of(fit.rig, HORIZONS[0])).evaluate(starts[KEPT_STARTS:])
    starts[KEPT_STARTS:] = sorted(starts[KEPT_STARTS:], key=lambda p: p.cost)[: HORIZON_STARTS - KEPT_STARTS]
    for share in HORIZONS:
        beginning = seen.on(early_window_of(fit.rig, share))
        starts = [p.at(p.q.copy()) for p in starts]
        solve(beginning, starts, SHORT_ITERATIONS if share < SHORT_HORIZON else ITERATIONS)
        starts.sort(key=lambda p: p.cost)
        del starts[KEPT_STARTS:]
        if share > SHORT_HORIZON:
            beginning = beginning.with_noise_seen_by(dict.fromkeys(fit.channels_of(estimate), starts[0]))
            seen = beginning.on(fit.rig)
            beginning.rescore(starts)
        # A shaft that went the other way stays off, a spool that stuck a moment longer does not.
        if not beginning.level(starts[0]) < LOST_LEVEL:
            break  # something is missing that this effect does not make up for
    for start in starts:
        start.columns = {}
    fit.evaluate(starts)
    solve(fit, starts, LAST_ITERATIONS)
    return min(starts, key=lambda p: p.cost)


def _elsewhere(rig: RigModel, estimate: Estimate) -> Iterator[Estimate]:
    """The estimate with each of its effects at every size and shape that is worth a first simulation: from the wrong side of a
    turn no small step leads to the right one."""
    for effect in estimate.effects():
        if estimate.channel is None or CATALOGUE[effect].family:
            continue
        for values in effect_starts(effect_in(rig, effect, estimate.channel), math.inf, whole=True):
            both = zip(estimate.unknowns, estimate.q, strict=True)
            q = [u.q(values[u.parameter]) if u.effect == effect else now for u, now in both]
            yield estimate.at(np.clip(q, *estimate.bounds))


# --- competing candidates -----------------------------------------------------------------------------------------------
def best_on_early_window(
    fit: Fit, presents: Sequence[tuple[int, Estimate]], names: Sequence[Sequence[str]]
) -> list[list[Estimate]]:
    """For each of `presents`, with its channel, the few extensions by one of the effects `names` on that channel that explain the
    beginning of the logs best.

    They come best first. They start from the estimate and from the known parameters as given, with every size and shape of the
    effect.
    """
    fields = [_starts(fit.rig, p, c, own) for (c, p), own in zip(presents, names, strict=True)]
    beginning = fit.on(early_window_of(fit.rig, STAGES[0][0]))
    beginning.evaluate([p for field in fields for p in field])
    fields = [best_of_each(field, FIRST_STARTS) for field in fields]
    for share, iterations, kept in STAGES:
        beginning = fit.on(early_window_of(fit.rig, share))
        fields = [[p.at(p.q.copy()) for p in field] for field in fields]
        solve(beginning, [p for field in fields for p in field], iterations)
        fields = [_within_reach(fit, best_of_each(field, kept)) for field in fields]
    best = ([p for p in best_of_each(field) if p.label] for field in fields)
    return [[p.at(p.q.copy()) for p in own[: fit.settings.max_effects]] for own in best]


def _starts(rig: RigModel, present: Estimate, channel: int, names: Sequence[str]) -> list[Estimate]:
    """Every start of every candidate; without a label those that have no further effect."""
    found = [present.at(present.q.copy(), ""), present.from_given().at(present.from_given().q, "")]
    for one in extensions(rig, present, channel, names):
        found += [one, one.from_given()]
    return found


def extensions(rig: RigModel, present: Estimate, channel: int, names: Iterable[str]) -> Iterator[Estimate]:
    """The estimate with each effect at every size and shape that is worth a first simulation."""
    for name in names:
        effect = effect_in(rig, name, channel)
        for values in effect_starts(effect, math.inf, whole=True):
            yield present.with_effect(effect, values, channel)


def best_of_each(
    field: Sequence[Estimate], count: int = 1, key: Callable[[Estimate], float] = lambda p: p.cost
) -> list[Estimate]:
    """The best `count` estimates of each label, best first."""
    found: list[Estimate] = []
    for p in sorted(field, key=key):
        if sum(other.label == p.label for other in found) < count:
            found.append(p)
    return found


def _within_reach(fit: Fit, field: Sequence[Estimate]) -> list[Estimate]:
    """Those of a field, best first, that may still become the best; in any case as many as a channel may have effects."""
    best = field[0].cost
    fall = min(p.cost for p in field if not p.label) - best
    found: list[Estimate] = []
    for p in field:
        near = p.cost - best < max(FAR_BEHIND, OUT_OF_REACH * fall)
        if near or not p.label or len({f.label for f in found} | {p.label}) <= fit.settings.max_effects:
            found.append(p)
    return found


# --- restarts ---------------------------------------------------------------------------------------------------------------
#: Base parameters that are drawn again, and the standard deviations of the factors, less than their priors': a start has to be
#: near enough to what is found from it.
DRAWN = {"Fc": 0.15, "Fs": 0.15, "vs": 0.3}
#: New starts, iterations of each round, after which the better half goes on, and how often all this is done at most, as long as
#: it helps. Three times free all four of the spools that are stuck in the rigs of tests/diagnosis/test_diagnosis_local_minima.py.
STARTS, ROUNDS, MAX_TIMES = 8, (2, 3), 3


def restart_friction(fit: Fit, estimates: Sequence[Estimate], iterations: int) -> None:
    """Multistart: improves in place those of `estimates` that leave more than noise, but not so much that an effect is missing;
    what becomes better is improved for `iterations` more.

    A spool that sticks a moment longer or shorter changes the logs by a jump, so Gauss-Newton steps end in the local minimum in
    which they began. So the friction of the spool is drawn again several times, about the values as given and about those of the
    estimate in turn; all starts are improved side by side, the better half for longer (successive halving).
    """
    rng = np.random.default_rng(0)
    live = [p for p in estimates if any(u.name in DRAWN for u in p.unknowns)]
    for _ in range(MAX_TIMES):
        live = [p for p in live if not fit.at_noise(p) and not fit.far_from_noise(p)]
        fields = [[_with_other_friction(p, n % 2 == 1, rng) for n in range(STARTS)] for p in live]
        for each in ROUNDS:
            solve(fit, [p for starts in fields for p in starts], each)
            fields = [sorted(starts, key=lambda p: p.cost)[: len(starts) // 2] for starts in fields]
        live = [p for p, starts in zip(live, fields, strict=True) if p.adopt(starts[0])]
        solve(fit, live, iterations)


def _with_other_friction(estimate: Estimate, here: bool, rng: np.random.Generator) -> Estimate:
    """The same with the friction of the spool drawn again, about its own or (not `here`) the given values."""
    q = estimate.q.copy()
    for j, u in enumerate(estimate.unknowns):
        if u.name in DRAWN:
            q[j] = (q[j] if here else 0.0) + DRAWN[u.name] / u.scale * rng.standard_normal()
    # Derivatives of before are good enough for the first step.
    return replace(estimate.at(np.clip(q, *estimate.bounds)), columns=dict(estimate.columns))
