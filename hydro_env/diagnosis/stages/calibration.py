"""Adjusting the known parameters inside their plausible ranges: what the model can explain without any further effect."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...measured import Finding
from ...plant import CATALOGUE, PARAMETERS, parameter_of
from ..estimation import (
    Estimate,
    Fit,
    Unknown,
    base_unknown,
    given_unknown,
    limited_by_effects,
    solve,
)
from ..logs import Estimates, Given, Logs, distinct
from ..models.base import RigModel, effect_in, given_repeats
from .row_times import without_outliers
from .screening import Screening

__all__ = ["Calibrated", "as_given", "base_unknowns", "calibrate", "run"]

#: Iterations of the calibration.
ITERATIONS = 18
#: Unknowns for which these iterations are enough: somewhat more than the base parameters of a channel.
FEW = 20


@dataclass(frozen=True)
class Calibrated:
    """The calibrated model beside the logs; `given` as in `Given`. `backlashes` are those of couplings that rattle, by a first
    look: `logs` follow the measured speed there."""

    logs: Logs
    given: Estimates
    estimates: Estimates
    findings: list[Finding]
    backlashes: list[Screening] = field(default_factory=list)


def run(given: Given) -> Calibrated:
    """Calibrates every channel and estimates the noise again; without the rows that stand out, where there are some."""
    logs, estimates = given.logs, calibrate(given.logs.fit)
    rig, found = without_outliers(logs.rig, estimates)
    if found:
        logs = replace(logs, fit=logs.fit.on(rig))
        estimates = calibrate(logs.fit)
    (fine, _), (held_out, more) = (without_outliers(each, estimates) for each in (logs.fine, logs.held_out))
    fit = logs.fit.with_noise_seen_by(estimates)
    fit.rescore(list(estimates.values()))
    return Calibrated(Logs(fit, fine, held_out), given.estimates, estimates, [*given.findings, *found, *more])


def base_unknowns(rig: RigModel, channel: int) -> list[Unknown]:
    """The parameters that calibration may adjust, about their values in the model as given."""
    limited, size = limited_by_effects(), rig.given("D", channel) / PARAMETERS["D"].nominal
    found = []
    for name in rig.base(channel):
        value, (effect, _, own) = rig.given(name, channel), name.rpartition(".")
        if effect:
            unknown = given_unknown(name, effect_in(rig, effect, channel).parameter(own), value)
        else:
            parameter = rig.own[name] if name in rig.own else parameter_of(name)
            unknown = base_unknown(parameter, value, name in limited, size)
        of_rig = effect and CATALOGUE[effect].scope == "rig"
        found.append(replace(unknown, channel=None if of_rig else channel))
    return found


def as_given(fit: Fit) -> Estimates:
    """The model as given, by channel."""
    estimates = {c: Estimate(c, [], np.zeros(0), "as given") for c in fit.rig.channels}
    fit.evaluate(list(estimates.values()))
    return estimates


def calibrate(fit: Fit, iterations: int = ITERATIONS) -> Estimates:
    """Adjusts the base parameters of every channel, with priors about the model as given."""
    rig, estimates = fit.rig, {}
    for channel in rig.channels:
        unknowns, follow = base_unknowns(rig, channel), given_repeats(rig, channel)
        estimates[channel] = Estimate(channel, unknowns, np.zeros(len(unknowns)), "calibrated", follow=follow)
    if rig.coupled and len(estimates) == 2:
        estimates = dict.fromkeys(estimates, _of_rig(estimates))
    every = distinct(estimates)
    # Given effects and rigs that are estimated as a whole have more unknowns, which take more steps.
    iterations *= max(1, *(len(p.unknowns) // FEW for p in every))
    solve(fit, every, iterations)
    return estimates


def _of_rig(estimates: Estimates) -> Estimate:
    """The estimates of both channels as one, in which what the channels share is there once."""
    both = [(u, v) for p in estimates.values() for u, v in zip(p.unknowns, p.q, strict=True)]
    own = {(u.name, u.channel): (u, v) for u, v in both}
    follow = {name: source for p in estimates.values() for name, source in p.follow.items()}
    unknowns, q = [u for u, _ in own.values()], np.array([v for _, v in own.values()])
    return Estimate(None, unknowns, q, "calibrated", follow=follow)
