"""What must not break a diagnosis: values of any machine that is accepted, 0 among them, threads, and pages that fail."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from hydro_env.case import command
from hydro_env.cli.main import run
from hydro_env.diagnosis import Diagnosis, diagnose
from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.estimation.gauss_newton import solve
from hydro_env.diagnosis.estimation.unknowns import base_unknown
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import BASE, DynamicRig
from hydro_env.diagnosis.report import wording as words
from hydro_env.diagnosis.report.page import report_page
from hydro_env.diagnosis.report.statements import comment
from hydro_env.diagnosis.stages.calibration import as_given, calibrate
from hydro_env.diagnosis.stages.localisation import locate
from hydro_env.diagnosis.stages.values import effect_values, known_parameters, widened_by_form
from hydro_env.diagnosis.stages.warnings import about_bounds
from hydro_env.errors import InputWarning
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model, scales_of, simulate
from hydro_env.practice.generate import make_practice
from hydro_env.units import BAR, RPM

#: A motor of 50 cm3 per turn beside the table's.
SIZE = 6.3
#: A rig with it, as fast and at the same pressure, by what grows with it.
BIG = {"D": SIZE, "J": SIZE, "B": SIZE, "Km": SIZE, "V": SIZE, "Kq": SIZE}


def _accepted(name: str) -> st.SearchStrategy[float]:
    """Values of a base parameter that a model may have: anywhere, at the ends, and 0 where that is one."""
    least, most = PARAMETERS[name].possible
    inside = st.floats(0.0, 1.0).map(lambda share: max(least, 1e-6 * most) ** (1.0 - share) * most**share)
    return st.sampled_from([least, PARAMETERS[name].nominal, most]) | inside


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(BASE), st.data(), st.floats(-4.0, 4.0), st.floats(0.0, 3.0))
def test_any_accepted_value_can_be_calibrated_and_reported(
    name: str, data: st.DataObject, q: float, width: float
) -> None:
    value = data.draw(_accepted(name))
    for limited in (False, True):
        unknown = replace(base_unknown(PARAMETERS[name], value, limited), channel=0)
        assert unknown.low <= value <= unknown.high and unknown.low < unknown.high and unknown.scale > 0.0
        assert unknown.low >= 0.0 and unknown.q(value) == pytest.approx(0.0, abs=1e-9)
        low, high = unknown.bounds
        estimate = Estimate(0, [unknown], np.clip(np.array([q]), low, high))
        spread = np.array([width])
        ends = {"low": np.maximum(estimate.q - spread, low), "high": np.minimum(estimate.q + spread, high)}
        estimate.intervals = SimpleNamespace(**ends, without=spread)  # type: ignore[assignment]
        rig: Any = SimpleNamespace(own={}, given=lambda name, channel, value=value: value)
        (known,) = known_parameters(rig, {0: estimate})
        told = [
            comment(rig, known),
            known.moved_by(),
            words.interval(known.estimate),
            *about_bounds({0: estimate}),
        ]
        assert not any("nan" in text or "inf" in text for text in told)


def test_plausible_values_follow_the_size_of_the_rig() -> None:
    """A motor of 50 cm3 is calibrated as one of 8 cm3 is: the same relative ranges about values that grew with it."""
    scales = scales_of(
        load_model("paper").with_values({n: f * PARAMETERS[n].nominal for n, f in BIG.items()})
    )
    for name in ("B", "Km", "V", "m", "Fc"):
        p, factor = PARAMETERS[name], BIG.get(name, 1.0)
        small, big = base_unknown(p, p.nominal), base_unknown(scales.parameter(p), factor * p.nominal)
        assert (big.low, big.high) == pytest.approx((factor * small.low, factor * small.high))
        assert big.scale == pytest.approx(small.scale)
    flywheel = base_unknown(PARAMETERS["J"], 0.02)
    assert flywheel.low == pytest.approx(0.01) and flywheel.high == pytest.approx(0.04)
    coil = base_unknown(PARAMETERS["R"], 10.0)  # of 24 V
    assert (coil.low, coil.high) == pytest.approx((8.0, 12.5)) and coil.scale < 0.12


def test_a_value_that_stays_as_given_is_not_at_the_edge_of_its_range() -> None:
    """The paper gives the least Stribeck speed that is possible; a healthy rig has it."""
    given = replace(base_unknown(PARAMETERS["vs"], 1e-4), channel=1)
    assert given.low == given.center
    assert not list(about_bounds({1: Estimate(1, [given], np.array([1e-4]))}))
    moved = replace(base_unknown(PARAMETERS["vs"], 5e-4), channel=1)
    assert len(list(about_bounds({1: Estimate(1, [moved], np.array([moved.bounds[0]]))}))) == 1


def test_a_file_of_a_large_motor_is_nothing_unusual(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    values = {name: factor * PARAMETERS[name].nominal for name, factor in BIG.items()}
    load_model("paper").with_values(values).to_yaml(tmp_path / "big.yaml")
    load_model(tmp_path / "big.yaml")
    assert not recwarn.list


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("practice")
    make_practice([], duration=3.0, rate=200.0, base_error=0.1, seed=5).write(folder)
    return folder


def test_a_model_without_friction_and_leakage_is_calibrated(logs: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    load_model("paper").with_values({"B": 0.0, "Km": 0.0}).to_yaml(model)
    found = command.run([logs / "fit_1.csv"], [logs / "sealed.csv"], tmp_path, model=model, quiet=True)
    data = json.loads((tmp_path / "diagnosis.json").read_text())
    assert data["calibrated"]["Km_1"]["nominal"] == 0.0 and data["calibrated"]["Km_1"]["value"] > 5e-11
    assert found.verdict == "calibration" and "Km_1 from 0" in found.summary()
    assert "from 0" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    "problem", [ZeroDivisionError("by zero"), ModuleNotFoundError("No module named 'jinja2'")]
)
def test_a_page_that_fails_costs_only_the_page(tmp_path: Path, problem: Exception) -> None:
    def report(path: Path) -> None:
        raise problem

    model = load_model("paper")
    found: Any = SimpleNamespace(
        report=report, as_dict=lambda: {"verdict": "none"}, next_experiment=None, model=model
    )
    (tmp_path / "report.html").write_text("of an earlier run")
    with pytest.warns(InputWarning, match=r"report\.html could not be made: .*(by zero|jinja2)"):
        command.write(found, tmp_path)
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == {"verdict": "none"}
    assert load_model(tmp_path / "model.yaml").channels == model.channels
    assert "could not be made" in (tmp_path / "report.html").read_text()


def _logged(path: Path, command: np.ndarray, seed: int, **values: float) -> Path:
    """A log of the paper's rig with some values changed: 500 Hz, current, pressure and speed with noise."""
    rng, period = np.random.default_rng(seed), 0.002
    model = load_model("paper").with_values(values)
    found = simulate(model, command, None, period, record=["current", "pressure", "speed"])
    columns, names = [np.arange(len(command)) * period], ["time_s"]
    for c in (0, 1):
        columns += [command[:, c]]
        columns += [found["current"][:, 0, c] + 2e-3 * rng.standard_normal(len(command))]
        columns += [found["pressure"][:, 0, c] / BAR + 0.05 * rng.standard_normal(len(command))]
        columns += [found["speed"][:, 0, c] / RPM + rng.standard_normal(len(command))]
        names += [f"command_{c + 1}_V", f"current_{c + 1}_A", f"pressure_{c + 1}_bar", f"speed_{c + 1}_rpm"]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.6g")
    return path


