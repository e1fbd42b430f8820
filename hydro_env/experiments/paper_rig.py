"""The paper's simulation: two motors, each under its own PID of Table III, run as finely as a continuous controller.

The paper's Simulink controller is continuous; here it is sampled every `PERIOD`, a tenth of the fastest time constant.
Speeds are the true ones: the paper's simulation has no sensors.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.controllers.base import Floats
from hydro_env.controllers.classical.pid import TABLE_III, Pid
from hydro_env.plant import Plant, PlantModel
from hydro_env.tasks import Scenario, load_scenario
from hydro_env.units import RPM

#: Sampling of the controller, s.
PERIOD = 1e-4


#: Paper, 4.1: set-point steps without load (Fig. 7).
SETPOINT_STEPS = load_scenario({"duration": 6, "setpoint_rpm": [[0, 600], [2, -200], [4, 600]]})
#: Paper, 4.2: 600 rpm, 10 % of the nominal load torque, from 2 s on all of it (Fig. 8). Loads here are shares of that torque.
LOAD_STEP = load_scenario({"duration": 4, "setpoint_rpm": [[0, 600]], "load_Nm": [[0, 0.1, 0.1], [2, 1, 1]]})


@dataclass(frozen=True)
class Traces:
    """What happened: `time` (T,) s, `setpoint` (T,) rpm, `speed` (T, N, 2) rpm, `command` (T, N, 2) V, every millisecond.

    `peak` (N,) is the largest speed difference in rpm over all samples, from the instant on that was asked for.
    """

    time: Floats
    setpoint: Floats
    speed: Floats
    command: Floats
    peak: Floats

    @property
    def difference(self) -> Floats:
        """Speed of motor 1 less that of motor 2, rpm, (T, N)."""
        return self.speed[..., 0] - self.speed[..., 1]


def run_paper(
    model: PlantModel, scenario: Scenario, *, values: Mapping[str, ArrayLike] | None = None, num_rigs: int = 1,
    nominal_torque: ArrayLike = 0.0, peak_from: float = 0.0,
) -> Traces:  # fmt: skip
    """Runs the paper's closed loop for `num_rigs` variants of a model side by side.

    `values` maps parameters to arrays that broadcast to (num_rigs, 2); `nominal_torque` (N m) to (num_rigs,). The paper mentions
    no limit of the controllers' output, so there is none, and no end stop that a spool could reach. The largest difference
    counts from `peak_from` s on.
    """
    values = dict(values or {})
    plant = Plant(model, num_rigs, effects={n.split(".")[0] for n in values if "." in n})
    plant.set_values(values)
    plant.set("u_rated", 1e6)
    plant.set("x_max", 9e-3)
    plant.reset()
    pid = Pid(PERIOD, np.zeros((num_rigs, 2)), TABLE_III["Kp"], TABLE_III["Ti"], TABLE_III["Td"])
    limits = -inf, inf
    # The derivative acts on the first step too, as it does in a continuous controller.
    pid.step(np.zeros((num_rigs, 2)), limits=limits)

    steps = round(scenario.duration / PERIOD)
    every = round(1e-3 / PERIOD)
    time: Floats = np.arange(steps, dtype=float) * PERIOD
    setpoint, load = scenario.profile(time, None)
    torque = np.broadcast_to(np.asarray(nominal_torque, dtype=float), (num_rigs,))
    speeds, commands = (np.empty((-(-steps // every), num_rigs, 2)) for _ in range(2))
    peak = np.zeros(num_rigs)
    for n in range(steps):
        speed = plant.speed / RPM
        command = pid.step(setpoint[n] - speed, limits=limits)
        if n % every == 0:
            speeds[n // every], commands[n // every] = speed, command
        if time[n] >= peak_from:
            np.maximum(peak, np.abs(speed[:, 0] - speed[:, 1]), out=peak)
        plant.step(command, load[n] * torque[:, None], PERIOD)
    return Traces(time[::every], setpoint[::every], speeds, commands, peak)


def equal_again_after(traces: Traces, scenario: Scenario, within_rpm: float) -> Floats:
    """Time in s, (changes, N), from each change of the set-point until the difference stays within a band."""
    changes = [0.0, *traces.time[1:][np.diff(traces.setpoint) != 0.0], scenario.duration]
    times = []
    for start, end in itertools.pairwise(changes):
        rows = (traces.time >= start - 1e-9) & (traces.time < end - 1e-9)
        outside = np.abs(traces.difference[rows]) > within_rpm
        last = np.where(outside.any(axis=0), outside.shape[0] - np.argmax(outside[::-1], axis=0), 0)
        times.append(last * (traces.time[1] - traces.time[0]))
    return np.array(times)
