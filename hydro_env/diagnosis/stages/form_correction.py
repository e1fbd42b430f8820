"""Corrections of form: what the law of a named effect leaves, put right at its own port. This is not physics.

A rig's effect has another functional form than the catalogue's: a corner is rounded, a gain is no straight line, a lag has a
second pole. Once an effect has its name, the corrections that belong to it are fitted jointly with its parameters and the base
parameters. Each number of a correction has a prior about zero, and a correction stays only if the deviance of the fit logs
falls by more than the penalty that a further effect would have to pay. It never names anything: where nothing is named or given
there is nothing to correct. Effects that the model as given has get their corrections before any is sought.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...plant import CATALOGUE, Effect
from ...plant.catalogue.form_corrections import CORRECTIONS, FAMILY, follows
from ..estimation.estimate import Estimate, Estimates, distinct
from ..estimation.fit import Fit
from ..estimation.gauss_newton import SETTLE_ITERATIONS, solve
from ..estimation.local_minima import grow_horizon
from ..estimation.unknowns import Unknown
from ..models.base import effect_in, given_effects
from .calibration import Calibrated
from .candidates import Correction, Selection, penalty_per_parameter

#: Iterations of a joint refit with a correction; the one that is kept goes as far as it goes.
TRY_ITERATIONS = 8
#: Corrections of one estimate at most, besides one for each given effect: in blind trials (docs/evidence/notes.md) a second one
#: halved what four of five rigs left above the noise.
MAX_CORRECTIONS = 2
#: An effect, and its channel (None: the rig).
Placed = tuple[str, int | None]
#: The best corrections of estimates for which any were tried, None where there is none.
Tried = Mapping[Estimate, Correction | None]
NONE: Tried = {}


@dataclass(frozen=True)
class Models:
    """The models that are compared, by channel: as given, calibrated, with the `named` effects, with the corrections of their
    form as well (`final`), and with the best wrong effects instead (`placebo`)."""

    given: Estimates
    calibrated: Estimates
    named: Estimates
    final: Estimates
    placebo: Estimates
    corrections: list[Correction] = field(default_factory=list)

    @property
    def shown(self) -> Estimates:
        """The estimates whose known parameters are reported."""
        return self.calibrated if self.final == self.given else self.final

    def with_shown(self, shown: Estimates) -> "Models":
        """The same with other estimates for those that are reported; one that is several models' stays one."""
        new = {p: shown[c] for c, p in self.shown.items()}
        names = ("given", "calibrated", "named", "final", "placebo")
        own: Any = {name: {c: new.get(p, p) for c, p in getattr(self, name).items()} for name in names}
        return replace(self, **own)

    def as_named(self) -> "Models":
        """The same without the corrections of what is named."""
        left = {placed for p in self.named.values() for placed in p.placed_effects()}
        kept = [k for k in self.corrections if (k.correction, k.channel) in left]
        return replace(self, final=self.named, corrections=kept)


def of_given(calibrated: Calibrated) -> tuple[Calibrated, list[Correction]]:
    """Corrects the form of the effects that the model as given has, and estimates the noise again: what is left of their laws
    would be taken for an effect that is missing.

    Of each effect the best correction that pays is kept, if it belongs to the law itself: a curve that several effects share
    could take up a missing one. It need not pay in independent samples, of which what is missing leaves few.
    """
    logs, found, every = calibrated.logs, dict(calibrated.estimates), []
    fit = logs.fit
    for p in [p for p in distinct(found) if fit.rig.has_hidden_states and not fit.at_noise(p)]:
        tries = sorted(attempts(fit, p, [], shared=False), key=lambda t: -t.score)
        best = {(t.effect, t.channel): t for t in tries if t.score < p.cost}
        better = p
        for t in sorted(best.values(), key=lambda t: t.score):
            of = effect_in(fit.rig, t.correction, t.channel)
            better = t.estimate if better is p else with_correction(better, t.effect, of, t.channel)
            every.append(replace(t, fall=p.cost - t.estimate.cost))
        solve(fit, [better] if best else [], SETTLE_ITERATIONS)
        found.update(dict.fromkeys(fit.channels_of(p), better))
    fit = fit.with_noise_seen_by(found) if every else fit
    fit.rescore(distinct(found) if every else [])
    plain = {c: p for c, p in calibrated.estimates.items() if p is not found[c]}
    return replace(calibrated, logs=replace(logs, fit=fit), estimates=found, plain=plain), every


def run(given: Estimates, selection: Selection, verdict: str, before: Sequence[Correction]) -> Models:
    """Corrects the form of what is named or given; `before` are the corrections that the calibrated estimates have."""
    fit, found = selection.logs.fit, selection.estimates
    final, corrections = (given, []) if verdict == "none" else (found, [*before])
    if verdict in ("effects", "calibration"):
        named = [(k.effect, k.channel) for k in selection.accepted]
        final, more = correct_all(fit, found, named, selection.forms)
        corrections += more
    return Models(given, selection.calibrated, found, final, selection.placebo, corrections)


def is_correction(effect: str) -> bool:
    """Whether an effect of the catalogue is a correction of form."""
    return CATALOGUE[effect].family == FAMILY


