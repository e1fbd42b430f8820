"""Bootstrap, noise floors, and what calibration hides."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.final_refinement import moves_along_axes, refine, settle
from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.estimation.gauss_newton import differentiate
from hydro_env.diagnosis.estimation.noise import noise_floor
from hydro_env.diagnosis.estimation.uncertainty import STRETCH_S, bootstrap, intervals_of, nearest_inside
from hydro_env.diagnosis.estimation.unknowns import base_unknown, less_taken
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import as_given, calibrate
from hydro_env.diagnosis.stages.localisation import shape
from hydro_env.diagnosis.stages.screening import Screening, hidden_by_calibration, screen
from hydro_env.diagnosis.stages.values import Interval, widened_by_form
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model
from hydro_env.practice.generate import make_practice
from tests.linear_rig import logged, time_of


def _fit(rig: DynamicRig) -> Fit:
    """The noise by the model as given."""
    given = as_given(Fit(rig, {(c, s.signal): 1e-3 for c in rig.channels for s in rig.segments[c]}))
    return Fit(rig, noise_of(rig, given))


def test_bootstrap_has_the_spread_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    truth, count = 2.0, 400
    noise = rng.standard_normal(count)
    matrices, sides = np.ones((count, 1, 1)), (truth + noise)[:, None]
    moves = bootstrap(matrices, sides, np.zeros((1, 1)), np.zeros(1), rng)
    assert np.std(moves) == pytest.approx(1.0 / np.sqrt(count), rel=0.2)


def test_replicas_differ_as_much_as_the_prior_where_the_logs_say_nothing() -> None:
    """Two parameters of which the logs see the sum alone, a hundred times."""
    rng, count = np.random.default_rng(0), 100
    matrices = np.ones((count, 2, 2))
    sides = rng.standard_normal((count, 1)) * np.ones((count, 2))
    moves = bootstrap(matrices, sides, np.eye(2), np.zeros(2), rng)
    assert np.std(moves.sum(axis=1)) == pytest.approx(1.0 / np.sqrt(count), rel=0.25)
    assert np.std(moves[:, 0] - moves[:, 1]) == pytest.approx(np.sqrt(2.0), rel=0.2)


def test_scales_that_only_held_parameters_fix_are_open() -> None:
    """However much the logs seem to say, the force of the coil is known as far as the priors of all forces."""
    fit, base = logged({}, {}, 4000)
    names = ("J", "k", "alpha", "m", "Fc", "Fs")
    unknowns = [base_unknown(PARAMETERS[n], PARAMETERS[n].nominal) for n in names]
    found = Estimate(0, unknowns, np.zeros(len(names)))
    found.simulated = dict(base.simulated)
    found.columns = {0: np.random.default_rng(1).standard_normal((4000, len(names)))}
    intervals = intervals_of(fit, found)
    widths = dict(zip(names, 0.5 * (intervals.high - intervals.low), strict=True))
    known = 1.0 / np.sqrt(sum(u.scale**-2 for u in unknowns[1:]))  # of the scale, by the priors alone
    scale = dict(zip(names, (u.scale for u in unknowns), strict=True))
    assert widths["J"] < 0.01
    assert 1.7 * known < widths["alpha"] * scale["alpha"] < 2.6 * known
    assert np.abs(intervals.draws).max() < 0.01


@pytest.mark.parametrize(
    ("parameter", "value", "bare", "low", "high"),
    [
        (
            "dead_zone.overlap_positive",
            5e-5,
            5e-5,
            4.7e-5,
            5.3e-5,
        ),  # a size: 3 % of its distance from neutral
        ("directional_gain.ratio", 0.6, 0.6, 0.576, 0.624),
        ("motor_coulomb_friction.stribeck_speed", 3.0, 3.0, 2.4, 3.6),  # what shapes the law: 10 %
        (
            "sensor_lag.time_constant",
            0.010,
            0.012,
            0.006,
            0.014,
        ),  # as far as a correction of form has moved it
        ("eccentric_load.phase", 1.0, 1.0, 1.0, 1.0),  # an angle
        ("displacement_ripple.order", 9.0, 9.0, 9.0, 9.0),
    ],
)
def test_the_interval_of_an_effect_holds_what_the_form_of_its_law_leaves_open(
    parameter: str, value: float, bare: float, low: float, high: float
) -> None:
    effect, name = parameter.split(".")
    exact, before = (Interval(v, v, v, "") for v in (value, bare))
    found = widened_by_form(CATALOGUE[effect], name, exact, before)
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.01 * abs(value))
    wide = replace(exact, low=0.9 * value, high=1.1 * value)
    found = widened_by_form(CATALOGUE[effect], name, wide, wide)
    assert found.low <= wide.low and found.high >= wide.high


def test_what_stops_beside_the_minimum_settles_there_with_its_own_spread() -> None:
    """Two curves that are nearly equal: their sum is known, their difference hardly."""
    time = time_of(4000)
    first = np.sin(5.0 * time)
    second = first + 0.01 * np.cos(9.0 * time)
    names = ("load_bias.bias", "eccentric_load.amplitude")
    fit, base = logged(dict(zip(names, (first, second), strict=True)), {names[0]: 0.3, names[1]: 0.2}, 4000)
    found = base.with_effect("load_bias", {"bias": 0.1}).with_effect(
        "eccentric_load", {"amplitude": 0.1, "phase": 0.0}
    )
    fit.evaluate([found])
    differentiate(fit, [found])
    settle(fit, [found])
    refine(fit, fit, [found])
    spread = _deviations(fit, found)
    for name, true in zip(names, (0.3, 0.2), strict=True):
        j = [u.name for u in found.unknowns].index(name)
        low, high = (found.unknowns[j].value(found.q[j] + s * spread[j]) for s in (-3.0, 3.0))
        assert low < true < high
    alone = found.at(found.q.copy())
    alone.simulated = dict(found.simulated)
    differentiate(fit, [alone])
    assert spread == pytest.approx(_deviations(fit, alone), rel=0.05)


def _deviations(fit: Fit, estimate: Estimate) -> np.ndarray:
    """Standard deviations of q (k,) by the derivatives."""
    matrix = fit.normal_equations_by_stretch(estimate, STRETCH_S)[0].sum(axis=0)
    prior = np.diag([1.0 if u.prior else 0.0 for u in estimate.unknowns])
    return np.sqrt(np.diag(np.linalg.inv(matrix + prior)))


@pytest.mark.parametrize("reach", [1.0, 10.0])
@pytest.mark.parametrize("beside", [0.0, 1e-13, 1e-3])
def test_secants_keep_to_their_axes_and_to_the_bounds(reach: float, beside: float) -> None:
    """Along axes of which one is a thousand times as stiff as another, with three unknowns at their bounds or just beside."""
    unknowns = [
        base_unknown(PARAMETERS[n], PARAMETERS[n].nominal) for n in ("k", "Kq", "alpha", "J", "D", "B")
    ]
    estimate = Estimate(0, unknowns, np.zeros(6))
    low, high = estimate.bounds
    estimate.q = np.array([high[0] - beside, low[1] + beside, 0.3, 0.0, -0.2, low[5] + beside])
    turned, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))
    matrix = turned * np.array([1e7, 1e4, 3e3, 300.0, 30.0, 10.0]) @ turned.T
    axes, moves = moves_along_axes(estimate, matrix, reach)
    np.testing.assert_allclose(axes.T @ axes, np.eye(6), atol=1e-9)
    longest = np.zeros(6)
    np.maximum.at(longest, np.abs(moves @ axes).argmax(axis=1), np.linalg.norm(moves, axis=1))
    # On every axis at least one move is long enough to tell a change from rounding.
    assert np.all(longest > 0.01 * reach / np.sqrt(np.diag(axes.T @ matrix @ axes)))
    along = np.abs(moves @ axes)
    length = np.linalg.norm(moves, axis=1)
    np.testing.assert_allclose(along.max(axis=1), length, rtol=1e-9)
    assert np.all(estimate.q + moves >= low - 1e-12) and np.all(estimate.q + moves <= high + 1e-12)
    assert set(along.argmax(axis=1)) == set(range(6)) and length.min() > 0.0


def test_a_replica_beyond_its_bounds_keeps_combinations_that_make_up_for_each_other() -> None:
    """The logs know the sum of two unknowns well and their difference hardly: clipping one of them would change the sum."""
    matrix = np.array([[1e4 + 1.0, 1e4 - 1.0], [1e4 - 1.0, 1e4 + 1.0]])
    bounds = np.array([-0.5, -3.0]), np.array([0.5, 3.0])
    found = nearest_inside(matrix, np.array([2.0, -2.0]), np.zeros(2), bounds)
    assert found == pytest.approx([0.5, -0.5], abs=1e-3)
    inside = nearest_inside(matrix, np.array([0.4, -0.4]), np.zeros(2), bounds)
    assert inside == pytest.approx([0.4, -0.4])


def test_a_value_beyond_its_usual_range_may_move_both_ways() -> None:
    usual, low = base_unknown(PARAMETERS["J"], 0.0028), base_unknown(PARAMETERS["Fc"], 0.002)
    assert (usual.low, usual.high) == (0.0014, 0.0056)
    assert low.low < 0.002 < low.high and low.low >= PARAMETERS["Fc"].possible[0]


def test_noise_floor_of_a_signal_that_stands_still_most_of_the_time() -> None:
    rng = np.random.default_rng(1)
    value = np.zeros(6000)
    value[4000:] = 0.5 * rng.standard_normal(2000)
    assert noise_floor(value, np.ones(6000, bool), 1e-3) == pytest.approx(0.5, rel=0.15)


def test_inertia_behind_a_coupling_comes_out_of_the_calibrated_one() -> None:
    assert less_taken({"J": 5e-3, "B": 1.0}, "shaft_backlash", {"inertia": 2e-3, "gap": 0.05}) == {
        "J": pytest.approx(3e-3)
    }
    assert less_taken({"J": 5e-3}, "dead_zone", {"overlap_positive": 1e-4}) == {}


def test_either_side_of_a_rig_serves_either_channel(tmp_path: Path) -> None:
    make_practice([], duration=3.0, rate=200.0, runs=("fit_1",), base_error=0.1, seed=3).write(tmp_path)
    model = load_model("paper").with_values({"Kq": (4e-4, 3e-4), "J": (3e-3, 2e-3)})
    rig = DynamicRig(model, read_parts([tmp_path / "fit_1.csv"], None))
    requests = [Request(0, {"R": 100.0 + n}) for n in range(3)] + [
        Request(1, {"load_bias.bias": 0.1}),
        Request(1, {}),
    ]
    together = rig.predict(requests)
    whole = rig.predict([Request(None, {"R": (102.0, model.value("R", 1))}), Request(None, {})])
    np.testing.assert_array_equal(together[2][0], whole[0][0])
    np.testing.assert_array_equal(together[4][1], whole[1][1])
    for request, answer in zip(requests, together, strict=True):
        np.testing.assert_array_equal(answer[request.channel], rig.predict([request])[0][request.channel])


def test_calibration_hides_a_wrong_scale_of_the_speed_and_not_a_dead_zone(tmp_path: Path) -> None:
    make_practice([], duration=4.0, rate=500.0, runs=("fit_1",), seed=3).write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    fit = _fit(rig)
    calibrated = calibrate(fit, 2)
    found = screen(fit, calibrated, ["sensor_gain", "dead_zone", "speed_dependent_leakage"], 4.0)
    hidden = hidden_by_calibration(found)
    assert "sensor_gain" in hidden and "dead_zone" not in hidden


def test_what_calibration_takes_up_but_for_next_to_nothing_is_hidden() -> None:
    def seen(visible: float, unprojected: float) -> Screening:
        return Screening("sensor_gain", 0, {}, 0.0, visible, unprojected)

    assert seen(50.0, 1e4).hidden and not seen(50.0, 1e4).shows
    assert seen(213.0, 6.5e6).hidden and not seen(213.0, 6.5e6).shows
    assert not seen(1e4, 6.5e6).hidden and seen(1e4, 6.5e6).shows
    small = seen(10.0, 20.0)  # nothing there that calibration could take
    assert not small.hidden and not small.shows


def test_the_shape_of_a_gap_tells_a_curve_from_memory() -> None:
    t = np.arange(6000) * 1e-3
    command = 40.0 * np.sin(2.0 * np.pi * t)
    overlap = shape(command, -np.clip(command, -10.0, 10.0), "command, V", "flow", 1.0)
    assert overlap.explains > 0.95
    assert next(p[1] for p in overlap.points) == pytest.approx(10.0, rel=0.01)
    loop = shape(command, np.sign(np.cos(2.0 * np.pi * t)), "command, V", "flow", 1.0)
    assert loop.explains < 0.1 and loop.with_direction > 0.95
