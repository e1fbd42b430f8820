"""How long logs must be: what is too short to be told from chance is refused."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.uncertainty import SHORTEST_S, STRETCH_S
from hydro_env.diagnosis.input.checks import read_logs
from hydro_env.errors import InputError
from hydro_env.measured import RigLog
from hydro_env.plant import load_model


def log(seconds: float, seed: int = 0) -> RigLog:
    time = np.arange(round(seconds / 1e-3)) * 1e-3
    command = np.column_stack([np.sin(20 * time + seed), np.full(len(time), np.nan)])
    return RigLog(time, command, 5.0 * command, name=f"log {seed}")


def test_the_bound_is_that_of_a_95_percent_interval() -> None:
    """Fewer stretches than five have fewer than forty different bootstrap samples."""
    number = round(SHORTEST_S / STRETCH_S)
    assert len(list(combinations_with_replacement(range(number), number))) >= 40
    assert len(list(combinations_with_replacement(range(number - 1), number - 1))) < 40


@pytest.mark.parametrize("preset", ["paper", "paper_dead_zone", "rig", "servo"])
def test_a_stretch_is_longer_than_the_memory_of_the_shaft(preset: str) -> None:
    model = load_model(preset)
    for channel in (0, 1):
        inertia, damping, displacement, leakage = (model.value(n, channel) for n in ("J", "B", "D", "Km"))
        assert 2.0 * inertia / (damping + displacement**2 / leakage) < STRETCH_S


@pytest.mark.parametrize("seconds", [0.06, 0.2, 1.0, 2.4])
def test_short_logs_are_refused(seconds: float) -> None:
    with pytest.raises(InputError, match=r"log 0: the fit logs last .* at least 2.5 s are needed"):
        read_logs([log(seconds)], [log(4.0, 1)], None)
    with pytest.raises(InputError, match=r"log 1: the held-out logs last .* at least 2.5 s are needed"):
        read_logs([log(4.0)], [log(seconds, 1)], None)


def test_logs_that_are_long_enough_together_are_used() -> None:
    fit, held_out = read_logs([log(1.3), log(1.3, 2)], [log(SHORTEST_S, 1)], None)
    assert len(fit) == 2 and held_out[0].seconds == pytest.approx(SHORTEST_S)
