"""CSV files (also gzipped): encoding, delimiter, header and units are recognised and said, the columns asked for are read.

A file is read once, line by line, and its rows in blocks of lines: the memory it takes is that of the columns and of one block.
"""

from __future__ import annotations

import csv
import gzip
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, suggestion
from hydro_env.measured.csv_cells import Cells
from hydro_env.measured.finding import Finding
from hydro_env.measured.header import find_header
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.table import Table, check_size

__all__ = ["read_csv"]

#: Lines in which the header is looked for, and lines read at a time behind them.
_HEAD, _BLOCK = 1000, 20_000
#: Characters of a line at most: as many as Python's csv module takes in one cell.
_MAX_LINE = 131_072

Choose = Callable[[tuple[str, ...]], Sequence[str]]


def read_csv(path: Path, choose: Choose, style: TableStyle | None = None) -> Table:
    """Reads the columns that `choose(header)` asks for; `InputError` names file, row and column of what is wrong."""
    style = style or TableStyle()
    findings: list[Finding] = []
    try:
        encoding = style.encoding or _encoding(path, findings)
        # What is not UTF-8 is taken line by line for Windows-1252.
        errors = "surrogateescape" if encoding == "utf-8-sig" else "strict"
        with _open(path, "rt", encoding=encoding, errors=errors) as file:
            return _read(path, _lines(path, file, findings), choose, style, findings)
    except LookupError:
        raise InputError(
            f"{path}: unknown encoding {style.encoding!r} in its mapping; say utf-8 or cp1252"
        ) from None
    except UnicodeError:
        said = (
            f"{style.encoding} as its mapping says"
            if style.encoding
            else "UTF-16 as it begins; is it cut off?"
        )
        raise InputError(f"{path}: not encoded in {said}") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(f"{path}: not a complete gzip file ({error}); compress it again") from None
    except csv.Error as error:
        raise InputError(f"{path}: not readable as CSV ({error})") from None


def _open(path: Path, mode: str, **how: str) -> Any:
    return gzip.open(path, mode, **how) if path.suffix == ".gz" else open(path, mode, **how)  # type: ignore[call-overload]


def _encoding(path: Path, findings: list[Finding]) -> str:
    """The encoding that the beginning of a file shows. InputError where that is no text."""
    with _open(path, "rb") as file:
        head = file.read(4096)
    if head[:2] == b"\x1f\x8b":
        raise InputError(f"{path}: a gzip file without the ending .gz; rename it to {path.name}.gz")
    if not head.strip():
        raise InputError(f"{path}: the file is empty; a log needs a header line and rows")
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        findings.append(Finding("encoding", "encoded in UTF-16", "save the log as UTF-8"))
        return "utf-16"
    if b"\0" in head:
        raise InputError(
            f"{path}: not a text file; binary logs need the ending .parquet, .mat, .mf4 or .tdms"
        )
    return "utf-8-sig"


def _lines(path: Path, file: Any, findings: list[Finding]) -> Iterator[str]:
    """The lines of a text file, whose ends are all \\n."""
    for number in count(1):
        line = file.readline(_MAX_LINE + 1)
        if len(line) > _MAX_LINE:
            raise InputError(
                f"{path}: row {number} is longer than {_MAX_LINE} characters; is an end of line missing, or is it no CSV file?"
            )
        if not line:
            return
        if not line.isascii() and any("\udc80" <= mark <= "\udcff" for mark in line):
            if not any(each.code == "encoding" for each in findings):
                message = "not UTF-8; read as Windows-1252"
                findings.append(Finding("encoding", message, "save the log as UTF-8"))
            line = line.encode("utf-8", "surrogateescape").decode("cp1252", "replace")
        yield line


def _read(
    path: Path, lines: Iterator[str], choose: Choose, style: TableStyle, findings: list[Finding]
) -> Table:
    first = 1 + sum(1 for _ in islice(lines, style.skip_rows))
    head: list[str] = []
    for line in lines:
        if head or not line.isspace():
            head.append(line)
        else:
            first += 1
        if len(head) == _HEAD:
            break
    header = find_header(path, head, first, style.delimiter, findings)
    wanted = list(dict.fromkeys(choose(header.names)))
    places = [_place(path, header.names, name) for name in wanted]
    cells = Cells(path, header, wanted, places, style.decimal, style.si_suffixes, findings)
    columns, numbers = [array("d") for _ in wanted], array("q")  # they grow in place
    block, start = head[header.first :], first + header.first
    while block or (block := list(islice(lines, _BLOCK))):
        check_size(path, max(start, len(numbers) * len(columns)))
        values, rows = cells.read(block, start)
        for column, some in zip(columns, values, strict=True):
            column.frombytes(some.tobytes())
        numbers.frombytes(rows.tobytes())
        start += len(block)
        block = []
    if not numbers:
        raise InputError(f"{path}: only a header, no rows; a log needs at least two samples")
    named = dict(zip(wanted, map(np.asarray, columns), strict=True))
    return Table(path, header.names, named, np.asarray(numbers), findings, header.units)


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
