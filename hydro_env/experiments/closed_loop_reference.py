"""A controller on a rig that the independent reference simulator plays: what its model is worth outside of that model.

`controllers.rollout` drives the compiled plant, whose equations a diagnosis fits and a tuner searches on. Here the same
controller, sensors and scenarios meet `practice.reference`: SciPy's stiff solver on equations of its own, with other
functional forms of the effects where there are some.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hydro_env.envs.observation import LIMIT, SCALES, noise_levels
from hydro_env.plant import PlantModel
from hydro_env.plant.plant import grid_points
from hydro_env.practice.reference import ReferenceRig
from hydro_env.practice.reference.forms import Constants
from hydro_env.tasks import Scenario, Trace, load_scenario
from hydro_env.units import RPM

#: Relative tolerance of the solver.
TOLERANCE = 1e-6
#: Sensors of the observation, in its order.
SENSORS = ("measured_speed", "current", "pressure")


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
