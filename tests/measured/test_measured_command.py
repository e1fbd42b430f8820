"""Foreign and spoilt logs through the command line: what is wrong is named in one line, or handled and said.

The logs are those of the compiled plant, with noise; each test spoils one the way that recordings are spoilt.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_env import cli
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.errors import InputError
from hydro_env.measured import read_log
from hydro_env.plant import load_model, simulate
from hydro_env.practice.generate import make_practice
from hydro_env.units import BAR, RPM

Columns = dict[str, np.ndarray]
MISTAKES: dict[str, tuple[Callable[[Columns], None], list[str]]] = {}


def _drive(seed: int, rows: int) -> np.ndarray:
    """Commands (T, 2) in V: rest, then other steps and sines on each channel."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) * 1e-3
    steps = np.repeat(rng.uniform(-45, 45, (rows // 400 + 1, 2)), 400, axis=0)[:rows]
    waves = np.column_stack([15 * np.sin(2 * np.pi * f * time + seed) for f in (0.9, 1.7)])
    command = np.round((steps + waves)[::10].repeat(10, axis=0)[:rows], 3)
    command[:300] = 0.0
    return command


def _log(seed: int, rows: int = 5000, load_Nm: np.ndarray | None = None) -> Columns:
    command = _drive(seed, rows)
    out = simulate(
        load_model("paper_dead_zone"),
        command,
        load_Nm,
        1e-3,
        record=("current", "pressure", "measured_speed"),
    )
    rng = np.random.default_rng(seed)
    columns: Columns = {"time_s": np.round(np.arange(rows) * 1e-3, 6)}
    for c in (0, 1):
        columns[f"command_{c + 1}_V"] = command[:, c]
        columns[f"current_{c + 1}_A"] = np.round(out["current"][:, 0, c] + 2e-3 * rng.normal(size=rows), 4)
        columns[f"pressure_{c + 1}_bar"] = np.round(
            out["pressure"][:, 0, c] / BAR + 0.05 * rng.normal(size=rows), 3
        )
        columns[f"speed_{c + 1}_rpm"] = np.round(
            out["measured_speed"][:, 0, c] / RPM + rng.normal(size=rows), 2
        )
    return columns


@pytest.fixture(scope="session")
def recorded() -> tuple[Columns, Columns]:
    """A log to fit and one to seal."""
    return _log(1), _log(2)


def _copy(columns: Columns) -> Columns:
    return {name: values.copy() for name, values in columns.items()}


def _save(path: Path, columns: Columns, separator: str = ",", decimal: str = ".", head: str = "") -> Path:
    rows = np.column_stack(list(columns.values()))
    lines = [
        separator.join("" if np.isnan(v) else f"{v:.12g}".replace(".", decimal) for v in row) for row in rows
    ]
    path.write_text(head + separator.join(columns) + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def _hydro_env(*words: object) -> tuple[int, str]:
    """Exit status and all that is printed."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.raises(SystemExit) as ended, redirect_stdout(out), redirect_stderr(err):
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0), out.getvalue() + err.getvalue()


def _inspected(path: Path, *extra: object) -> str:
    status, text = _hydro_env("diagnose", "--inspect", path, *extra, "--out", path.parent / "inspected")
    assert status == 0, text
    return text


def _refused(path: Path, sealed: Path, *extra: object) -> str:
    """The one line with which `diagnose` refuses a log."""
    out = path.parent / "out"
    status, text = _hydro_env("diagnose", path, "--sealed", sealed, *extra, "--out", out)
    assert status == 2, text
    assert not out.exists()
    lines = [line for line in text.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1 and str(path) in lines[0], text
    return lines[0]


# --- what cannot go on: one line that names file, row or column, and what would be right


def mistake(*words: str) -> Callable[[Callable[[Columns], None]], Callable[[Columns], None]]:
    def keep(spoil: Callable[[Columns], None]) -> Callable[[Columns], None]:
        MISTAKES[spoil.__name__] = spoil, list(words)
        return spoil

    return keep


@mistake("row 2502", "'time_s'", "runs backwards", "split the log there")
def clock_jumps_back(columns: Columns) -> None:
    columns["time_s"][2500:] -= 0.8


@mistake("row 2502", "'time_s'", "jumps by", "split the log there")
def clock_jumps_forward(columns: Columns) -> None:
    columns["time_s"][2500:] += 600.0


@mistake("row 13", "'time_s'", "4491 rows repeat the time", "write more digits")
def clock_too_coarse(columns: Columns) -> None:
    columns["time_s"] = np.floor(columns["time_s"] * 100) / 100
    columns["time_s"][:10] = np.arange(10) * 1e-3


@mistake("row 1002", "'time_s'", "no time", "delete the row")
def clock_with_a_hole(columns: Columns) -> None:
    columns["time_s"][1000] = np.nan


@mistake("'time_s'", "rows come every 1 s", "is 'time_s' in ms")
def clock_in_ms(columns: Columns) -> None:
    columns["time_s"] *= 1000


@mistake("swapped", "exchange the speed columns")
def motors_swapped(columns: Columns) -> None:
    columns["speed_1_rpm"], columns["speed_2_rpm"] = columns["speed_2_rpm"], columns["speed_1_rpm"]


@mistake("drives the shaft of the other one", "swapped", "exchange the columns of")
def pressures_swapped(columns: Columns) -> None:
    columns["pressure_1_bar"], columns["pressure_2_bar"] = (
        columns["pressure_2_bar"],
        columns["pressure_1_bar"],
    )


@mistake("'speed_2_rpm'", "channel 2 falls when its command rises", "`sign: -1` for the speed")
def speed_of_the_other_sign(columns: Columns) -> None:
    columns["speed_2_rpm"] *= -1


@mistake("'command_1_V'", "current and speed of channel 1 fall", "`sign: -1` for the command")
def command_of_the_other_sign(columns: Columns) -> None:
    columns["command_1_V"] *= -1


@mistake("'current_2_A'", "current of channel 2 falls when its command rises", "`sign: -1`")
def current_of_the_other_sign(columns: Columns) -> None:
    columns["current_2_A"] *= -1


@mistake("pressure of channel 1", "mirror image", "`sign: -1`")
def pressure_of_the_other_sign(columns: Columns) -> None:
    columns["pressure_1_bar"] *= -1


@mistake("'pressure_1_bar'", "bar", "is it in kPa")
def kilopascal_called_bar(columns: Columns) -> None:
    columns["pressure_1_bar"] *= 100


@mistake("'pressure_2_bar' (read as bar)", "pressure of channel 2", "is it in psi")
def psi_called_bar(columns: Columns) -> None:
    columns["pressure_2_bar"] *= 14.504


@mistake("'speed_1_rpm' (read as rpm)", "speed of channel 1", "is it in rad/s")
def radians_called_rpm(columns: Columns) -> None:
    columns["speed_1_rpm"] *= RPM


@mistake("'pressure_2_bar' (read as bar)", "is it in MPa")
def megapascal_called_bar(columns: Columns) -> None:
    columns["pressure_2_bar"] /= 10


@mistake("the currents are 0.73 times", "in percent")
def percent_called_volt(columns: Columns) -> None:
    for c in (1, 2):
        columns[f"command_{c}_V"] /= 0.73


@mistake("the currents are 73 times", "a fraction of full command")
def fraction_called_volt(columns: Columns) -> None:
    for c in (1, 2):
        columns[f"command_{c}_V"] /= 73


@mistake("'current_1_A'", "is it in mA")
def milliampere_called_ampere(columns: Columns) -> None:
    columns["current_1_A"] *= 1000


@mistake("'speed_1_rpm'", "is empty", "required")
def speed_never_recorded(columns: Columns) -> None:
    columns["speed_1_rpm"][:] = np.nan


@mistake("'speed_2_rpm' is constant", "look at the sensor")
def speed_frozen(columns: Columns) -> None:
    columns["speed_2_rpm"][:] = 120.0


@mistake("the command of channel 1 is zero throughout", "record the signal that drives the valve")
def command_never_recorded(columns: Columns) -> None:
    columns["command_1_V"][:] = 0.0


@pytest.mark.parametrize("name", list(MISTAKES))
def test_a_log_that_is_surely_wrong_is_refused(
    tmp_path: Path, recorded: tuple[Columns, Columns], name: str
) -> None:
    columns = _copy(recorded[0])
    spoil, words = MISTAKES[name]
    spoil(columns)
    path, sealed = _save(tmp_path / "fit.csv", columns), _save(tmp_path / "sealed.csv", recorded[1])
    line = _refused(path, sealed)
    for word in words:
        assert word in line, line


def test_a_load_of_the_other_sign(tmp_path: Path) -> None:
    load = 0.02 * np.round(_drive(9, 5000))  # N m, changes every 400 rows
    fit, sealed = _log(1, load_Nm=load), _log(2, load_Nm=load)
    for columns in (fit, sealed):
        columns["load_1_Nm"], columns["load_2_Nm"] = load[:, 0], -load[:, 1]
    status, text = _hydro_env(
        "diagnose",
        _save(tmp_path / "fit.csv", fit),
        "--sealed",
        _save(tmp_path / "sealed.csv", sealed),
        "--out",
        tmp_path,
    )
    assert status == 2 and "the shaft of channel 2 turns as if its load had the other sign" in text, text
    assert "`sign: -1` for the load" in text and "channel 1" not in text


def test_rpm_that_a_mapping_calls_radians(tmp_path: Path, recorded: tuple[Columns, Columns]) -> None:
    mapping = _mapping(tmp_path)
    logs = [_foreign(log) for log in recorded]
    for log in logs:
        log["n_left"] /= RPM
    path, sealed = (_save(tmp_path / f"{n}.csv", log) for n, log in enumerate(logs))
    line = _refused(path, sealed, "--mapping", mapping, "--model", "paper_dead_zone")
    assert "'n_left' (read as rad/s) is 9.55 times the model's speed of channel 1: is it in rpm?" in line


def test_sensors_exchanged_in_closed_loop(tmp_path: Path) -> None:
    """Both motors follow one set-point, so each speed is like the other's: only the shaft tells."""
    practice = make_practice(["dead_zone:1"], duration=6.0, runs=("fit_2",), seed=4)
    sealed = tmp_path / "sealed.csv"
    for signal in ("speed", "pressure", "current"):
        columns = {name: values.copy() for name, values in practice.logs["fit_2"].items()}
        _save(sealed, columns)
        one, two = (next(n for n in columns if n.startswith(f"{signal}_{c}")) for c in (1, 2))
        columns[one], columns[two] = columns[two], columns[one]
        line = _refused(_save(tmp_path / "fit.csv", columns), sealed)
        assert "swapped" in line and signal in line.split("exchange the")[1], line


def test_a_refused_log_that_is_right_can_be_accepted(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    columns, other = _copy(recorded[0]), _copy(recorded[1])
    for log in (columns, other):
        speed_of_the_other_sign(log)
    path, sealed = (
        _save(tmp_path / "fit.csv", _coarse(columns)),
        _save(tmp_path / "sealed.csv", _coarse(other)),
    )
    assert "--accept sign" in _refused(path, sealed, "--steady")
    status, text = _hydro_env(
        "diagnose", path, "--sealed", sealed, "--steady", "--accept", "sign", "--out", tmp_path / "out"
    )
    assert status == 0
    assert any("falls when its command rises" in w for w in _diagnosis(tmp_path / "out")["warnings"]), text


def test_a_part_on_one_side_of_a_clock_jump_can_be_used(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    columns = _coarse(recorded[0])
    columns["time_s"][250:] += 600.0
    path = _save(tmp_path / "fit.csv", columns)
    assert "jumps by" in _refused(path, path, "--steady")
    status, text = _hydro_env(
        "diagnose", f"{path}@0:2.5", "--sealed", f"{path}@602.5:", "--steady", "--out", tmp_path / "out"
    )
    assert status == 0, text


def test_a_channel_that_rests_is_left_out(tmp_path: Path, recorded: tuple[Columns, Columns]) -> None:
    """Many test one axis at a time, with the other one's columns in the log."""
    logs = [_coarse(log) for log in recorded]
    for log in logs:
        log["command_2_V"][:] = 0.0
        log["speed_2_rpm"] = np.random.default_rng(0).normal(size=len(log["time_s"]))
    path, sealed = (_save(tmp_path / f"{n}.csv", log) for n, log in enumerate(logs))
    status, text = _hydro_env("diagnose", path, "--sealed", sealed, "--steady", "--out", tmp_path / "out")
    assert status == 0 and "channel 2 was neither driven nor did it move" in text, text
    assert list(_diagnosis(tmp_path / "out")["gap"]["sealed"]) == ["speed_1_rpm"]


def test_a_signal_that_only_some_fit_logs_have_counts_there(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    names = [n for n in recorded[0] if "_2" not in n]
    one, two = ({n: v for n, v in _coarse(log).items() if n in names} for log in recorded)
    sealed = _save(tmp_path / "sealed.csv", two)
    first = _save(tmp_path / "first.csv", one)
    del two["pressure_1_bar"]
    two["speed_1_rpm"] = two["speed_1_rpm"] + 0.01  # another file than the sealed one
    second = _save(tmp_path / "second.csv", two)
    status, text = _hydro_env(
        "diagnose", first, second, "--sealed", f"{sealed}@1:", "--steady", "--out", tmp_path / "out"
    )
    assert status == 0, text
    rig = DynamicRig(load_model("paper"), read_parts([first, second], None))
    assert [s.signal for s in rig.segments[0]] == ["speed", "current", "pressure", "speed", "current"]


# --- what is handled, and said


def _coarse(columns: Columns) -> Columns:
    """The same log at 100 Hz, which the steady model takes in a second."""
    return {name: values[::10].copy() for name, values in columns.items()}


def _diagnosis(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "diagnosis.json").read_text()))


def gap(columns: Columns) -> Columns:
    keep = (columns["time_s"] < 2.0) | (columns["time_s"] > 2.4)
    return {name: values[keep] for name, values in columns.items()}


def uneven(columns: Columns) -> Columns:
    jitter = np.random.default_rng(0).uniform(0, 4e-4, len(columns["time_s"]))
    return columns | {"time_s": columns["time_s"] + jitter}


def duplicate_rows(columns: Columns) -> Columns:
    return {
        name: np.repeat(values, 1 + (np.arange(len(values)) % 7 == 0)) for name, values in columns.items()
    }


def stuck_speed(columns: Columns) -> Columns:
    columns["speed_1_rpm"][2100:2900] = columns["speed_1_rpm"][2100]
    return columns


def dead_speed(columns: Columns) -> Columns:
    columns["speed_1_rpm"][2100:2900] = 0.0
    return columns


def saturated_pressure(columns: Columns) -> Columns:
    limit = np.quantile(columns["pressure_2_bar"], 0.97)
    columns["pressure_2_bar"] = np.minimum(columns["pressure_2_bar"], limit)
    return columns


def constant_current(columns: Columns) -> Columns:
    columns["current_2_A"][:] = 0.25
    return columns


def blank_cells(columns: Columns) -> Columns:
    columns["speed_2_rpm"][::9] = np.nan
    return columns


def blank_commands(columns: Columns) -> Columns:
    columns["command_1_V"][np.arange(len(columns["time_s"])) % 10 != 0] = np.nan  # told when it changes
    return columns


def disturbed_speed(columns: Columns) -> Columns:
    time = columns["time_s"]
    for name in ("command_1_V", "command_2_V"):
        columns[name][:] = np.where(time < 1.5, columns[name], columns[name][1500])
    columns["pressure_1_bar"] = 0.05 * np.random.default_rng(3).normal(size=len(time))
    columns["speed_1_rpm"] = columns["speed_1_rpm"][1500] + np.random.default_rng(4).normal(size=len(time))
    columns["speed_1_rpm"] += np.where((time > 2.0) & (time < 4.2), 60 * np.sin(2 * np.pi * 23 * time), 0.0)
    return columns | {"time_s": 2.0 * time}


def clock_of_dates(columns: Columns) -> Columns:
    return columns  # written by the test


def coarse_speed(columns: Columns) -> Columns:
    return columns | {"speed_1_rpm": 25.0 * np.round(columns["speed_1_rpm"] / 25.0)}


def percent_commands(columns: Columns) -> Columns:
    return columns | {
        f"command_{c}_V": 100.0 * columns[f"command_{c}_V"] / np.abs(columns[f"command_{c}_V"]).max()
        for c in (1, 2)
    }


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (gap, ["1 gap in 'time_s'", "0.402 s after 1.999 s", "row 2002", "counts for nothing"]),
        (uneven, ["unevenly spaced", "commands are held from their own times on"]),
        (duplicate_rows, ["715 rows are copies of the row before", "row 3", "dropped"]),
        (stuck_speed, ["'speed_1_rpm' repeats the value", "for 0.8 s from 2.1 s", "row 2102", "left out"]),
        (dead_speed, ["'speed_1_rpm' repeats the value 0 rpm for 0.8 s", "left out of every comparison"]),
        (saturated_pressure, ["'pressure_2_bar' stays at its largest value", "left out of every comparison"]),
        (constant_current, ["'current_2_A' is constant (0.25 A)", "taken as absent"]),
        (clock_of_dates, ["read as seconds", "counted from the first row", "at 1000 Hz"]),
        (blank_cells, ["'speed_2_rpm' holds no value in 556 of 5000 cells", "row 2", "left out"]),
        (blank_commands, ["'command_1_V' holds no value in 4500 of 5000 cells", "the value before is held"]),
        (disturbed_speed, ["'speed_1_rpm' shakes at about 12 Hz", "the sensor is disturbed", "left out"]),
        (coarse_speed, ["'speed_1_rpm' has only", "finer resolution"]),
        (percent_commands, ["'command_1_V' peaks at 100 V", "is it in percent"]),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)  # fmt: skip
def test_what_is_handled_is_said(
    tmp_path: Path, recorded: tuple[Columns, Columns], spoil: Callable[[Columns], Columns], words: list[str]
) -> None:
    path = _save(tmp_path / "log.csv", spoil(_copy(recorded[0])))
    if spoil is clock_of_dates:
        start = datetime(2024, 2, 29, 23, 59, 58)
        head, *lines = path.read_text().splitlines()
        rows = [
            (start + timedelta(milliseconds=n)).isoformat(" ", "milliseconds") + line[line.index(",") :]
            for n, line in enumerate(lines)
        ]
        path.write_text("\n".join([head, *rows]) + "\n")
    text = _inspected(path)
    for word in words:
        assert word in text, text
    assert "wrong:" not in text


def test_a_clean_log_has_no_remark(tmp_path: Path, recorded: tuple[Columns, Columns]) -> None:
    for number, columns in enumerate(recorded):
        assert "nothing suspicious found" in _inspected(_save(tmp_path / f"{number}.csv", columns))


def test_a_log_with_many_small_faults_is_diagnosed_and_each_is_said(tmp_path: Path) -> None:
    """Semicolons, decimal commas, BOM, a row of units, blanks, copies, a gap and a stuck sensor; the truth is still found."""
    path, sealed = (
        _axis(tmp_path / f"{name}.csv", seed, seed == 1) for name, seed in (("fit", 1), ("sealed", 2))
    )
    status, text = _hydro_env("diagnose", path, "--sealed", sealed, "--steady", "--out", tmp_path / "out")
    assert status == 0, text
    data = _diagnosis(tmp_path / "out")
    assert [e["name"] for e in data["effects"]] == ["dead_zone"], text
    said = " ".join(data["warnings"])
    page = (tmp_path / "out" / "report.html").read_text()
    for word in (
        "separated by ';'", "decimal comma", "row 2 holds units", "holds no value", "copies of the row before", "1 gap",
        "repeats the value",
    ):  # fmt: skip
        assert word in said and word.replace("'", "&#39;") in page, said


def _axis(path: Path, seed: int, spoilt: bool) -> Path:
    """30 s of one motor behind a dead zone at 100 Hz, as a German spreadsheet writes it; with faults if `spoilt`."""
    rng = np.random.default_rng(seed)
    time = np.arange(3000) * 0.01
    command = 25 * np.sin(0.5 * time) + 18 * np.sin(1.3 * time + seed)
    command += 15 * np.repeat(rng.uniform(-1, 1, 21), 150)[:3000]
    command[:100] = 0.0
    speed, state = np.empty(3000), 0.0
    for n, target in enumerate(12.0 * (command - np.clip(command, -9.0, 5.0))):
        speed[n] = state
        state += (target - state) * (1.0 - np.exp(-0.01 / 0.1))
    speed += rng.normal(size=3000)
    columns = {"time_s": time, "command_1_V": np.round(command, 4), "speed_1_rpm": np.round(speed, 3)}
    if spoilt:
        columns["speed_1_rpm"][700:800] = columns["speed_1_rpm"][700]
        columns["speed_1_rpm"][1200:1210] = np.nan
        keep = np.repeat(np.arange(3000), np.where(np.arange(3000) == 400, 2, 1))
        keep = keep[(keep < 2000) | (keep > 2030)]
        columns = {name: values[keep] for name, values in columns.items()}
    _save(path, columns, ";", ",", head="\ufeff")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], "s;V;rpm", *lines[1:]]) + "\n")
    return path


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    start=st.integers(400, 3800), length=st.integers(500, 1000), channel=st.sampled_from([1, 2]),
    signal=st.sampled_from(["speed", "current", "pressure"]),
)  # fmt: skip
def test_a_sensor_that_sticks_anywhere_is_found_in_its_place(
    tmp_path: Path, recorded: tuple[Columns, Columns], start: int, length: int, channel: int, signal: str
) -> None:
    columns = _copy(recorded[0])
    name = next(n for n in columns if n.startswith(f"{signal}_{channel}"))
    columns[name][start : start + length] = columns[name][start]
    log = read_log(_save(tmp_path / "log.csv", columns))
    found = [f for f in log.findings if f.code == "stuck"]
    assert [f.column for f in found] == [name]
    values = log.get(signal)
    assert values is not None and np.isnan(values[start + 2 : start + length, channel - 1]).all()
    assert abs((found[0].row or 0) - start - 2) <= 2
    assert np.isfinite(values[: start - 2, channel - 1]).all()


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.integers(10, 4990), size=st.floats(0.002, 9.9) | st.floats(10.1, 1e4), back=st.booleans())
def test_a_jump_of_the_clock_is_named_in_its_row(
    tmp_path: Path, recorded: tuple[Columns, Columns], at: int, size: float, back: bool
) -> None:
    columns = _copy(recorded[0])
    columns["time_s"][at:] += -size if back else size
    path = _save(tmp_path / "log.csv", columns)
    if back:
        with pytest.raises(InputError, match=f"row {at + 2}, column 'time_s': time runs backwards"):
            read_log(path)
        return
    found = [f for f in read_log(path).findings if f.code in ("gap", "clock_jump")]
    assert [f.row for f in found] == [at + 2]
    assert found[0].sure is (size > 10.0)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    separator=st.sampled_from([",", ";", "\t", "|"]), comma=st.booleans(), bom=st.booleans(), end=st.sampled_from(["\n", "\r\n"]),
    units=st.booleans(), blank_lines=st.booleans(), encoding=st.sampled_from(["utf-8", "utf-16"]),
)  # fmt: skip
def test_every_spelling_of_a_csv_reads_the_same(
    tmp_path: Path, recorded: tuple[Columns, Columns], separator: str, comma: bool, bom: bool, end: str, units: bool,
    blank_lines: bool, encoding: str,
) -> None:  # fmt: skip
    columns = {name: values[:200] for name, values in recorded[0].items()}
    decimal = "," if comma and separator != "," else "."
    text = _save(tmp_path / "log.csv", columns, separator, decimal).read_text()
    lines = text.splitlines()
    if units:
        lines.insert(1, separator.join(["s", *["V", "A", "bar", "rpm"] * 2]))
    if blank_lines:
        lines.insert(20, "")
    head = "\ufeff" if bom and encoding == "utf-8" else ""
    path = tmp_path / "other.csv"
    path.write_bytes((head + end.join(lines) + end).encode(encoding))
    log = read_log(path)
    np.testing.assert_array_equal(log.time_s, columns["time_s"])
    for c in (0, 1):
        np.testing.assert_allclose(log.speed[:, c] / RPM, columns[f"speed_{c + 1}_rpm"], rtol=1e-12)


