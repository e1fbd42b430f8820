"""The paper's simulation: two motors, each under its own PID of Table III, run as finely as a continuous controller.

The paper's Simulink controller is continuous; here it is sampled every `PERIOD`, a tenth of the fastest time constant.
Speeds are the true ones: the paper's simulation has no sensors.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hydro_env.controllers.classical.pid import TABLE_III, Pid
from hydro_env.plant import Plant, PlantModel
from hydro_env.units import RPM

Floats = NDArray[np.float64]

#: Sampling of the controller, s.
PERIOD = 1e-4


@dataclass(frozen=True)
class Profile:
    """Set-point (rpm) and load (share of the nominal torque) as steps: rows (time in s, value)."""

    duration: float
    setpoint_rpm: Sequence[tuple[float, float]]
    load_share: Sequence[tuple[float, float]] = ((0.0, 0.0),)

    @staticmethod
    def at(table: Sequence[tuple[float, float]], time: Floats) -> Floats:
        """The value in force at each instant."""
        rows = np.asarray(table)
        return rows[np.searchsorted(rows[:, 0], time + 1e-9, side="right") - 1, 1]


#: Paper, 4.1: set-point steps without load (Fig. 7).
SETPOINT_STEPS = Profile(6.0, ((0.0, 600.0), (2.0, -200.0), (4.0, 600.0)))
#: Paper, 4.2: 600 rpm, 10 % of the nominal load torque, from 2 s on all of it (Fig. 8).
LOAD_STEP = Profile(4.0, ((0.0, 600.0),), ((0.0, 0.1), (2.0, 1.0)))


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
    model: PlantModel, profile: Profile, *, values: Mapping[str, ArrayLike] | None = None, num_rigs: int = 1,
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

    steps = round(profile.duration / PERIOD)
    every = round(1e-3 / PERIOD)
    time: Floats = np.arange(steps, dtype=float) * PERIOD
    setpoint = Profile.at(profile.setpoint_rpm, time)
    torque = np.broadcast_to(np.asarray(nominal_torque, dtype=float), (num_rigs,))
    load = Profile.at(profile.load_share, time)
    speeds, commands = (np.empty((-(-steps // every), num_rigs, 2)) for _ in range(2))
    peak = np.zeros(num_rigs)
    for n in range(steps):
        speed = plant.speed / RPM
        command = pid.step(setpoint[n] - speed, limits=limits)
        if n % every == 0:
            speeds[n // every], commands[n // every] = speed, command
        if time[n] >= peak_from:
            np.maximum(peak, np.abs(speed[:, 0] - speed[:, 1]), out=peak)
        plant.step(command, (load[n] * torque)[:, None], PERIOD)
    return Traces(time[::every], setpoint[::every], speeds, commands, peak)


def equal_again_after(traces: Traces, profile: Profile, within_rpm: float) -> Floats:
    """Time in s, (changes, N), from each change of the set-point until the difference stays within a band."""
    changes = [t for t, _ in profile.setpoint_rpm] + [profile.duration]
    times = []
    for start, end in itertools.pairwise(changes):
        rows = (traces.time >= start - 1e-9) & (traces.time < end - 1e-9)
        outside = np.abs(traces.difference[rows]) > within_rpm
        last = np.where(outside.any(axis=0), outside.shape[0] - np.argmax(outside[::-1], axis=0), 0)
        times.append(last * (traces.time[1] - traces.time[0]))
    return np.array(times)
