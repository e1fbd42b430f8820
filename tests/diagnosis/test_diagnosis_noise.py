"""Noise floor and effective number of samples."""

import numpy as np
import pytest

from hydro_env.diagnosis.estimation import effective_samples, noise_floor


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
