"""A spool that its friction holds stays where it is."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_env.plant import Plant


@pytest.mark.parametrize("model", ["paper", "servo"])
def test_a_stuck_spool_does_not_creep(model: str) -> None:
    """However long the command is held, and whatever its friction."""
    plant, stream, rest = Plant(model, 16), np.random.default_rng(0), np.zeros((16, 2))
    for name in ("Fc", "s0", "s1", "m"):
        plant.set(name, plant.get(name) * stream.uniform(0.7, 1.5, (16, 2)))
    plant.set("Fs", plant.get("Fc") * stream.uniform(1.0, 2.5, (16, 2)))
    command = stream.uniform(-1.0, 1.0, (4, 16, 2)) * plant.get("u_rated")
    for row in np.repeat(command, 20, axis=0):
        plant.hold(row, rest, 0.01)
    for _ in range(100):
        plant.hold(command[-1], rest, 0.01)
    stuck = plant.spool
    for _ in range(300):
        plant.hold(command[-1], rest, 0.01)
    assert np.abs(plant.spool - stuck).max() < 1e-9