def _steps(seed: int, rows: int = 2000) -> np.ndarray:
    steps = np.random.default_rng(seed).uniform(-35.0, 35.0, (rows // 125, 2))
    steps[0] = 0.0
    return np.repeat(steps, 125, axis=0)


def _page(found: Diagnosis) -> str:
    """The report with single spaces."""
    return " ".join(report_page(found).split())


def test_logs_of_a_constant_command_determine_no_parameters(tmp_path: Path) -> None:
    still = np.full((1500, 2), 25.0)
    fit, held_out = (_logged(tmp_path / f"{n}.csv", still, n, J=0.003, R=104.0) for n in (1, 2))
    found = diagnose([fit], [held_out])
    text = found.summary()
    assert found.verdict == "calibration" and "These logs do not determine the known parameters" in text
    assert "command of channel 1 is constant" in text
    assert "still missing" not in text and "is enough" not in text
    assert "Do not use the calibrated values" in _page(found)


def test_held_out_logs_of_a_hotter_coil_are_of_another_state(tmp_path: Path) -> None:
    fit = _logged(tmp_path / "fit.csv", _steps(1), 1, J=0.003, R=104.0)
    same = _logged(tmp_path / "same.csv", _steps(2), 2, J=0.003, R=104.0)
    hot = _logged(tmp_path / "hot.csv", _steps(2), 2, J=0.003, R=118.0)
    for held_out, said in ((same, False), (hot, True)):
        found = diagnose([fit], [held_out])
        text = found.summary()
        assert found.verdict == "calibration" and "still missing" not in text
        assert ("seem to be of another rig or state: the coil current of channel 1" in text) == said
        assert ("Calibration is enough" in text) != said
        assert ("same rig, valves and temperature" in _page(found)) == said


@pytest.mark.parametrize(
    ("what", "owner"),
    [
        ({"dead_zone.overlap_positive": 8e-5, "dead_zone.overlap_negative": 8e-5}, "valve_flow"),
        ({"supply_droop.relative_drop": 0.3, "supply_droop.time_constant": 0.05}, "valve_flow"),
        ({"motor_coulomb_friction.coulomb": 0.3}, "shaft"),
    ],
)
def test_what_is_missing_is_located_where_it_is(tmp_path: Path, what: dict[str, float], owner: str) -> None:
    """Calibration has moved the shaft's parameters to make up for a valve; the shaft is not blamed for it."""
    log = _logged(tmp_path / "fit.csv", _steps(3, 3000), 1, J=0.003, D=1.42e-6, **what)
    rig = DynamicRig(load_model("paper"), read_parts([log], None))
    fit = Fit(rig, {(c, s.signal): 1e-3 for c in rig.channels for s in rig.segments[c]})
    fit = Fit(rig, noise_of(rig, as_given(fit)))
    places = locate(rig, calibrate(fit, 4))
    for c in rig.channels:
        first = next(p for p in places if p.channel == c)
        assert first.equation == owner and first.share > 0.8


def test_the_time_of_a_filter_that_is_calculated_once_a_row_is_in_its_interval(tmp_path: Path) -> None:
    """y += (1 - exp(-row / T)) (x - y) is late by T - row / 2: the two cannot be told apart by the rows."""
    true, row = 0.006, 0.002
    keep = float(np.exp(-row / true))
    log = _logged(tmp_path / "fit.csv", _steps(3), 1)
    table = np.loadtxt(log, delimiter=",", skiprows=1)
    for column in (4, 8):
        table[:, column] = lfilter([1.0 - keep], [1.0, -keep], table[:, column])
    head = log.read_text().splitlines()[0]
    np.savetxt(log, table, delimiter=",", header=head, comments="", fmt="%.6g")
    rig = DynamicRig(load_model("paper"), read_parts([log], None))
    estimate = Estimate(0, [], np.zeros(0)).with_effect("sensor_lag", {"time_constant": 0.02})
    noise = {"speed": 0.1 * RPM}
    fit = Fit(rig, {(c, s.signal): noise.get(s.signal, 1e9) for c in rig.channels for s in rig.segments[c]})
    solve(fit, [estimate], 12)
    found = effect_values({0: estimate}, "sensor_lag", 0)["time_constant"]
    assert found.value == pytest.approx(true - 0.5 * row, abs=0.1 * row)
    wide = widened_by_form(CATALOGUE["sensor_lag"], "time_constant", found, found, row)
    assert wide.low < true < wide.high and wide.high - wide.low < 2.0 * row


def test_the_command_ends_well_without_its_page(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(found: object) -> str:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr("hydro_env.diagnosis.report.page.report_page", broken)
    words = [
        "diagnose",
        f"{logs}/fit_1.csv",
        "--sealed",
        f"{logs}/sealed.csv",
        "--out",
        str(tmp_path / "out"),
    ]
    assert run(words) == 0
    out, err = capsys.readouterr()
    (line,) = [line for line in err.splitlines() if line.startswith("warning:")]
    assert "report.html could not be made" in line and "results beside it are complete" in line
    assert out.startswith("verdict: ") and {"diagnosis.json", "model.yaml"} <= set(
        os.listdir(tmp_path / "out")
    )


@pytest.fixture
def often_switched() -> Iterator[None]:
    """Threads that take turns as often as they can."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


def test_threads_may_ask_for_new_inputs_at_the_same_time(logs: Path, often_switched: None) -> None:
    """Many short parts of a log, in ever other combinations, so that threads keep new inputs all the time."""
    parts = read_parts([f"{logs}/fit_1.csv@{0.04 * n:.2f}:{0.04 * n + 0.1:.2f}" for n in range(60)], None)
    rig = DynamicRig(load_model("paper"), parts, jobs=8)
    for count in range(1, 31):
        rig.predict([Request(c, {"Kq": 0.3 + 0.001 * n}) for n in range(count) for c in (0, 1)])
