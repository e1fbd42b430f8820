"""The delay line: to the last bit the same for a rig alone, in a batch, and after a reset."""

from __future__ import annotations

import numpy as np

from hydro_env.plant import Plant, load_model

PERIOD = 0.01


def test_delayed_rows_start_afresh_whatever_their_neighbours() -> None:
    """Also where the channels of a rig act on each other and their commands are late by different times."""
    values = {"supply_droop.relative_drop": 0.2, "command_delay.delay": (0.0042, 0.0173)}
    model = load_model("rig").with_values(values)
    commands = np.random.default_rng(0).uniform(-22.0, 22.0, (60, 5, 2))
    wide, narrow, alone = Plant(model, 5, block=16), Plant(model, 5, block=1), Plant(model)
    speeds = [plant.run(commands[:23], None, PERIOD)["speed"] for plant in (wide, narrow)]
    assert np.array_equal(*speeds)
    wide.reset([3])
    late = wide.run(commands[23:], None, PERIOD)["speed"][:, 3]
    assert np.array_equal(late, alone.run(commands[23:, [3]], None, PERIOD)["speed"][:, 0])
    assert not wide.diverged.any() and np.ptp(late) > 1.0


def test_a_held_command_is_late_by_the_same_at_every_period() -> None:
    """Rows of the same command, or one row: the shift is the same, and so are speeds within the tolerance."""
    model = load_model("paper").with_values({"command_delay.delay": 0.03})
    ends = []
    for period in (0.24, 0.08, 0.04, 0.01, 1e-3, 1e-4):
        rows = round(0.24 / period)
        plant = Plant(model)
        plant.run(np.full((rows, 2), 40.0), None, period)
        plant.run(np.full((rows, 2), -30.0), None, period)
        ends.append(plant.speed[0, 0])
    assert np.ptp(ends) < 0.1 * np.pi / 30.0 and abs(ends[0]) > 1.0
