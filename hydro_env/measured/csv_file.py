"""CSV files (also gzipped): encoding, delimiter, header and units are recognised and said, the columns asked for are read.

A file is read once, line by line, and its rows in blocks of lines: the memory it takes is that of the columns and of one block.
A block becomes numbers in one of two ways. The careful one understands every spelling that a log may have and names the row and
column of what it does not. The fast one (Apache Arrow's) takes blocks in which every row is complete and every cell that is
wanted is a plain number or empty, and refuses all others. What it takes the careful one reads as the same numbers, so it changes
the time only.
"""

import csv
import gzip
import io
import math
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, shown
from hydro_env.measured.cell_text import MISSING, SI_SUFFIX, has_suffix, is_number, is_value, seconds
from hydro_env.measured.finding import Finding
from hydro_env.measured.header import Header, find_header
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.table import Table, check_size, place_of

#: Lines in which the header is looked for, and lines read at a time behind them.
_HEAD, _BLOCK = 1000, 20_000
#: Characters of a line at most: as many as Python's csv module takes in one cell.
_MAX_LINE = 131_072
#: Characters that the careful reader reads in the time that it takes to import Arrow.
_LONG = 1 << 19

#: Which of the columns of a file are wanted.
Choose = Callable[[tuple[str, ...]], Sequence[str]]


def read_csv(path: Path, choose: Choose, style: TableStyle) -> Table:
    """Reads the columns that `choose(header)` asks for; `InputError` names row and column of what is wrong."""
    findings: list[Finding] = []
    try:
        encoding = style.encoding or _encoding(path, findings)
        # What is not UTF-8 is taken line by line for Windows-1252.
        errors = "surrogateescape" if encoding == "utf-8-sig" else "strict"
        with _open(path, "rt", encoding=encoding, errors=errors) as file:
            return _read(_lines(file, findings), choose, style, findings)
    except LookupError:
        raise InputError(f"unknown encoding {style.encoding!r} in its mapping; say utf-8 or cp1252") from None
    except UnicodeError:
        mapped, begun = f"{style.encoding} as its mapping says", "UTF-16 as it begins; is it cut off?"
        raise InputError(f"not encoded in {mapped if style.encoding else begun}") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(f"not a complete gzip file ({error}); compress it again") from None


def _open(path: Path, mode: str, **how: str) -> Any:
    return gzip.open(path, mode, **how) if path.suffix == ".gz" else open(path, mode, **how)  # type: ignore[call-overload]


def _encoding(path: Path, findings: list[Finding]) -> str:
    """The encoding that the beginning of a file shows. InputError where that is no text."""
    with _open(path, "rb") as file:
        head = file.read(4096)
    if head[:2] == b"\x1f\x8b":
        raise InputError(f"a gzip file without the ending .gz; rename it to {path.name}.gz")
    if not head.strip():
        raise InputError("the file is empty; a log needs a header line and rows")
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        findings.append(Finding("encoding", "encoded in UTF-16", "save the log as UTF-8"))
        return "utf-16"
    if b"\0" in head:
        raise InputError("not a text file; binary logs need the ending .parquet, .mat, .mf4 or .tdms")
    return "utf-8-sig"


def _lines(file: Any, findings: list[Finding]) -> Iterator[str]:
    """The lines of a text file, whose ends are all \\n."""
    for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE + 1), ""), 1):
        if len(line) > _MAX_LINE:
            raise InputError(f"row {number} is longer than {_MAX_LINE} characters; is it no CSV file?")
        if not line.isascii() and any("\udc80" <= mark <= "\udcff" for mark in line):
            if not any(each.code == "encoding" for each in findings):
                findings.append(
                    Finding("encoding", "not UTF-8; read as Windows-1252", "save the log as UTF-8")
                )
            line = line.encode("utf-8", "surrogateescape").decode("cp1252", "replace")
        yield line


def _read(lines: Iterator[str], choose: Choose, style: TableStyle, findings: list[Finding]) -> Table:
    first = 1 + sum(1 for _ in islice(lines, style.skip_rows))
    head = list(islice(lines, _HEAD))
    header = find_header(head, first, style.delimiter, findings)
    places = {name: place_of(header.names, name) for name in choose(header.names)}
    cells = Cells(header, places, style, findings)
    columns, numbers = [array("d") for _ in places], array("q")  # they grow in place
    start = first + header.first
    for block in chain([head[header.first :]], iter(lambda: list(islice(lines, _BLOCK)), [])):
        check_size(max(start, len(numbers) * len(columns)))
        values, rows = cells.read(block, start)
        for column, some in zip(columns, values, strict=True):
            column.frombytes(some.tobytes())
        numbers.frombytes(rows.tobytes())
        start += len(block)
    if not numbers:
        raise InputError("only a header, no rows; a log needs at least two samples")
    named = dict(zip(places, map(np.asarray, columns), strict=True))
    return Table(header.names, named, np.asarray(numbers), findings, header.units)


