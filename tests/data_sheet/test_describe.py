"""A model from data sheets does on the simulated plant what the sheets say, and says what was assumed."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_env import cli
from hydro_env.data_sheet import DataSheet, Described, describe, read_sheet, template
from hydro_env.diagnosis import estimate
from hydro_env.errors import InputError
from hydro_env.plant import load_model, simulate
from hydro_env.plant.model_files import sources_of
from hydro_env.units import BAR, RPM
from hydro_env.validation import checked

SHEETS = sorted((Path(__file__).parents[2] / "configs" / "data_sheets").glob("*.yaml"))
LEAST: dict[str, Any] = {
    "valve": {"rated_flow_lpm": 16, "at_pressure_drop_bar": 10, "rated_command_V": 10},
    "motor": {"displacement_cm3": 16},
    "supply": {"pressure_bar": 100},
}


def made(**changes: dict[str, Any]) -> Described:
    """What the least sheet describes, with more in its tables."""
    tables = {name: {**LEAST.get(name, {}), **changes.get(name, {})} for name in {**LEAST, **changes}}
    return describe(checked(DataSheet, {"schema": DataSheet.FORMAT, **tables}, "sheet"))


@pytest.fixture(scope="module")
def least() -> Described:
    return made()


@pytest.mark.parametrize("sheet", SHEETS, ids=lambda path: path.stem)
def test_simulated_data_sheet_is_the_given_one(sheet: Path) -> None:
    found = describe(read_sheet(sheet))
    compared = [figure for figure in found.figures if figure.given is not None]
    assert {"rated_flow_lpm", "hysteresis_percent", "step_response_ms"} <= {figure.key for figure in compared}
    assert not [figure for figure in compared if figure.marked]


def test_command_writes_a_model_that_loads_without_a_word(tmp_path: Path) -> None:
    assert cli.run(["describe", str(SHEETS[0]), "--out", str(tmp_path / "rig")]) == 0
    written = tmp_path / "rig" / "model.yaml"
    with warnings.catch_warnings(action="error"):
        model, sources = load_model(written), sources_of(written)
    assert {*sources} == {(name, c) for name in model.values for c in (0, 1)}
    assert not [text for text in sources.values() if "does not say" in text]
    assert load_model(model.to_dict("itself")) == model and model.ranges
    data = json.loads((tmp_path / "rig" / "describe.json").read_text(encoding="utf-8"))
    assert data["schema"] == "hydro_env/describe/1" and data["assumptions"]


def test_a_sheet_of_no_model_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = SHEETS[0].read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        re.sub(r"rated_flow_lpm: \S+", "rated_flow_lpm: 90000", text), encoding="utf-8"
    )
    assert cli.run(["describe", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "rig")]) == 2
    assert "rig.yaml: no model has these values" in capsys.readouterr().err


def test_least_sheet_is_enough_and_what_it_lacks_is_said(least: Described) -> None:
    keys = {row.key for row in least.assumptions}
    assert {"dead_band_percent", "hysteresis_percent", "inertia_kgm2", "edges", "bore_mm"} <= keys
    by_key = {row.key: row for row in least.assumptions}
    assert "J" in by_key["inertia_kgm2"].parameters
    low, high = least.model.ranges["J"]
    assert low < 0.3 * least.model.value("J", 0) and high > 3.0 * least.model.value("J", 0)


def test_what_the_sheet_gives_is_no_assumption(least: Described) -> None:
    told = made(
        motor={"inertia_kgm2": 0.01},
        valve={"pressure_drop_over": "edge", "rated_command_mA": 800, "coil_resistance_Ohm": 12.5},
    )
    assert told.model.pair("J") == (0.01, 0.01) and "J" not in told.model.ranges
    assert told.model.value("R", 0) == pytest.approx(12.5)
    assert told.model.value("Kq", 0) == pytest.approx(least.model.value("Kq", 0) / 2**0.5, rel=0.01)


def test_figures_that_no_spool_has_together_are_marked() -> None:
    found = made(valve={"step_response_ms": 80, "frequency_minus_90_deg_Hz": 60})
    assert {figure.key for figure in found.figures if figure.marked} >= {"frequency_minus_90_deg_Hz"}


def test_second_valve_is_its_own() -> None:
    found = made(valve_2={**LEAST["valve"], "rated_flow_lpm": 8, "dead_band_percent": 3})
    flows = [figure.simulated for figure in found.figures if figure.key == "rated_flow_lpm"]
    assert flows == pytest.approx([16.0, 8.0], rel=0.02)
    one, two = found.model.pair("dead_zone.overlap_positive")
    assert one > 3.0 * two


@pytest.mark.parametrize(
    ("table", "wrong", "said"),
    [
        ("valve", {"dead_band_percent": 60}, "valve.dead_band_percent is 60"),
        ("valve", {"dead_band_percnt": 5}, "did you mean 'dead_band_percent'"),
        ("valve", {"rated_flow": 5}, "did you mean 'rated_flow_lpm'"),
        ("valve", {"rated_flow_lpm": "16 l/min"}, "valve.rated_flow_lpm is '16 l/min'"),
        ("valve", {"rated_command_V": None}, "rated_command_V or rated_command_mA is missing"),
        ("valve", {"rated_command_mA": 1000, "coil_resistance_Ohm": 100}, "1000 mA through 100 Ohm"),
        ("motor", {"volumetric_efficiency_percent": 110}, "motor.volumetric_efficiency_percent is 110"),
        ("motor", {"displacement_cm3": 0.032}, "motor.displacement_cm3 is 0.032"),
        ("supply", {"pressure_bar": 14000}, "supply.pressure_bar is 14000"),
        ("supply", {"relief_bar": 50}, "below the supply pressure"),
    ],
)  # fmt: skip
def test_wrong_sheet_is_one_line(table: str, wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as refused:
        made(**{table: wrong})
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_template_has_every_key_and_is_read_when_filled_in() -> None:
    text = template()
    for key in ("hysteresis_percent", "starting_torque_Nm", "crossport_relief_bar", "bulk_modulus_bar"):
        assert f"# {key}:" in text
    filled = text.replace("rated_flow_lpm:", "rated_flow_lpm: 16").replace("drop_bar:", "drop_bar: 10")
    filled = filled.replace("displacement_cm3:", "displacement_cm3: 16").replace(
        "  pressure_bar:", "  pressure_bar: 100"
    )
    filled = filled.replace("# rated_command_V:", "rated_command_V: 10")
    checked(DataSheet, yaml.safe_load(filled), "template")


def test_questions_need_a_terminal_and_end_in_a_sheet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["describe", "--out", str(tmp_path / "rig")]) == 2
    assert "questions need a terminal" in capsys.readouterr().err
    known = {"rated flow": ["", "16 l/min", "16"], "at which that is the flow": ["10"], "rated command, V": ["", "10"],
             "displacement": ["16"], "supply pressure": ["100"]}  # fmt: skip
    answers: dict[str, Iterator[str]] = {text: chain(given, repeat("")) for text, given in known.items()}
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr(
        "builtins.input",
        lambda asked: next((next(given) for text, given in answers.items() if text in asked), ""),
    )
    assert cli.run(["describe", "--out", str(tmp_path / "rig")]) == 0
    said = capsys.readouterr().out
    assert said.count("an answer is needed") == said.count("once more") == 1
    again = read_sheet(tmp_path / "rig" / "data_sheet.yaml")
    assert again.valve.rated_flow_lpm == 16 and again.motor.inertia_kgm2 is None


def test_calibration_keeps_to_the_ranges_of_a_described_model(least: Described, tmp_path: Path) -> None:
    given = least.model
    true = given.with_values({"J": 2.8 * given.value("J", 0)})
    time = np.arange(0.0, 6.0, 0.005)
    command = np.repeat(10.0 * np.sign(np.sin(2.0 * np.pi * time / 3.0))[:, None], 2, axis=1)
    out = simulate(true, command, None, 0.005, record=("speed", "pressure"))
    noise = np.random.default_rng(1)
    log = tmp_path / "log.csv"
    columns = [time, command[:, 0], out["speed"][:, 0, 0] / RPM + noise.normal(size=len(time)),
               out["pressure"][:, 0, 0] / BAR + 0.1 * noise.normal(size=len(time))]  # fmt: skip
    np.savetxt(
        log,
        np.column_stack(columns),
        "%.6g",
        ",",
        header="time_s,command_1_V,speed_1_rpm,pressure_1_bar",
        comments="",
    )
    found = estimate([log], given, parameters=["J"])
    assert found.parameters["J_1"].estimate.value == pytest.approx(true.value("J", 0), rel=0.03)
    narrow = replace(given, ranges={"J": (0.9 * given.value("J", 0), 1.1 * given.value("J", 0))})
    kept = estimate([log], narrow, parameters=["J"])
    assert kept.parameters["J_1"].estimate.value <= 1.1001 * given.value("J", 0)
