"""Adjusting the known parameters inside their plausible ranges: what the model can explain without any further effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
from ..models.base import RigModel, effect_in, given_repeats
from ..state import Estimates, State
from .row_times import without_outliers

__all__ = ["as_given", "base_unknowns", "calibrate", "run"]

#: Iterations of the calibration.
ITERATIONS = 18
#: Unknowns for which these iterations are enough: somewhat more than the base parameters of a channel.
FEW = 20


def run(state: State) -> State:
    """Calibrates every channel and estimates the noise again; without the rows that stand out, where there are some."""
    fit, calibrated = state.fit, calibrate(state.fit)
    rig, found = without_outliers(fit.rig, calibrated)
    if found:
        fit = fit.on(rig)
        calibrated = calibrate(fit)
    (fine, _), (held_out, more) = (without_outliers(r, calibrated) for r in (state.fine, state.held_out))
    fit = fit.with_noise_seen_by(calibrated)
    fit.rescore(list(calibrated.values()))
    findings = [*state.findings, *found, *more]
    return replace(state, fit=fit, fine=fine, held_out=held_out, calibrated=calibrated, findings=findings)


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
    every = list({id(p): p for p in estimates.values()}.values())
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
