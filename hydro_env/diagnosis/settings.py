"""What may be set for a diagnosis."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """The choices of a diagnosis that a user may change. Numbers of the numerics stand where they are used."""

    #: Accepted chance of one superfluous effect: the `p` of PASTIS (Gerardos and Ronceray 2025).
    false_alarm: float = 0.01
    #: Effects on a channel at most: one more than blind trials hide.
    max_effects: int = 3
    #: A residual that is this many times the noise, more than twice its power, in a signal of a log, stays unexplained: the
    #: verdict is `unknown`, ...
    unexplained: float = 1.5
    #: ... unless what was found explains this share of it in `Fit.levels`, more than it leaves, ...
    level_share: float = 0.5
    #: ... or this share in power: less than half of it is left in size.
    power_share: float = 0.8
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
