"""How much of a residual is explained: the criteria by which a candidate, a name or a verdict is accepted."""

from __future__ import annotations

import numpy as np

from .estimate import Estimate
from .fit import Fit
from .noise import effective_samples

__all__ = ["could_pay", "far_from_noise", "mostly_explained", "unexplained"]

#: Signals above this many times the noise count where power is compared: three quarters of their power are missing.
CLEARLY_ABOVE = 2.0
#: A residual (in `Fit.levels`, summed over the signals) that is too small to speak of something unknown: errors of 1.15 times the
#: noise in one signal.
SMALL_SUM = 0.15
#: A log whose mean square error is above this many times the noise's (1.02 squared, as `Fit.at_noise`) could pay for an effect,
#: if its deviance is worth one parameter of a library of 200 (`candidates.penalty`).
ABOVE_NOISE, WORTH = 1.04, 20.0
#: A residual (`Fit.level`) up to which a local minimum may be the cause, errors of 2.1 times the noise; what a missing effect
#: leaves is larger.
SMALL_LEVEL = 1.0


def could_pay(fit: Fit, estimate: Estimate, channel: int) -> bool:
    """Whether a channel has a residual above its noise that could pay for an effect, or one that must not stay unexplained.

    A residual that goes on for long counts few independent samples, and the many more that are left when an effect explains it.
    """
    worth, seen = 0.0, False
    for s in fit.rig.segments[channel]:
        error = (s.measured - estimate.simulated[channel][s.place])[s.used]
        if error.size:
            ratio = float(np.mean(error**2)) / fit.noise[channel, s.signal] ** 2
            seen = seen or ratio > ABOVE_NOISE
            worth += effective_samples(error) * max(np.log(ratio), 0.0)
    return seen and (worth > WORTH or unexplained(fit, estimate, channel))


def unexplained(fit: Fit, estimate: Estimate, channel: int) -> bool:
    """Whether a residual stays that is clearly above the noise, in a signal of a log."""
    left = fit.rms(estimate.simulated[channel], channel)
    return any(v > fit.settings.unexplained * fit.noise[channel, signal] for (_, signal), v in left.items())


def mostly_explained(fit: Fit, before: Estimate, after: Estimate, c: int) -> bool:
    """Whether most of the residual that `before` leaves on channel c is explained by `after`, by level or by power.

    By level a few events count little, such as a spool that meets its end stop late in a model of another functional form;
    by power what is small everywhere counts little, such as the ripple that a steady model leaves.
    """
    old, new = (sum(fit.levels(p.simulated[c], c).values()) for p in (before, after))
    by_level = new < SMALL_SUM or new < (1.0 - fit.settings.most_of_level) * old
    was, left = (fit.rms(p.simulated[c], c) for p in (before, after))
    noise = {k: fit.noise[c, k[1]] for k in left}
    excess = {k: left[k] ** 2 - noise[k] ** 2 for k in left if left[k] > CLEARLY_ABOVE * noise[k]}
    left_share = 1.0 - fit.settings.most_of_power
    by_power = all(e < left_share * (was[k] ** 2 - noise[k] ** 2) for k, e in excess.items())
    return by_level or by_power


def far_from_noise(fit: Fit, estimate: Estimate) -> bool:
    """Whether more is left than a local minimum leaves."""
    return fit.level(estimate) > SMALL_LEVEL
