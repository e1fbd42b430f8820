"""The workflow on the dynamic rig, with logs of the independent simulator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import diagnose
from hydro_env.diagnosis.estimation.unknowns import base_unknown, effect_starts, effect_unknowns
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DTYPE, TOLERANCE, DynamicRig
from hydro_env.plant import BUILT_IN, CATALOGUE, PARAMETERS, Plant, load_model
from hydro_env.practice.generate import make_practice
from hydro_env.units import RPM


@pytest.fixture(scope="module")
def fit_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("practice")
    make_practice([], duration=3.0, rate=500.0, runs=("fit_1",)).write(folder)
    return folder / "fit_1.csv"


def test_a_request_is_answered_the_same_beside_others(fit_log: Path) -> None:
    rig = DynamicRig(load_model("paper"), read_parts([fit_log], None))
    one = Request(0, {"Kq": 0.4})
    both = Request(None, {"Kq": (0.4, 0.3)})
    alone = rig.predict([one])[0]
    beside = rig.predict([Request(1, {"Kq": 0.2}), one, Request(0, {"J": 0.003}), both])
    np.testing.assert_array_equal(alone[0], beside[1][0])
    np.testing.assert_array_equal(alone[0], beside[3][0])
    assert set(alone) == {0} and set(beside[3]) == {0, 1}


def test_a_log_is_simulated_the_same_beside_a_longer_one_and_one_of_another_period(
    fit_log: Path, tmp_path: Path
) -> None:
    make_practice([], duration=3.0, rate=400.0, runs=("fit_2",)).write(tmp_path)
    files = [fit_log, f"{fit_log}@0:2.6", tmp_path / "fit_2.csv"]
    wanted = [Request(c, {"Kq": 0.3 + 0.01 * n}) for n in range(3) for c in (0, 1)]
    together = DynamicRig(load_model("paper"), read_parts(files, None))
    for number, file in enumerate(files):
        alone = DynamicRig(load_model("paper"), read_parts([file], None))
        for one, other in zip(alone.predict(wanted), together.predict(wanted), strict=True):
            for c in one:
                own = [s.place for s in together.segments[c] if s.log == number]
                np.testing.assert_array_equal(one[c], np.concatenate([other[c][place] for place in own]))


@pytest.mark.parametrize("followed", [(), (0,)])
def test_threads_change_no_bit(fit_log: Path, followed: tuple[int, ...]) -> None:
    parts = read_parts([fit_log], None)
    wanted = [Request(c, {"Kq": 0.2 + 0.01 * n}) for n in range(20) for c in (0, 1)]
    wanted += [Request(0, {"dead_zone.overlap_positive": 1e-5 * n}) for n in range(3)]
    wanted += [Request(None, {"supply_droop.relative_drop": (0.1 * n, 0.1 * n)}) for n in range(1, 9)]
    shared = DynamicRig(load_model("paper"), parts, jobs=3)
    rigs = DynamicRig(load_model("paper"), parts), shared
    alone, beside = (rig.following(followed).predict(wanted) for rig in rigs)
    for one, other in zip(alone, beside, strict=True):
        assert one.keys() == other.keys()
        for c in one:
            np.testing.assert_array_equal(one[c], other[c])


#: Effects whose course single precision may change: where a shaft rattles or comes to rest, any rounding does.
ROUGH = {"displacement_ripple": 1.0, "eccentric_load": 1.0, "shaft_backlash": 10.0}


@pytest.mark.parametrize("name", ["", *(n for n in BUILT_IN if not CATALOGUE[n].family)])
def test_the_fits_numbers_are_near_those_of_the_proof(fit_log: Path, name: str) -> None:
    parts = read_parts([fit_log], None)
    typical = {f"{name}.{p.name}": p.typical for p in CATALOGUE[name].parameters if p.typical} if name else {}
    pairs = {key: (value, value) for key, value in typical.items()}
    fit = DynamicRig(load_model("paper"), parts)
    proof = fit.with_parts(parts, True)
    found = [m.predict([Request(None, pairs)])[0] for m in (fit, proof)]
    for c in (0, 1):
        speed = next(s for s in fit.segments[c] if s.signal == "speed")
        change = (found[0][c] - found[1][c])[speed.place]
        assert np.sqrt(np.mean(change**2)) / RPM < ROUGH.get(name, 0.2)


@pytest.mark.parametrize("followed", [(), (0,)])
def test_what_takes_the_steps_of_another_is_the_same_beside_others_and_on_threads(
    fit_log: Path, followed: tuple[int, ...]
) -> None:
    parts = read_parts([fit_log], None)
    pairs = [
        Request(None, {"supply_droop.relative_drop": (0.2, 0.2), "J": (0.003 + n / 1e5, 0.003)})
        for n in range(4)
    ]
    nominal = [Request(0, {"Kq": 0.4}), Request(1, {"dead_zone.overlap_positive": 1e-5}), pairs[0]]
    moved = [replace(nominal[0], values={"Kq": 0.4 + n / 1e3}, like=nominal[0]) for n in range(20)]
    moved.append(replace(nominal[1], values={"dead_zone.overlap_positive": 2e-5, "Kq": 0.3}, like=nominal[1]))
    moved += [replace(r, like=nominal[2]) for r in pairs[1:]]
    shared = DynamicRig(load_model("paper"), parts, jobs=3)
    beside = shared.following(followed).predict([*moved, *nominal])
    rig = DynamicRig(load_model("paper"), parts).following(followed)
    for n in (0, 5, 19, 20, 21, 23, 24, 25, 26):
        alone = rig.predict([[*moved, *nominal][n]])[0]
        for c in alone:
            np.testing.assert_array_equal(alone[c], beside[n][c])
    np.testing.assert_array_equal(beside[0][0], beside[24][0])


def test_differences_between_neighbours_hold_no_errors_of_steps(fit_log: Path) -> None:
    rig = DynamicRig(load_model("rig"), read_parts([fit_log], None), dtype=np.float64)
    speed = next(s for s in rig.segments[0] if s.signal == "speed").place
    spread: dict[bool, list[float]] = {True: [], False: []}
    for name in ("J", "m", "Kq", "alpha", "beta"):
        value = 1.02 * rig.given(name, 0)
        nominal = Request(0, {name: value})
        for grouped, own in spread.items():
            like = nominal if grouped else None
            moved = [Request(0, {name: value * (1.0 + n * 1e-5)}, like) for n in range(1, 8)]
            first, *others = (found[0][speed] for found in rig.predict([nominal, *moved]))
            slopes = np.array([(one - first) / n for n, one in enumerate(others, 1)])
            mean = slopes.mean(axis=0)
            own.append(float(np.std(slopes - mean) / np.std(mean)))
    assert np.mean(spread[False]) > 5.0 * np.mean(spread[True])


@pytest.mark.parametrize("name", ["paper_dead_zone", "rig", "servo", "valve_1", "valve_2"])
def test_the_tolerance_of_the_fit_follows_presets_under_hard_commands(name: str) -> None:
    """Steps, and full range one way or the other, every 10 ms, as in the logs of the fastest practice runs."""
    model, rng = load_model(name), np.random.default_rng(0)
    steps = np.repeat(rng.uniform(-0.6, 0.6, (5, 2)), 30, axis=0)
    share = np.concatenate([steps, rng.choice([-1.0, 1.0], (150, 2))])
    commands = np.repeat(share * model.value("u_rated", 0), 10, axis=0)
    coarse, fine = (
        Plant(model, 1, tolerance=t, dtype=d).run(commands, None, 1e-3, ("speed",))["speed"]
        for t, d in ((TOLERANCE, DTYPE), (TOLERANCE / 100, np.float64))
    )
    assert np.abs(coarse - fine).max() / RPM < 0.4


def test_the_model_as_given_explains_a_rig_without_surprise(fit_log: Path) -> None:
    rig = DynamicRig(load_model("paper"), read_parts([fit_log], None))
    simulated = rig.predict([Request(0, {})])[0][0]
    speed = next(s for s in rig.segments[0] if s.signal == "speed")
    error = speed.measured - simulated[speed.place]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.pi / 30.0, rel=0.1)  # the noise of 1 rpm


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_effect_has_sensible_starts(name: str) -> None:
    effect = CATALOGUE[name]
    rows = effect_starts(effect, 12.0)
    assert rows
    for row in rows:
        for unknown in effect_unknowns(effect, row):
            low, high = unknown.bounds
            assert low <= 0.0 <= high and np.isfinite(unknown.scale) and unknown.scale > 0.0
            assert unknown.value(0.0) == row[unknown.parameter]
    assert any(not effect.is_neutral(row) for row in rows)


def test_valves_that_open_at_the_load_pressures_of_a_log_are_seen_at_first_look(fit_log: Path) -> None:
    """Check valves of the supply's usual pressure never open in logs of low load pressures."""
    rig = DynamicRig(load_model("paper"), read_parts([fit_log], None))
    pressure = next(s for s in rig.segments[0] if s.signal == "pressure")
    assert 25e5 < np.abs(pressure.measured).max() < 90e5
    starts = effect_starts(CATALOGUE["anti_cavitation"], 3.0)
    without, *found = rig.predict(
        [Request(0, {}), *(Request(0, {f"anti_cavitation.{k}": v for k, v in s.items()}) for s in starts)]
    )
    moved = {s["supply_pressure"]: np.ptp(f[0] - without[0]) for s, f in zip(starts, found, strict=True)}
    assert moved[100e5] == 0.0 and moved[20e5] > 0.0


