"""The simulator with four edges and two lines: convergence, steady state, and the plant where edges and lines are alike."""

import math

import numpy as np
import pytest

from docs.evidence.four_edge_rigs import RATED, engineers_model
from docs.evidence.four_edges import TANK, Axis, simulate
from hydro_env.plant import Plant
from hydro_env.units import RPM

SUPPLY = 121e5


def _axis(rated: float = RATED[0], **other: float) -> Axis:
    model = engineers_model()
    gain = model.value("alpha", 0) / model.value("R", 0) / model.value("k", 0)
    return Axis(
        gain, 80.0, 0.8, rated / math.sqrt(60e5), 2e-4, 2e-4, 1.267e9, 1.348e-6, 1.5e-11, 2.8e-3, 4.3e-3
    )._replace(**other)


def _inputs(rows: int) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(rows) * 1e-3
    command = np.stack([24.0 * np.sign(np.sin(7.0 * t)), 20.0 * np.sin(11.0 * t)], axis=1)
    return command, np.stack([2.0 * (t > 0.5), np.sin(3.0 * t)], axis=1)


def test_shorter_steps_change_nothing() -> None:
    command, load = _inputs(1500)
    rich = _axis(play=2.0, coulomb=0.5, static=0.8, relief_pressure=15e5, relief_slope=2e-10, relief_lag=0.01)
    rigs = (_axis(overlap_pa=4e-5, air=4e-3, leak_a=1e-12, sensor_lag=0.02), rich)
    speeds = [
        simulate(rigs, command, load, 1e-3, supply=SUPPLY, resistance=3e9, step=step)["measured_speed"]
        for step in (20e-6, 5e-6)
    ]
    assert np.abs(speeds[1]).max() > 300 * RPM
    np.testing.assert_allclose(*speeds, atol=0.05 * RPM)


def test_in_the_steady_state_the_flow_through_each_edge_is_what_the_motor_takes() -> None:
    axis = _axis(negative_gain=0.8)
    command, load = np.full((3000, 2), 15.0), np.full((3000, 2), 1.5)
    command[:, 1] *= -1.0
    seen = simulate((axis, axis), command, load, 1e-3, supply=SUPPLY)
    a, b, w = (seen[name][-1] for name in ("pressure_a", "pressure_b", "measured_speed"))
    through = axis.displacement * w + axis.leakage * (a - b)
    opening = axis.gain * 15.0
    np.testing.assert_allclose(
        axis.displacement * (a - b), axis.friction * w + load[-1], rtol=1e-3
    )  # torques
    into = axis.orifice * opening * np.array([math.sqrt(SUPPLY - a[0]), -0.8 * math.sqrt(a[1] - TANK)])
    out = axis.orifice * opening * np.array([math.sqrt(b[0] - TANK), -0.8 * math.sqrt(SUPPLY - b[1])])
    np.testing.assert_allclose(into, through, rtol=1e-3)
    np.testing.assert_allclose(out, through, rtol=1e-3)


def test_where_edges_and_lines_are_alike_the_plant_says_the_same() -> None:
    command, load = _inputs(2000)
    model = engineers_model().with_values({"Fc": 1e-4, "Fs": 1e-4})
    plant = Plant(model)
    expected = plant.run(command[:, None], load[:, None], 1e-3, ["measured_speed"])["measured_speed"][:, 0]
    seen = simulate((_axis(RATED[0]), _axis(RATED[1])), command, load, 1e-3, supply=SUPPLY)["measured_speed"]
    assert np.abs(expected).max() > 400 * RPM
    # What is left is the pressure between the lines, which the plant takes as half of the supply at any time.
    assert np.sqrt(np.mean((seen - expected) ** 2)) < 1.5 * RPM


@pytest.mark.parametrize(
    ("field", "value"),
    [("delay", 0.012), ("voltage_limit", 15.0), ("zero", 2e-5), ("hose", 1.5e-9), ("sensor_offset", 0.1)],
)
def test_what_one_axis_has_moves_that_axis_alone(field: str, value: float) -> None:
    command, load = _inputs(600)
    plain = simulate((_axis(), _axis()), command, load, 1e-3, supply=SUPPLY)["measured_speed"]
    other = simulate((_axis(), _axis(**{field: value})), command, load, 1e-3, supply=SUPPLY)["measured_speed"]
    np.testing.assert_array_equal(plain[:, 0], other[:, 0])
    assert np.abs(plain - other)[:, 1].max() > 0.5 * RPM


def test_a_weak_supply_ties_the_axes_together() -> None:
    command, load = _inputs(600)
    rest = command * [0.0, 1.0]
    both, one = (
        simulate((_axis(), _axis()), c, load, 1e-3, supply=SUPPLY, resistance=1e10)["measured_speed"]
        for c in (command, rest)
    )
    assert np.abs(both - one)[:, 1].max() > 5.0 * RPM
