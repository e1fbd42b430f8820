"""Logs as loggers write them: the table is found below what stands above it, and the proposed mapping reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_env import cli
from hydro_env.errors import InputError
from hydro_env.lab.uploads import ending_of
from hydro_env.measured import read_log
from hydro_env.measured.formats import ENDINGS, read_table
from hydro_env.measured.inspect import propose, shown
from hydro_env.units import RPM, to_si
from hydro_env.valve_bench import Columns, read_curve

ROWS = 400
TIME = np.round(np.arange(ROWS) * 0.01, 6)
COMMAND = np.round(np.repeat(np.random.default_rng(5).uniform(-9.0, 9.0, ROWS // 20), 20), 3)
NOISE = np.random.default_rng(1).normal(size=(ROWS, 4))


def _lagged() -> np.ndarray:
    out = np.zeros(ROWS)
    for n in range(1, ROWS):
        out[n] = out[n - 1] + 0.12 * (20.0 * COMMAND[n - 1] - out[n - 1])
    return out


SPEED = np.round(_lagged() + 0.2 * NOISE[:, 0], 3)  # rpm
ANGLE = np.cumsum(_lagged()) * 0.01 / 60.0  # revolutions
A, B = (np.round(60.0 + sign * 3.0 * COMMAND + 0.1 * NOISE[:, n], 3) for n, sign in ((1, 1.0), (2, -1.0)))
OIL = np.round(45.0 + 0.01 * np.arange(ROWS) + 0.05 * NOISE[:, 3], 3)
VALUES = {"t": TIME, "u": COMMAND, "n": SPEED, "a": A, "b": B, "oil": OIL}


def table(separator: str, *columns: np.ndarray, decimal: str = ".", end: str = "\n") -> str:
    rows = np.column_stack(columns)
    return "".join(
        separator.join(f"{v:.10g}" for v in row).replace(".", decimal) + end for row in rows.tolist()
    )


def labview(names: str, body: str, header: bool = True) -> str:
    """As LabVIEW's measurement files are: a header of the file, then one of the recording."""
    first = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tNo\nX_Columns\tOne\nTime_Pref\tRelative\nDate\t2031/05/06\nTime\t07:08:09.5\n***End_of_Header***\t\n\t\n"
    )
    return (first if header else "") + (
        "Channels\t5\t\t\t\t\t\nSamples\t400\t400\t400\t400\t400\t\nDate\t2031/05/06\t2031/05/06\t2031/05/06\t2031/05/06\t2031/05/06\t\n"
        "X_Dimension\tTime\tTime\tTime\tTime\tTime\t\nX0\t0.0E+0\t0.0E+0\t0.0E+0\t0.0E+0\t0.0E+0\t\n"
        f"Delta_X\t0.01\t0.01\t0.01\t0.01\t0.01\t\n***End_of_Header***\t\t\t\t\t\t\n{names}\tComment\n{body}"
    )