# --- files that cannot be read


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.csv", b"", ["the file is empty"]),
        ("empty.parquet", b"", ["the file is empty"]),
        ("empty.mat", b"", ["the file is empty"]),
        ("head.csv", b"time_s,command_1_V,speed_1_rpm\n", ["no rows"]),
        ("text.csv", b"time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,1,ERR\n", ["row 3", "'speed_1_rpm'", "'ERR'"]),
        ("cut.csv", b"time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,1\n", ["row 3 has 2 cells", "cut off"]),
        ("unit.csv", b"time_s,command_1_mV,speed_1_rpm\n0,0,0\n0.01,1,2\n", ["'command_1_V' is missing", "mapping"]),
        ("no.tdms", b"nothing", ["not readable as TDMS"]),
        ("no.mf4", b"nothing", ["not readable as MDF"]),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_one_line(
    tmp_path: Path, name: str, content: bytes, words: list[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    sealed = tmp_path / "sealed.csv"
    sealed.write_text("time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,1,2\n")
    line = _refused(path, sealed)
    for word in words:
        assert word in line, line


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    at=st.floats(0, 1), what=st.sampled_from(["cut", "drop", "swap", "junk", "nul", "twice", "zeros", "quote"]),
    junk=st.text(max_size=6), binary=st.binary(min_size=1, max_size=6),
)  # fmt: skip
def test_a_damaged_file_is_read_or_refused_in_one_line(
    tmp_path: Path, recorded: tuple[Columns, Columns], at: float, what: str, junk: str, binary: bytes
) -> None:
    columns = {name: values[:100] for name, values in recorded[0].items()}
    path = _save(tmp_path / "log.csv", columns)
    data = path.read_bytes()
    n = int(at * (len(data) - 1))
    piece = {
        "cut": b"", "drop": data[n + 1 :], "swap": data[n + 1 : n + 2] + data[n : n + 1] + data[n + 2 :],
        "junk": junk.encode("utf-8", "replace") + data[n:], "nul": b"\0" + data[n:], "twice": data[n:] + data[:n],
        "zeros": b"\0" * 64, "quote": b'"' + binary + data[n:],
    }[what]  # fmt: skip
    path.write_bytes(data[:n] + piece)
    try:
        log = read_log(path)
    except InputError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
    else:
        assert np.isfinite(log.time_s).all() and np.isfinite(log.command_V[:, list(log.channels)]).all()
    status, text = _hydro_env("diagnose", "--inspect", path, "--out", tmp_path / "inspected")
    assert status in (0, 2) and "Traceback" not in text


# --- foreign formats with a mapping and other units


def _foreign(columns: Columns) -> Columns:
    """The log as another logger names and scales it."""
    out = {"t_ms": 1e3 * columns["time_s"]}
    for c, side in ((1, "left"), (2, "right")):
        out[f"cmd_{side}"] = columns[f"command_{c}_V"] / 0.73  # percent of 73 V
        out[f"i_{side}"] = 1e3 * columns[f"current_{c}_A"]
        out[f"pa_{side}"] = 100.0 * columns[f"pressure_{c}_bar"] + 5000.0
        out[f"pb_{side}"] = np.full(len(columns["time_s"]), 5000.0) + 1e-3 * np.arange(len(columns["time_s"]))
        out[f"n_{side}"] = -RPM * columns[f"speed_{c}_rpm"]
    return out


def _mapping(folder: Path, prefix: str = "") -> Path:
    channels = {
        f"channel_{c}": {
            "command": {"column": f"{prefix}cmd_{side}", "unit": "percent", "full_scale": 73.0},
            "current": {"column": f"{prefix}i_{side}", "unit": "mA"},
            "pressure": {"column": f"{prefix}pa_{side}", "unit": "kPa", "minus": {"column": f"{prefix}pb_{side}", "unit": "kPa"}},
            "speed": {"column": f"{prefix}n_{side}", "unit": "rad/s", "sign": -1},
        }
        for c, side in ((1, "left"), (2, "right"))
    }  # fmt: skip
    data = {"schema": "hydro_env/mapping/1", "time": {"column": f"{prefix}t_ms", "unit": "ms"}, **channels}
    path = folder / "mapping.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def _as_csv(path: Path, columns: Columns) -> None:
    _save(path, columns)


def _as_parquet(path: Path, columns: Columns) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(columns), path)


