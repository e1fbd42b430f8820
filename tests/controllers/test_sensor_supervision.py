"""What the agents' law finds out about sensors and delay while it drives, and that it finds nothing where all is well."""

import numpy as np
import pytest

from hydro_env.controllers.estimation.estimator import EstimatorSettings
from hydro_env.controllers.estimation.nominal import Motor
from hydro_env.controllers.estimation.sensor_supervision import SensorSettings, SensorSupervision
from hydro_env.controllers.mpc.flow_controller import FlowController, FlowSettings
from hydro_env.envs import HydraulicSyncVectorEnv
from hydro_env.envs.observation import NOISE, Measurements, decode
from hydro_env.plant import load_model
from hydro_env.units import RPM

RIGS = 12


def drive(seconds=1.0, plant="paper_dead_zone", mismatch="val", noise=1.0, supervised=True, at_step=None):
    """Drives the law alone; returns its estimator, the largest speed difference of every rig, and the rigs."""
    env = HydraulicSyncVectorEnv(RIGS, plant=plant, mismatch=mismatch, scenario="setpoint_steps", noise=noise)
    observation, _ = env.reset(seed=list(range(RIGS)))
    estimator = EstimatorSettings(sensors=SensorSettings(active=supervised))
    law, largest = FlowController(FlowSettings(estimator=estimator, planner=None)), np.zeros(RIGS)
    law.start(decode(observation), 0.01)
    for step in range(round(seconds / 0.01)):
        observation, *_, info = env.step(law.command())
        if at_step is not None:
            observation = at_step(step, observation)
        law.update(decode(observation))
        largest = np.maximum(largest, np.abs(info["speed_difference_rpm"]))
    return law.estimator, largest, env


def test_nothing_is_found_where_all_is_well():
    found, _, _ = drive(seconds=3.0)
    assert not found.delay.periods.any()
    assert not found.sensors.unsound.any()
    assert np.mean(found.sensors.state.noise > 1.0) < 0.2


@pytest.mark.parametrize("late", [1, 2])
def test_a_delay_of_the_commands_is_found_and_allowed_for(late):
    model = load_model("paper_dead_zone").with_values({"command_delay.delay": 0.01 * late})
    found, largest, _ = drive(plant=model)
    assert np.mean(found.delay.periods == late) > 0.9
    _, careless, _ = drive(plant=model, supervised=False)
    assert np.median(largest) < 0.6 * np.median(careless)


def test_noise_is_measured_at_rest():
    found, largest, _ = drive(noise=5.0)
    assert np.all((found.sensors.state.noise > 2.0) & (found.sensors.state.noise < 12.0), axis=1).mean() > 0.7
    _, careless, _ = drive(noise=5.0, supervised=False)
    assert np.median(largest) < 0.6 * np.median(careless)


def test_valves_that_open_early_are_no_noise():
    """One valve lets oil through from the first command on, the other one later; what is noise still counts as noise."""
    rng, n = np.random.default_rng(0), 500
    torque, still = np.zeros((n, 2)), np.zeros(n, bool)
    flows = np.zeros((3, n, 2))
    flows[1:, :, 0], flows[2, :, 1] = [[10.0], [18.0]], 8.0

    def found(noise, shown):
        for k in range(3):
            speed = noise * rng.standard_normal((n, 2)) * NOISE["speed_rpm"] * RPM
            pressure = (noise * rng.standard_normal((n, 2)) + shown[k]) * NOISE["pressure_bar"] * 1e5
            seen = Measurements(np.zeros(n), speed, np.zeros((n, 2)), pressure, np.zeros((n, 2)))
            if k == 0:
                check = SensorSupervision(SensorSettings(), 0.01, Motor(), seen)
            else:
                check.update(seen, torque, torque, still)
        return check.state.pressure_noise

    assert np.mean(found(1.0, flows) > 2.0) < 0.01
    assert np.mean(found(1.0, 0.0 * flows) > 1.0) < 0.03
    assert np.mean(found(5.0, 0.0 * flows) > 2.0) > 0.9


def test_a_speed_sensor_that_stands_still_is_replaced():
    """From 0.5 s on the first sensor of every rig shows what it showed last, then the set-point falls at 2 s."""
    held = {}

    def freeze(step, observation):
        if step == 50:
            held["reading"] = observation[:, 1].copy()
        if step >= 50:
            observation = observation.copy()
            observation[:, 1] = held["reading"]
        return observation

    found, _, env = drive(seconds=2.6, at_step=freeze)
    assert found.sensors.state.stuck[:, 0].all() and not found.sensors.state.stuck[:, 1].any()
    assert np.median(np.abs(found.sensors.state.speed[:, 0] - env.plant.speed[:, 0])) < 40.0 * RPM


def test_a_lagging_speed_sensor_is_noticed():
    model = load_model("paper_dead_zone").with_values({"sensor_lag.time_constant": (0.05, 0.0)})
    found, largest, _ = drive(plant=model, seconds=3.0)
    assert np.mean(found.sensors.state.lagging[:, 0]) > 0.8 and not found.sensors.state.lagging[:, 1].any()
    _, careless, _ = drive(plant=model, seconds=3.0, supervised=False)
    assert np.median(largest) < 0.6 * np.median(careless)
