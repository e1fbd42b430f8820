"""What the paper must have had but does not print, found from its own results.

Its tables alone give a speed difference of about 13 rpm where it reports 175; its Fig. 2 and its text say that the
valves have a dead zone, its tables hold none. And it loads the motors with a "nominal torque" without a value. Both
numbers are found here by simulation, in one batch each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from hydro_env.errors import InputError
from hydro_env.experiments.paper_rig import LOAD_STEP, SETPOINT_STEPS, run_paper
from hydro_env.plant import PlantModel, load_model

__all__ = [
    "PUBLISHED_LOAD_RPM",
    "PUBLISHED_STEPS_RPM",
    "Calibration",
    "calibrate_dead_zone",
    "calibrate_torque",
]

#: Largest speed differences that the paper reports: Fig. 7 (set-point steps) and Fig. 8 (load step), rpm.
PUBLISHED_STEPS_RPM = 175.0
PUBLISHED_LOAD_RPM = 12.0


@dataclass(frozen=True)
class Calibration:
    """The value that meets the target, and the curve it was read from (`tried` -> `reached` rpm)."""

    value: float
    tried: list[float]
    reached: list[float]


def _crossing(tried: np.ndarray, reached: np.ndarray, target: float, what: str) -> Calibration:
    order = np.argsort(reached)
    if not reached.min() <= target <= reached.max():
        raise InputError(
            f"calibration of {what}: {target:g} rpm lies outside the {reached.min():.1f} to {reached.max():.1f} rpm"
            f" that {tried.min():g} to {tried.max():g} can give"
        )
    value = float(PchipInterpolator(reached[order], tried[order])(target))
    return Calibration(value, tried.tolist(), reached.tolist())


def calibrate_dead_zone(target_rpm: float = PUBLISHED_STEPS_RPM) -> Calibration:
    """Overlap (m) of valve V1, the same both ways, with which the paper's set-point steps give this peak difference.

    V2 keeps none: only the difference of the two matters much, and Fig. 2 shows V1 as the odd one. InputError if no
    overlap up to 150 um gives it.
    """
    overlap = np.linspace(0.0, 150e-6, 16)
    pairs = np.column_stack([overlap, np.zeros_like(overlap)])
    values = {"dead_zone.overlap_positive": pairs, "dead_zone.overlap_negative": pairs}
    traces = run_paper(load_model("paper"), SETPOINT_STEPS, values=values, num_rigs=overlap.size)
    return _crossing(overlap, traces.peak, target_rpm, "the dead zone")


def calibrate_torque(model: PlantModel, target_rpm: float = PUBLISHED_LOAD_RPM) -> Calibration:
    """Nominal load torque (N m) with which the paper's load step gives this peak difference, without a command limit.

    InputError if no torque up to 6 N m gives it.
    """
    torque = np.concatenate([np.linspace(0.5, 2.5, 3), np.linspace(2.75, 4.0, 11), np.linspace(4.5, 6.0, 2)])
    traces = run_paper(model, LOAD_STEP, num_rigs=torque.size, nominal_torque=torque, peak_from=2.0)
    return _crossing(torque, traces.peak, target_rpm, "the nominal torque")
