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
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, shown
from hydro_env.measured.cell_text import MISSING, SI_SUFFIX, has_suffix, is_number, is_value, seconds
from hydro_env.measured.finding import Finding
from hydro_env.measured.header import Header

__all__ = ["Cells"]

#: Characters that the careful reader reads in the time that it takes to import Arrow.
_LONG = 1 << 19


class Cells:
    """Reads blocks of rows of one file below its `header`; `wanted` are the columns' names, `places` their numbers from 0.

    `decimal` is the decimal mark, None if it is to be recognised; with `si_suffixes` 25.1m is 0.0251. Spellings that are
    understood but worth a word go to `findings`.
    """

    def __init__(
        self, path: Path, header: Header, wanted: Sequence[str], places: Sequence[int], decimal: str | None,
        si_suffixes: bool, findings: list[Finding],
    ) -> None:  # fmt: skip
        self.path, self.header, self.wanted, self.places = path, header, wanted, places
        self.width, self.blanks = len(header.names), header.delimiter == " "
        self.delimiter = "\t" if self.blanks else header.delimiter
        self.decimal, self.si_suffixes, self.findings = decimal, si_suffixes, findings
        self.decimal_comma = decimal == ","

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

        wanted = [str(place) for place in self.places]
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
        block = [np.concatenate([_numbers(chunk) for chunk in column.chunks]) for column in table.columns]
        # A row without a number may be an empty line, or one of delimiters only.
        if any(column.null_count for column in table.columns) and np.isnan(block).all(axis=0).any():
            return None
        return block

    def careful(self, text: str, start: int) -> tuple[list[np.ndarray], np.ndarray]:
        """The columns of any block cell by cell, and the numbers of its lines without the empty ones."""
        values, kept = array("d"), array("q")
        rows = csv.reader(io.StringIO(text), delimiter=self.delimiter)
        for row in self._rows(rows, start):
            if not self.decimal_comma and len(row) == self.width:
                try:  # a row of plain numbers: most are
                    values.extend([float(row[place]) for place in self.places])
                    kept.append(start + rows.line_num - 1)
                    continue
                except ValueError:
                    pass
            if not any(cell.strip() for cell in row):
                continue
            line = start + rows.line_num - 1
            if len(row) < self.width or (any(row[self.width :]) and not self.header.open_end):
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
        if row and not is_value(row[0].replace(",", ".")) and seconds(row[0]) is None:
            hint = f"does another recording begin here, with {shown(row[0])}? Save it to a file of its own"
        if len(row) > self.width and self.delimiter == ",":
            hint = "decimal commas need another delimiter: write 0.5, or separate the columns by ';'"
        return InputError(
            f"{self.path}: row {line} has {len(row)} cells, the header has {self.width}; {hint}"
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
        seen = f"({text!r} in row {line}), read"
        if self._has_decimal_comma(text):
            if self.decimal is None:
                message = f"numbers are written with a decimal comma {seen} so"
                self._note("decimal_comma", message, name, line, "write decimal points")
            self.decimal_comma = True
            return float(text.replace(",", "."))
        stamp = seconds(text)
        if stamp is not None:
            self._note("time_stamps", f"times are written as dates or hours {seen} as seconds", name, line)
            return stamp
        if self.si_suffixes and has_suffix(text):
            self._note("si_suffixes", f"numbers carry suffixes {seen} so", name, line)
            return float(text[:-1]) * SI_SUFFIX[text[-1]]
        raise InputError(
            f"{self.path}: row {line}, column {name!r}: {text!r} is not a number; {self._hint(text, name)}"
        )

    def _note(self, code: str, message: str, name: str, line: int, hint: str = "") -> None:
        """Notes a spelling where it is first seen."""
        if all(each.code != code for each in self.findings):
            self.findings.append(Finding(code, message, hint, column=name, row=line))

    def _has_decimal_comma(self, text: str) -> bool:
        # With another delimiter a comma inside a number can only be the decimal mark (or, far rarer, thousands).
        possible = self.decimal_comma or (self.decimal is None and self.delimiter != ",")
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
