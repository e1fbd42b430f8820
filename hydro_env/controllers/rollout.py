"""Runs one controller on a batch of rigs for one episode and keeps what happened."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_env.controllers.base import Floats
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.tasks import Trace, compute

__all__ = ["Episodes", "roll_out"]


@dataclass(frozen=True)
class Episodes:
    """What happened: the true signals of every rig, and which fault each rig had ("" for none)."""

    trace: Trace
    faults: tuple[str, ...]

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
) -> Episodes:
    """Lets a controller drive one episode per seed, all at once. Row i is what a reset with `seeds[i]` draws.

    A controller whose `needs` is "bench" or "parameters" is shown a copy of the plant beforehand. What the
    controller raises is passed on; ValueError if it returns something that is no command, or if a rig diverges.
    """
    env = HydraulicSyncVectorEnv(
        len(seeds), plant=plant, mismatch=mismatch, scenario=scenario, control_period=control_period
    )
    observation, info = env.reset(seed=[int(seed) for seed in seeds])
    if getattr(controller, "needs", "measurements") != "measurements":
        controller.prepare(copy.deepcopy(env.plant))
    controller.reset(len(seeds), control_period)
    faults = tuple(str(fault) for fault in info["fault"])
    signals = {key: [np.array(info[key])] for key in ("setpoint_rpm", "speed_rpm", "angle_difference_deg")}
    commands = []
    done = np.zeros(len(seeds), dtype=bool)
    while not done.all():
        action = _checked(controller.act(observation), len(seeds))
        observation, _, terminated, truncated, info = env.step(action.astype(np.float32))
        if np.any(terminated):
            raise ValueError(f"the plant of case {int(np.argmax(terminated))} diverged")
        done = np.asarray(truncated)
        commands.append(action)
        for key, rows in signals.items():
            rows.append(np.array(info[key]))
    load = None if env.scenario.random else env.scenario.reference(control_period).load[:, None, :]
    trace = Trace(
        period=control_period,
        command=np.array(commands),
        load_Nm=load,
        **{key: np.array(rows) for key, rows in signals.items()},
    )
    return Episodes(trace, faults)


def _checked(action: Any, num_rigs: int) -> Floats:
    """The action as commands (num_rigs, 2) in [-1, 1]; ValueError if it is none."""
    command = np.asarray(action, dtype=float)
    if command.shape != (num_rigs, 2):
        raise ValueError(f"act returned the shape {command.shape}, expected ({num_rigs}, 2)")
    if not np.all(np.isfinite(command)):
        case = int(np.argmin(np.isfinite(command).all(axis=1)))
        raise ValueError(f"act returned a command that is not finite for case {case}")
    return np.clip(command, -1.0, 1.0)