def test_the_friction_of_the_spool_may_be_far_less_than_given_but_not_far_more(fit_log: Path) -> None:
    given = base_unknown(PARAMETERS["Fs"], 0.2, limited=True)
    assert given.high == pytest.approx(0.2 * 1.35) and given.low == pytest.approx(0.02)
    assert given.scale == 0.5  # factors of friction are nothing unusual
    parts = read_parts([fit_log], None)
    for friction, adjusted in ((0.002, {"Fc", "Fs"}), (0.0, set[str]())):
        model = load_model("servo").with_values({"Fc": friction, "Fs": friction})
        assert {"Fc", "Fs"} & {*DynamicRig(model, parts).base(0)} == adjusted


@pytest.mark.parametrize("name", [n for n in PARAMETERS if n != "u_rated"])
def test_base_parameters_stay_in_their_range(name: str) -> None:
    unknown = base_unknown(PARAMETERS[name], PARAMETERS[name].nominal)
    low, high = unknown.bounds
    assert low < high
    assert unknown.value(low) >= PARAMETERS[name].low * (1 - 1e-9)
    assert unknown.value(high) <= PARAMETERS[name].high * (1 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "base_error", "verdict"),
    [([], 0.0, "none"), ([], 0.1, "calibration"), (["dead_zone:1"], 0.1, "effects")],
)
def test_practice_logs(tmp_path: Path, hidden: list[str], base_error: float, verdict: str) -> None:
    make_practice(hidden, base_error=base_error, seed=5).write(tmp_path)
    found = diagnose(
        [tmp_path / "fit_1.csv", tmp_path / "fit_2.csv"],
        [tmp_path / "sealed.csv"],
        model=tmp_path / "model.yaml",
    )
    assert found.verdict == verdict
    assert [f"{e.name}:{e.channel}" for e in found.effects] == hidden
    for key, gap in found.as_dict()["gap"]["sealed"].items():
        assert gap["after"] < 1.5 * gap["noise"], key
