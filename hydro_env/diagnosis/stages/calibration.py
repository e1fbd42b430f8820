"""Adjusting the known parameters inside their plausible ranges: what the model can explain without any further effect."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ...errors import InputError, check_known
from ...measured import Finding
from ...plant import CATALOGUE, parameter_of, scales_of
from ..estimation.estimate import Estimate, Estimates, distinct, joined
from ..estimation.final_refinement import refine
from ..estimation.fit import Fit
from ..estimation.gauss_newton import DIFFERENCE_STEPS, solve
from ..estimation.local_minima import restart_friction
from ..estimation.unknowns import Unknown, base_unknown, given_unknown, limited_by_effects, within
from ..logs import Logs
from ..models.base import RigModel, effect_in, given_repeats
from .row_times import without_outliers
from .screening import Screening

#: Parameters to calibrate by name, each with its bounds (SI) or None for the plausible ones.
Chosen = Mapping[str, tuple[float, float] | None]

#: Iterations of the calibration: each step of differences six times.
ITERATIONS = 6 * len(DIFFERENCE_STEPS)
#: Unknowns for which these iterations are enough: somewhat more than the base parameters of a channel.
FEW = 20


@dataclass(frozen=True)
class Calibrated:
    """The calibrated model beside the logs, after the one as `given`. `backlashes` are those of couplings that rattle, by a first
    look: `logs` follow the measured speed there. `plain` are the estimates of those channels on which the form of given effects
    was corrected since, before that."""

    logs: Logs
    given: Estimates
    estimates: Estimates
    findings: list[Finding]
    backlashes: list[Screening] = field(default_factory=list)
    plain: Estimates = field(default_factory=dict)


def run(logs: Logs, given: Estimates, findings: list[Finding], chosen: Chosen | None = None) -> Calibrated:
    """Calibrates every channel and estimates the noise again; without the rows that stand out, where there are some.

    `given` and `findings` are of the model as given, `chosen` the parameters to adjust, by default all that may be.
    """
    fit, estimates = logs.fit, calibrate(logs.fit, chosen=chosen)
    rig, found = without_outliers(fit.rig, estimates)
    if found:
        fit = fit.on(rig)
        estimates = calibrate(fit, chosen=chosen)
    # A calibration that stops early leaves what would be taken for a missing effect.
    refine(fit, fit, distinct(estimates))
    fit = fit.with_noise_seen_by(estimates)
    fit.rescore(list(estimates.values()))
    fine, _ = without_outliers(logs.fine, estimates)
    held_out, more = (fine, []) if logs.held_out is logs.fine else without_outliers(logs.held_out, estimates)
    return Calibrated(Logs(fit, fine, held_out), given, estimates, [*findings, *found, *more])


def base_unknowns(rig: RigModel, channel: int, chosen: Chosen | None = None) -> list[Unknown]:
    """The parameters that calibration may adjust, about their values in the model as given; of these the `chosen` ones."""
    limited, scales = limited_by_effects(), scales_of(rig.model, channel).rough
    found = []
    for name in (n for n in rig.base(channel) if chosen is None or n in chosen):
        value, (effect, _, own) = rig.given(name, channel), name.rpartition(".")
        if effect:
            unknown = given_unknown(name, effect_in(rig, effect, channel).parameter(own), value)
        else:
            parameter = rig.own[name] if name in rig.own else scales.parameter(parameter_of(name))
            unknown = base_unknown(parameter, value, name in limited)
        if name in rig.model.ranges:
            unknown = within(unknown, *rig.model.ranges[name])
        if chosen is not None and (bounds := chosen[name]):
            unknown = replace(unknown, low=bounds[0], high=bounds[1])
        of_rig = effect and CATALOGUE[effect].scope == "rig"
        found.append(replace(unknown, channel=None if of_rig else channel))
    return found


def check_chosen(rig: RigModel, chosen: Chosen) -> None:
    """InputError for a parameter that calibration cannot adjust, or bounds that do not hold its value."""
    known = dict.fromkeys(name for c in rig.channels for name in rig.base(c))
    check_known("unknown parameter", chosen, known)
    for u in (u for c in rig.channels for u in base_unknowns(rig, c, chosen)):
        around = u.low <= u.center <= u.high and math.isfinite(u.high - u.low)
        if not around or (u.log and not u.low > 0.0):
            need = "positive bounds" if u.log else "bounds"
            given = f"{u.low:g} to {u.high:g} {u.unit}"
            raise InputError(f"{u.name}: {given} are no {need} around {u.center:g} of the model")


def as_given(fit: Fit) -> Estimates:
    """The model as given, by channel."""
    estimates = {c: Estimate(c, [], np.zeros(0), "as given") for c in fit.rig.channels}
    fit.evaluate(list(estimates.values()))
    return estimates


def calibrate(fit: Fit, iterations: int = ITERATIONS, chosen: Chosen | None = None) -> Estimates:
    """Adjusts the base parameters of every channel, or the `chosen` ones, with priors about the model as given."""
    rig, estimates = fit.rig, {}
    for channel in rig.channels:
        unknowns, follow = base_unknowns(rig, channel, chosen), given_repeats(rig, channel)
        estimates[channel] = Estimate(channel, unknowns, np.zeros(len(unknowns)), "calibrated", follow=follow)
    if rig.coupled and len(estimates) == 2:
        estimates = dict.fromkeys(estimates, joined(estimates))
    every = distinct(estimates)
    # Given effects and rigs that are estimated as a whole have more unknowns, which take more steps.
    iterations *= max(1, *(len(p.unknowns) // FEW for p in every))
    solve(fit, every, iterations)
    restart_friction(fit, every, iterations)
    return estimates
