"""Logs that somebody else sent: none runs code, fetches another file or fills the memory; each is refused in one line."""

from __future__ import annotations

import gzip
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_env import cli
from hydro_env.errors import InputError
from hydro_env.measured import load_mapping, read_log
from hydro_env.measured.formats import read_table
from hydro_env.measured.table import MAX_VALUES

TIME = np.arange(50) * 0.01
COLUMNS = {"command_1_V": np.sin(np.arange(50) / 5.0), "speed_1_rpm": 100 * np.cos(np.arange(50) / 5.0)}
HEAD = "time_s,command_1_V,speed_1_rpm\n"
ROWS = "".join(f"{t},{u},{n}\n" for t, u, n in zip(TIME, *COLUMNS.values(), strict=True))


def refused(path: Path | str, *words: str) -> None:
    """Reading and inspecting end with one line that names the file and holds the words."""
    with pytest.raises(InputError) as caught:
        read_log(path)
    line = str(caught.value)
    assert "\n" not in line and str(path)[:200] in line.replace("\\x00", "\0"), line
    for word in words:
        assert word in line, line


def mdf(
    folder: Path, version: str = "4.10", clock: Any = None, other: Any = None, **conversions: Any
) -> Path:
    """An MDF file with these conversions (keywords of asammdf) of its channels and of its clock."""
    asammdf = pytest.importorskip("asammdf")
    blocks = asammdf.blocks.v4_blocks if version >= "4" else asammdf.blocks.v2_v3_blocks
    path = folder / ("log.mf4" if version >= "4" else "log.mdf")
    columns = COLUMNS if other is None else COLUMNS | {"other": COLUMNS["speed_1_rpm"]}
    with asammdf.MDF(version=version) as file:
        for name, values in columns.items():
            rule = other if name == "other" else conversions.get(name)
            file.append([asammdf.Signal(values, TIME, name=name, conversion=rule)])
        for group in file.groups if clock else []:
            group.channels[0].conversion = blocks.ChannelConversion(**clock)
        file.save(path)
    return path


FORMULAS = (
    "__import__('os').system('touch {ran}')", "open('{ran}', 'w')", "2*X1 + open('{ran}', 'w').fileno()",
    "getattr(open('{ran}', 'w'), 'fileno')() * X1", "2*X1",
)  # fmt: skip


@pytest.mark.parametrize("where", ["speed_1_rpm", "clock"])
@pytest.mark.parametrize("text", FORMULAS)
@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_a_formula_in_an_mdf_file_never_runs(tmp_path: Path, text: str, where: str, version: str) -> None:
    ran = tmp_path / "ran"
    rule = {"conversion_type": 3 if version >= "4" else 10, "formula": text.format(ran=ran)}
    path = mdf(tmp_path, version, **{where: rule})
    name = where if where != "clock" else "time"
    refused(path, "come from a formula", "never run", f"'{name}'")
    status = cli.run(["diagnose", "--inspect", str(path), "--out", str(tmp_path / "out")])
    assert status == (2 if where == "clock" else 0)
    assert not ran.exists()


