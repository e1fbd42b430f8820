"""What may be set for a diagnosis, and which of its rules are switched off.

A rule is a step that rescues a fit or questions a name. Each has a switch, so that an ablation can measure what it is worth:
`diagnose(..., settings=Settings(rules_off=["grow_horizon"]))`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from ..errors import check_known

#: What each rule does, by its name.
RULES = {
    "compare_sets": "compare a set of local effects with one that has an effect of the whole rig",
    "compete_on_beginning": "compare all candidates on the beginning of the logs where the best one leaves something",
    "correct_form": "correct the form of named effects",
    "doubt_left": "reject names that leave much of a signal of the fit logs, whatever their form",
    "doubt_neutral": "reject names whose interval holds the neutral value",
    "doubt_worse": "reject names that make a signal worse of the held-out logs",
    "follow_speed": "follow the measured speed where a coupling rattles, which multiplies every difference",
    "grow_horizon": "fit what is far from the noise to the beginning of the logs first",
    "restart_friction": "restart the calibration with other spool friction where a little more than noise is left",
    "prefer_form": "drop an effect if another form of those beside it explains more",
}


@dataclass(frozen=True)
class Settings:
    """The choices of a diagnosis that a user may change. Numbers of the numerics stand where they are used.

    InputError for a rule that does not exist.
    """

    #: Accepted chance of one superfluous effect: the `p` of PASTIS (Gerardos and Ronceray 2025).
    false_alarm: float = 0.01
    #: Effects on a channel at most: one more than blind trials hide.
    max_effects: int = 3
    #: A residual that is this many times the noise, more than twice its power, in a signal of a log, stays unexplained: the
    #: verdict is `unknown`, ...
    unexplained: float = 1.5
    #: ... unless what was found explains this share of it in `Fit.levels`, more than it leaves, ...
    most_of_level: float = 0.5
    #: ... or this share in power: less than half of it is left in size.
    most_of_power: float = 0.8
    #: Competing candidates whose gain is less than this share behind count as indistinguishable: the laws of machines differ as
    #: much.
    tied_share: float = 0.1
    #: Factor on a deviance by which competing candidates fall behind: models are never exact, so a likelihood is tempered
    #: (power likelihood; Holmes and Walker 2017), here to the share above.
    temper: float = 0.1
    #: Command of the next experiment at most, as a share of the rated one, ...
    command_limit: float = 1.0
    #: ... its rate of change in rated commands per second (full command in 50 ms is a step to a shaft that remembers 0.18 s), ...
    rate_limit: float = 20.0
    #: ... the load pressure that the models predict, Pa; none: the supply pressure of the model.
    pressure_limit: float | None = None
    #: Its load at most, N m; none: the largest of the logs, 0: no load.
    load_limit: float | None = None
    #: Seed of the bootstrap; the same one gives the same result.
    seed: int = 0
    #: Rules that are switched off.
    rules_off: Collection[str] = ()

    def __post_init__(self) -> None:
        check_known("unknown rule", self.rules_off, RULES)

    def uses(self, name: str) -> bool:
        """Whether a rule is on."""
        return name not in self.rules_off
