"""CSV files (also gzipped): encoding, delimiter, header and units are recognised and said, the columns asked for are read.

One streaming pass; the memory it takes is that of the columns and of one block of text. A line, and what a gzipped file
unpacks to, may not be longer than any log's.
"""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from hydro_env.errors import InputError, suggestion
from hydro_env.measured.csv_cells import MISSING, Cells, Dialect, is_number, is_value, seconds
from hydro_env.measured.finding import Finding
from hydro_env.measured.table import Table, check_size
from hydro_env.units import unit

__all__ = ["CsvStyle", "read_csv"]

#: Characters parsed at a time, first and then: one odd cell costs the careful reading of no more than its block.
_FIRST_BLOCK, _BLOCK = 1 << 16, 1 << 22
#: Characters of a line at most: as many as Python's csv module takes in one cell.
_LONGEST_LINE = 131_072
_BROKEN_GZIP = (gzip.BadGzipFile, EOFError, zlib.error)

Choose = Callable[[tuple[str, ...]], Sequence[str]]


@dataclass(frozen=True)
class CsvStyle:
    """How a CSV file is written; None is recognised from the file.

    Without a `header` the columns are called "1", "2", ...; None takes a first line of nothing but numbers for data.
    """

    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    skip_rows: int = 0
    si_suffixes: bool = False
    header: bool | None = True


@dataclass
class _Header:
    """The column names, the delimiter that was recognised (" ": any run of blanks), the text of the first lines of data that
    were read already, and the number of their first line."""

    names: tuple[str, ...]
    delimiter: str
    text: str
    line: int


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
    header = _header(path, file, style, findings)
    names = header.names
    wanted = list(dict.fromkeys(choose(names)))
    times = Counter(names)
    for name in wanted:
        if not times[name]:
            raise InputError(f"{path}: column {name!r} is not in the header; {suggestion(name, names)}")
        if times[name] > 1:
            found = [str(i + 1) for i, other in enumerate(names) if other == name]
            raise InputError(
                f"{path}: column {name!r} appears {len(found)} times (columns {', '.join(found)}); keep one of them"
            )
    units = _units_in_names(names) | _units_row(path, file, header, style.si_suffixes, findings)
    blanks = header.delimiter == " "
    dialect = Dialect(
        len(names), "\t" if blanks else header.delimiter, blanks, style.decimal, style.si_suffixes
    )
    cells = Cells(path, dialect, wanted, [names.index(name) for name in wanted], findings)
    columns, lines = _numbers(path, cells, _blocks(path, file, header))
    return Table(path, names, columns, lines, findings, units)


def _header(path: Path, file: IO[str], style: CsvStyle, findings: list[Finding]) -> _Header:
    """Reads up to the first line of data: `sep=` line, column names, delimiter."""
    line, first = 1, _line(path, file, 1)
    while first and (line <= style.skip_rows or not first.strip()):
        line += 1
        first = _line(path, file, line)
    first = first.lstrip("\ufeff")
    delimiter = style.delimiter
    if delimiter is None and first.lower().startswith("sep="):
        delimiter = first.strip("\r\n")[4:] or ","
        if len(delimiter) > 1 and delimiter.strip():  # a blank or tab may be the separator itself
            delimiter = delimiter.strip()
        line += 1
        first = _line(path, file, line)
    elif delimiter is None:
        delimiter = _delimiter(first)
        if delimiter != ",":
            shown = {"\t": "tab", " ": "blanks"}.get(delimiter, delimiter)
            findings.append(
                Finding("delimiter", f"columns are separated by {shown!r}, read so", "write commas")
            )
    if len(delimiter) != 1 or delimiter in '"\r\n' or delimiter.isalnum():
        raise InputError(
            f"{path}: columns cannot be separated by {delimiter!r}; one mark is right, such as ; in `sep=;` or in the mapping"
        )
    if delimiter == " ":  # a unit in brackets belongs to the name before it
        cells = _cells_of(re.sub(r"\s+(?=[(\[])", "", first), delimiter)
    else:
        cells = _cells_of(first, delimiter)
    names = tuple(name.strip() for name in cells)
    while names and not names[-1]:
        names = names[:-1]
    numbers_only = bool(names) and all(is_value(name, style.si_suffixes) for name in names)
    if style.header is False or (style.header is None and numbers_only):
        return _Header(tuple(str(place + 1) for place in range(len(names))), delimiter, first, line)
    if names and all(is_number(name) for name in names):
        raise InputError(
            f"{path}: row {line} holds numbers where the header should be; add the line of column names"
        )
    return _Header(names, delimiter, _line(path, file, line + 1), line + 1)


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


def _cells_of(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        line, delimiter = "\t".join(line.split()), "\t"
    return next(csv.reader([line], delimiter=delimiter), [])


def _delimiter(header: str) -> str:
    counts = {mark: header.count(mark) for mark in ("\t", ";", ",", "|")}
    best = max(counts, key=lambda mark: counts[mark])
    if counts[best]:
        return best
    return " " if len(header.split()) > 1 else ","


def _units_row(
    path: Path, file: IO[str], header: _Header, si_suffixes: bool, findings: list[Finding]
) -> dict[str, str]:
    """Units by column where the line after the names is a row of units, which is then passed over."""
    try:
        cells = [cell.strip().strip("[]()") for cell in _cells_of(header.text, header.delimiter)]
    except csv.Error:
        return {}
    if len(cells) < len(header.names):
        return {}
    if any(is_value(cell, si_suffixes) or seconds(cell) is not None for cell in cells):
        return {}
    units = {
        name: cell
        for name, cell in zip(header.names, cells, strict=False)
        if cell and cell.lower() not in MISSING and _is_unit(cell)
    }
    if len(units) < 2:
        return {}
    findings.append(Finding("units_row", f"row {header.line} holds units, read so", row=header.line))
    header.text, header.line = _line(path, file, header.line + 1), header.line + 1
    return units


def _units_in_names(names: tuple[str, ...]) -> dict[str, str]:
    """`p1 [kPa]` gives kPa."""
    found = {}
    for name in names:
        match = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
        if match and match[1].strip() and not is_number(match[1]) and _is_unit(match[1].strip()):
            found[name] = match[1].strip()
    return found


def _is_unit(text: str) -> bool:
    try:
        unit(text)
    except InputError:
        return False
    return True


def _blocks(path: Path, file: IO[str], header: _Header) -> Iterator[tuple[str, int]]:
    """Whole lines of data and the number of the first of them."""
    text, line = header.text + file.read(_FIRST_BLOCK), header.line
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
