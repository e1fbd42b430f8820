"""Candidates: what an effect must gain to be accepted, how a refitted one is judged, and what selection remembers of each."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...plant import CATALOGUE
from ..estimation.estimate import Estimate, Estimates
from ..estimation.fit import Fit
from ..estimation.unknowns import Unknown
from ..logs import Logs, place_of

#: What becomes of a candidate, in words that the report shows.
ACCEPTED = "accepted"
OUTDONE = "others explain more"
VANISHED = "vanishes when refitted"
ABSENT = "its interval holds the neutral value"
TOO_LITTLE = "explains too little at first look"
#: An estimate that is nearer to neutral than this share of the usual size has vanished: nobody would look for so little.
NEUTRAL_SHARE = 0.02
#: The round under which candidates are listed that were judged after the forward rounds.
AFTER_ROUNDS = 9


@dataclass(frozen=True, eq=False)
class Candidate:
    """What became of a candidate: `gain` is the fall of the deviance, `needed` what it takes; `outcome` in words."""

    effect: str
    channel: int | None
    round: int
    gain: float
    needed: float
    outcome: str
    estimate: Estimate | None = None

    @property
    def where(self) -> str:
        return place_of(self.channel)

    @property
    def refitted(self) -> bool:
        return self.estimate is not None

    @property
    def accepted(self) -> bool:
        return self.outcome == ACCEPTED

    def as_dict(self) -> dict[str, object]:
        return {
            "effect": self.effect, "channel": self.where, "round": self.round, "gain": round(float(self.gain), 1),
            "needed": round(float(self.needed), 1), "refitted": self.refitted, "outcome": self.outcome,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Accepted:
    """An effect that was accepted, its gain over leaving it out (`without`), and the candidates that did nearly as well in its
    place, by name with how far their deviance is behind. `rival` is how far the best other set of effects is behind, with what
    both must pay for, where such a set without this effect was fitted."""

    effect: str
    channel: int | None
    gain: float
    needed: float
    competing: Mapping[str, float] = field(default_factory=dict)
    without: Estimate | None = None
    rival: float = np.inf


@dataclass(frozen=True)
class Correction:
    """An estimate with one correction of the form of an effect more, and by how much the cost must fall for it (`needed`); of one
    that stayed how far it fell (`fall`)."""

    effect: str
    channel: int | None
    correction: str
    estimate: Estimate
    needed: float
    fall: float = 0.0

    @property
    def score(self) -> float:
        """The cost with what the correction must pay for."""
        return self.estimate.cost + self.needed


@dataclass(frozen=True)
class Selection:
    """The result: final estimates by channel (the same joint one for both where an effect of the rig was accepted), the
    calibrated ones beside them, and the `logs` with the noise that they show. `forms` are the best corrections of form of those
    estimates for which any were tried."""

    logs: Logs
    calibrated: Estimates
    estimates: Estimates
    accepted: list[Accepted]
    candidates: list[Candidate]
    placebo: Estimates
    forms: Mapping[Estimate, Correction | None] = field(default_factory=dict)

    def in_best_form(self) -> Estimates:
        """The estimates, each with its best correction of form where that explains more."""
        best = {c: self.forms.get(p) for c, p in self.estimates.items()}
        pays = {c: t for c, t in best.items() if t is not None and t.estimate.cost < self.estimates[c].cost}
        return {**self.estimates, **{c: t.estimate for c, t in pays.items()}}


def penalty_per_parameter(fit: Fit) -> float:
    """Fall of the deviance that every parameter of an effect must pay for: 2 ln(n0 / p) with n0 parameters in the library and p
    the accepted chance of a superfluous effect (PASTIS, Gerardos and Ronceray 2025)."""
    library = sum(len(CATALOGUE[name].parameters) for name in fit.rig.candidates()) * len(fit.rig.channels)
    return float(2.0 * np.log(max(library, 2) / fit.settings.false_alarm))


def penalty(fit: Fit, effect: str) -> float:
    """Fall of the deviance that the effect's parameters must pay for."""
    return penalty_per_parameter(fit) * len(CATALOGUE[effect].parameters)


def judge(fit: Fit, after: Estimate, effect: str, gain: float, channel: int | None = None) -> str:
    """What becomes of a candidate that gains so much: `ACCEPTED`, or why not; `channel` is its own, where the estimate is the
    rig's."""
    if gain < penalty(fit, effect):
        return "gains less than chance could"
    return VANISHED if is_neutral(after, effect, channel) else ACCEPTED


def neutral_of(unknown: Unknown) -> float:
    """Where an effect vanishes by this parameter. That of a limit is infinite: the upper end of its range stands for it."""
    return min(CATALOGUE[unknown.effect].parameter(unknown.parameter).neutral, unknown.high)


def is_neutral(estimate: Estimate, effect: str, channel: int | None = None) -> bool:
    """Whether the estimate of an effect is its neutral value; `channel` says whose, where the estimate is the rig's."""
    for u, q in zip(estimate.unknowns, estimate.q, strict=True):
        own = u.effect == effect and (channel is None or u.channel in (None, channel))
        if own and CATALOGUE[effect].parameter(u.parameter).carries_size:
            neutral = neutral_of(u)
            if abs(u.value(float(q)) - neutral) >= NEUTRAL_SHARE * abs(u.typical - neutral):
                return False
    return True
