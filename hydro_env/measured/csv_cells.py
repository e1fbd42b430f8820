"""Rows of a CSV file as columns of numbers: a fast reader for plain numbers and a careful one for everything else.

The careful reader understands every spelling that a log may have and names the row and column of what it does not. The
fast one (Apache Arrow's) takes blocks in which every row is complete and every cell that is wanted
is a plain number or empty, and refuses all others. What it takes the careful one reads as the same numbers, so it changes
the time only.
"""

from __future__ import annotations

import csv
import io
import math
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, shown
from hydro_env.measured.finding import Finding

__all__ = ["MISSING", "SI_SUFFIX", "Cells", "Dialect", "is_number", "is_value", "seconds"]

#: Powers of ten that circuit simulators and bench instruments write behind a number.
SI_SUFFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
#: Cells that say that nothing was measured, in lower case.
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
#: Characters that the careful reader reads in the time that it takes to import Arrow.
_LONG = 1 << 19
_HOURS = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)")
_DAYS = re.compile(
    r"(?P<y>\d{4})(?P<s>[-/.])(?P<m>\d\d?)(?P=s)(?P<d>\d\d?)|(?P<d2>\d\d?)\.(?P<m2>\d\d?)\.(?P<y2>\d{4})"
)


@dataclass(frozen=True)
class Dialect:
    """How the rows are written: `width` cells, separated by `delimiter` (of `blanks`, any run separates). `decimal` is the
    decimal mark, None if it is to be recognised; with `si_suffixes` 25.1m is 0.0251. More cells are passed over if `open_end`."""

    width: int
    delimiter: str
    blanks: bool = False
    decimal: str | None = None
    si_suffixes: bool = False
    open_end: bool = False


