"""What else a rig could be asked than what a case asks: random experiments, and those that show most about parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_env.case.dialogue import next_question, recorded
from hydro_env.case.hypotheses import places_of
from hydro_env.case.sensors import SENSORS, Shown
from hydro_env.diagnosis import Diagnosis, Settings
from hydro_env.diagnosis.experiment_design import (
    Answers,
    Array,
    Operation,
    Trial,
    best_design,
    commands_csv,
    experiments_of,
    random_pieces,
)
from hydro_env.diagnosis.models.base import UNITS
from hydro_env.diagnosis.stages.next_experiment import max_load
from hydro_env.plant import PlantModel


def sure(found: Diagnosis) -> bool:
    """Whether a case would ask nothing more."""
    return next_question(found, places_of(found), Shown({}), "question.csv", may_ask=True)[1] == "sure"


def lacking(found: Diagnosis) -> list[str]:
    """The sensors that the logs do not have."""
    return [name for name in SENSORS if name not in recorded(found.logs)]


def random_design(
    model: PlantModel, limits: Settings, rng: np.random.Generator, max_load: float = 0.0
) -> tuple[Array, Array]:
    """A random experiment of the family: commands (T, 2) in V and loads (T, 2) in N m."""
    found = experiments_of(random_pieces(rng, 1, 1.0, max_load)[0], limits)
    return found[..., 0] * np.array(model.pair("u_rated")), found[..., 1]


def at_random(found: Diagnosis, rng: np.random.Generator) -> tuple[str, list[str]] | None:
    """Random manoeuvres of the same family and limits, with one of the sensors, or none, drawn evenly."""
    if sure(found):
        return None
    commands = commands_csv(*random_design(found.rig.model, Settings(), rng, max_load(found)))
    names = [[], *([name] for name in lacking(found))]
    return commands, names[rng.integers(len(names))]


class Information(Trial):
    """Experiments by what they show about the parameters of the `operations`: the logarithm of the factor by which the volume of
    what is open shrinks (Bayesian D-optimality; Chaloner and Verdinelli, Bayesian experimental design, 1995)."""

    def scores(self, answers: Answers) -> Array:
        found, places = np.zeros(answers[1].shape), [[*UNITS].index(signal) for signal in self.signals]
        for (c, operation), table in zip(self.operations.items(), answers[0], strict=True):
            seen = table[c][:, :, places] / self._scales([operation.estimate], c)
            for n in range(len(found)):
                whole, _, *draws = seen[:, n]
                off = (np.array(draws) - whole).reshape(len(draws), -1) / np.sqrt(len(draws))
                found[n, c] = np.linalg.slogdet(np.eye(len(off)) + off @ off.T)[1]
        return np.where(answers[1], found, -np.inf)


def d_optimal(found: Diagnosis, rng: np.random.Generator) -> tuple[str, list[str]] | None:
    """What shows most about all parameters of the diagnosed model, whatever is open, with the sensor that adds most to that."""
    held_out = found.logs.fit.on(found.logs.held_out)
    sized = {c: p for c, p in found.models.final.items() if p.intervals}
    trial = Information(found.logs.fit, (), {c: Operation.of(held_out, p, c) for c, p in sized.items()})
    if sure(found) or not trial.operations:
        return None
    design = best_design(trial, rng, max_load(found))
    if design is None:
        return None
    experiment = np.stack(
        [design.command_V / np.array(found.rig.model.pair("u_rated")), design.load], axis=-1
    )
    answers = trial.simulated(experiment[None])
    had = found.logs.fit.rig.signals
    added = {name: [s for s in SENSORS[name] if s not in had] for name in lacking(found)}
    more = {name: replace(trial, more=added[name]).scores(answers).sum() for name in added}
    return commands_csv(design.command_V, design.load), [max(more, key=more.__getitem__)] if more else []
