"""Calibration alone: the known parameters of a model, estimated from rig logs with intervals, and what the model then leaves.

    found = estimate(["run.csv"], "paper", parameters=["J", "Kq"])
    found.parameters["J_1"].estimate  # value, low, high, unit
    found.residuals["speed_1_rpm"].after, found.residuals["speed_1_rpm"].noise
    found.model.to_yaml("model.yaml")

It is the calibration of a diagnosis, without the search for effects that the model lacks: where these change the logs, parameters
make up for them, which `Calibration.warnings` says.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..measured import Finding, RigLog
from ..measured import Mapping as LogMapping
from ..plant import PlantModel
from .estimation.estimate import Estimates, Vector
from .estimation.fit import Fit
from .logs import opened
from .settings import Settings
from .stages import calibration, consistency, uncertainty
from .stages.calibration import check_chosen
from .stages.validation import Proof, prove, shown_unit, signal_key
from .stages.values import KnownParameter, estimated_model, known_parameters
from .stages.warnings import about_bounds, about_logs


@dataclass(frozen=True)
class Residual:
    """What a model leaves of a signal, in the unit that the signal's name ends with.

    `noise` is the standard deviation of the signal's noise, `before` and `after` the RMS errors of the model as given and of the
    calibrated one over all rows that count. `time_s` and `error` hold for every log the times (n,) in s and measured less
    simulated (n,) of the calibrated model, NaN where a row does not count; of a log of more than 6000 rows evenly spaced ones.
    """

    noise: float
    before: float
    after: float
    time_s: list[Vector]
    error: list[Vector]


@dataclass(frozen=True)
class Calibration:
    """What was estimated.

    `parameters`, by names such as "J_1" (the parameter and the channel) or "dead_zone.overlap_positive_2": each has its
    `nominal` value as given and its `estimate` with value, `low` and `high` of a 95 % interval, and unit, all SI. `residuals`, by
    names such as "speed_1_rpm". `model` is the calibrated model. `warnings` say what makes the estimates doubtful.
    """

    parameters: dict[str, KnownParameter]
    residuals: dict[str, Residual]
    model: PlantModel
    warnings: list[str]

    def as_dict(self) -> dict[str, Any]:
        """The parameters as under "calibrated" in diagnosis.json, the RMS errors of the residuals, and the warnings."""
        left = {
            n: {"noise": r.noise, "before": r.before, "after": r.after} for n, r in self.residuals.items()
        }
        known = {n: {"nominal": p.nominal, **vars(p.estimate)} for n, p in self.parameters.items()}
        return {"calibrated": known, "residuals": left, "warnings": self.warnings}


def estimate(
    logs: Sequence[str | Path | RigLog], model: str | Path | PlantModel = "paper", mapping: LogMapping | str | Path | None = None,
    parameters: Collection[str] | Mapping[str, tuple[float, float] | None] | None = None, *, jobs: int = 1, steady: bool = False,
    accept: Collection[str] = (), seed: int = 0, progress: Callable[[str, int], None] = lambda text, simulations: None,
) -> Calibration:  # fmt: skip
    """Estimates known parameters of a model from rig logs, by maximum likelihood with priors about the model as given.

    Each signal counts by its noise, which the logs show themselves. Steps are those of Gauss-Newton inside the bounds; intervals
    come from a block bootstrap, and are never narrower than the curvature of the likelihood says.

    Args:
        logs: paths, parts of logs (`LOG@FROM:TO`, in seconds) or loaded logs, of one rig; 2.5 s or more in all.
        model: preset, YAML file or model to calibrate.
        mapping: what the columns of the logs mean, where their header does not say it.
        parameters: names of the parameters to estimate on every logged channel, such as "J" or "dead_zone.overlap_positive" (of
            an effect that the model has), or a dictionary of these with bounds (low, high) in SI, None for the plausible ones. By
            default all that calibration may adjust; with none the residuals are those of the model as given.
        jobs: threads that simulate; the result does not depend on it.
        steady: whether to use the reduced steady-valve model, as for axes with cylinders.
        accept: codes of findings (`sign`, `swapped`, `unit`, ...) that would otherwise end the estimation.
        seed: seed of the bootstrap.
        progress: called with what is being done and the number of simulations done since the last call.

    Raises:
        InputError: for logs or a model that cannot be used, logs that are surely not of this machine, a parameter that is not
            known or cannot be estimated here, and bounds that do not hold its value in the model.
    """
    settings = Settings(seed=seed)
    progress("reading logs", 0)
    with opened(
        logs, None, model, mapping, accept, steady=steady, jobs=jobs, settings=settings,
        count=lambda done: progress("calibrating", done),
    ) as all_logs:  # fmt: skip
        rig = all_logs.rig
        chosen = parameters if isinstance(parameters, Mapping | None) else dict.fromkeys(parameters)
        check_chosen(rig, chosen or {})
        found = calibration.run(*consistency.run(all_logs, accept), chosen)
        after = uncertainty.run(found.logs, uncertainty.settle(found.logs, found.estimates))
        proof = prove(found.logs.fine, {"before": found.given, "calibrated": after, "after": after})
        known = {p.name: p for p in known_parameters(rig, after)}
        improved = estimated_model(rig, after, f"{rig.model.name} calibrated")
        warnings = [*_warnings(found.logs.fit, after, found.findings, proof)]
        return Calibration(known, _residuals(proof), improved, warnings)


def _residuals(proof: Proof) -> dict[str, Residual]:
    rig, found = proof.rig, {}
    for (c, signal), e in proof.errors.items():
        own, size = rig.segments[c].by_signal[signal], shown_unit(rig, signal, c)[1]
        shown = proof.traces["after"][c]
        errors = [np.where(s.used, (s.measured - shown[s.place]) / size, np.nan) for s in own]
        times = [rig.parts[s.log].log.time_s[s.rows] for s in own]
        found[signal_key(rig, signal, c)] = Residual(e["noise"], e["before"], e["after"], times, errors)
    return found


def _warnings(fit: Fit, calibrated: Estimates, findings: Sequence[Finding], proof: Proof) -> Sequence[str]:
    """What makes the estimates doubtful, the weightiest first."""
    rig = fit.rig
    missing = [
        f"{signal_key(rig, signal, c)}: the calibrated model leaves {e['after'] / e['noise']:.2g} times the noise; "
        "something is missing from it, which `diagnose` looks for, and parameters may make up for that"
        for (c, signal), e in proof.errors.items()
        if rig.has_hidden_states and e["after"] > fit.settings.unexplained * e["noise"]
    ]
    return [*missing, *(f.text for f in findings), *about_bounds(calibrated), *about_logs(rig, rig.parts)]
