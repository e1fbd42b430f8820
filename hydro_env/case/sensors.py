"""Sensors that an experiment may ask for: what each would show, and whether that is worth its cost."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..diagnosis import Diagnosis
from ..diagnosis.experiment_design import Answers, Trial
from ..diagnosis.report.wording import plain
from ..diagnosis.stages.next_experiment import operations
from ..errors import InputError, suggestion
from ..limits import Limits
from .hypotheses import Distances, asked

#: Sensors by the names of `hydro-env hide --record`, and the signals that they show.
SENSORS: dict[str, tuple[str, ...]] = {
    "current": ("current",),
    "pressure": ("pressure",),
    "spool": ("spool",),
    "flow": ("flow",),
    "line_pressures": ("pressure", "mean_line_pressure"),
    "motor_pressure": ("motor_pressure",),
}
#: A sensor for one experiment costs as much as this many experiments, unless the user says otherwise.
COST = 1.0
#: A sensor that costs something has to bring this much of the criterion, a natural logarithm: a tenth of what is open.
WORTH = 0.1


class Shown(NamedTuple):
    """What the proposed experiment shows: how far models of two names are `apart` with a `sensor` besides (None: as logged so
    far), and what that sensor brings, in words."""

    apart: Distances
    sensor: str | None = None
    words: str = ""


def costs_of(words: Sequence[str]) -> dict[str, float]:
    """`spool=2` ... as the cost of each sensor in experiments; `none`: no sensor may be asked for. InputError for others."""
    costs = dict.fromkeys(SENSORS, COST)
    for word in words:
        name, _, text = word.partition("=")
        if word == "none":
            return {}
        if name not in SENSORS:
            raise InputError(f"--sensor {word}: {suggestion(name, [*SENSORS, 'none'])}")
        costs[name] = Limits(0.0, 1000.0).read(text, f"--sensor {word}: the cost, in experiments,")
    return costs


def shown(found: Diagnosis, costs: Mapping[str, float]) -> Shown:
    """What the proposed experiment shows with the sensor that brings most beyond its cost, if one does."""
    design = None if found.next_experiment is None else found.next_experiment.design
    if design is None:
        return Shown({})
    experiment = np.stack(
        [design.command_V / np.array(found.rig.model.pair("u_rated")), design.load], axis=-1
    )
    trial = Trial(found.logs.fit, asked(found), operations(found))
    return chosen(trial, trial.simulated(experiment[None]), costs)


def chosen(trial: Trial, answers: Answers, costs: Mapping[str, float]) -> Shown:
    """The sensor that brings most beyond its cost, by the criterion that experiments are designed for.

    What it costs is what that many more of the same experiment would bring without it.
    """
    had, without = trial.fit.rig.signals, trial.distances(answers)
    best, most = Shown(without), 0.0
    for name, cost in costs.items():
        if not (more := [signal for signal in SENSORS[name] if signal not in had]):
            continue
        with_it, repeated = replace(trial, more=more), replace(trial, times=1.0 + cost)
        net = float((with_it.scores(answers) - repeated.scores(answers)).sum()) - (WORTH if cost else 0.0)
        if net > most:
            apart = with_it.distances(answers)
            best, most = Shown(apart, name, f"; log {plain(name)} as well{_compared(without, apart)}"), net
    return best


def _compared(without: Distances, apart: Distances) -> str:
    """What a sensor changes most, in words."""
    if not apart:
        return ": it shows more of what the held-out logs need"
    pair = max(apart, key=lambda names: apart[names] / max(without[names], 1e-3))
    one, other = map(plain, pair)
    return f": with it {one} and {other} differ by {apart[pair]:.2g}, without by {without[pair]:.2g}"
