"""A search for effects: the estimates so far, what was accepted, and what became of every candidate."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...plant import CATALOGUE
from ..estimation.estimate import Estimate, Estimates
from ..estimation.fit import Fit
from ..estimation.gauss_newton import SETTLE_ITERATIONS, differentiate, solve, step_all
from ..estimation.local_minima import grow_horizon
from .candidates import (
    ACCEPTED,
    AFTER_ROUNDS,
    OUTDONE,
    Accepted,
    Candidate,
    Correction,
    judge,
    penalty,
    penalty_per_parameter,
)
from .form_correction import best_attempt
from .screening import Screening

#: Iterations of a short refit: one to come near, one from there. Where simulating costs next to nothing there are more.
SHORT_ITERATIONS, CHEAP_ITERATIONS = 2, 10
#: Multiples of a step of a short refit: parts of it are the best of all in one of forty.
SHORT_FACTORS = (4.0, 2.0, 1.0)


@dataclass
class Search:
    """A selection under way: `present` are the estimates so far, from `calibrated`; `forms` the best correction of form of those
    that were tried, if there is one; the rest as in `Selection`."""

    fit: Fit
    calibrated: Estimates
    screening: Sequence[Screening]
    seconds: float
    present: Estimates
    accepted: list[Accepted] = field(default_factory=list)
    candidates: list[Candidate] = field(default_factory=list)
    forms: dict[Estimate, Correction | None] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """The candidates that act on one channel."""
        return [n for n in self.fit.rig.candidates() if CATALOGUE[n].scope == "channel"]

    def on(self, channel: int | None) -> list[Accepted]:
        """What was accepted on a channel."""
        return [k for k in self.accepted if k.channel == channel]

    def put(self, estimate: Estimate) -> None:
        """Makes an estimate the present one: of its channel, or of both where it is the rig's."""
        self.present.update(dict.fromkeys(self.fit.channels_of(estimate), estimate))

    def record(
        self, effect: str, channel: int | None, number: int, gain: float, outcome: str, estimate: Estimate | None = None
    ) -> None:  # fmt: skip
        """Remembers what became of a candidate in a round."""
        needed = penalty(self.fit, effect)
        self.candidates.append(Candidate(effect, channel, number, gain, needed, outcome, estimate))

    def competing(self, effect: str, gains: dict[str, float]) -> dict[str, float]:
        """Those of other effects' `gains` that are nearly as large as that of `effect`, as how far they are behind."""
        found, needed = gains[effect], penalty(self.fit, effect)
        behind = {name: max(0.0, found - g) for name, g in gains.items() if name != effect}
        return {n: d for n, d in behind.items() if d < self.fit.settings.tied_share * found or d < needed}

    def judged(
        self, c: int | None, before: Estimate, refit: Estimate, number: int, outdone: bool = False
    ) -> Candidate:
        """Judges a refitted candidate of a channel (None: of the rig) beside `before`, and remembers what became of it; one that
        is `outdone` by a better one is not accepted."""
        gain = self.fit.gain(before, refit)
        outcome = judge(self.fit, refit, refit.label, gain, c)
        outcome = OUTDONE if outdone and outcome == ACCEPTED else outcome
        self.record(refit.label, c, number, gain, outcome, refit)
        return self.candidates[-1]

    def drop(self, one: Accepted, gain: float, outcome: str, estimate: Estimate) -> None:
        """Takes away again what was accepted, after the forward rounds."""
        self.accepted.remove(one)
        self.record(one.effect, one.channel, AFTER_ROUNDS, gain, outcome, estimate)

    # --- refits -----------------------------------------------------------------------------------------------------------
    def settle(self, estimates: Sequence[Estimate]) -> None:
        """Improves estimates as far as they go, in place."""
        solve(self.fit, estimates, SETTLE_ITERATIONS)
        if self.fit.rig.has_hidden_states:
            solve(self.fit, grow_horizon(self.fit, estimates), SETTLE_ITERATIONS)
            in_whole_orders(self.fit, estimates)

    def form_of(self, estimate: Estimate) -> Correction | None:
        """The estimate with the correction of form that explains most of what it leaves, with its price, if there is one."""
        if estimate not in self.forms:
            self.forms[estimate] = best_attempt(self.fit, estimate, estimate.placed_effects())
        return self.forms[estimate]

    def in_other_form(self, estimate: Estimate) -> Estimate:
        """The estimate with its best correction of form, if that pays."""
        form = self.form_of(estimate)
        return estimate if form is None or form.score >= estimate.cost else form.estimate


def in_whole_orders(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Holds orders (periods in a turn) at the nearest whole numbers, in place, where that explains the logs no worse by more than
    these parameters are worth.

    Over many turns a small part of an order trades its angle for the displacement, so a fit ends where both are wrong.
    """
    held = {p: twin for p in estimates if (twin := p.with_whole_orders()) is not None}
    given = {p: twin.from_given() for p, twin in held.items()}
    solve(fit, [*held.values(), *given.values()], SETTLE_ITERATIONS)
    for p, twin in held.items():
        twin.adopt(given[p])
        orders = sum(a is not b for a, b in zip(p.unknowns, twin.unknowns, strict=True))
        if fit.gain(twin, p) < penalty_per_parameter(fit) * orders:
            p.unknowns, p.q, p.cost, p.simulated, p.columns = (
                twin.unknowns, twin.q, twin.cost, twin.simulated, twin.columns
            )  # fmt: skip


def short_refit(fit: Fit, estimates: Sequence[Estimate]) -> None:
    """Two steps along the derivatives of the base parameters as they are and fresh ones of the new effect.

    Where simulating costs next to nothing all derivatives are fresh and there are more steps.
    """
    fit.evaluate([p for p in estimates if not p.simulated])
    if fit.rig.simulation_is_cheap:
        differentiate(fit, estimates)
        solve(fit, estimates, CHEAP_ITERATIONS)
        return
    fresh = []
    for p in estimates:
        bases = {own.part_of for own in CATALOGUE[p.label].parameters}
        fresh.append([j for j, u in enumerate(p.unknowns) if u.effect == p.label or u.name in bases])
    for _ in range(SHORT_ITERATIONS):
        differentiate(fit, estimates, fresh)
        step_all(fit, [p for p in estimates if np.isfinite(p.cost)], SHORT_FACTORS)
