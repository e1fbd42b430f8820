"""What choosing alike valves is worth: every pair of several valves drives two equal motors under given controllers.

All pairs get the motors of the first model and the valves of their own. Both orders are driven, since a controller may
have gains of its own for each channel, under several seeds of the sensor noise.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.controllers.registry import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.plant import CATALOGUE, PARAMETERS, PlantModel

__all__ = ["METRICS", "Valve", "pair_model", "synchronisation"]

#: Base parameters of the motor and its line; the others are the valve's.
MOTOR = ("D", "J", "B", "Km", "beta", "V")
#: Ports of the effects that sit in the valve.
PORTS = ("driver", "coil", "force", "opening", "flow")
#: What is compared: speed differences, and the tracking error without which they mean little.
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")


@dataclass(frozen=True)
class Valve:
    """A modelled valve: channel 0 or 1 of a model."""

    name: str
    model: PlantModel
    channel: int


def pair_model(first: Valve, second: Valve, rig: PlantModel) -> PlantModel:
    """The rig with these two valves: motors, loads, supply and sensors are those of `rig`, alike on both channels."""
    values: dict[str, tuple[float, float]] = {}
    for name in PARAMETERS:
        if name in MOTOR:
            values[name] = (rig.value(name, 0),) * 2
        else:
            values[name] = first.model.value(name, first.channel), second.model.value(name, second.channel)
    declared = {*first.model.declared, *second.model.declared, *rig.declared}
    for effect in CATALOGUE:
        if effect not in declared:
            continue
        inside = CATALOGUE[effect].port in PORTS
        for parameter in CATALOGUE[effect].parameters:
            name = f"{effect}.{parameter.name}"
            if inside:
                values[name] = (
                    first.model.value(name, first.channel),
                    second.model.value(name, second.channel),
                )
            elif effect in rig.declared:
                values[name] = (rig.value(name, 0),) * 2
    return PlantModel(name=f"{first.name} + {second.name}", values=values)


def synchronisation(
    valves: Sequence[Valve],
    controllers: Sequence[str],
    *,
    alike: tuple[str, str],
    scenario: str = "setpoint_steps",
    seeds: Sequence[int] = range(4),
    progress: bool = True,
) -> dict[str, Any]:
    """Drives all pairs under all controllers and says by how much the pair `alike` wins.

    Every valve is paired with its like as well (`twins`): what is left there is the controller's, not the valves'.
    InputError for an unknown controller or scenario.
    """
    if len(valves) < 2:
        raise InputError("synchronisation needs two valves at least")
    ready = {name: make_controller(name) for name in dict.fromkeys(controllers)}
    couples = list(itertools.combinations_with_replacement(valves, 2))
    pairs: list[dict[str, Any]] = []
    twins: list[dict[str, Any]] = []
    with tqdm(total=len(ready) * len(couples), desc="pairs", disable=not progress, leave=False) as bar:
        for name, controller in ready.items():
            for first, second in couples:
                orders = [(first, second)] if first is second else [(first, second), (second, first)]
                scores: dict[str, list[float]] = {metric: [] for metric in METRICS}
                for order in orders:
                    model = pair_model(*order, valves[0].model)
                    driven = roll_out(controller, list(seeds), plant=model, mismatch=None, scenario=scenario)
                    for metric, values in driven.metrics(METRICS).items():
                        scores[metric] += values.tolist()
                (twins if first is second else pairs).append(
                    {
                        "controller": name,
                        "valves": [first.name, second.name],
                        **{metric: float(np.mean(values)) for metric, values in scores.items()},
                        "range": {metric: [min(values), max(values)] for metric, values in scores.items()},
                        "episodes": len(orders) * len(seeds),
                    }
                )
                bar.update()
    return {
        "scenario": scenario,
        "pairs": pairs,
        "twins": twins,
        "most_alike": [_gain(name, pairs, twins, alike) for name in ready],
    }


def _gain(
    name: str, pairs: list[dict[str, Any]], twins: list[dict[str, Any]], alike: tuple[str, str]
) -> dict[str, Any]:
    """How the pair that is most alike does against the others under one controller."""
    metric = METRICS[0]
    rows = [row for row in pairs if row["controller"] == name]
    own = next(row for row in rows if set(row["valves"]) == set(alike))
    others = [row for row in rows if row is not own]
    like = [row[metric] for row in twins if row["controller"] == name and row["valves"][0] in alike]
    gain: dict[str, Any] = {
        "controller": name,
        "valves": list(alike),
        metric: own[metric],
        "twins_rpm": float(np.mean(like)),
    }
    if others:
        mean = float(np.mean([row[metric] for row in others]))
        best = min(others, key=lambda row: row[metric])
        gain |= {
            "wins": own[metric] < best[metric],
            "best_other": best["valves"],
            "rpm_less_than_best_other": best[metric] - own[metric],
            "mean_of_others_rpm": mean,
            "rpm_less_than_mean_of_others": mean - own[metric],
        }
    return gain
