"""What choosing alike valves is worth: every pair of several valves drives two equal motors under given controllers.

All pairs get the motors of the first model and the valves of their own. Both orders are driven, since a controller may
have gains of its own for each channel, under several seeds of the sensor noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.controllers.registry import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.plant import CATALOGUE, PARAMETERS, PlantModel
from hydro_env.valve_bench.bench import Valve

SCENARIO = "setpoint_steps"
#: Base parameters of the motor and its line; the others are the valve's.
MOTOR = ("D", "J", "B", "Km", "beta", "V")
#: Ports of the effects that sit in the valve.
PORTS = ("driver", "coil", "force", "opening", "flow")
#: What is compared: speed differences, and the tracking error without which they mean little.
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")


def pair_model(first: Valve, second: Valve, rig: PlantModel) -> PlantModel:
    """The rig with these two valves: motors, loads, supply and sensors are those of `rig`, alike on both channels."""
    of_valve = {name: name not in MOTOR for name in PARAMETERS}
    declared = {*first.model.declared, *second.model.declared, *rig.declared}
    for name, effect in CATALOGUE.items():
        inside = effect.port in PORTS
        if name in (declared if inside else rig.declared):
            of_valve |= {f"{name}.{p.name}": inside for p in effect.parameters}
    values = {
        name: (first.value(name), second.value(name)) if inside else (rig.value(name, 0),) * 2
        for name, inside in of_valve.items()
    }
    return PlantModel(name=f"{first.name} + {second.name}", values=values)


def synchronisation(
    valves: Sequence[Valve], controllers: Sequence[str], alike: tuple[str, str], *, seeds: int, progress: bool
) -> dict[str, Any]:
    """Drives all pairs under all controllers, with `seeds` seeds each, and says by how much the pair `alike` wins.

    Every valve is paired with its like as well (`twins`): what is left there is the controller's, not the valves'.
    """
    names = list(dict.fromkeys(controllers))
    tasks = list(product(names, combinations_with_replacement(valves, 2)))
    rows = [
        _driven(name, first, second, valves[0].model, seeds)
        for name, (first, second) in tqdm(tasks, desc="pairs", disable=not progress, leave=False)
    ]
    twins = [row for row in rows if row["valves"][0] == row["valves"][1]]
    pairs = [row for row in rows if row not in twins]
    return {
        "scenario": SCENARIO,
        "pairs": pairs,
        "twins": twins,
        "most_alike": [_gain(name, pairs, twins, alike) for name in names],
    }


def _driven(controller: str, first: Valve, second: Valve, rig: PlantModel, seeds: int) -> dict[str, Any]:
    """Mean metrics of a pair of valves, in both orders, and their ranges."""
    orders = [(first, second)] if first is second else [(first, second), (second, first)]
    runs = [
        roll_out(
            make_controller(controller), range(seeds), plant=pair_model(*order, rig), mismatch=None, scenario=SCENARIO
        ).metrics(METRICS)
        for order in orders
    ]  # fmt: skip
    scores = {metric: np.concatenate([run[metric] for run in runs]) for metric in METRICS}
    return {
        "controller": controller,
        "valves": [first.name, second.name],
        **{metric: float(values.mean()) for metric, values in scores.items()},
        "range": {metric: [float(values.min()), float(values.max())] for metric, values in scores.items()},
        "episodes": len(orders) * seeds,
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
    gain = {"controller": name, "valves": list(alike), metric: own[metric], "twins_rpm": float(np.mean(like))}
    if not others:
        return gain
    mean = float(np.mean([row[metric] for row in others]))
    best = min(others, key=lambda row: row[metric])
    return gain | {
        "wins": own[metric] < best[metric],
        "best_other": best["valves"],
        "rpm_less_than_best_other": best[metric] - own[metric],
        "mean_of_others_rpm": mean,
        "rpm_less_than_mean_of_others": mean - own[metric],
    }
