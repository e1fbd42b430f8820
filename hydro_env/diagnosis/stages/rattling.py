"""Couplings that rattle: a free simulation of a gap soon runs apart from the rig, whatever its parameters.

Each blow of a coupling depends on when the one before it came, so an error grows fivefold in a tenth of a second, and a fit to a
free simulation has as many local minima as there are blows. A simulation that follows the measured speed (`DynamicRig.following`)
stays beside the rig: the load behind the coupling is driven by what the shaft really did. There a few looks tell
whether a backlash explains something. Where one does, all candidates of the channel are compared, refitted and judged by such
simulations; the errors that are reported stay those of free ones.
"""

from itertools import product

import numpy as np

from ..estimation.estimate import Estimate, Estimates, Vector
from ..estimation.fit import Fit
from ..estimation.gauss_newton import SETTLE_ITERATIONS, solve
from ..models.base import effect_in
from .calibration import Calibrated, as_given
from .candidates import penalty
from .screening import Screening

EFFECT = "shaft_backlash"
#: First looks, over most of what is plausible: shares of the known inertia that are behind the coupling, and its gap and
#: stiffness over their usual ones.
SHARES, GAPS, STIFFNESSES = (0.2, 0.4, 0.65), (0.4, 1.0, 1.8), (0.7, 1.7)
#: Rounds of the cross-entropy method (Rubinstein 1999) about the best looks, how many looks each, eight for each of the four
#: parameters, and how many are the best, a fifth of these. Their spread at first, that of the first looks, and what is added so
#: that it does not die out, as logarithms.
ROUNDS, LOOKS, BEST, FIRST_WIDTH, MIN_WIDTH = 8, 32, 6, 0.4, 0.03


def run(calibrated: Calibrated, beside: Estimates) -> Calibrated:
    """Finds the channels whose coupling rattles beside the estimates so far, and has their simulations follow the measured speed.

    An effect that explains more may have hidden it beside the calibrated model. The same result if there is no new one.
    """
    logs, found = calibrated.logs, {}
    fit, rig = logs.fit, logs.rig
    able = rig.has_hidden_states and EFFECT in rig.candidates()
    for c, p in beside.items() if able else ():
        known = c in rig.followed or EFFECT in p.effects() or rig.has(EFFECT, c)
        open_ = p.channel == c and not known and fit.unexplained(p, c)
        if open_ and (one := _backlash(fit.on(rig.following({c})), p, c)):
            found[c] = one
    if not found:
        return calibrated
    logs = logs.following(rig.followed | set(found))
    estimates = {c: p.at(p.q.copy()) if c in found else p for c, p in calibrated.estimates.items()}
    solve(logs.fit, [estimates[c] for c in found], SETTLE_ITERATIONS)
    every = [*found.values(), *calibrated.backlashes]
    plain = {c: p for c, p in calibrated.plain.items() if c not in found}
    return Calibrated(logs, as_given(logs.fit), estimates, calibrated.findings, every, plain)


def _backlash(fit: Fit, calibrated: Estimate, c: int) -> Screening | None:
    """A backlash on a channel as it is looked at first, if one explains something beside the calibrated model.

    If none of the first looks comes nearer to the logs than the model without, none is there.
    Else random looks about the best ones lead to where derivatives do: a blow earlier or later is no matter of small steps.
    """
    bare = calibrated.at(calibrated.q.copy())
    usual = {p.name: p for p in effect_in(fit.rig, EFFECT, c).parameters}
    inertias = np.array(SHARES) * bare.values(c)["J"]
    gaps = np.array(GAPS) * usual["gap"].typical
    stiffnesses = np.array(STIFFNESSES) * usual["stiffness"].nominal
    points = np.log(list(product(inertias, gaps, stiffnesses, [usual["damping"].nominal])))
    looks = _looks(fit, bare, c, points)
    fit.evaluate([bare])
    if min(p.cost for p in looks) > bare.cost:
        return None
    rng, width = np.random.default_rng(fit.settings.seed), np.full(4, FIRST_WIDTH)
    for _ in range(ROUNDS):
        best = points[np.argsort([p.cost for p in looks])[:BEST]]
        new = best[np.arange(LOOKS) % BEST] + width * rng.standard_normal((LOOKS, 4))
        points, looks = np.concatenate([points, new]), [*looks, *_looks(fit, bare, c, new)]
        width = points[np.argsort([p.cost for p in looks])[:BEST]].std(axis=0) + MIN_WIDTH
    found = min(looks, key=lambda p: p.cost)
    gain = fit.gain(bare, found)
    start = {n.removeprefix(f"{EFFECT}."): v for n, v in found.values(c).items() if n.startswith(EFFECT)}
    return Screening(EFFECT, c, start, gain, 0.0) if gain > penalty(fit, EFFECT) else None


def _looks(fit: Fit, bare: Estimate, c: int, points: Vector) -> list[Estimate]:
    """The estimate with a backlash at each of `points` (n, 4), logarithms of its parameters, simulated."""
    effect, found = effect_in(fit.rig, EFFECT, c), []
    for point in np.exp(points):
        both = zip(effect.parameters, point, strict=True)
        start = {p.name: float(np.clip(v, p.low, p.high)) for p, v in both}
        found.append(bare.with_effect(effect, start, c))
    fit.evaluate(found)
    return found
