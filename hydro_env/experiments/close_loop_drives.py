"""A controller of `close_loop` at work: gains are searched on a model, and it drives a rig that the reference simulator plays.

`controllers.rollout` drives the compiled plant, whose equations a diagnosis fits and the search for gains runs on. In `drive` the
same controller, sensors and scenarios meet `practice.reference`: SciPy's stiff solver on equations of its own, with other
functional forms of the effects where there are some.
"""

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
from hydro_env.envs.observation import LIMIT, SCALES, noise_levels
from hydro_env.plant import PlantModel
from hydro_env.plant.plant import grid_points
from hydro_env.practice.reference import ReferenceRig
from hydro_env.practice.reference.forms import Constants
from hydro_env.tasks import Scenario, Trace, load_scenario
from hydro_env.units import RPM

#: What is tuned on, how often a candidate drives it, and the rpm of tracking error that one rpm of difference is worth.
TUNED_ON, TUNING_EPISODES, WEIGHT = "random_drives", 4, 2.0
POPULATION, GENERATIONS = 16, 11
#: Relative tolerance of the solver.
TOLERANCE = 1e-6
#: Sensors of the observation, in its order.
SENSORS = ("measured_speed", "current", "pressure")


# --- gains ---------------------------------------------------------------------------------------------------------------
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


# --- the hidden rig -------------------------------------------------------------------------------------------------------
def drive(
    controller: Any, truth: PlantModel, scenario: str | Scenario, seed: int, *, forms: str = "different",
    constants: Constants | None = None, control_period: float = 0.01, noise: float = 1.0,
) -> Trace:  # fmt: skip
    """Lets a controller drive one episode from rest on the reference simulator; a trace of one rig (N = 1).

    Args:
        controller: `reset(1, control_period)`, then `act` once a period. A controller that has to be told of a plant
            beforehand (`prepare`) has been told already: nothing of the truth reaches it here but measurements.
        truth: the rig.
        scenario: what is driven; a random one is drawn from `seed`.
        seed: of the sensors' noise, and of a random scenario.
        forms: of the effects in the simulator, see `practice.reference.FORMS`.
        constants: of these forms; None: the middle ones.
        control_period: s.
        noise: factor on the sensors' noise, as in the environment.

    InputError for an unknown scenario; ValueError for a command that is not finite.
    """
    profile_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
    profile = load_scenario(scenario).reference(control_period, np.random.default_rng(profile_seed))
    stream, levels = np.random.default_rng(noise_seed), noise_levels(noise)
    rig = ReferenceRig(truth, forms=forms, constants=constants, tolerance=TOLERANCE)
    rated = np.array(truth.pair("u_rated"))
    controller.reset(1, control_period)
    rows = len(profile.setpoint)
    speed, angle, command = np.empty((rows, 1, 2)), np.empty((rows, 1)), np.zeros((rows, 1, 2))
    peak, points = np.zeros((rows, 1)), grid_points(control_period)
    now, last = rig.signals(), np.zeros(2)
    for n in range(rows):
        speed[n, 0] = now["speed"] / RPM
        angle[n, 0] = np.degrees(now["angle"][0] - now["angle"][1])
        if n == rows - 1:
            break
        seen = np.concatenate([now[name] for name in SENSORS]) / SCALES[1:7]
        seen = seen + levels * stream.standard_normal(levels.size)
        frame = np.concatenate([[profile.setpoint[n] / SCALES[0]], seen, last])
        action = np.asarray(controller.act(np.clip(frame, -LIMIT, LIMIT).astype(np.float32)[None]))[0]
        if not np.isfinite(action).all():
            raise ValueError(f"act returned a command that is not finite at {n * control_period:g} s")
        command[n, 0] = last = np.clip(action, -1.0, 1.0)
        part = rig.advance(last * rated, profile.load[n], control_period, points)
        peak[n + 1] = np.abs(np.diff(part["speed"], axis=-1)).max() / RPM
        now = {name: values[-1] for name, values in part.items()}
    return Trace(control_period, profile.setpoint[:, None] / RPM, speed, angle, command[:-1], peak)
