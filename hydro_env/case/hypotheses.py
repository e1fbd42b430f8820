"""What is open after a diagnosis, with probabilities, what an experiment is to show of it, and how likely the best answer is
expected to be right then.

The probabilities are those of naming. Where nothing is named, the candidates that explain most share what unconfirmed names are
worth, by their tempered deviance. Where parameters explain the logs, candidates count by what they gain beyond what they must
pay for: that payment is the prior of the search (PASTIS, Gerardos and Ronceray 2025); effects that the logs would not show stay
as likely as they were.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..diagnosis import Diagnosis
from ..diagnosis.experiment_design import SECONDS, Question
from ..diagnosis.models.base import BLOCK_S, effect_in
from ..diagnosis.stages.naming import PARAMETERS, UNCONFIRMED, UNKNOWN
from ..diagnosis.stages.next_experiment import CALIBRATION, proposed, questions
from ..diagnosis.stages.screening import medium_starts
from .folder import Place

Distances = Mapping[tuple[str, str], float]

#: Digits of a probability, and the least share that is listed on its own.
DIGITS, LISTED = 3, 0.005
#: Effects that an experiment is to show at most: as many models as where names compete on both channels.
MAX_UNSEEN = 6


def places_of(found: Diagnosis) -> list[Place]:
    """What is open, for each effect that is named; else for each channel with candidates, or for the rig."""
    if found.effects:
        return [_place(n.channel, n.shares) for n in found.effects]
    if found.verdict in ("none", "calibration"):
        return [_place("rig", _without_names(found))]
    half, places = 0.5 * found.logs.fit.settings.temper, []
    for question in questions(found):
        least = min(p.cost for p in question.models.values())
        weights = {n: math.exp(-half * (p.cost - least)) for n, p in question.models.items()}
        shares = {n: UNCONFIRMED * w / sum(weights.values()) for n, w in weights.items()}
        if CALIBRATION in shares:
            shares[PARAMETERS] = shares.pop(CALIBRATION)
        channel = "rig" if question.channel is None else str(question.channel + 1)
        places.append(_place(channel, shares | {UNKNOWN: 1.0 - UNCONFIRMED}))
    return places or [_place("rig", {UNKNOWN: 1.0})]


def _without_names(found: Diagnosis) -> dict[str, float]:
    weights = {PARAMETERS: 1.0}
    for t in found.selection.candidates:
        if t.refitted and t.gain < t.needed:
            weights[t.effect] = max(weights.get(t.effect, 0.0), math.exp(0.5 * (t.gain - t.needed)))
    # What the logs would not show keeps its prior: every second rig lacks an effect, each is as likely.
    for s in (s for s in found.screening if not s.shows):
        weights[s.effect] = weights.get(s.effect, 0.0) + 1.0 / len(found.screening)
    return {n: w / sum(weights.values()) for n, w in weights.items()}


def _place(channel: str, shares: Mapping[str, float]) -> Place:
    """Rounded, the likeliest first, small ones as something unknown; they still sum to one."""
    kept = {n: round(p, DIGITS) for n, p in shares.items() if n != UNKNOWN and p >= LISTED}
    kept[UNKNOWN] = max(0.0, round(1.0 - sum(kept.values()), DIGITS))
    return Place(channel=channel, hypotheses=dict(sorted(kept.items(), key=lambda item: -item[1])))


def certainty(places: Sequence[Place]) -> float:
    """How likely the best answer is right at the place where that is least likely."""
    return min(max([p for n, p in each.hypotheses.items() if n != UNKNOWN], default=0.0) for each in places)


def expected(places: Sequence[Place], apart: Distances, temper: float) -> float:
    """The same after an experiment in which models of two names are so far apart (RMS in units of what is not known).

    If one of them is right, the others keep the weight of their expected deviance, tempered as in naming, and the likeliest is
    the best answer. What no model stands for keeps its share.
    """
    return min(_expected(each, apart, temper) for each in places)


def _expected(place: Place, apart: Distances, temper: float) -> float:
    shares = {n: p for n, p in place.hypotheses.items() if n != UNKNOWN and p > 0.0}
    models = {n: CALIBRATION if n == PARAMETERS else n for n in shares}

    def kept(one: str, other: str) -> float:
        pair = models[one], models[other]
        # An effect that no model stands for shows as little as none.
        known = [d for n in pair if (d := apart.get((CALIBRATION, n))) is not None]
        far = apart.get(pair, apart.get(pair[::-1], known[0] if len(known) == 1 else 0.0))
        # The laws of machines differ from block to block of `BLOCK_S`, so each counts once.
        return math.exp(-0.5 * temper * SECONDS / BLOCK_S * far**2)

    right = 0.0
    for one, p in shares.items():
        weights = [q if other == one else q * kept(one, other) for other, q in shares.items()]
        right += p * max(weights) / sum(weights)
    best = max(shares.values(), default=0.0)
    return round(max(best, right), DIGITS)


# --- where nothing seems to be missing: effects that the logs would not show ------------------------------------------------
def asked(found: Diagnosis) -> list[Question]:
    """What an experiment is to part: what the diagnosis leaves open; where nothing is missing the model without effects from it
    with one that the logs would not show, those first that they nearly show. What calibration takes up no experiment shows."""
    if found.verdict not in ("none", "calibration") or not found.rig.has_hidden_states:
        return questions(found)
    wanted: list[Question] = []
    for s in sorted((s for s in found.screening if not s.shows and not s.hidden), key=lambda s: -s.visible):
        if s.channel is not None and (bare := found.models.calibrated[s.channel]).columns:
            effect = effect_in(found.rig, s.effect, s.channel)
            start = medium_starts(effect, found.logs.seconds)[0]
            models = {CALIBRATION: bare, s.effect: bare.extended(effect, start, s.channel)}
            wanted.append(Question(s.channel, models))
    del wanted[MAX_UNSEEN:]
    found.logs.fit.evaluate([p for question in wanted for p in question.models.values()])
    return wanted


def with_experiment(found: Diagnosis) -> Diagnosis:
    """The diagnosis with an experiment for what the logs would not show, where it proposes none."""
    return (
        found if found.next_experiment else replace(found, next_experiment=proposed(found, asked(found), {}))
    )
