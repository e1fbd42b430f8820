"""Runs one controller on a batch of rigs for one episode and keeps what happened."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from hydro_env.arrays import Floats, Singles
from hydro_env.controllers.base import Controller
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.envs.own_functions import checked_rows
from hydro_env.tasks import Trace, compute
from hydro_env.tasks.metrics import SETTLED_RPM

__all__ = ["Episodes", "Step", "inform", "roll_out"]


#: True signals of the environment's `info` that the metrics need.
SIGNALS = "setpoint_rpm", "speed_rpm", "angle_difference_deg", "peak_difference_rpm"


class Step(NamedTuple):
    """What the environment gave after a control period, with one row per rig; `action` (num_rigs, 2) within [-1, 1] is applied
    as float32. Action and reward are missing after the reset."""

    observation: Singles
    info: dict[str, Any]
    action: Floats | None = None
    reward: Floats | None = None


@dataclass(frozen=True)
class Episodes:
    """What happened: the true signals of every rig, and which fault each rig had ("" for none). `typical_command` is the median
    size of what the controller returned, before it was limited to [-1, 1]; `decision_s` how long it took for a rig and a
    command."""

    trace: Trace
    faults: tuple[str, ...]
    typical_command: float
    decision_s: float = 0.0

    @property
    def returns(self) -> Floats:
        """Sums of the environment's reward with its default weights, (num_rigs,)."""
        return self.trace.returns

    def metrics(self, names: Iterable[str] | None = None) -> dict[str, Floats]:
        """Scores of every rig by metric, each (num_rigs,)."""
        return compute(self.trace, names)


def roll_out(
    controller: Any,
    seeds: Sequence[int],
    *,
    plant: Any = "paper_dead_zone",
    mismatch: Any = "val",
    scenario: Any = "setpoint_steps",
    control_period: float = 0.01,
    limit: float = inf,
    dtype: str = "float64",
    steps: list[Step] | None = None,
) -> Episodes:
    """Lets a controller drive one episode per seed, all at once. Row i is what a reset with `seeds[i]` draws.

    A controller whose `needs` is not "measurements" is shown a copy of the plant beforehand, and the loads to come if
    it is "everything". What the controller raises is passed on; ValueError if it returns something that is no command,
    or if a rig diverges; TimeoutError if it has taken more than `limit` s by itself, looked at after every `act`.
    `dtype` is that of the plant; `steps` receives all that the environment gives.
    """
    task = {"plant": plant, "mismatch": mismatch, "scenario": scenario}
    env = HydraulicSyncVectorEnv(len(seeds), **task, control_period=control_period, dtype=dtype)
    observation, info = env.reset(seed=[int(seed) for seed in seeds])
    signals = {key: [np.array(info[key])] for key in SIGNALS}
    commands: list[Floats] = []
    if steps is not None:
        steps.append(Step(observation, info))
    inform(controller, env.model, env.plant, lambda: _loads(env))
    controller.reset(len(seeds), control_period)
    faults = tuple(str(fault) for fault in info["fault"])
    sizes: list[Singles] = []
    spent, returns, done = 0.0, np.zeros(len(seeds)), np.zeros(len(seeds), dtype=bool)
    while not done.all():
        began = perf_counter()
        returned = checked_rows("act returned", controller.act(observation), (len(seeds), 2))
        spent += perf_counter() - began
        action = np.minimum(np.maximum(returned, -1.0), 1.0)
        asked = controller.asked if isinstance(controller, Controller) else returned
        sizes.append(np.abs(asked).astype(np.float32))
        if spent > limit:
            raise TimeoutError(f"took more than {limit:g} s for {len(sizes)} steps of {len(seeds)} rigs")
        observation, reward, terminated, truncated, info = env.step(action.astype(np.float32))
        commands.append(action)
        for key, rows in signals.items():
            rows.append(np.array(info[key]))
        if steps is not None:
            steps.append(Step(observation, info, action, reward))
        returns += reward
        if terminated.any():
            case = int(np.argmax(terminated))
            raise ValueError(f"case {case}: {info['termination'][case]}")
        done = np.asarray(truncated)
    arrays = {key: np.array(rows) for key, rows in (signals | {"command": commands}).items()}
    settled = env.scales.speed * SETTLED_RPM
    trace = Trace(period=control_period, settled_rpm=settled, returns=returns, **arrays)
    return Episodes(trace, faults, float(np.median(sizes)), spent / (len(sizes) * len(seeds)))


def inform(controller: Any, model: Any, plant: Any, loads: Callable[[], Floats]) -> None:
    """Tells a controller of which `model` its rigs are, and shows it beforehand what its `needs` ask for: a copy of the `plant`,
    and the `loads` to come (periods, num_rigs, 2), N m."""
    if hasattr(controller, "drives"):
        controller.drives(model)
    needs = getattr(controller, "needs", "measurements")
    if needs != "measurements":
        controller.prepare(plant.copy())
    if needs == "everything":
        controller.foresee(loads())


def _loads(env: HydraulicSyncVectorEnv) -> Floats:
    return np.stack([env.reference(row).load for row in range(env.num_envs)], axis=1)