GERMAN = 'Zeit [s];"Sollwert Y1 [V]";Drehzahl 1 (1/min);Druck A [bar];Druck B [bar];T_Oel [°C]\n'
PLAIN = "Zeit;Ventilspannung;Drehzahl;Druck A;Druck B;Oeltemperatur\n"
UNITS = "s;V;1/min;bar;bar;°C\n"
BODY = table(";", *VALUES.values(), decimal=",")
LOGGER = 'Geraet;"Logger 7"\nMessrate;100\nBereich;10\nKanaele;6\nVerstaerkung;1\n'
LABVIEW_NAMES = "X_Value\tcommand (V)\tspeed (rpm)\tp_A (bar)\tp_B (bar)\ttemperature (degC)"
#: Files that hold VALUES.
FILES: dict[str, Callable[[], str]] = {
    "german.csv": lambda: GERMAN + BODY,
    "units_row.csv": lambda: PLAIN + UNITS + BODY,
    "brackets_in_units_row.csv": lambda: PLAIN + "[s];[V];[1/min];[bar];[bar];[°C]\n\n" + BODY,
    "logger.csv": lambda: LOGGER + "\n" + PLAIN + UNITS + BODY,
    "logger_close.csv": lambda: LOGGER + GERMAN + BODY,
    "logger_colon.txt": lambda: "Device: X\nRate: 100 Hz\n\nNote: a, b; c\n" + GERMAN + BODY,
    "ruled.csv": lambda: "***;***\n" + PLAIN + UNITS + "-----;-----;-----;-----;-----;-----\n" + BODY,
    "groups.csv": lambda: "Lauf 3\n;Ventil;Motor;Leitung;Leitung;Tank\n" + PLAIN + UNITS + BODY,
    "comments.txt": lambda: "# run 3\n# t_s u_V n_rpm p_a_bar p_b_bar oil_degC\n" + table(" ", *VALUES.values()),
    "quoted.csv": lambda: '"Run 3, with oil"\n"of, Monday"\n' + '"t [s]","u [V]","n [rpm]","p_A [bar]","p_B [bar]","Oil [degC]"\n'
    + table(",", *VALUES.values()),
    "labview.lvm": lambda: labview(LABVIEW_NAMES, table("\t", *VALUES.values())),
    "labview_remarks.lvm": lambda: labview(LABVIEW_NAMES, table("\t", *VALUES.values()).replace("\n", "\tstart\n", 1)),
    "dates.csv": lambda: "Start;Monday\n" + GERMAN.replace("Zeit [s]", "Zeit")
    + "".join(f"06.05.2031 07:00:{t:09.6f}".replace(".", ",", 9).replace(",", ".", 2) + ";" + row.split(";", 1)[1] + "\n"
              for t, row in zip(TIME, BODY.splitlines(), strict=True)),
}  # fmt: skip


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def looked_at(path: Path, *words: object) -> Path:
    """The mapping that `diagnose --inspect` writes."""
    out = path.parent / "look"
    assert cli.run(["diagnose", "--inspect", str(path), *map(str, words), "--out", str(out)]) == 0
    return out / "mapping.yaml"


@pytest.mark.parametrize("name", list(FILES))
def test_the_proposal_reads_the_values_of_the_file(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, name, FILES[name]())
    mapping = looked_at(path)
    assert "to be decided" not in mapping.read_text()
    log = read_log(path, mapping)
    np.testing.assert_allclose(log.time_s, TIME, atol=1e-6)
    np.testing.assert_allclose(log.command_V[:, 0], COMMAND)
    np.testing.assert_allclose(log.speed[:, 0], SPEED * RPM)
    assert log.pressure_a is not None and log.pressure_b is not None and log.temperature is not None
    np.testing.assert_allclose(log.pressure_a[:, 0], A * 1e5)
    np.testing.assert_allclose(log.pressure_b[:, 0], B * 1e5)
    np.testing.assert_allclose(log.temperature, to_si(OIL, "degC"))
    for column in (source for source, _ in log.read_as.values()):
        assert repr(column) in mapping.read_text()  # and says why


def test_a_rig_log_below_a_preamble_needs_no_mapping(tmp_path: Path) -> None:
    head = "recorder 7\nrate: 100\n\ntime_s,command_1_V,speed_1_rpm\n"
    log = read_log(write(tmp_path, "a.csv", head + table(",", TIME, COMMAND, SPEED)))
    np.testing.assert_array_equal(log.command_V[:, 0], COMMAND)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FILES["labview.lvm"]() + "\n" + labview(LABVIEW_NAMES, table("\t", *VALUES.values()), False),
         ["row 422", "another recording begins here"]),
        ("t;u;n\n0;1;2\n1;2\n2;3;4\n3;3;4\n4;3;4\n", ["row 3 has 2 cells, the header has 3"]),
        ("t;u\n" + table(";", TIME, COMMAND, SPEED), ["row 2 has 3 cells, the header has 2"]),
        ("a title\nand another line\n", ["row 2 has 3 cells, the header has 2"]),
        (LOGGER, ["'Messrate'", "not a number"]),
    ],
)  # fmt: skip
def test_what_is_no_table_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: list[str]
) -> None:
    path = write(tmp_path, "log.csv", text)
    with pytest.raises(InputError) as caught:
        read_table(path, lambda names: names)
    assert all(word in str(caught.value) for word in words), caught.value
    assert cli.run(["diagnose", "--inspect", str(path), "--out", str(tmp_path / "look")]) in (0, 2)
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", ","), ("\t", "."), (" ", "."), (" ", ",")]
)
def test_numbers_alone_get_a_mapping_by_number(tmp_path: Path, separator: str, decimal: str) -> None:
    path = write(tmp_path, "log.txt", table(separator, TIME, SPEED, COMMAND, decimal=decimal))
    mapping = looked_at(path)
    text = mapping.read_text()
    assert "to be decided: channel_1.command: '3'?" in text and "to be decided: channel_1.speed: '2'?" in text
    log = read_log(path, mapping)
    np.testing.assert_allclose(log.time_s, TIME)
    np.testing.assert_allclose(log.command_V[:, 0], COMMAND)
    np.testing.assert_allclose(log.speed[:, 0], SPEED * RPM)