def test_a_formula_of_a_channel_that_is_not_used_does_not_disturb(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = tmp_path / "ran"
    path = mdf(tmp_path, other={"conversion_type": 3, "formula": FORMULAS[0].format(ran=ran)})
    np.testing.assert_allclose(read_log(path).command_V[:, 0], COLUMNS["command_1_V"])
    assert cli.run(["diagnose", "--inspect", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "'other': left out; the values of channel 'other' come from a formula" in capsys.readouterr().out
    assert not ran.exists()


@pytest.mark.parametrize(
    ("version", "rule"),
    [
        ("4.10", {"a": 2.0, "b": 1.0}),
        ("3.30", {"a": 2.0, "b": 1.0}),
        ("4.10", {"P1": 0.0, "P2": 2.0, "P3": 1.0, "P4": 0.0, "P5": 0.0, "P6": 1.0}),
        ("4.10", {"raw_0": -1e3, "phys_0": -1999.0, "raw_1": 1e3, "phys_1": 2001.0, "interpolation": True,
                  "val_param_nr": 4}),
    ],
    ids=["linear", "linear of MDF 3", "rational", "table"],
)  # fmt: skip
def test_arithmetic_conversions_of_mdf_files_are_applied(tmp_path: Path, version: str, rule: Any) -> None:
    log = read_log(mdf(tmp_path, version, command_1_V=rule))
    np.testing.assert_allclose(log.command_V[:, 0], 2.0 * COLUMNS["command_1_V"] + 1.0, rtol=1e-12)


def test_invalid_samples_of_an_mdf_file_are_missing(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    invalid = np.arange(50) == 7
    with asammdf.MDF(version="4.10") as file:
        for name, values in COLUMNS.items():
            bits = invalid if name == "speed_1_rpm" else None
            file.append([asammdf.Signal(values, TIME, name=name, invalidation_bits=bits)])
        file.save(tmp_path / "log.mf4")
    log = read_log(tmp_path / "log.mf4")
    np.testing.assert_array_equal(np.isnan(log.speed[:, 0]), invalid)


def mat73(path: Path, extra: Any) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"time_s": TIME, "command_1_V": COLUMNS["command_1_V"]}.items():
            file[name] = values[None, :]
        extra(file)
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")
    return path


def test_a_mat_file_reads_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "other").write_bytes(bytes(400))
    place = [(str(tmp_path / "other"), 0, 400)]
    path = mat73(
        tmp_path / "log.mat", lambda file: file.create_dataset("speed_1_rpm", (1, 50), "f8", external=place)
    )
    refused(path, "lies in another file")


def test_sizes_that_are_only_claimed_are_refused(tmp_path: Path) -> None:
    path = mat73(
        tmp_path / "log.mat",
        lambda file: file.create_dataset("speed_1_rpm", (1, MAX_VALUES + 1), "f8", chunks=(1, 1000)),
    )
    refused(path, "holds or claims more than 864,000,000 numbers")
    mapping = tmp_path / "map.yaml"
    mapping.write_text(
        "schema: hydro_env/mapping/1\ntime: {sample_rate: 100}\ntable: {skip_rows: 1000000000000000000}\n"
        "channel_1: {command: {column: a, unit: V}, speed: {column: b, unit: rpm}}\n"
    )
    log = tmp_path / "log.csv"
    log.write_text(HEAD + ROWS)
    with pytest.raises(InputError, match="not in the header"):
        read_log(log, load_mapping(mapping))


def test_damage_inside_a_record_of_an_mdf_file_is_named(tmp_path: Path) -> None:
    """The library reads and writes memory at the place that the file gives for its clock."""
    path = mdf(tmp_path)
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(path) as file:
        address = file.groups[1].channels[0].address
    data = bytearray(path.read_bytes())
    # ##CN block: header (24), links, then type, sync type, data type, bit offset (4), byte offset (4).
    links = int.from_bytes(data[address + 16 : address + 24], "little")
    data[address + 24 + 8 * links + 5] = 8
    path.write_bytes(data)
    refused(path, "outside its record")


@pytest.mark.parametrize("packed", [False, True])
def test_a_wrong_bit_in_what_a_mat_file_says_of_itself_is_read_or_refused(
    tmp_path: Path, packed: bool
) -> None:
    """SciPy believes it, and the process would end: by a kind of number that there is not, or a matrix called complex."""
    from scipy.io import savemat

    path = tmp_path / "log.mat"
    short = {"time_s": np.arange(4.0), "log": {"command_1_V": np.arange(4.0), "note": "text"}}
    savemat(path, short, do_compression=packed)
    data = path.read_bytes()
    assert read_table(path, lambda names: names).names == ("time_s", "log.command_1_V")
    for place in range(128, len(data)):
        for bit in range(0 if place % 4 < 2 else 7, 8):  # lengths and kinds are small
            path.write_bytes(data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :])
            try:
                read_table(path, lambda names: names)
            except InputError as error:
                assert str(path) in str(error) and "\n" not in str(error)
    for length in range(128, len(data), 8):
        path.write_bytes(data[:length])
        with suppress(InputError):
            read_table(path, lambda names: names)


@pytest.mark.parametrize("ending", ["tdms", "parquet", "mat"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(at=st.floats(0, 1), bit=st.integers(0, 7), cut=st.booleans())
def test_a_damaged_binary_log_is_read_or_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], ending: str, at: float, bit: int, cut: bool
) -> None:
    columns = {"time_s": TIME, **COLUMNS}
    path = tmp_path / f"log.{ending}"
    if ending == "tdms":
        tdms = pytest.importorskip("nptdms")
        with tdms.TdmsWriter(path) as writer:
            writer.write_segment([tdms.ChannelObject("run", name, v) for name, v in columns.items()])
    elif ending == "parquet":
        pyarrow = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(columns), path)
    else:
        from scipy.io import savemat

        savemat(path, columns)
    data = bytearray(path.read_bytes())
    place = int(at * (len(data) - 1))
    if cut:
        del data[max(place, 1) :]
    else:
        data[place] ^= 1 << bit
    path.write_bytes(data)
    try:
        log = read_log(path)
    except InputError as error:
        assert str(path) in str(error) and "\n" not in str(error)
    else:
        assert np.isfinite(log.time_s).all() and (np.diff(log.time_s) > 0.0).all()
        assert np.nanmax(np.abs(log.speed)) < 1e18
    assert capfd.readouterr().err == ""


# --- CSV


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    mark=st.text(min_size=2, max_size=5).filter(
        lambda text: len(text.strip()) > 1 and not set(text) & set("\r\n")
    )
)
def test_a_separator_of_several_characters_is_refused(tmp_path: Path, mark: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(f"sep={mark}\n{HEAD}{ROWS}".encode("utf-8", "replace"))
    refused(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"sep=;;\n{HEAD}{ROWS}", ["cannot be separated by ';;'", "one mark"]),
        (HEAD + ROWS + "1," + "9" * 140_000 + ",1\n", ["row 52 is longer than 131072 characters"]),
        (HEAD + ROWS + '1,"' + "9\n" * 140_000, ["row", "cells", "cut off"]),
        ("a" * 200_000, ["row 1 is longer than"]),
        (HEAD + "".join(f"{n * 5e-324},1,{n}\n" for n in range(50)), ["'time_s'", "rows come every", "right unit"]),
        (HEAD + ROWS + "1,1e37,1\n", ["row 52", "'command_1_V'", "1e+37 is no measurement", "leave the cell empty"]),
    ],
)  # fmt: skip
def test_what_no_recorder_writes_is_named(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    refused(path, *words)


def test_a_bomb_of_blank_lines_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(HEAD.encode() + b"\n" * 3_000_000))
    refused(path, "no rows")


# --- paths


def test_paths_that_are_no_plain_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo.csv")
    (tmp_path / "folder.csv").mkdir()
    refused(tmp_path / "fifo.csv", "not a plain file")
    refused(tmp_path / "folder.csv", "a folder")
    refused("/dev/zero", "a pipe or a device")
    refused("x" * 5000 + ".csv", "cannot be read", "too long")
    refused("a\0b.csv", "embedded null")
    refused(tmp_path / "nothing.csv", "no such file")
    (tmp_path / "log.mat.gz").write_bytes(gzip.compress(b"x"))
    refused(tmp_path / "log.mat.gz", "unpack it first")