@dataclass
class Cells:
    """Reads blocks of rows of one file below its `header`; `places` are the numbers of the wanted columns, from 0, by name.

    The decimal mark is that of the `style`, or recognised. Spellings that are understood but worth a word go to `findings`.
    """

    header: Header
    places: dict[str, int]
    style: TableStyle
    findings: list[Finding]

    def __post_init__(self) -> None:
        self.width, self.blanks = len(self.header.names), self.header.delimiter == " "
        self.delimiter = "\t" if self.blanks else self.header.delimiter
        self.decimal_comma = self.style.decimal == ","

    def read(self, lines: Sequence[str], start: int) -> tuple[list[np.ndarray], np.ndarray]:
        """The wanted columns (rows,) of lines, the first of which is line `start`, and the numbers of the lines with a row."""
        text = "".join("\t".join(line.split()) + "\n" for line in lines) if self.blanks else "".join(lines)
        columns = self.fast(text) if len(text) >= _LONG else None
        if columns is not None:
            return columns, np.arange(start, start + len(columns[0]))
        return self.careful(text, start)

    def fast(self, text: str) -> list[np.ndarray] | None:
        """The columns of a block of complete rows of plain numbers and empty cells, None of any other block."""
        # One column cannot be told from empty lines, a quoted cell may hold a delimiter or the end of a line, and Arrow takes
        # nan(1) for a number.
        if self.width < 2 or not self.places or '"' in text or "(" in text or not self.delimiter.isascii():
            return None
        from pyarrow import ArrowInvalid, csv, float64, py_buffer

        wanted = [str(place) for place in self.places.values()]
        try:
            table = csv.read_csv(
                py_buffer(text.encode()),
                csv.ReadOptions(column_names=[str(place) for place in range(self.width)]),
                csv.ParseOptions(delimiter=self.delimiter, quote_char=False, ignore_empty_lines=False),
                csv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, float64()),
                    include_columns=wanted,
                    null_values=[""],
                    decimal_point="," if self.decimal_comma else ".",
                ),
            )
        except ArrowInvalid:
            return None
        # Arrow's own way to NumPy imports pandas first, a third of a second, if it can.
        block = [
            np.concatenate([np.from_dlpack(chunk.fill_null(math.nan)) for chunk in column.chunks])
            for column in table.columns
        ]
        # A row without a number may be an empty line, or one of delimiters only.
        if any(column.null_count for column in table.columns) and np.isnan(block).all(axis=0).any():
            return None
        return block

    def careful(self, text: str, start: int) -> tuple[list[np.ndarray], np.ndarray]:
        """The columns of any block cell by cell, and the numbers of its lines without the empty ones."""
        values, kept = array("d"), array("q")
        rows = csv.reader(io.StringIO(text), delimiter=self.delimiter)
        try:
            for row in rows:
                if not any(cell.strip() for cell in row):
                    continue
                line = start + rows.line_num - 1
                if len(row) < self.width or (any(row[self.width :]) and not self.header.open_end):
                    raise self._wrong_width(row, line)
                kept.append(line)
                values.extend(self.cell(row[place], name, line) for name, place in self.places.items())
        except csv.Error as error:
            told = f"row {start + rows.line_num - 1} is not readable as CSV ({error})"
            raise InputError(f"{told}; is a quotation mark not closed?") from None
        block = np.array(values).reshape(len(kept), len(self.places))
        return list(np.ascontiguousarray(block.T)), np.array(kept)

    def _wrong_width(self, row: list[str], line: int) -> InputError:
        hint = "a cell is missing, or the recording was cut off here"
        if row and not is_value(row[0].replace(",", ".")) and seconds(row[0]) is None:
            hint = f"does another recording begin here, with {shown(row[0])}? Save it to a file of its own"
        if len(row) > self.width and self.delimiter == ",":
            hint = "decimal commas need another delimiter: write 0.5, or separate the columns by ';'"
        return InputError(f"row {line} has {len(row)} cells, the header has {self.width}; {hint}")

    def cell(self, text: str, name: str, line: int) -> float:
        """The number in a cell of column `name`; NaN where it says that nothing was measured."""
        if not (self.decimal_comma and "." in text):
            try:
                return float(text)
            except ValueError:
                pass
        text = text.strip()
        if text.lower() in MISSING:
            return math.nan
        seen = f"({text!r} in row {line}), read"
        if self._has_decimal_comma(text):
            if self.style.decimal is None:
                message = f"numbers are written with a decimal comma {seen} so"
                self._note("decimal_comma", message, name, line, "write decimal points")
            self.decimal_comma = True
            return float(text.replace(",", "."))
        stamp = seconds(text)
        if stamp is not None:
            self._note("time_stamps", f"times are written as dates or hours {seen} as seconds", name, line)
            return stamp
        if self.style.si_suffixes and has_suffix(text):
            self._note("si_suffixes", f"numbers carry suffixes {seen} so", name, line)
            return float(text[:-1]) * SI_SUFFIX[text[-1]]
        raise InputError(f"row {line}, column {name!r}: {text!r} is not a number; {self._hint(text, name)}")

    def _note(self, code: str, message: str, name: str, line: int, hint: str = "") -> None:
        """Notes a spelling where it is first seen."""
        if all(each.code != code for each in self.findings):
            self.findings.append(Finding(code, message, hint, column=name, row=line))

    def _has_decimal_comma(self, text: str) -> bool:
        # With another delimiter a comma inside a number can only be the decimal mark (or, far rarer, thousands).
        possible = self.decimal_comma or (self.style.decimal is None and self.delimiter != ",")
        return possible and text.count(",") == 1 and "." not in text and is_number(text.replace(",", "."))

    def _hint(self, text: str, name: str) -> str:
        """What would be right instead of a cell that cannot be understood."""
        if self.decimal_comma and is_number(text):
            return "decimal commas are used elsewhere in the file; write all numbers alike"
        if "," in text and "." in text:
            return "write it without thousands separators, with a decimal point"
        if has_suffix(text):
            return "for suffixes such as m and k say `si_suffixes: true` under `table` in the mapping"
        if ":" in text:
            return "time stamps are seconds as a plain number, hh:mm:ss.sss, or yyyy-mm-dd hh:mm:ss.sss"
        if name == next(iter(self.places)):
            return "write a number; if another recording begins here, save it to a file of its own"
        return "write a number, or leave the cell empty where nothing was measured"
