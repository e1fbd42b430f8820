"""Free simulations that run apart: where the angle of the shaft acts, an error of its speed adds up, and a fit to a free one ends
in a local minimum that makes up for this by chance.

A simulation that follows the measured speed (`DynamicRig.following`) stays beside the rig. Where what is named leaves a residual
in a free simulation and none in such a one, its values and its form are taken from that: prediction errors instead of output
errors (Ljung, System Identification, 1999). Held-out logs are still simulated freely, and judge as ever.
"""

from dataclasses import replace

from ..estimation.gauss_newton import SETTLE_ITERATIONS, solve
from .candidates import Selection
from .form_correction import Models, correct
from .validation import AT_NOISE


def run(selection: Selection, verdict: str, models: Models) -> Models:
    """Refits what is named to simulations that follow the measured speed, on the channels where these alone explain the logs.

    A residual of the speed alone is left as it is: a simulation that follows the speed says little of it. So is a rig that is
    estimated as a whole, whose simulations are slow.
    """
    fit = selection.logs.fit
    for c, p in models.named.items() if verdict == "effects" else ():
        near = fit.on(fit.rig.following(fit.rig.followed | {c}))
        names = [(k.effect, k.channel) for k in selection.accepted if k.channel == c]
        able = names and p.channel == c and near.rig.followed > fit.rig.followed
        if not able or not fit.unexplained(models.final[c], c, besides="speed"):
            continue
        starts = [p.at(p.q.copy()), p.from_given()]
        solve(near, starts, SETTLE_ITERATIONS)
        bare = min(starts, key=lambda start: start.cost)
        near = near.with_noise_seen_by({c: bare})
        near.rescore([bare])
        better, kept = correct(near, bare, names)
        if near.at_noise(better, AT_NOISE):
            of_given = p.placed_effects()
            others = [k for k in models.corrections if k.channel != c or (k.correction, c) in of_given]
            models = replace(
                models, named={**models.named, c: bare}, final={**models.final, c: better}, corrections=[*others, *kept],
                followed=models.followed | {c},
            )  # fmt: skip
    return models
