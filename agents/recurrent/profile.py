"""What recurrent policies drive while they are trained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hydro_env.tasks.scenarios import NOMINAL_TORQUE, Scenario

Floats = NDArray[np.float64]

SPEED = 600.0
"""Largest set-point, rpm."""


def _held(time: Floats, changes: Floats, values: Floats) -> Floats:
    """Values (m,) in force from the instants `changes` (m,) on, zero before the first: (len(time),)."""
    return np.concatenate([[0.0], values])[changes.searchsorted(time, side="right")]


def _profile(time: Floats, stream: np.random.Generator | None) -> tuple[Floats, Floats]:
    """More steps than `random_drives` has, from rest and at full speed: what happens within 50 ms of one decides the score."""
    assert stream is not None
    most = int(time[-1] / 0.25) + 2
    rest, ramps, length, kind = stream.random(4)
    gaps, stops, levels, extremes = stream.random((4, most))
    changes = 0.02 + 0.5 * rest**2 + np.concatenate([[0.0], np.cumsum(0.25 + gaps[1:])])
    share = 2.0 * levels - 1.0
    share = np.where(extremes < 0.25, np.sign(share), share)
    setpoint = _held(time, changes, np.where(stops < 0.08, 0.0, SPEED * share))
    if ramps < 0.25:  # a moving mean over 0.1-1 s
        window = max(1, round((0.1 + 0.9 * length) / (time[1] - time[0])))
        total = np.concatenate([np.zeros(window), np.cumsum(setpoint)])
        setpoint = (total[window:] - total[:-window]) / window
    load = np.zeros((time.size, 2))
    if kind > 0.6:  # on both motors alike, or on each its own
        for channel in (0, 1):
            gaps, levels = stream.random((2, most))
            load[:, channel] = _held(time, np.cumsum(0.5 + 1.5 * gaps), NOMINAL_TORQUE * (2.0 * levels - 1.0))
        if kind < 0.8:
            load[:, 1] = load[:, 0]
    return setpoint, load


TRAINING = Scenario(
    "training_steps",
    "steps from rest and at full speed, some ramps, loads in two of five episodes",
    6.0,
    _profile,
    random=True,
)