@pytest.mark.parametrize(
    ("unit", "name", "factor"),
    [
        ("deg", "Winkel 1 [deg]", 360.0),
        ("rad", "theta_rad", 2 * np.pi),
        ("rev", "position [rev]", 1.0),
        ("rev", "encoder_counts", 4000.0),
        ("deg", "motor angle", 360.0),
        ("wrapped", "motor angle [deg]", 360.0),
    ],
)
def test_a_position_is_a_source_of_speed(tmp_path: Path, unit: str, name: str, factor: float) -> None:
    position = np.round(ANGLE * factor, 0 if "counts" in name else 4)
    if unit == "wrapped":
        position = position % 360.0
    path = write(tmp_path, "log.csv", f"t_s,command_V,{name}\n" + table(",", TIME, COMMAND, position))
    mapping = looked_at(path)
    if "counts" in name:
        assert (
            "to be decided: channel_1.speed: scale is a guess: the revolutions per count"
            in mapping.read_text()
        )
        content = yaml.safe_load(mapping.read_text())
        content["channel_1"]["speed"]["scale"] = 1.0 / factor
        mapping.write_text(yaml.safe_dump(content))
    log = read_log(path, mapping)
    true = _lagged()
    assert np.std(log.speed[5:-5, 0] / RPM - true[5:-5]) < 0.05 * np.std(true)
    assert any(finding.code == "from_position" for finding in log.findings)


def test_a_piston_position_makes_a_cylinder(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "log.csv",
        "t_s,command_V,stroke [mm]\n" + table(",", TIME, COMMAND, np.round(50 * ANGLE, 4)),
    )
    log = read_log(path, looked_at(path))
    assert log.kinds[0] == "cylinder"
    assert np.std(log.speed[5:-5, 0] - 0.05 * _lagged()[5:-5] / 60.0) < 0.05 * np.std(log.speed[:, 0])


def _proposed(tmp_path: Path, columns: dict[str, np.ndarray]) -> tuple[dict, tuple[str, ...]]:
    path = write(tmp_path, "log.csv", ",".join(columns) + "\n" + table(",", *columns.values()))
    found = propose(path)
    return yaml.safe_load(found.text), found.notes


