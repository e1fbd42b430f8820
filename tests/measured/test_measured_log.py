"""Rig logs: round trip, spellings of CSV, windows, resampling, binary formats, mappings."""

from __future__ import annotations

import gzip
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_env.errors import InputError
from hydro_env.measured import RigLog, load_mapping, read_log, write_log
from hydro_env.units import BAR, LPM, RPM, UNITS, from_si, to_si, unit

MAPPINGS = Path(__file__).parents[2] / "configs" / "mappings"
MINIMAL = "time_s,command_1_V,speed_1_rpm\n0,0,0\n0.01,10,5\n0.02,10,12\n"


def write(folder: Path, text: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@st.composite
def logs(draw: st.DrawFn) -> RigLog:
    rows = draw(st.integers(2, 12))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    channels = draw(st.sampled_from([(0,), (1,), (0, 1)]))
    present = draw(st.sets(st.sampled_from(["current", "pressure", "load", "spool", "flow"])))
    rig = draw(st.sets(st.sampled_from(["setpoint", "supply", "temperature"])))
    holes = draw(st.booleans())

    def pair() -> np.ndarray:
        values = np.full((rows, 2), np.nan)
        values[:, channels] = rng.normal(size=(rows, len(channels))) * 10.0 ** rng.integers(-6, 7)
        if holes and rows > 2:
            values[rng.integers(1, rows), channels[0]] = np.nan
        return values

    period = draw(st.sampled_from([1e-4, 1e-3, 0.01]))
    return RigLog(
        time_s=np.arange(rows) * period,
        command_V=pair(),
        speed=pair(),
        **{signal: pair() for signal in present},
        **{signal: 300.0 + rng.normal(size=rows) for signal in rig},
    )


def expected(log: RigLog, signal: str) -> np.ndarray:
    """What reading gives: holes of what is held until the next row are filled with the value before."""
    values = log.get(signal)
    assert values is not None
    values = values.copy()
    if signal in ("command", "load"):
        for channel in log.channels:
            for row in range(1, len(values)):
                if np.isnan(values[row, channel]):
                    values[row, channel] = values[row - 1, channel]
    return values


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(log=logs(), packed=st.booleans())
def test_a_written_log_reads_back(tmp_path: Path, log: RigLog, packed: bool) -> None:
    path = tmp_path / ("log.csv.gz" if packed else "log.csv")
    write_log(path, log)
    back = read_log(path)
    assert back.signals == log.signals and back.channels == log.channels
    np.testing.assert_allclose(back.time_s, log.time_s, rtol=1e-11, atol=1e-15)
    for signal in log.signals:
        np.testing.assert_allclose(back.get(signal), expected(log, signal), rtol=1e-10, atol=1e-12)
    assert list(tmp_path.iterdir()) == [path] or {p.name for p in tmp_path.iterdir()} <= {
        "log.csv",
        "log.csv.gz",
    }


def test_the_header_is_the_documented_one(tmp_path: Path) -> None:
    two = np.ones((3, 2))
    log = RigLog(np.arange(3.0), *[two] * 10, np.ones(3), np.ones(3), np.ones(3))
    write_log(tmp_path / "log.csv", log)
    assert (tmp_path / "log.csv").read_text().splitlines()[0] == (
        "time_s,setpoint_rpm,command_1_V,current_1_A,pressure_1_bar,speed_1_rpm,load_1_Nm,"
        "command_2_V,current_2_A,pressure_2_bar,speed_2_rpm,load_2_Nm,"
        "spool_1_mm,flow_1_lpm,spool_2_mm,flow_2_lpm,"
        "pressure_a_1_bar,pressure_b_1_bar,pressure_a_2_bar,pressure_b_2_bar,motor_pressure_1_bar,motor_pressure_2_bar,"
        "supply_bar,temperature_C"
    )


def test_units_become_si_once(tmp_path: Path) -> None:
    header = "time_s,command_2_V,speed_2_rpm,pressure_2_bar,flow_2_lpm,temperature_C\n"
    log = read_log(write(tmp_path, header + "0,0,60,2,6,20\n1e-2,1,120,3,12,21\n"))
    assert log.channels == (1,) and np.isnan(log.speed[:, 0]).all()
    np.testing.assert_allclose(log.speed[:, 1], [60 * RPM, 120 * RPM])
    np.testing.assert_allclose(log.pressure[:, 1], [2 * BAR, 3 * BAR])
    np.testing.assert_allclose(log.flow[:, 1], [6 * LPM, 12 * LPM])
    np.testing.assert_allclose(log.temperature, [293.15, 294.15])
    assert log.load is None and log.period == 0.01 and len(log.sha256) == 64


@pytest.mark.parametrize("name", sorted(UNITS))
def test_units_convert_back(name: str) -> None:
    assert from_si(to_si(12.5, name), name) == pytest.approx(12.5)
    assert unit(f" {name} ").name == name


def test_unit_spellings() -> None:
    assert [unit(name).name for name in ("Bar", "N·m", "Nm", "°C", "LPM", "gpm", "%", "µm")] == [
        "bar", "N m", "N m", "degC", "l/min", "GPM", "percent", "um",
    ]  # fmt: skip
    with pytest.raises(InputError, match="unknown unit 'baar'; did you mean 'bar'"):
        unit("baar")
    with pytest.raises(InputError):
        unit("mPa")  # a millipascal is not a megapascal


@pytest.mark.parametrize(
    "data",
    [
        MINIMAL.replace("\n", "\r\n").encode(),
        b"\xef\xbb\xbf" + MINIMAL.encode(),
        MINIMAL.encode("utf-16"),
        MINIMAL.replace(",", ";").encode(),
        MINIMAL.replace(",", "\t").encode(),
        MINIMAL.replace(",", ";").replace(".", ",").encode(),
        MINIMAL.replace(",", " , ").encode(),
        b"\n" + MINIMAL.encode() + b"\n\n",
        b"sep=,\n" + MINIMAL.encode(),
        MINIMAL.replace("\n", ",\n").encode(),
        MINIMAL.replace("rpm\n", "rpm,\xe9tat\n").replace("5\n", "5,on\n").replace("0\n", "0,on\n", 1)
        .replace("12\n", "12,on\n").encode("cp1252"),
    ],
    ids=["crlf", "bom", "utf16", "semicolon", "tab", "comma_decimal", "blanks", "empty_lines", "sep", "trailing",
         "cp1252"],
)  # fmt: skip
def test_spellings_of_the_same_csv(tmp_path: Path, data: bytes) -> None:
    log = read_log(write(tmp_path, data))
    np.testing.assert_array_equal(log.time_s, [0, 0.01, 0.02])
    np.testing.assert_allclose(log.speed[:, 0] / RPM, [0, 5, 12])


def test_empty_cells_are_missing_samples(tmp_path: Path) -> None:
    log = read_log(write(tmp_path, MINIMAL.replace("5\n", "\n")))
    assert np.isnan(log.speed[1, 0]) and log.findings[0].code == "missing_values"
    assert log.findings[0].row == 3


def test_window_and_resample() -> None:
    time = np.arange(101) * 0.01
    command = np.repeat((time >= 0.5).astype(float)[:, None], 2, axis=1)
    log = RigLog(time, command, np.column_stack([time, 2 * time]), setpoint=(time >= 0.5) * 1.0)
    part = log.window(0.2, 0.7)
    assert part.time_s[0] == 0.2 and part.time_s[-1] < 0.7 and len(part) == 50
    again = log.resample()
    np.testing.assert_allclose(again.command_V, log.command_V, atol=1e-12)
    np.testing.assert_array_equal(again.speed, log.speed)
    with pytest.raises(ValueError, match="fewer than two rows"):
        log.window(5.0, 6.0)


def test_commands_of_uneven_rows_act_from_their_own_times() -> None:
    """Every step of the grid holds the mean of the command in it; measurements keep their values and say when they were taken."""
    rng = np.random.default_rng(4)
    number = np.flatnonzero(rng.random(400) > 0.05)
    time = 5.0 + 0.01 * (number + 0.3 * rng.uniform(-1.0, 1.0, len(number)))
    command = np.repeat(rng.normal(size=len(number)).round(2)[:, None], 2, axis=1)
    log = RigLog(time, command, np.column_stack([time, 2 * time]))
    assert not log.uniform and abs(log.period - 0.01) < 2e-5
    even = log.resample()
    assert even.uniform and even.late is not None and np.abs(even.late).max() <= 0.5 * log.period + 1e-9
    known = np.isfinite(even.speed[:, 0])
    np.testing.assert_allclose((even.time_s + even.late)[known], even.speed[known, 0], atol=1e-9)
    assert 0.03 < np.mean(~known) < 0.07  # the rows that are missing
    acted = np.sum(command[:-1, 0] * np.diff(time))
    grid = even.time_s
    ends = command[0, 0] * (time[0] - grid[0]) + command[-1, 0] * (grid[-1] + log.period - time[-1])
    np.testing.assert_allclose(even.command_V[:, 0].sum() * log.period, acted + ends, atol=1e-9)
    fine = log.held(log.command_V, finer=10)
    np.testing.assert_allclose(fine.reshape(len(even), 10, 2).mean(axis=1), even.command_V, atol=1e-9)


def test_writing_twice_gives_the_same_bytes_and_failing_leaves_nothing(tmp_path: Path) -> None:
    log = RigLog(np.arange(3.0), np.ones((3, 2)), np.ones((3, 2)))
    for name in ("a.csv.gz", "b.csv.gz"):
        write_log(tmp_path / name, log)
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    with pytest.raises(ValueError):
        write_log(tmp_path / "c.csv", replace(log, kinds=("cylinder", "cylinder")))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv.gz", "b.csv.gz"]


# --- mappings

FOREIGN = """schema: hydro_env/mapping/1
name: foreign
time: {column: t, unit: ms}
supply: {column: Ps, unit: MPa}
channel_1:
  actuator: cylinder
  displacement: {value: 200, unit: cm2}
  command: {column: U, unit: percent, full_scale: 10}
  pressure: {column: A, unit: bar, minus: {column: B, unit: kPa, scale: 0.5}}
  speed: {column: v, unit: mm/s, sign: -1, scale: 2, offset: 1}
"""


def test_a_foreign_log_through_its_mapping(tmp_path: Path) -> None:
    mapping = write(tmp_path, FOREIGN, "map.yaml")
    log = read_log(
        write(tmp_path, "v,t,U,A,B,Ps,note\n1,0,50,10,1000,20,on\n2,10,-100,11,1000,20,off\n"), mapping
    )
    assert log.kinds[0] == "cylinder" and log.displacement[0] == pytest.approx(0.02)
    np.testing.assert_allclose(log.time_s, [0, 0.01])
    np.testing.assert_allclose(log.command_V[:, 0], [5, -10])
    np.testing.assert_allclose(log.speed[:, 0], [-0.003, -0.005])
    np.testing.assert_allclose(log.pressure[:, 0], [5e5, 6e5])
    np.testing.assert_allclose(log.supply, [20e6, 20e6])


def test_a_log_says_units_by_their_names(tmp_path: Path) -> None:
    text = (
        "schema: hydro_env/mapping/1\nname: lab\ntime: {column: t, unit: sec}\n"
        "channel_1:\n  command: {column: U, unit: Volt}\n  speed: {column: n, unit: U/min}\n"
    )
    log = read_log(
        write(tmp_path, "t,U,n\n0,0,0\n0.01,10,5\n0.02,10,12\n"), write(tmp_path, text, "map.yaml")
    )
    assert log.read_as == {"command_1": ("U", "V"), "speed_1": ("n", "rpm")}


def test_a_sample_rate_replaces_the_time_column(tmp_path: Path) -> None:
    text = """schema: hydro_env/mapping/1
time: {sample_rate: 200}
table: {si_suffixes: true, skip_rows: 2}
channel_2: {command: {column: i, unit: V}, speed: {column: n, unit: rad/s}}
"""
    log = read_log(
        write(tmp_path, "made by\na logger\ni,n\n25.1m,1\n1k,2\n"), write(tmp_path, text, "m.yaml")
    )
    np.testing.assert_allclose(log.command_V[:, 1], [0.0251, 1000.0])
    np.testing.assert_allclose(log.time_s, [0, 0.005])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("  speed:", "  sped:", "channel_1: unknown key 'sped': did you mean 'speed'?"),
        ("sign: -1", "sing: -1", "channel_1.speed: unknown key 'sing': did you mean 'sign'?"),
        ("sign: -1", "sign: -2", "channel_1.speed.sign is -2, should be 1 or -1"),
        ("supply:", "suply:", "unknown key 'suply': did you mean 'supply'?"),
        ("mapping/1", "maping/1", "schema is 'hydro_env/maping/1', should be 'hydro_env/mapping/1'"),
        ("unit: mm/s", "unit: mm/h", "unknown unit 'mm/h'; did you mean"),
        ("unit: mm/s", "unit: bar", "speed of a cylinder: bar is a unit of pressure; use mm/s"),
        ("unit: mm/s", "unit: rpm", "use mm/s, or say `actuator: motor`"),
        ("full_scale: 10", "scale: 10", "a fraction needs `full_scale`"),
        ("scale: 2", "scale: two", "channel_1.speed.scale is 'two', should be a number"),
        ("scale: 2", "scale: 0", "scale is 0"),
        ("unit: ms", "unit: bar", "bar is a unit of pressure; time is in s, ms or us"),
        ("column: t, unit: ms", "unit: ms", "give either `column`"),
        ("unit: cm2", "unit: cm3/rev", "displacement of a cylinder"),
        ("{column: U", "[column: U", " line 8: not YAML"),
        (
            "actuator: cylinder",
            "actuator: winch",
            "channel_1.actuator is 'winch', should be 'motor' or 'cylinder'",
        ),
    ],
)
def test_a_wrong_mapping_is_named(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in FOREIGN
    path = write(tmp_path, FOREIGN.replace(old, new), "map.yaml")
    with pytest.raises(InputError) as caught:
        load_mapping(path)
    line = str(caught.value)
    assert line.startswith(str(path)) and expected in line and "\n" not in line


def test_a_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    mapping = write(tmp_path, FOREIGN, "map.yaml")
    with pytest.raises(InputError, match="column 'Ps' is not in the header; did you mean 'Pss'"):
        read_log(write(tmp_path, "v,t,U,A,B,Pss\n1,0,50,10,1000,20\n2,10,0,11,1000,20\n"), mapping)


CRANE = [("main_sine", "main"), ("dual_sine_1", "main"), ("dual_sine_1", "jib")]


@pytest.mark.parametrize("axis", ["main", "jib"])
def test_the_shipped_mappings_are_valid(axis: str) -> None:
    mapping = load_mapping(MAPPINGS / f"crane_{axis}.yaml")
    assert mapping.name == f"crane_{axis}" and mapping.channel_1 is not None
    assert mapping.channel_1.actuator == "cylinder"


@pytest.mark.skipif(
    "HYDRO_ENV_REALDATA" not in os.environ, reason="HYDRO_ENV_REALDATA names no folder of real logs"
)
@pytest.mark.parametrize(("run", "axis"), CRANE)
def test_the_crane_logs(run: str, axis: str) -> None:
    folder = Path(os.environ["HYDRO_ENV_REALDATA"]) / "crane_two_axes"
    log = read_log(folder / f"{run}.csv.gz", MAPPINGS / f"crane_{axis}.yaml")
    assert log.channels == (0,) and log.kinds[0] == "cylinder" and log.period == 0.01
    assert log.signals == ("command", "pressure", "speed", "supply")
    # A clean recording raises no alarm; the jib's position sensor was disturbed for nine seconds of one run.
    assert [f.code for f in log.findings] == (["disturbed"] if axis == "jib" else [])
    # The cylinder's flow at full speed stays below what such a crane's pump delivers.
    assert np.nanmax(np.abs(log.speed[:, 0])) * log.displacement[0] < 100 * LPM


# --- binary formats

COLUMNS = {
    "time_s": np.arange(50) * 0.01,
    "command_1_V": np.sin(np.arange(50) / 5.0),
    "speed_1_rpm": 100 * np.cos(np.arange(50) / 5.0),
}


def check_binary(path: Path) -> None:
    log = read_log(path)
    np.testing.assert_allclose(log.time_s, COLUMNS["time_s"], atol=1e-12)
    np.testing.assert_allclose(log.speed[:, 0] / RPM, COLUMNS["speed_1_rpm"])
    np.testing.assert_allclose(log.command_V[:, 0], COLUMNS["command_1_V"])


def test_parquet(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(COLUMNS), tmp_path / "log.parquet")
    check_binary(tmp_path / "log.parquet")


@pytest.mark.parametrize("oned_as", ["row", "column"])
def test_mat_5(tmp_path: Path, oned_as: str) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "log.mat", {**COLUMNS, "comment": "text"}, oned_as=oned_as)
    check_binary(tmp_path / "log.mat")
    savemat(
        tmp_path / "deep.mat",
        {"log": dict(zip(("t", "u", "n"), COLUMNS.values(), strict=True))},
    )
    text = """schema: hydro_env/mapping/1
time: {column: log.t}
channel_1: {command: {column: log.u, unit: V}, speed: {column: log.n, unit: rpm}}
"""
    log = read_log(tmp_path / "deep.mat", write(tmp_path, text, "m.yaml"))
    np.testing.assert_allclose(log.speed[:, 0] / RPM, COLUMNS["speed_1_rpm"])


