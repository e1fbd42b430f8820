"""The fast reader of CSV files gives what the careful one gives, for whatever stands in the cells."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hydro_env.errors import InputError
from hydro_env.measured import csv_file
from hydro_env.measured.csv_file import Cells, read_csv
from hydro_env.measured.header import Header
from hydro_env.measured.mapping import TableStyle

NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1e4, 1e4).map("{:.4f}".format),
    st.integers(-(10**20), 10**20).map(str),
    st.floats(-1e3, 1e3).map("{:+.3E}".format),
)
ODD = st.sampled_from(
    ["", " ", "nan", "NaN", "NA", "n/a", "null", "None", "-", "nan(1)", "inf", "-Infinity", "1e400", "1,5", "1.234,5", "+2",
     " 3 ", "\t4", "5.", ".5", "1_0", "0x1p3", "1d3", "1.5m", "12:30:01.5", "2024-01-02 12:30:01", "abc", "é", "٣", "7#", '"8"',
     '"9', "--1", "1e", "true"]
)  # fmt: skip


def texts() -> st.SearchStrategy[tuple[str, str]]:
    """A CSV file of three columns and its delimiter; most rows are plain, some are not."""

    @st.composite
    def text(draw: st.DrawFn) -> tuple[str, str]:
        delimiter = draw(st.sampled_from(",;\t|"))
        cell = NUMBERS if draw(st.booleans()) else st.one_of(NUMBERS, NUMBERS, NUMBERS, ODD)
        comma = delimiter != "," and draw(st.booleans())
        rows = draw(st.lists(st.lists(cell, min_size=3, max_size=3), min_size=1, max_size=30))
        lines = [delimiter.join(each.replace(".", ",") if comma else each for each in row) for row in rows]
        for _ in range(draw(st.integers(0, 2))):
            lines.insert(
                draw(st.integers(0, len(lines))), draw(st.sampled_from(["", "  ", "1", delimiter * 2]))
            )
        end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
        return end.join([delimiter.join(["a", "b", "c"]), *lines, *[""] * draw(st.booleans())]), delimiter

    return text()


def outcome(path: Path, style: TableStyle) -> Any:
    """What reading the file gives: the table and what was said about it, or the error."""
    try:
        table = read_csv(path, lambda names: ["c", "a"], style)
    except InputError as error:
        return str(error)
    columns = {
        name: values.tobytes() for name, values in table.columns.items()
    }  # bytes: NaN equals NaN, -0.0 is not 0.0
    return table.names, columns, table.lines.tolist(), table.findings, table.units


@settings(max_examples=400, deadline=None)
@given(texts(), st.sampled_from([1, 7, 1000]), st.booleans())
@example(("a;b;c\n1,5;2;3\n4;;6\n", ";"), 1, False)
@example(("a,b,c\n1,2,nan(1)\n", ","), 1, False)
@example(("a;b;c\n1.5;2;1,5\n", ";"), 1, True)
@example(("a,b,c\n,,\n1,2,3\n", ","), 1, False)
@example(("a,b,c\r\r0.0,0.0,0.0", ","), 1, False)
@example(("a,b,c\n,2,\n1,,3\n1,2,3,\n", ","), 7, False)
def test_both_readers_give_the_same(
    tmp_path_factory: pytest.TempPathFactory, text: tuple[str, str], block: int, suffixes: bool
) -> None:
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    path.write_bytes(text[0].encode())
    style = TableStyle(delimiter=text[1], si_suffixes=suffixes)
    with mock.patch.object(csv_file, "_BLOCK", block):
        with mock.patch.object(csv_file, "_LONG", 0):
            found = outcome(path, style)
        with mock.patch.object(Cells, "fast", return_value=None):
            assert found == outcome(path, style)


@pytest.mark.parametrize(
    ("text", "decimal", "expected"),
    [
        ("1,2.5\n3,-4e3\n", None, [[1.0, 3.0], [2.5, -4000.0]]),
        ("1,\n3,NaN\n", None, [[1.0, 3.0], [np.nan, np.nan]]),
        (",1\r\n3,\r\n,5", None, [[np.nan, 3.0, np.nan], [1.0, np.nan, 5.0]]),
        ("1,5\t2\r\n3\t4,25\r\n", ",", [[1.5, 3.0], [2.0, 4.25]]),
    ],
)
def test_fast_reader_takes_ordinary_blocks(
    text: str, decimal: str | None, expected: list[list[float]]
) -> None:
    header = Header(("a", "b"), "," if decimal is None else "\t", {}, 0)
    columns = Cells(header, {"a": 0, "b": 1}, TableStyle(decimal=decimal), []).fast(text)
    assert columns is not None
    np.testing.assert_array_equal(columns, expected)


def test_fast_reader_leaves_text_of_other_columns_alone() -> None:
    header = Header(("a", "b", "c", "d"), ";", {}, 0)
    columns = Cells(header, {"b": 1, "d": 3}, TableStyle(), []).fast("on;1;;2\noff;3;;4\n")
    assert columns is not None
    np.testing.assert_array_equal(columns, [[1.0, 3.0], [2.0, 4.0]])


def test_lines_are_counted_over_blocks(tmp_path: Path) -> None:
    """A bad cell far down is named by its line, whatever the ends of lines and wherever the blocks end."""
    path = tmp_path / "log.csv.gz"
    for end in ("\n", "\r\n", "\r"):
        rows = [f"{n},{2 * n}" for n in range(3000)]
        rows[2500] = "2500,x"
        path.write_bytes(gzip.compress(end.join(["a,b", *rows]).encode()))
        for block in (1, 997, 20_000):
            with (
                mock.patch.object(csv_file, "_BLOCK", block),
                pytest.raises(InputError, match=r"row 2502, column 'b': 'x' is not a number"),
            ):
                read_csv(path, lambda names: names, TableStyle())
