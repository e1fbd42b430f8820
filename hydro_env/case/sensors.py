"""Sensors that an experiment may ask for: how far each would move models apart, and whether that is worth its cost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..diagnosis import Diagnosis
from ..diagnosis.experiment_design import Trial
from ..diagnosis.report.wording import plain
from ..diagnosis.stages.next_experiment import PARTED
from ..errors import InputError, suggestion
from ..limits import Limits
from .hypotheses import Distances, weight_of
from .unseen import asked

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
    if design is None or not design.apart:
        return Shown({})
    fit = found.logs.fit
    experiment = np.stack([design.command_V / np.array(fit.rig.model.pair("u_rated")), design.load], axis=-1)
    with_each = apart_with(Trial(fit, asked(found)), experiment, costs)
    return chosen(design.apart, with_each, costs, fit.settings.temper)


def apart_with(trial: Trial, experiment: NDArray[np.float64], names: Iterable[str]) -> dict[str, Distances]:
    """How far models are apart in an experiment (T, 2, 2) with each sensor that the logs lack. The measure stays that without it:
    means over more signals, but of the sum, since a sensor takes nothing away."""
    had, apart = trial.fit.rig.signals, dict[str, Distances]()
    for name in names:
        if more := [signal for signal in SENSORS[name] if signal not in had]:
            grown = float(np.sqrt(1.0 + len(more) / len(had)))
            distances = replace(trial, more=more).distances(experiment)
            apart[name] = {pair: grown * d for pair, d in distances.items()}
    return apart


def chosen(
    without: Distances, with_each: Mapping[str, Distances], costs: Mapping[str, float], temper: float
) -> Shown:
    """The sensor that brings most beyond its cost.

    A sensor is worth as many further experiments as would part two models as far without it. It has to halve the weight of a
    wrong one at least, and where commands part the two it is worth nothing.
    """

    def worth(pair: tuple[str, str], with_it: float) -> float:
        if without[pair] >= PARTED or weight_of(with_it, temper) > 0.5 * weight_of(without[pair], temper):
            return 0.0
        return float(min(with_it, PARTED) / max(without[pair], 1e-3)) ** 2 - 1.0

    best, most = Shown(without), 0.0
    for name, apart in with_each.items():
        pair = max(apart, key=lambda names: worth(names, apart[names]))
        net = worth(pair, apart[pair]) - costs[name]
        if net > most:
            both = " and ".join(map(plain, pair))
            text = f"with it {both} differ by {apart[pair]:.2g}, without by {without[pair]:.2g}"
            best, most = Shown(apart, name, f"; log {plain(name)} as well: {text}"), net
    return best