def with_correction(estimate: Estimate, effect: str, of: Effect, channel: int | None = None) -> Estimate:
    """The estimate with a correction `of` one of its effects more; `channel` is the effect's, where the estimate is the rig's.

    Numbers of either sign begin at zero, others at their usual size: a corner that is rounded ever less has no derivative.
    """
    alone = channel if estimate.channel is None else None
    correction = of.name
    repeated, added = follows(correction, effect), []
    for p in (p for p in of.parameters if f"{correction}.{p.name}" not in repeated):
        # The prior is as wide as a correction usually is: ridge regression, in other words.
        shape = not p.carries_size
        scale = 0.7 if p.log else 0.15 * (p.high - p.low) if shape else abs(p.typical)
        bounds = (p.nominal, p.low, p.high)
        added.append(Unknown(p.name, p.unit, *bounds, scale, p.log, True, alone, correction))
    q = np.concatenate([estimate.q, [1.0 if u.low == u.center == 0.0 else 0.0 for u in added]])
    label, follow = f"{estimate.label} + {correction}", {**estimate.follow, **repeated}
    return Estimate(estimate.channel, [*estimate.unknowns, *added], q, label, follow=follow)


def correct(
    fit: Fit, estimate: Estimate, named: Sequence[Placed], known: Tried = NONE
) -> tuple[Estimate, list[Correction]]:
    """The estimate with those corrections of its effects `named` (with their channels) and of given ones that pay for themselves;
    the estimate itself if none does. `known` are the best corrections of estimates for which they were tried.
    """
    kept: list[Correction] = []
    for number in range(MAX_CORRECTIONS + len(given_on(fit, estimate))):
        if not fit.rig.has_hidden_states or fit.at_noise(estimate):
            break
        best = known.get(estimate) or best_attempt(fit, estimate, named)
        if best is None:
            break
        better = replace(best.estimate)
        if number == 0 and estimate.channel is not None:
            grow_horizon(fit, [better])
        # As a further effect it pays in independent samples.
        if better.cost + best.needed >= estimate.cost or fit.gain(estimate, better) < best.needed:
            break
        solve(fit, [better], SETTLE_ITERATIONS)
        kept.append(replace(best, fall=estimate.cost - better.cost))
        estimate = better
    return estimate, kept


def given_on(fit: Fit, estimate: Estimate) -> list[Placed]:
    """The effects that the model as given has on the channels of an estimate, each with its channel, None for the whole rig."""
    both = ((e, c) for c in fit.channels_of(estimate) for e in given_effects(fit.rig, c))
    every = ((e.name, None if e.scope == "rig" else c) for e, c in both if not is_correction(e.name))
    return list(dict.fromkeys(every))


def best_attempt(fit: Fit, estimate: Estimate, named: Sequence[Placed]) -> Correction | None:
    """The best of the estimates with a correction more of one of its effects `named` (with their channels) or of given ones;
    None if there is none."""
    return min(attempts(fit, estimate, named), key=lambda t: t.score, default=None)


def attempts(fit: Fit, estimate: Estimate, named: Sequence[Placed], shared: bool = True) -> list[Correction]:
    """The estimates with a correction more of one of its effects `named` (with their channels) or of given ones, refitted. Those
    that several effects share and that repeat nothing of any are left out unless `shared`.

    The known parameters have moved to make up for the form, so they begin where they are and where they were given. Those of a
    whole rig, whose simulations are slow, and those with a correction before this one begin where they are.
    """
    tries, present = [], set(estimate.placed_effects())
    for effect, channel in dict.fromkeys([*named, *given_on(fit, estimate)]):
        for correction, repeated in CORRECTIONS.get(effect, {}).items():
            own_law = shared or repeated or len(CATALOGUE[correction].corrects) == 1
            if own_law and not fit.rig.has(correction, channel) and (correction, channel) not in present:
                own = len(CATALOGUE[correction].parameters) - len(repeated)
                more = with_correction(estimate, effect, effect_in(fit.rig, correction, channel), channel)
                tries.append(Correction(effect, channel, correction, more, penalty_per_parameter(fit) * own))
    first = estimate.channel is not None and not any(map(is_correction, estimate.effects()))
    again = {t.estimate: t.estimate.from_given().in_all_directions() for t in tries if first}
    every = [*(t.estimate for t in tries), *again.values()]
    solve(fit, every, TRY_ITERATIONS)
    for one, other in again.items():
        one.adopt(other)
    return tries


def correct_all(
    fit: Fit, estimates: Estimates, named: Sequence[Placed], known: Tried = NONE
) -> tuple[Estimates, list[Correction]]:
    """Every estimate with the corrections of what is `named` there: effects with their channel, None for those of the rig."""
    found: Estimates = dict(estimates)
    every: list[Correction] = []
    for one in distinct(estimates):
        names = [(effect, channel) for effect, channel in named if one.channel in (None, channel)]
        if names or given_on(fit, one):
            better, kept = correct(fit, one, names, known)
            found.update(dict.fromkeys(fit.channels_of(one), better))
            every += kept
    return found, every
