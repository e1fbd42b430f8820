"""A model of a rig for tests of the diagnosis whose speed is a sum of known curves, so that every answer is known beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit
from hydro_env.diagnosis.estimation.gauss_newton import solve
from hydro_env.diagnosis.estimation.unknowns import base_unknown
from hydro_env.diagnosis.models.base import Request, Segment, Segments
from hydro_env.plant import PARAMETERS, PlantModel, load_model

#: Noise of the speed, rad/s.
NOISE = {(0, "speed"): 0.01}
PERIOD = 1e-3


@dataclass
class LinearRig:
    """One channel's speed: a sine by the inertia, and for every effect's parameter its value times a curve.

    `curves` holds these by "effect.parameter"; those of two effects may be equal. With more `signals` all are alike.
    """

    curves: dict[str, np.ndarray]
    time: np.ndarray
    channels: tuple[int, ...] = (0,)
    simulation_is_cheap: bool = False
    has_hidden_states: bool = True
    coupled: bool = False
    signals: int = 1
    segments: dict[int, Segments] = field(default_factory=dict)
    model: PlantModel = field(default_factory=lambda: load_model("paper"))

    def predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        return [{0: np.tile(self.speed(dict(r.values)), self.signals)} for r in requests]  # type: ignore[arg-type]

    def speed(self, values: dict[str, float]) -> np.ndarray:
        total = values.get("J", PARAMETERS["J"].nominal) / PARAMETERS["J"].nominal * np.sin(3.0 * self.time)
        return total + sum(values.get(name, 0.0) * curve for name, curve in self.curves.items())

    def has(self, effect: str, channel: int | None) -> bool:
        return effect in self.model.declared

    def candidates(self) -> list[str]:
        return list(dict.fromkeys(name.split(".")[0] for name in self.curves))


def time_of(rows: int) -> np.ndarray:
    """The instants of a log of so many rows, s."""
    return np.arange(rows) * PERIOD


def logged(curves: dict[str, np.ndarray], truth: dict[str, float], rows: int) -> tuple[Fit, Estimate]:
    """A rig with these curves, whose log of so many rows has the `truth` and noise, and its calibration."""
    rig, every = LinearRig(curves, time_of(rows)), np.arange(rows)
    noise = NOISE[0, "speed"] * np.random.default_rng(0).standard_normal(rows)
    used, place = np.ones(rows, bool), slice(0, rows)
    rig.segments[0] = Segments([Segment(0, 0, "speed", rig.speed(truth) + noise, every, used, PERIOD, place)])
    base = Estimate(0, [base_unknown(PARAMETERS["J"], PARAMETERS["J"].nominal)], np.zeros(1), "calibrated")
    fit = Fit(rig, NOISE)  # type: ignore[arg-type]
    solve(fit, [base], 4)
    return fit, base
