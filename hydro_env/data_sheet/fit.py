"""Makes the simulated data sheet that of the paper, as far as a few numbers can: a small least-squares fit on the plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from hydro_env.data_sheet.derive import Fitted
from hydro_env.data_sheet.simulated import dynamics_of, steady_figures
from hydro_env.plant import PlantModel

__all__ = ["DYNAMIC", "fit"]

#: Figures of the spool's dynamics that a sheet may have, and what is fitted to one, two and three of them, with its bounds.
DYNAMIC = ("step_response_ms", "frequency_minus_3_dB_Hz", "frequency_minus_90_deg_Hz")
_FREE = (("frequency", 0.1, 10.0), ("damping", 0.25, 3.0), ("coil_lag", 0.02, 3.0))
_ROUNDS = 2


def fit(
    q: Mapping[str, float], channel: int, model_of: Callable[[Fitted], PlantModel]
) -> tuple[Fitted, dict[str, float]]:
    """The numbers by which the model of `model_of` does what the quantities `q` say, and its figures."""
    fitted = Fitted()
    for _ in range(_ROUNDS):
        fitted = _of_dynamics(q, channel, model_of, fitted)
        for _ in range(3):  # both are nearly in proportion
            found = steady_figures(model_of(fitted), channel, q)
            fitted = replace(
                fitted,
                hysteresis=fitted.hysteresis * _ratio(q, found, "hysteresis_percent"),
                flow=fitted.flow * _ratio(q, found, "rated_flow_lpm"),
            )
    model = model_of(fitted)
    return fitted, {**steady_figures(model, channel, q), **dynamics_of(model, channel, q)}


def _ratio(q: Mapping[str, float], found: Mapping[str, float], key: str) -> float:
    return min(max(q[key] / max(found[key], 1e-9), 0.3), 3.0)


def _of_dynamics(
    q: Mapping[str, float], channel: int, model_of: Callable[[Fitted], PlantModel], start: Fitted
) -> Fitted:
    given = [key for key in DYNAMIC if key in q]
    names = [row for row in _FREE if row[0] != "coil_lag" or "coil_lag" in q][: len(given)]
    at = {name: getattr(start, name) or q.get(name, 1.0) for name, _, _ in names}

    def fitted(x: np.ndarray) -> Fitted:
        return replace(start, **{row[0]: math.exp(value) for row, value in zip(names, x, strict=True)})

    def off(x: np.ndarray) -> np.ndarray:
        found = dynamics_of(model_of(fitted(x)), channel, q)
        return np.array([min(max(math.log(found[key] / q[key]), -3.0), 3.0) for key in given])

    low, high = (np.log([row[n] for row in names]) for n in (1, 2))
    first = np.clip(np.log(list(at.values())), low + 1e-6, high - 1e-6)
    answer = least_squares(off, first, bounds=(low, high), diff_step=0.01, xtol=1e-4, ftol=1e-5, max_nfev=20)
    return fitted(answer.x)