def _as_mat5(path: Path, columns: Columns) -> None:
    from scipy.io import savemat

    savemat(path, {"rec": columns})


def _as_mat73(path: Path, columns: Columns) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file[f"rec/{name}"] = values[None, :]
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")


def _as_mdf(path: Path, columns: Columns) -> None:
    asammdf = pytest.importorskip("asammdf")
    time = columns["t_ms"] * 1e-3
    with asammdf.MDF(version="4.10") as file:
        for name, values in columns.items():
            unit = {"i": "mA", "p": "kPa", "n": "rad/s", "t": "ms", "c": "%"}[name[0]]
            file.append([asammdf.Signal(values, time, name=name, unit=unit)])
        file.save(path)


def _as_tdms(path: Path, columns: Columns) -> None:
    tdms = pytest.importorskip("nptdms")
    units = {"i": "mA", "p": "kPa", "n": "rad/s", "t": "ms", "c": "%"}
    with tdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                tdms.ChannelObject("run", n, v, properties={"unit_string": units[n[0]]})
                for n, v in columns.items()
            ]
        )


FORMATS = {
    "log.csv": (_as_csv, ""), "log.parquet": (_as_parquet, ""), "five.mat": (_as_mat5, "rec."), "seven.mat": (_as_mat73, "rec."),
    "log.mf4": (_as_mdf, ""), "log.tdms": (_as_tdms, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", list(FORMATS))
def test_a_foreign_log_reads_the_same_through_its_mapping(
    tmp_path: Path, recorded: tuple[Columns, Columns], name: str
) -> None:
    write, prefix = FORMATS[name]
    path = tmp_path / name
    write(path, _foreign(recorded[0]))
    mapping = _mapping(tmp_path, prefix)
    log = read_log(path, mapping)
    assert log.findings == ()
    for c in (0, 1):
        for signal, unit, size in (("command", "V", 1.0), ("current", "A", 1.0), ("speed", "rpm", RPM)):
            values = log.get(signal)
            assert values is not None
            np.testing.assert_allclose(
                values[:, c] / size, recorded[0][f"{signal}_{c + 1}_{unit}"], atol=1e-9
            )
        assert log.pressure is not None
        wanted = recorded[0][f"pressure_{c + 1}_bar"] - 1e-5 * np.arange(len(log))
        np.testing.assert_allclose(log.pressure[:, c] / BAR, wanted, atol=1e-9)
    text = _inspected(path, "--mapping", mapping)
    assert "5000 rows" in text and "at 1000 Hz" in text and "nothing suspicious found" in text


@pytest.mark.parametrize("name", list(FORMATS))
def test_inspect_proposes_a_mapping_that_reads_the_foreign_log(
    tmp_path: Path, recorded: tuple[Columns, Columns], name: str
) -> None:
    write, _ = FORMATS[name]
    path = tmp_path / name
    write(path, _foreign(recorded[0]))
    text = _inspected(path)
    proposed = tmp_path / "inspected" / "mapping.yaml"
    log = read_log(path, proposed)
    assert log.period == pytest.approx(1e-3) and log.channels == (0, 1)
    assert "corrected in the proposal" in text and "falls when its command rises" in text  # the speeds' signs
    if name in ("log.mf4", "log.tdms"):  # the others do not tell the unit, and 95 may well be rpm
        np.testing.assert_allclose(log.speed[:, 0] / RPM, recorded[0]["speed_1_rpm"], atol=1e-9)
    else:
        assert "unit guessed from the size" in text
    assert log.pressure is not None
    np.testing.assert_allclose(log.pressure[:, 1] / BAR, recorded[0]["pressure_2_bar"], atol=0.06)
    assert not [f for f in log.findings if f.sure]


def test_a_unit_that_the_file_contradicts_is_said(tmp_path: Path, recorded: tuple[Columns, Columns]) -> None:
    path = tmp_path / "log.tdms"
    _as_tdms(path, _foreign(recorded[0]))
    mapping = _mapping(tmp_path)
    mapping.write_text(mapping.read_text().replace("unit: kPa", "unit: psi"))
    assert "the file says that 'pa_left' is in kPa, it is read as psi" in _inspected(
        path, "--mapping", mapping
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema: hydro_env/mapping/1\ntime: {column: t_ms, unit: ms}\n", ["no channel", "channel_1"]),
        ("schema: hydro_env/mapping/2\n", ["schema"]),
        ("time: [", ["line 1"]),
    ],
)
def test_a_wrong_mapping_is_one_line(tmp_path: Path, text: str, words: list[str]) -> None:
    path, mapping = tmp_path / "log.csv", tmp_path / "map.yaml"
    path.write_text("t_ms,u,n\n0,0,0\n1,1,1\n")
    mapping.write_text(text)
    status, output = _hydro_env(
        "diagnose", path, "--sealed", path, "--mapping", mapping, "--out", tmp_path / "out"
    )
    assert status == 2 and str(mapping) in output
    for word in words:
        assert word in output, output


def test_a_column_that_the_mapping_lacks_is_named(tmp_path: Path, recorded: tuple[Columns, Columns]) -> None:
    columns = _foreign(recorded[0])
    columns["n_rihgt"] = columns.pop("n_right")
    path = _save(tmp_path / "log.csv", columns)
    line = _refused(path, path, "--mapping", _mapping(tmp_path))
    assert "'n_right'" in line and "did you mean 'n_rihgt'" in line


# --- suspicions about pressures and loads


def test_small_pressures_in_kilopascal_are_suspected_before_a_model_is_looked_at(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    columns = _copy(recorded[0])
    for name in ("pressure_1_bar", "pressure_2_bar"):
        columns[name] *= 100 * 5.0 / np.abs(columns[name]).max()  # 5 bar at most
    assert "is it in kPa" in _inspected(_save(tmp_path / "log.csv", columns))


def test_psi_called_bar_with_many_blank_cells_is_refused(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    columns = _copy(recorded[0])
    for name in ("pressure_1_bar", "pressure_2_bar"):
        columns[name] *= 14.504
        columns[name][::3] = np.nan
    path, sealed = _save(tmp_path / "fit.csv", columns), _save(tmp_path / "sealed.csv", recorded[1])
    line = _refused(path, sealed, "--model", "paper_dead_zone")
    assert "times the model's pressure" in line and "is it in psi" in line


@pytest.mark.parametrize("stuck", [1.0, -2.0, 20.0])
def test_a_load_that_does_not_act_is_named(
    tmp_path: Path, recorded: tuple[Columns, Columns], stuck: float
) -> None:
    fit, sealed = (_copy(each) for each in recorded)
    for columns in (fit, sealed):
        columns["load_1_Nm"] = np.full(len(columns["time_s"]), stuck)
    line = _refused(_save(tmp_path / "fit.csv", fit), _save(tmp_path / "sealed.csv", sealed))
    assert "did not act" in line and "stuck or at its limit" in line and "--accept load" in line


def test_a_measured_load_at_the_limit_of_its_sensor_is_said(
    tmp_path: Path, recorded: tuple[Columns, Columns]
) -> None:
    load = 0.02 * _drive(9, 5000)[:, 0] + 0.01 * np.random.default_rng(1).normal(size=5000)
    columns = _copy(recorded[0]) | {"load_1_Nm": load}
    assert "its limit" not in _inspected(_save(tmp_path / "free.csv", columns))
    columns["load_1_Nm"] = np.minimum(load, 0.4)
    assert "'load_1_Nm' stays at its largest value, 0.4 N m" in _inspected(
        _save(tmp_path / "log.csv", columns)
    )
    profile = np.clip(np.abs(np.arange(5000) % 2000 - 1000) / 500.0, 0.2, 1.5)  # computed: ramps and plateaus
    columns["load_1_Nm"] = profile
    assert "its limit" not in _inspected(_save(tmp_path / "profile.csv", columns))