@pytest.mark.parametrize("version", ["4", "5"])
def test_columns_of_a_matrix_in_a_mat_file(tmp_path: Path, version: str) -> None:
    from scipy.io import savemat

    time = np.arange(80) * 0.01
    savemat(tmp_path / "log.mat", {"data": np.column_stack([time, np.sin(time), time**2])}, format=version)
    text = """schema: hydro_env/mapping/1
time: {column: "data(:,1)"}
channel_1: {command: {column: "data(:,2)", unit: V}, speed: {column: "data(:,3)", unit: rad/s}}
"""
    log = read_log(tmp_path / "log.mat", write(tmp_path, text, "m.yaml"))
    np.testing.assert_allclose(log.speed[:, 0], time**2)


def test_mat_73(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    # MATLAB puts its own 512 bytes before the HDF5 file.
    with h5py.File(tmp_path / "log.mat", "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[name] = values[None, :]
    with open(tmp_path / "log.mat", "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")
    check_binary(tmp_path / "log.mat")


def test_mdf_4(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        for name in ("command_1_V", "speed_1_rpm"):
            file.append([asammdf.Signal(COLUMNS[name], COLUMNS["time_s"], name=name)])
        file.save(tmp_path / "log.mf4")
    check_binary(tmp_path / "log.mf4")


def test_tdms(tmp_path: Path) -> None:
    tdms = pytest.importorskip("nptdms")
    with tdms.TdmsWriter(tmp_path / "log.tdms") as writer:
        writer.write_segment([tdms.ChannelObject("run", name, values) for name, values in COLUMNS.items()])
    check_binary(tmp_path / "log.tdms")


@pytest.mark.parametrize("ending", ["parquet", "mat", "mf4", "tdms"])
def test_a_broken_binary_log_is_one_line(tmp_path: Path, ending: str) -> None:
    path = write(tmp_path, b"this is no such file" * 20, f"log.{ending}")
    with pytest.raises(InputError) as caught:
        read_log(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_library_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r"'\.\[measured\]'"):
        read_log(write(tmp_path, b"PAR1", "log.parquet"))


def test_gzip_is_recognised(tmp_path: Path) -> None:
    assert len(read_log(write(tmp_path, gzip.compress(MINIMAL.encode()), "log.csv.gz"))) == 3
    for data, name in (
        (gzip.compress(MINIMAL.encode())[:-9], "cut.csv.gz"),
        (MINIMAL.encode(), "plain.csv.gz"),
    ):
        with pytest.raises(InputError, match="not a complete gzip file"):
            read_log(write(tmp_path, data, name))
    with pytest.raises(InputError, match="without the ending"):
        read_log(write(tmp_path, gzip.compress(MINIMAL.encode()), "log.csv"))
