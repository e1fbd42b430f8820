"""CSV files (also gzipped): encoding, delimiter, header and units are recognised and said, the columns asked for are read.

One streaming pass; the memory it takes is that of the columns and of one block of text. A line, and what a gzipped file
unpacks to, may not be longer than any log's.
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from hydro_env.errors import InputError, suggestion
from hydro_env.measured.csv_cells import Cells, Dialect
from hydro_env.measured.finding import Finding
from hydro_env.measured.header import find_header
from hydro_env.measured.table import Table, check_size

__all__ = ["CsvStyle", "read_csv"]

#: Characters parsed at a time, first and then: one odd cell costs the careful reading of no more than its block.
_FIRST_BLOCK, _BLOCK = 1 << 16, 1 << 22
#: Characters of a line at most: as many as Python's csv module takes in one cell.
_LONGEST_LINE = 131_072
_BROKEN_GZIP = (gzip.BadGzipFile, EOFError, zlib.error)

Choose = Callable[[tuple[str, ...]], Sequence[str]]


@dataclass(frozen=True)
class CsvStyle:
    """How a CSV file is written; None is recognised from the file."""

    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    skip_rows: int = 0
    si_suffixes: bool = False


def read_csv(path: Path, choose: Choose, style: CsvStyle | None = None) -> Table:
    """Reads the columns that `choose(header)` asks for; `InputError` names file, row and column of what is wrong."""
    style = style or CsvStyle()
    encoding, findings = _encoding(path, style.encoding)
    try:
        return _decoded(path, encoding, "strict", choose, style, findings)
    except UnicodeError:
        if style.encoding or encoding != "utf-8-sig":
            said = (
                f"{style.encoding} as its mapping says"
                if style.encoding
                else "UTF-16 as it begins; is it cut off?"
            )
            raise InputError(f"{path}: not encoded in {said}") from None
    findings.clear()  # the first pass may have found some already
    findings.append(Finding("encoding", "not UTF-8; read as Windows-1252", "save the log as UTF-8"))
    return _decoded(path, "cp1252", "replace", choose, style, findings)


def _decoded(
    path: Path, encoding: str, errors: str, choose: Choose, style: CsvStyle, findings: list[Finding]
) -> Table:
    try:
        with _open(path, encoding, errors) as file:
            return _read(path, file, choose, style, findings)
    except _BROKEN_GZIP as error:
        raise InputError(f"{path}: not a complete gzip file ({error}); compress it again") from None
    except csv.Error as error:
        raise InputError(f"{path}: not readable as CSV ({error})") from None


def _open(path: Path, encoding: str, errors: str) -> IO[str]:
    if path.suffix == ".gz":
        return gzip.open(path, "rt", encoding=encoding, errors=errors, newline="")
    return open(path, encoding=encoding, errors=errors, newline="")


def _encoding(path: Path, given: str | None) -> tuple[str, list[Finding]]:
    try:
        with gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb") as file:  # type: ignore[attr-defined]
            head = file.read(4096)
    except _BROKEN_GZIP as error:
        raise InputError(f"{path}: not a complete gzip file ({error}); compress it again") from None
    if head[:2] == b"\x1f\x8b":
        raise InputError(f"{path}: a gzip file without the ending .gz; rename it to {path.name}.gz")
    if not head.strip():
        raise InputError(f"{path}: the file is empty; a log needs a header line and rows")
    if given:
        try:
            "".encode(given)
        except LookupError:
            raise InputError(
                f"{path}: unknown encoding {given!r} in its mapping; say utf-8 or cp1252"
            ) from None
        return given, []
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16", [Finding("encoding", "encoded in UTF-16", "save the log as UTF-8")]
    if b"\0" in head:
        raise InputError(
            f"{path}: not a text file; binary logs need the ending .parquet, .mat, .mf4 or .tdms"
        )
    return "utf-8-sig", []


def _read(path: Path, file: IO[str], choose: Choose, style: CsvStyle, findings: list[Finding]) -> Table:
    lines, number = _begin(path, file, style.skip_rows)
    header = find_header(path, lines, number, style.delimiter, findings)
    names, blanks = header.names, header.delimiter == " "
    wanted = list(dict.fromkeys(choose(names)))
    dialect = Dialect(
        len(names),
        "\t" if blanks else header.delimiter,
        blanks,
        style.decimal,
        style.si_suffixes,
        header.open_end,
    )
    cells = Cells(path, dialect, wanted, [_place(path, names, name) for name in wanted], findings)
    rest, first = "".join(lines[header.first :]), number + header.first
    columns, rows = _numbers(path, cells, _blocks(path, file, rest, first))
    return Table(path, names, columns, rows, findings, header.units)


def _place(path: Path, names: Sequence[str], wanted: str) -> int:
    """The place of a column, by its name or, where the header has no such name, by its number from 1."""
    found = [place for place, name in enumerate(names) if name == wanted]
    if len(found) > 1:
        shown = ", ".join(str(place + 1) for place in found)
        raise InputError(
            f"{path}: column {wanted!r} appears {len(found)} times (columns {shown}); keep one of them, or call it by its number"
        )
    if found:
        return found[0]
    if wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    raise InputError(f"{path}: column {wanted!r} is not in the header; {suggestion(wanted, names)}")


def _begin(path: Path, file: IO[str], skip: int) -> tuple[list[str], int]:
    """The first lines that are not to be skipped nor all empty, and the number of the first of them."""
    number = 1
    while number <= skip and _line(path, file, number):
        number += 1
    while text := file.read(_FIRST_BLOCK) + file.readline(_LONGEST_LINE + 1):
        lines = list(io.StringIO(text.removeprefix("\ufeff"), newline=""))
        for place, line in enumerate(lines):
            if len(line) > _LONGEST_LINE:
                raise _too_long(path, number + place)
        if not text.isspace():
            return lines, number
        number += len(lines)
    return [], number


def _line(path: Path, file: IO[str], number: int) -> str:
    """The next line, which is line `number`."""
    text = file.readline(_LONGEST_LINE + 1)
    if len(text) > _LONGEST_LINE:
        raise _too_long(path, number)
    return text


def _too_long(path: Path, number: int) -> InputError:
    return InputError(
        f"{path}: row {number} is longer than {_LONGEST_LINE} characters; is an end of line missing, or is it no CSV file?"
    )


def _blocks(path: Path, file: IO[str], text: str, line: int) -> Iterator[tuple[str, int]]:
    """Whole lines of data, at first `text`, and the number of the first of them."""
    text = text or file.read(_BLOCK)
    while text:
        text += file.readline(_LONGEST_LINE + 1)
        start = 0
        while len(text) - start > _LONGEST_LINE:  # from the last end of a line within reach to the next
            end = max(text.rfind(mark, start, start + _LONGEST_LINE) for mark in "\r\n") + 1
            if not end:
                raise _too_long(path, line + _count_lines(text[:start]))
            start = end
        yield text, line
        line += _count_lines(text)
        text = file.read(_BLOCK)


def _count_lines(text: str) -> int:
    """Lines of a text of whole lines, which end with \\n, \\r\\n or \\r."""
    returns = text.count("\r")
    return text.count("\n") + returns - (text.count("\r\n") if returns else 0)


def _numbers(
    path: Path, cells: Cells, blocks: Iterator[tuple[str, int]]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """All rows of the wanted columns by name, and the numbers of their lines."""
    columns, lines = [array("d") for _ in cells.wanted], array("q")  # they grow in place
    for text, start in blocks:
        check_size(path, max(start, len(lines) * len(columns)))
        block, numbers = cells.read(text, start)
        infinite = [
            (int(np.argmax(bad)), place) for place, bad in enumerate(map(np.isinf, block)) if bad.any()
        ]
        if infinite:
            row, place = min(infinite)
            raise InputError(
                f"{path}: row {numbers[row]}, column {cells.wanted[place]!r}: infinite; "
                "leave the cell empty where nothing was measured"
            )
        for column, values in zip(columns, block, strict=True):
            column.frombytes(values.tobytes())
        lines.frombytes(numbers.tobytes())
    if not lines:
        raise InputError(f"{path}: only a header, no rows; a log needs at least two samples")
    return dict(zip(cells.wanted, map(np.asarray, columns), strict=True)), np.asarray(lines)
