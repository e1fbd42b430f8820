"""Recursive estimation of valves: edges and gains are found, their uncertainty is honest, and changes are followed."""

import numpy as np
import pytest

from hydro_env.controllers.estimation.nominal import Motor
from hydro_env.controllers.estimation.spool import SpoolModel, SpoolSettings, channel_of
from hydro_env.controllers.estimation.valve_estimator import ValveEstimator, ValveSettings

PERIOD = 0.01


def spools(num_rigs):
    settings = SpoolSettings()
    return SpoolModel(
        np.zeros((num_rigs, 2)), channel_of(settings, Motor(), PERIOD, 1), settings.pressure_lag
    )


def rest(spool, place):
    """Puts spools to rest at a place."""
    spool.position[:], spool.coil[:], spool.speed[:], spool.ringing[:] = place, place, 0.0, 0.0


def test_edge_and_gain_are_found():
    """Valves with known curves under slow sweeps, and noisy flow: the estimates come near, within what they say."""
    n, rng = 100, np.random.default_rng(0)
    edge, gain = rng.uniform(0.0, 0.2, (n, 2)), rng.uniform(0.65, 1.0, (n, 2))
    valves, spool = ValveEstimator(ValveSettings(), n, PERIOD), spools(n)
    for k in range(400):
        place = np.full((n, 2), 0.25 - 0.25 * np.cos(2.0 * np.pi * k / 200))
        flow = gain * np.maximum(place - edge, 0.0) + 0.002 * rng.standard_normal((n, 2))
        rest(spool, place)
        valves.update(spool, flow, np.ones((n, 2)))
    found = valves.state
    assert np.std(found.gain - gain) < 0.02
    off = found.edge[..., 0] - edge
    assert np.std(off) < 0.003
    assert np.all(np.abs(off) < 3.0 * np.sqrt(found.edge_variance[..., 0]))
    assert found.unknown[..., 1].all()  # never visited
    np.testing.assert_allclose(found.edge[..., 1], 0.11, atol=0.02)


def test_no_flow_rules_out_what_the_spool_has_passed():
    valves, spool = ValveEstimator(ValveSettings(), 1, PERIOD), spools(1)
    for place in (0.05, 0.1, 0.15):
        rest(spool, np.full((1, 2), place))
        valves.update(spool, np.zeros((1, 2)), np.ones((1, 2)))
    assert valves.state.unknown.all()
    assert valves.state.passed[..., 0] == pytest.approx(np.full((1, 2), 0.14))
    assert np.all(valves.state.edge[..., 0] > 0.15)


def test_valves_that_change_while_they_run_are_followed():
    """Gain and edges wander, of a valve that is in use and of the side that is not."""
    n, rng = 40, np.random.default_rng(0)
    valves, spool = ValveEstimator(ValveSettings(still=0.012), n, PERIOD), spools(n)
    valves.begin_with(np.full((n, 2, 2), 0.1), np.full((n, 2), 0.8), 0.004, 0.02)
    for _ in range(300):
        rest(spool, np.full((n, 2), 0.4))
        valves.update(spool, 0.8 * (0.4 - 0.13) + 0.002 * rng.standard_normal((n, 2)), np.ones((n, 2)))
    state = valves.state
    beyond = state.gain * (0.4 - state.edge[..., 0])
    np.testing.assert_allclose(np.median(beyond), 0.8 * 0.27, atol=0.004)
    unused = np.sqrt(state.edge_variance[..., 1])
    assert np.all((unused > 0.015) & (unused < 0.021))
