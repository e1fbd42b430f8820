"""The filter of speeds and loads: what it tells from noise, and what a load on one motor alone takes."""

import numpy as np
import pytest

from hydro_env.controllers.estimation.motor_filter import (
    DISPLACEMENT,
    FRICTION,
    INERTIA,
    SPEED_NOISE,
    MotorFilter,
    MotorFilterSettings,
)
from hydro_env.controllers.estimation.nominal import Motor

PERIOD = 0.01
SETTINGS = MotorFilterSettings(together=0.006, apart=0.001, changed=0.1, twice=5.0)


def driven(load, noise=1.0, rigs=200, rng=None):
    """Speeds, what the filter takes them for, its loads and misses, (T, rigs, 2), under the loads (T, 2) in N m."""
    rng = rng or np.random.default_rng(0)
    speed, none = np.full((rigs, 2), 40.0), np.zeros((rigs, 2))
    pressure = np.full((rigs, 2), FRICTION * 40.0 / DISPLACEMENT)
    found = MotorFilter(SETTINGS, PERIOD, Motor(), speed, pressure)
    rows = []
    for now in load:
        speed = speed + PERIOD / INERTIA * (DISPLACEMENT * pressure - FRICTION * speed - now)
        reading = speed + noise * SPEED_NOISE * rng.standard_normal(speed.shape)
        found.update(reading, pressure, none, np.full((rigs, 2), noise), none.astype(bool))
        rows.append((speed, found.state.speed.copy(), found.state.torque.copy(), found.state.miss.copy()))
    return [np.array(each) for each in zip(*rows, strict=True)]


@pytest.mark.parametrize("noise", [1.0, 10.0])
def test_speeds_are_known_better_than_the_readings_are(noise):
    speed, taken, load, _ = driven(np.zeros((300, 2)), noise)
    assert np.std((taken - speed)[100:]) < 0.65 * noise * SPEED_NOISE
    assert abs(np.mean(load[100:])) < 0.01


def test_a_large_load_is_taken_in_at_once_whether_on_both_motors_or_on_one():
    for share in ([1.0, 1.0], [1.0, 0.0]):
        course = np.zeros((60, 2))
        course[30:] = 0.8 * np.array(share)
        *_, load, miss = driven(course)
        assert np.allclose(np.mean(miss[30], axis=0), course[-1], atol=0.05)
        assert np.allclose(np.mean(load[30], axis=0), course[-1], atol=0.1)
        assert np.allclose(np.mean(load[-1], axis=0), course[-1], atol=0.03)


def test_a_small_load_on_both_motors_does_not_look_like_a_difference_of_loads():
    """It comes in within some periods, and so do not the loads' estimates apart from each other."""
    course = np.zeros((60, 2))
    course[30:] = 0.08
    *_, load, _ = driven(course)
    assert np.mean(load[36]) > 0.05
    assert np.std(load[30:40, :, 0] - load[30:40, :, 1]) < 0.03


def test_a_blind_sensor_changes_no_load_and_its_reading_is_the_speed():
    found = MotorFilter(SETTINGS, PERIOD, Motor(), np.full((1, 2), 10.0), np.zeros((1, 2)))
    blind = np.array([[True, False]])
    for reading in (9.0, 50.0, -20.0):
        found.update(np.array([[reading, 10.0]]), np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)), blind)
        assert found.state.speed[0, 0] == reading
        assert found.state.torque[0, 0] == 0.0
    np.testing.assert_allclose(found.state.covariance[0], found.state.covariance[0].T, atol=1e-12)
    assert np.all(np.linalg.eigvalsh(found.state.covariance[0]) > -1e-9)
