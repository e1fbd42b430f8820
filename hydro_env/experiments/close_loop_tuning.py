"""Gains of a control law for one model, by differential evolution: what closing the loop does to every law and model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import log
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from hydro_env.controllers.base import Controller, Floats, Gain
from hydro_env.controllers.classical.cross_coupling import CrossCoupled
from hydro_env.controllers.classical.model_inverse import ModelInverse
from hydro_env.controllers.classical.pid import PidController
from hydro_env.controllers.rollout import roll_out
from hydro_env.plant import PlantModel

#: What is tuned on, how often a candidate drives it, and the rpm of tracking error that one rpm of difference is worth.
TUNED_ON, TUNING_EPISODES, WEIGHT = "random_drives", 4, 2.0
POPULATION, GENERATIONS = 16, 11


@dataclass(frozen=True)
class Law:
    """A control law, made from a model and gains. Gains in `fixed` say how fast the set-point is followed: were they free,
    a tuner would buy synchronisation with tracking or the other way round, and nothing could be compared. `each` are gains
    with a value for each channel."""

    kind: type[Controller]
    fixed: Mapping[str, float] = field(default_factory=dict)
    each: tuple[str, ...] = ()
    model: bool = False

    def build(self, name: str, model: PlantModel, gains: Mapping[str, Any]) -> Controller:
        """The controller with these gains; those laws that are made from a model get `model`."""
        given = {"model": model} if self.model else {}
        return self.kind(name, **given, **self.fixed, **gains)

    def genes(self) -> list[Gain]:
        """What is searched: gains, twice those that each channel has of its own."""
        free = [gain for gain in self.kind.GAINS if gain.default is None and gain.name not in self.fixed]
        return [gain for gain in free for _ in range(2 if gain.name in self.each else 1)]


LAWS: dict[str, Law] = {
    # the paper's law: a PID on each motor, gains of its own for each valve
    "pid": Law(PidController, each=("Kp", "Ti")),
    "cross_coupled": Law(CrossCoupled, fixed={"filter": 0.067}),
    # feed-forward and inverse valve curves read off the model, and feedback
    "model_inverse": Law(ModelInverse, fixed={"rate": 30.0}, model=True),
}


@dataclass(frozen=True)
class Tuning:
    """A search for gains: of which law, on which model."""

    law: str
    source: str
    rig: str  # "" on the wrong model, which all rigs of a seed share
    model: PlantModel = field(compare=False)
    seed: int
    generations: int = GENERATIONS

    def __str__(self) -> str:
        return f"{self.law} {self.source} {self.rig}".strip()

    def row(self) -> dict[str, Any]:
        """What the gains say of it."""
        return {"controller": self.law, "tuned_on": self.source, "rig": self.rig or None, "seed": self.seed}

    def run(self) -> dict[str, Any]:
        """The gains with the least mean cost on the task's own model, and that cost in rpm."""
        law = LAWS[self.law]
        genes = law.genes()
        seeds = [self.seed * 1000 + n for n in range(TUNING_EPISODES)]

        def gains_of(points: Floats) -> dict[str, Floats]:
            """Gains (candidates, 1 or 2) of points (genes, candidates)."""
            made: dict[str, list[Floats]] = {}
            for gain, row in zip(genes, points, strict=True):
                made.setdefault(gain.name, []).append(np.exp(row) if gain.log else row)
            return {name: np.stack(rows, axis=-1) for name, rows in made.items()}

        def mean_costs(points: Floats) -> Floats:
            count = points.shape[1]
            gains = {name: np.repeat(value, len(seeds), axis=0) for name, value in gains_of(points).items()}
            tried = law.build(self.law, self.model, gains)
            done = roll_out(tried, seeds * count, plant=self.model, mismatch=None, scenario=TUNED_ON)
            costs = done.metrics(["tracking_mae_rpm", "max_speed_difference_rpm"])
            cost = costs["tracking_mae_rpm"] + WEIGHT * costs["max_speed_difference_rpm"]
            return cost.reshape(count, len(seeds)).mean(axis=1)

        bounds = np.array([(log(g.low), log(g.high)) if g.log else (g.low, g.high) for g in genes])
        first = qmc.LatinHypercube(len(genes), rng=np.random.default_rng(self.seed)).random(POPULATION)
        found = differential_evolution(
            mean_costs, bounds, init=bounds[:, 0] + first * (bounds[:, 1] - bounds[:, 0]), maxiter=self.generations - 1,
            rng=np.random.default_rng(self.seed), vectorized=True, updating="deferred", mutation=(0.4, 0.9),
            recombination=0.9, polish=False, tol=0.0,
        )  # fmt: skip
        best = {
            name: [float(f"{v:.4g}") for v in value[0]] for name, value in gains_of(found.x[:, None]).items()
        }
        gains = {name: value if len(value) > 1 else value[0] for name, value in best.items()}
        return {"gains": gains, "cost_rpm": float(found.fun)}