def test_names_that_only_look_like_it(tmp_path: Path) -> None:
    """A drone's log: nothing in it is a valve, but no name is taken for what it is not."""
    rng = np.random.default_rng(3)
    columns = {"time": TIME, "batteryVoltage": 12.0 + 0.01 * NOISE[:, 0], "motorCommand": COMMAND / 10.0, "PosRef": np.sin(TIME),
               "commanded_deg_s": 100.0 * np.cos(TIME), "quat_e_w": np.cos(0.1 * TIME), "quat_e_x": np.sin(0.1 * TIME),
               "speed_error": NOISE[:, 1], "status": rng.integers(0, 3, ROWS)}  # fmt: skip
    content, notes = _proposed(tmp_path, columns)
    assert content["channel_1"]["command"]["column"] == "motorCommand"
    assert content["channel_1"]["speed"]["column"] == "?"
    assert content["setpoint"] == {"column": "commanded_deg_s", "unit": "deg/s"}
    assert any(note.startswith("to be decided: channel_1.speed") for note in notes)
    for name in columns:
        assert any(repr(name) in note for note in notes), name
    (tmp_path / "mapping.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=r"'\?' is not in the header"):
        read_log(tmp_path / "log.csv", tmp_path / "mapping.yaml")


@pytest.mark.parametrize(
    ("name", "place", "unit"),
    [
        ("Sollwert Y1 [%]", "channel_1.command", "percent"),
        ("Sollwert Y1 [1/min]", "setpoint", "rpm"),
        ("T_Oel [degC]", "temperature", "degC"),
        ("T [K]", "temperature", "K"),
        ("Iststrom Y1 [mA]", "channel_1.current", "mA"),
        ("Spannung [bar]", "", ""),
        ("Kanal 2 [l/min]", "channel_2.flow", "l/min"),
        ("Pumpendruck [bar]", "supply", "bar"),
        ("valve position [mm]", "channel_1.spool", "mm"),
        ("v_soll [rad/s]", "setpoint", "rad/s"),
    ],
)
def test_units_overrule_names(tmp_path: Path, name: str, place: str, unit: str) -> None:
    columns = {
        "t [s]": TIME,
        name: 40.0 + 5.0 * np.abs(COMMAND),
        "n_1 [rpm]": SPEED,
        "n_2 [rpm]": SPEED + 1.0,
    }
    if not place.endswith("command"):
        columns |= {"u_1 [V]": COMMAND, "u_2 [V]": COMMAND[::-1]}
    content, _ = _proposed(tmp_path, columns)
    found = [
        (f"{key}.{signal}" if key.startswith("channel") else key, source["unit"])
        for key, value in content.items()
        for signal, source in (value.items() if key.startswith("channel") else [(key, value)])
        if isinstance(source, dict) and source.get("column") == name
    ]
    assert found == ([(place, unit)] if place else [])


def test_one_doubtful_column_does_not_drop_the_others(tmp_path: Path) -> None:
    """A torque beside a piston, a column of text, one that is infinite, and a clock that runs backwards."""
    clock = TIME.copy()
    clock[200:] -= 1.0
    rows = table(",", TIME, COMMAND, SPEED / 1000.0, 5.0 * NOISE[:, 0], A).splitlines()
    rows = [f"{row},note {n},{'inf' if n == 7 else n % 9}" for n, row in enumerate(rows)]
    head = "t [s],u [V],v [m/s],torque [N m],p [bar],remark,flow [l/min]\n"
    path = write(tmp_path, "log.csv", head + "\n".join(rows) + "\n")
    mapping = looked_at(path)
    log = read_log(path, mapping)
    assert log.signals == ("command", "pressure", "speed")
    for word in ("'torque [N m]': left out", "'remark': left out", "'flow [l/min]': left out"):
        assert word in mapping.read_text()
    back = write(tmp_path, "back.csv", "t [s],u [V],n [rpm]\n" + table(",", clock, COMMAND, SPEED))
    text = looked_at(back).read_text()
    assert "time runs backwards" in text and "to be decided: time.sample_rate" in text


def test_a_begun_mapping_is_completed(tmp_path: Path) -> None:
    """Only the table, which is written as no program could tell: `0,5` in a file separated by commas."""
    body = "".join(
        f'"{t:.2f}"|"{u:g}"|{n:g}\n'.replace(".", ",") for t, u, n in zip(TIME, COMMAND, SPEED, strict=True)
    )
    path = write(tmp_path, "log.csv", "junk|junk|junk\nt|u|n\n" + body)
    begun = write(
        tmp_path,
        "begun.yaml",
        'schema: hydro_env/mapping/1\nname: mine\ntable: {decimal: ",", skip_rows: 1, delimiter: "|"}\n',
    )
    text, mapping = shown(path, begun)
    assert "400 rows" in text and yaml.safe_load(mapping)["name"] == "mine"
    log = read_log(path, write(tmp_path, "whole.yaml", mapping))
    np.testing.assert_allclose(log.command_V[:, 0], COMMAND)
    begun.write_text(begun.read_text().replace("skip_rows", "skip_row"))
    with pytest.raises(InputError, match="did you mean 'skip_rows'"):
        shown(path, begun)


def test_a_column_that_stands_twice_is_called_by_its_number(tmp_path: Path) -> None:
    path = write(
        tmp_path, "log.csv", "t [s],x,u [V],t [s],n [rpm]\n" + table(",", TIME, OIL, COMMAND, TIME, SPEED)
    )
    content = yaml.safe_load(propose(path).text)
    assert content["time"]["column"] in ("1", "4")
    assert len(read_log(path, looked_at(path))) == ROWS


def test_a_column_without_a_name_is_no_error(tmp_path: Path) -> None:
    path = write(tmp_path, "log.csv", "title\nt [s];u [V];n [rpm];\n" + table(";", TIME, COMMAND, SPEED, OIL))
    log = read_log(path, looked_at(path))
    np.testing.assert_allclose(log.speed[:, 0], SPEED * RPM)


# --- the clock


@pytest.mark.parametrize("scale", ["min", "h"])
@pytest.mark.parametrize("period", [0.001, 0.01, 0.02])
def test_a_clock_in_a_longer_unit_is_said(tmp_path: Path, scale: str, period: float) -> None:
    time = np.arange(ROWS) * period / to_si(1.0, scale)
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([time, COMMAND, SPEED]), delimiter=",", header="time_s,command_1_V,speed_1_rpm",
               comments="", fmt="%.10g")  # fmt: skip
    if time[1] < 1e-6:
        with pytest.raises(InputError, match="give its right unit in a mapping"):
            read_log(path)
        return
    found = [finding for finding in read_log(path).findings if finding.code == "time_unit"]
    assert found and f"is 'time_s' in {scale}" in found[0].message
    assert found[0].sure is bool(time[1] < 4e-5)


