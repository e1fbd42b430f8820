"""Noise floor and effective number of samples."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.fit import noise_in
from hydro_env.diagnosis.estimation.noise import effective_samples, noise_floor
from hydro_env.diagnosis.models.base import Segment
from tests.linear_rig import LinearRig


def test_the_floor_of_white_noise_on_a_moving_signal() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(12000) * 1e-3
    signal = 20.0 * np.sin(2.0 * time) + 5.0 * (time % 2.0 > 1.0)
    found = noise_floor(signal + 0.3 * rng.standard_normal(time.size), np.ones(time.size, bool), 1e-3)
    assert found == pytest.approx(0.3, rel=0.03)


def test_rows_that_do_not_count_are_left_out() -> None:
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(4000)
    noise[2000:] *= 50.0
    inside = np.arange(4000) < 2000
    assert noise_floor(noise, inside, 1e-3) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("memory", [0, 2])
def test_the_swing_of_a_motor_is_no_noise(memory: int) -> None:
    """A motor at 8 Hz, of which a model with another bulk modulus leaves a swing; noise of a filter keeps what it has."""
    time = np.arange(12000) * 2e-3
    white = np.random.default_rng(3).standard_normal(time.size)
    noise = white if memory == 0 else np.convolve(white, np.ones(memory), "same") / memory**0.5
    swing = 0.0 if memory else 40.0 * np.sin(2.0 * np.pi * 8.0 * time)
    used = np.ones(time.size, bool)
    own = Segment(0, 0, "speed", swing + noise, np.arange(time.size), used, 2e-3)
    rig = LinearRig({}, time)
    D, V, beta = (rig.model.value(name, 0) for name in ("D", "V", "beta"))
    swinging = {"J": D**2 * beta / V / (2.0 * np.pi * 8.0) ** 2, "Km": 1e-16, "B": 1e-6}
    rig.model = rig.model.with_values(swinging)
    found, plain = noise_in(rig, own, own.measured), noise_floor(own.measured, used, 2e-3)  # type: ignore[arg-type]
    assert found == pytest.approx(plain if memory else 1.0, rel=0.1) and (memory or plain > 5.0)


def test_effective_samples() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal(20000)
    assert effective_samples(white) > 0.8 * white.size
    red = np.empty_like(white)
    red[0] = 0.0
    for n in range(1, white.size):
        red[n] = 0.95 * red[n - 1] + white[n]
    # First order: n (1 - a) / (1 + a).
    assert effective_samples(red) == pytest.approx(white.size * 0.05 / 1.95, rel=0.3)