class Cells:
    """Reads blocks of rows of one file; `wanted` are the columns' names, `places` their numbers from 0.

    Spellings that are understood but worth a word go to `findings`.
    """

    def __init__(
        self,
        path: Path,
        dialect: Dialect,
        wanted: Sequence[str],
        places: Sequence[int],
        findings: list[Finding],
    ) -> None:
        self.path, self.dialect, self.wanted, self.places = path, dialect, wanted, places
        self.findings = findings
        self.decimal_comma = dialect.decimal == ","

    def read(self, text: str, start: int) -> tuple[list[np.ndarray], np.ndarray]:
        """The wanted columns (rows,) of a block of whole lines, the first of which is line `start`, and the lines' numbers."""
        if not text or text.isspace():
            return [np.empty(0)] * len(self.wanted), np.empty(0, np.int64)
        if self.dialect.blanks:
            text = "".join("\t".join(line.split()) + "\n" for line in io.StringIO(text, newline=""))
        columns = self.fast(text) if len(text) >= _LONG else None
        if columns is not None:
            return columns, np.arange(start, start + len(columns[0]))
        return self.careful(text, start)

    def fast(self, text: str) -> list[np.ndarray] | None:
        """The columns of a block of complete rows of plain numbers and empty cells, None of any other block."""
        delimiter, width = self.dialect.delimiter, self.dialect.width
        # One column cannot be told from empty lines, a quoted cell may hold a delimiter or the end of a line, and Arrow takes
        # nan(1) for a number. Lines that end in \r alone are not counted here.
        lone = "\r" in text and text.count("\r") != text.count("\r\n")
        if width < 2 or not self.places or lone or '"' in text or "(" in text or not delimiter.isascii():
            return None
        from pyarrow import ArrowInvalid, csv, float64, py_buffer

        wanted = [str(place) for place in self.places]
        try:
            table = csv.read_csv(
                py_buffer(text.encode()),
                csv.ReadOptions(column_names=[str(place) for place in range(width)]),
                csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False),
                csv.ConvertOptions(
                    column_types=dict.fromkeys(wanted, float64()),
                    include_columns=wanted,
                    null_values=[""],
                    decimal_point="," if self.decimal_comma else ".",
                ),
            )
        except ArrowInvalid:
            return None
        block = [np.concatenate([_numbers(chunk) for chunk in column.chunks]) for column in table.columns]
        # A row without a number may be an empty line, or one of delimiters only.
        if any(column.null_count for column in table.columns) and np.isnan(block).all(axis=0).any():
            return None
        return block

    def careful(self, text: str, start: int) -> tuple[list[np.ndarray], np.ndarray]:
        """The columns of any block cell by cell, and the numbers of its lines without the empty ones."""
        values, kept = array("d"), array("q")
        width = self.dialect.width
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=self.dialect.delimiter)
        for row in self._rows(rows, start):
            if not self.decimal_comma and len(row) == width:
                try:  # a row of plain numbers: most are
                    values.extend([float(row[place]) for place in self.places])
                    kept.append(start + rows.line_num - 1)
                    continue
                except ValueError:
                    pass
            if not any(cell.strip() for cell in row):
                continue
            line = start + rows.line_num - 1
            if len(row) < width or (any(row[width:]) and not self.dialect.open_end):
                raise self._wrong_width(row, line)
            kept.append(line)
            values.extend(
                self.cell(row[place], name, line)
                for place, name in zip(self.places, self.wanted, strict=True)
            )
        block = np.array(values).reshape(len(kept), len(self.places))
        return list(np.ascontiguousarray(block.T)), np.array(kept)

    def _rows(self, rows: Any, start: int) -> Iterator[list[str]]:
        """The rows of a reader; InputError where a cell does not end."""
        try:
            yield from rows
        except csv.Error as error:
            raise InputError(
                f"{self.path}: row {start + rows.line_num - 1} is not readable as CSV ({error}); is a quotation mark not closed?"
            ) from None

    def _wrong_width(self, row: list[str], line: int) -> InputError:
        hint = "a cell is missing, or the recording was cut off here"
        if row and not is_value(row[0].replace(",", "."), True) and seconds(row[0]) is None:
            hint = f"does another recording begin here, with {shown(row[0])}? Save it to a file of its own"
        if len(row) > self.dialect.width and self.dialect.delimiter == ",":
            hint = "decimal commas need another delimiter: write 0.5, or separate the columns by ';'"
        return InputError(
            f"{self.path}: row {line} has {len(row)} cells, the header has {self.dialect.width}; {hint}"
        )

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
        if self._has_decimal_comma(text):
            if not self.decimal_comma and self.dialect.decimal is None:
                message = f"numbers are written with a decimal comma ({text!r} in row {line}), read so"
                self.findings.append(
                    Finding("decimal_comma", message, "write decimal points", column=name, row=line)
                )
                self.decimal_comma = True
            return float(text.replace(",", "."))
        stamp = seconds(text)
        if stamp is not None:
            if not any(f.code == "time_stamps" for f in self.findings):
                message = f"times are written as dates or hours ({text!r} in row {line}), read as seconds"
                self.findings.append(Finding("time_stamps", message, column=name, row=line))
            return stamp
        if self.dialect.si_suffixes and _has_suffix(text):
            if not any(f.code == "si_suffixes" for f in self.findings):
                message = f"numbers carry suffixes ({text!r} in row {line}), read so"
                self.findings.append(Finding("si_suffixes", message, column=name, row=line))
            return float(text[:-1]) * SI_SUFFIX[text[-1]]
        raise InputError(
            f"{self.path}: row {line}, column {name!r}: {text!r} is not a number; {self._hint(text, name)}"
        )

    def _has_decimal_comma(self, text: str) -> bool:
        # With another delimiter a comma inside a number can only be the decimal mark (or, far rarer, thousands).
        possible = self.decimal_comma or (self.dialect.decimal is None and self.dialect.delimiter != ",")
        return possible and text.count(",") == 1 and "." not in text and is_number(text.replace(",", "."))

    def _hint(self, text: str, name: str) -> str:
        """What would be right instead of a cell that cannot be understood."""
        if self.decimal_comma and is_number(text):
            return "decimal commas are used elsewhere in the file; write all numbers alike"
        if "," in text and "." in text:
            return "write it without thousands separators, with a decimal point"
        if _has_suffix(text):
            return "for suffixes such as m and k say `si_suffixes: true` under `table` in the mapping"
        if ":" in text:
            return "time stamps are seconds as a plain number, hh:mm:ss.sss, or yyyy-mm-dd hh:mm:ss.sss"
        if name == self.wanted[0]:
            return "write a number; if another recording begins here, save it to a file of its own"
        return "write a number, or leave the cell empty where nothing was measured"


def _numbers(chunk: Any) -> np.ndarray:
    """An array of Arrow as NumPy's, NaN where it is null. Its own method imports pandas first, a third of a second, if it can."""
    valid, data = chunk.buffers()
    rows = slice(chunk.offset, chunk.offset + len(chunk))
    values = np.frombuffer(data)[rows]
    if valid is None:
        return values
    return np.where(np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[rows], values, np.nan)


def seconds(text: str) -> float | None:
    """The seconds of a time of day (since midnight) or of a date and time (since 1970), or None: 2024-01-02T12:30:01.5 as in ISO
    8601, with / or . for -, or 2.1.2024 12:30:01,5."""
    day, _, time = text.strip().replace("T", " ").rpartition(" ")
    match, date = _HOURS.fullmatch(time.rstrip("Z")), _DAYS.fullmatch(day.strip())
    if not match or (day and not date):
        return None
    if not date:
        return _of_hours(match)
    year, month, of_month = date.group("y", "m", "d") if date["y"] else date.group("y2", "m2", "d2")
    try:
        return datetime(int(year), int(month), int(of_month), tzinfo=UTC).timestamp() + _of_hours(match)
    except ValueError:
        return None


def _of_hours(match: re.Match[str]) -> float:
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", "."))


def is_value(text: str, si_suffixes: bool) -> bool:
    """Whether `text` is a number, with an SI suffix where these are allowed."""
    return is_number(text) or (si_suffixes and _has_suffix(text))


def _has_suffix(text: str) -> bool:
    return text[-1:] in SI_SUFFIX and is_number(text[:-1])


def is_number(text: str) -> bool:
    try:
        float(text.strip())
    except ValueError:
        return False
    return True