@pytest.mark.parametrize(
    "rate", [50.0, 100.0, 200.0, 600.0, 1000.0, 1200.0, 2000.0, 4800.0, 10_000.0, 19_200.0, 20_000.0]
)
def test_a_usual_rate_is_not_questioned(tmp_path: Path, rate: float) -> None:
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([np.arange(ROWS) / rate, COMMAND, SPEED]), delimiter=",",
               header="time_s,command_1_V,speed_1_rpm", comments="", fmt="%.10g")  # fmt: skip
    assert not [finding for finding in read_log(path).findings if finding.code == "time_unit"]


# --- the same in the valve test and in the lab


def test_a_measured_curve_below_a_preamble(tmp_path: Path) -> None:
    signal = 10.0 * np.abs(np.arange(ROWS) % 200 - 100.0) / 100.0 - 5.0
    head = "Pruefling;Ventil 7\nDruck;70\nRate;10\n\nStrom;Durchfluss\nmA;l/min\n"
    plain = write(tmp_path, "plain.csv", "Strom (mA);Durchfluss (l/min)\n" + table(";", signal, 2.0 * signal))
    curves = [read_curve(plain)]
    for name, text in (("preamble.csv", head), ("labview.lvm", "")):
        body = table(";", signal, 2.0 * signal, decimal=",") if text else labview(
            "I (mA)\tQ (l/min)", table("\t", signal, 2.0 * signal))  # fmt: skip
        columns = Columns(signal_unit="mA", flow_unit="l/min")
        curves.append(read_curve(write(tmp_path, name, text + body), columns))
    gaps = "Current (mA) - 0\tFlow (l/min) - 0\tCurrent (mA) - 1\tFlow (l/min) - 1\tCurrent (mA) - 2\tFlow (l/min) - 2\t\n"
    body = table("\t", signal, 2.0 * signal, end="\t\t\t\t\t\n")
    curves.append(read_curve(write(tmp_path, "plots.txt", gaps + body)))
    for curve in curves[1:]:
        np.testing.assert_allclose(curve.signal, curves[0].signal)
        np.testing.assert_allclose(curve.flow, curves[0].flow)


def test_the_lab_takes_every_file_that_is_read() -> None:
    for ending in ENDINGS:
        assert ending_of(f"monday{ending.upper()}") == ending
