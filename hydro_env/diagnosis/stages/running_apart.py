"""Free simulations that run apart: where the angle of the shaft acts, an error of its speed adds up, and a fit to a free one ends
in a local minimum that makes up for this by chance.

A simulation that follows the measured speed (`DynamicRig.following`) stays beside the rig. Where what is named leaves a residual
in a free simulation and none in such a one, its values and its form are taken from that: prediction errors instead of output
errors (Ljung, System Identification, 1999). Held-out logs are still simulated freely, and judge as ever.
"""

from dataclasses import replace

from ..estimation.estimate import Estimate, distinct
from ..estimation.fit import Fit
from ..estimation.gauss_newton import SETTLE_ITERATIONS, solve
from .candidates import Selection
from .form_correction import Models, correct


def run(selection: Selection, verdict: str, models: Models) -> Models:
    """Refits what is named to simulations that follow the measured speed, on the channels where these alone explain the logs."""
    fit, accepted = selection.logs.fit, selection.accepted
    for p in distinct(models.named) if verdict == "effects" else ():
        channels = fit.channels_of(p)
        near = fit.on(fit.rig.following(fit.rig.followed | {*channels}))
        names = [(k.effect, k.channel) for k in accepted if p.channel in (None, k.channel)]
        able = names and near.rig.followed > fit.rig.followed
        if not able or not any(_unexplained(fit, models.final[c], c) for c in channels):
            continue
        starts = [p.at(p.q.copy()), p.from_given()]
        solve(near, starts, SETTLE_ITERATIONS)
        bare = min(starts, key=lambda start: start.cost)
        near = near.with_noise_seen_by(dict.fromkeys(channels, bare))
        near.rescore([bare])
        better, kept = correct(near, bare, names)
        if any(near.unexplained(better, c) for c in channels):
            continue
        before = [
            k
            for k in models.corrections
            if k.channel not in channels or (k.correction, k.channel) in p.placed_effects()
        ]
        models = replace(
            models, named={**models.named, **dict.fromkeys(channels, bare)},
            final={**models.final, **dict.fromkeys(channels, better)}, corrections=[*before, *kept],
            followed=models.followed | {*channels},
        )  # fmt: skip
    return models


def _unexplained(fit: Fit, estimate: Estimate, c: int) -> bool:
    """Whether a residual stays that is clearly above the noise, not only in the speed: of that a simulation that follows it says
    little."""
    factor, left = fit.settings.unexplained, fit.rms(estimate.simulated[c], c)
    return any(v > factor * fit.noise[c, signal] for (_, signal), v in left.items() if signal != "speed")
