"""Scenarios: on the grid, in the right units, drawn anew where random, and refused where wrong."""

import pickle

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.plant import PARAMETERS
from hydro_env.tasks.mismatch import draw_pairs
from hydro_env.tasks.scenarios import NOMINAL_TORQUE, SCENARIOS, load_scenario

RPM = 2 * np.pi / 60


def stream(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.parametrize("period", [0.01, 0.005, 0.003])
def test_shapes_and_bounds(name, period):
    scenario = SCENARIOS[name]
    reference = scenario.reference(period, stream())
    rows = scenario.steps(period) + 1
    assert reference.setpoint.shape == (rows,)
    assert reference.load.shape == (rows, 2)
    assert rows - 1 == pytest.approx(scenario.duration / period, abs=0.5)
    assert np.abs(reference.setpoint).max() <= 600 * RPM + 1e-9
    assert np.abs(reference.load).max() <= NOMINAL_TORQUE + 1e-9
    assert np.ptp(reference.setpoint) > 100 * RPM
    assert scenario.name == name and scenario.summary


def test_paper_set_points():
    for period in (0.01, 0.005, 0.001, 0.002):
        setpoint = SCENARIOS["setpoint_steps"].reference(period).setpoint / RPM
        before = 0.0
        for time, value in ((0.2, 600), (2.0, -200), (4.0, 600)):
            row = round(time / period)
            assert setpoint[row - 1 : row + 1] == pytest.approx([before, value]), (period, time)
            before = value
        assert setpoint[-1] == pytest.approx(600)


def test_paper_load():
    load = SCENARIOS["load_step"].reference(0.01).load / NOMINAL_TORQUE
    assert load[199] == pytest.approx([0.1, 0.1])
    assert load[200] == pytest.approx([1.0, 1.0])


def test_the_weaker_valve_of_most_pairs_holds_the_nominal_torque():
    """Steady balance at 73 V and 600 rpm: Kq x = D w + Km dp, D dp = tau + B w."""
    nominal = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
    pairs = draw_pairs("train", 500).values
    spool = np.minimum(nominal["alpha"] * 73.0 / (pairs["R"] * nominal["k"]), nominal["x_max"])
    opening = spool + pairs["null_offset.offset"] - pairs["dead_zone.overlap_positive"]
    speed = 600 * RPM
    pressure = (pairs["Kq"] * opening - nominal["D"] * speed) / nominal["Km"]
    held = (nominal["D"] * pressure - nominal["B"] * speed).min(axis=1)
    assert (held > NOMINAL_TORQUE).mean() > 0.93


def test_random_scenarios_differ_by_stream_alone():
    scenario = SCENARIOS["random_steps"]
    first, again, other = (scenario.reference(0.01, stream(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.setpoint, again.setpoint)
    np.testing.assert_array_equal(first.load, again.load)
    assert (first.setpoint != other.setpoint).any()
    many = [scenario.reference(0.01, stream(s)) for s in range(60)]
    loaded = np.mean([r.load.any() for r in many])
    assert 0.4 < loaded < 0.9
    assert np.mean([np.abs(np.diff(r.setpoint)) > 0 for r in many]) * 600 > 3


def test_step_tables():
    scenario = load_scenario(
        {"duration": 1.0, "setpoint_rpm": [[0.0, 60], [0.5, -60]], "load_Nm": [[0.2, 1.0, 0.5]]}
    )
    reference = scenario.reference(0.1)
    assert reference.setpoint / RPM == pytest.approx([60] * 5 + [-60] * 6)
    assert reference.load[:2] == pytest.approx(np.zeros((2, 2)))
    assert reference.load[2] == pytest.approx([1.0, 0.5])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(scenario)).reference(0.1).load, reference.load)


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("setpoint_step", "did you mean 'setpoint_steps'"),
        ({"setpoint_rpm": [[0, 1]]}, "duration"),
        ({"duration": 1.0, "speed": 3}, "unknown key 'speed'"),
        ({"duration": 1.0, "setpoint_rpm": [[0, 1, 2]]}, "setpoint_rpm"),
        ({"duration": 1.0, "setpoint_rpm": [[1, 1], [0, 2]]}, "rise"),
        ({"duration": -1.0}, "duration"),
        (7, "scenario is 7, expected setpoint_steps"),
    ],
)
def test_refused(source, told):
    with pytest.raises(InputError, match=told):
        load_scenario(source)
