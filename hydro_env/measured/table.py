"""A recorded table as it lies in a file: named columns of numbers, read without guessing what they mean.

CSV (also gzipped) is read here in one streaming pass that parses only the columns asked for; text encodings,
delimiters and decimal commas are recognised. The binary formats are in `hydro_env.measured.formats`.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import itertools
import math
import re
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

import numpy as np

from hydro_env.errors import InputError
from hydro_env.measured.finding import Finding
from hydro_env.units import unit

__all__ = ["CsvStyle", "Table", "digest", "read_csv"]

_CHUNK = 50_000  # rows parsed at a time; bounds the memory taken by text
_SI_SUFFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
_BROKEN_GZIP = (gzip.BadGzipFile, EOFError, zlib.error)
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "#n/a"}


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
class Table:
    """Columns (T,) of float64 by name, NaN where a cell is empty; `lines` are the file's line numbers (T,); `units` what
    the file itself says of a column's unit."""

    path: Path
    names: tuple[str, ...]
    columns: dict[str, np.ndarray]
    lines: np.ndarray
    findings: list[Finding] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)

    def row(self, index: int) -> int:
        """The line of the file that holds sample `index` (the header is line 1)."""
        return int(self.lines[index])


def digest(path: Path) -> str:
    """SHA-256 of the file's bytes, in hexadecimal."""
    total = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            total.update(block)
    return total.hexdigest()


def read_csv(
    path: Path, choose: Callable[[tuple[str, ...]], Sequence[str]], style: CsvStyle | None = None
) -> Table:
    """Reads the columns that `choose(header)` asks for; `InputError` names file, row and column of what is wrong."""
    style = style or CsvStyle()
    encoding, findings = _encoding(path, style.encoding)
    try:
        with _open(path, encoding) as file:
            return _read(path, file, choose, style, findings)
    except UnicodeError:
        pass
    except _BROKEN_GZIP as error:
        raise InputError(f"{path}: not a complete gzip file ({error}); compress it again") from None
    except csv.Error as error:
        raise InputError(f"{path}: not readable as CSV ({error})") from None
    if style.encoding:
        raise InputError(f"{path}: not encoded in {style.encoding} as its mapping says")
    findings.clear()  # the first pass may have told some already
    findings.append(Finding("encoding", "not UTF-8; read as Windows-1252", "save the log as UTF-8"))
    with _open(path, "cp1252", "replace") as file:
        return _read(path, file, choose, style, findings)


def _open(path: Path, encoding: str, errors: str = "strict") -> IO[str]:
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


def _read(
    path: Path,
    file: IO[str],
    choose: Callable[[tuple[str, ...]], Sequence[str]],
    style: CsvStyle,
    findings: list[Finding],
) -> Table:
    for _ in range(style.skip_rows):
        file.readline()
    first = file.readline()
    while first and not first.strip():
        first = file.readline()
        style = replace(style, skip_rows=style.skip_rows + 1)
    first = first.lstrip("\ufeff")
    start = style.skip_rows + 1
    if first.lower().startswith("sep=") and style.delimiter is None:
        style = replace(style, delimiter=first.strip()[4:] or ",")
        first = file.readline()
        start += 1
    delimiter = style.delimiter or _delimiter(first)
    if style.delimiter is None and delimiter != ",":
        shown = {"\t": "tab", " ": "blanks"}.get(delimiter, delimiter)
        findings.append(Finding("delimiter", f"columns are separated by {shown!r}, read so", "write commas"))
    lines_left: Iterator[str] = iter(file)
    if delimiter == " ":  # any run of blanks separates
        lines_left = ("\t".join(line.split()) + "\n" for line in lines_left)
        # A unit in brackets belongs to the name before it.
        first, delimiter = "\t".join(re.sub(r"\s+(?=[(\[])", "", first).split()) + "\n", "\t"
    names = tuple(name.strip() for name in next(csv.reader([first], delimiter=delimiter)))
    while names and not names[-1]:
        names = names[:-1]
    numbers_only = bool(names) and all(_is_value(name, style.si_suffixes) for name in names)
    if style.header is False or (style.header is None and numbers_only):
        lines_left = itertools.chain([first], lines_left)
        names = tuple(str(place + 1) for place in range(len(names)))
        start -= 1
    elif names and all(_is_number(name) for name in names):
        raise InputError(
            f"{path}: row {start} holds numbers where the header should be; add the line of column names"
        )
    wanted = list(dict.fromkeys(choose(names)))
    for name in wanted:
        if names.count(name) > 1:
            found = [str(i + 1) for i, other in enumerate(names) if other == name]
            raise InputError(
                f"{path}: column {name!r} appears {len(found)} times (columns {', '.join(found)}); keep one of them"
            )
    lines_left, units = _units_row(lines_left, names, delimiter, style.si_suffixes)
    if units:
        findings.append(Finding("units_row", f"row {start + 1} holds units, read so", row=start + 1))
        start += 1
    units = {**_units_in_names(names), **units}
    parse = _Cells(path, names, style, delimiter, findings)
    places = [names.index(name) for name in wanted]
    parts: list[np.ndarray] = []
    lines: list[np.ndarray] = []
    while text := list(itertools.islice(lines_left, _CHUNK)):
        numbers = np.arange(start + 1, start + 1 + len(text))
        start += len(text)
        block = parse.plain(text, places)
        if block is None:
            block, numbers = parse.careful(text, places, wanted, numbers)
        if np.isinf(block).any():
            row, place = np.argwhere(np.isinf(block))[0]
            raise InputError(
                f"{path}: row {numbers[row]}, column {wanted[place]!r}: infinite; "
                "leave the cell empty where nothing was measured"
            )
        parts.append(block)
        lines.append(numbers)
    if not sum(map(len, parts)):
        raise InputError(f"{path}: only a header, no rows; a log needs at least two samples")
    columns = {
        name: np.concatenate([block[:, place] for block in parts]) for place, name in enumerate(wanted)
    }
    return Table(path, names, columns, np.concatenate(lines), findings, units)


def _units_row(
    lines: Iterator[str], names: tuple[str, ...], delimiter: str, si_suffixes: bool
) -> tuple[Iterator[str], dict[str, str]]:
    """The lines after the header, without a row of units where there is one, and the units by column."""
    first = next(lines, None)
    if first is None:
        return lines, {}
    back = itertools.chain([first], lines)
    try:
        cells = [cell.strip().strip("[]()") for cell in next(csv.reader([first], delimiter=delimiter))]
    except (csv.Error, StopIteration):
        return back, {}
    if any(_is_value(cell, si_suffixes) or _seconds(cell) is not None for cell in cells) or len(cells) < len(
        names
    ):
        return back, {}
    units = {
        name: cell
        for name, cell in zip(names, cells, strict=False)
        if cell and cell.lower() not in _MISSING and _is_unit(cell)
    }
    return (lines, units) if len(units) >= 2 else (back, {})


def _units_in_names(names: tuple[str, ...]) -> dict[str, str]:
    """`p1 [kPa]` gives kPa."""
    found = {}
    for name in names:
        match = re.search(r"[\[(]([^\])]*)[\])]\s*$", name)
        if match and match[1].strip() and not _is_number(match[1]) and _is_unit(match[1].strip()):
            found[name] = match[1].strip()
    return found


def _is_unit(text: str) -> bool:
    try:
        unit(text)
    except InputError:
        return False
    return True


def _delimiter(header: str) -> str:
    counts = {mark: header.count(mark) for mark in ("\t", ";", ",", "|")}
    best = max(counts, key=lambda mark: counts[mark])
    if counts[best]:
        return best
    return " " if len(header.split()) > 1 else ","


class _Cells:
    """Turns lines of text into numbers."""

    def __init__(
        self, path: Path, names: tuple[str, ...], style: CsvStyle, delimiter: str, findings: list[Finding]
    ) -> None:
        self.path, self.names, self.style, self.delimiter, self.findings = (
            path,
            names,
            style,
            delimiter,
            findings,
        )
        self.decimal_comma = style.decimal == ","

    def plain(self, text: list[str], places: list[int]) -> np.ndarray | None:
        """Lines of complete rows of plain numbers as (rows, places), or None where there is anything else."""
        if self.decimal_comma or self.style.si_suffixes:
            return None
        if any(line.count(self.delimiter) != len(self.names) - 1 or '"' in line for line in text):
            return None
        try:
            return np.loadtxt(text, delimiter=self.delimiter, usecols=places, ndmin=2, comments=None)
        except ValueError:
            return None

    def careful(
        self, text: list[str], places: list[int], wanted: list[str], numbers: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same cell by cell, with holes and other spellings; also the lines' numbers without the empty lines."""
        values = array("d")
        kept: list[int] = []
        width = len(self.names)
        rows = csv.reader(text, delimiter=self.delimiter)
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            line = int(numbers[rows.line_num - 1])
            if len(row) < width or any(row[width:]):
                hint = "a cell is missing, or the recording was cut off here"
                if len(row) > width and self.delimiter == ",":
                    hint = "decimal commas need another delimiter: write 0.5, or separate the columns by ';'"
                raise InputError(
                    f"{self.path}: row {line} has {len(row)} cells, the header has {width}; {hint}"
                )
            kept.append(line)
            values.extend(
                self.cell(row[place], name, line) for place, name in zip(places, wanted, strict=True)
            )
        return np.array(values).reshape(len(kept), len(places)), np.array(kept, dtype=np.int64)

    def cell(self, text: str, name: str, line: int) -> float:
        if not (self.decimal_comma and "." in text):
            try:
                return float(text)
            except ValueError:
                pass
        text = text.strip()
        if text.lower() in _MISSING:
            return math.nan
        # With another delimiter a comma inside a number can only be the decimal mark (or, far rarer, thousands).
        may_be_decimal = self.decimal_comma or (self.style.decimal is None and self.delimiter != ",")
        if may_be_decimal and text.count(",") == 1 and "." not in text and _is_number(text.replace(",", ".")):
            if not self.decimal_comma and self.style.decimal is None:
                message = f"numbers are written with a decimal comma ({text!r} in row {line}), read so"
                self.findings.append(
                    Finding("decimal_comma", message, "write decimal points", column=name, row=line)
                )
                self.decimal_comma = True
            return float(text.replace(",", "."))
        stamp = _seconds(text)
        if stamp is not None:
            if not any(f.code == "time_stamps" for f in self.findings):
                message = f"times are written as dates or hours ({text!r} in row {line}), read as seconds"
                self.findings.append(Finding("time_stamps", message, column=name, row=line))
            return stamp
        if self.style.si_suffixes and text[-1:] in _SI_SUFFIX and _is_number(text[:-1]):
            return float(text[:-1]) * _SI_SUFFIX[text[-1]]
        hint = "write a number, or leave the cell empty where nothing was measured"
        if self.decimal_comma and _is_number(text):
            hint = "decimal commas are used elsewhere in the file; write all numbers alike"
        elif "," in text and "." in text:
            hint = "write it without thousands separators, with a decimal point"
        elif text[-1:] in _SI_SUFFIX and _is_number(text[:-1]):
            hint = "for suffixes such as m and k say `si_suffixes: true` under `table` in the mapping"
        elif text.count(":") >= 1:
            hint = "time stamps are seconds as a plain number, hh:mm:ss.sss, or yyyy-mm-dd hh:mm:ss.sss"
        raise InputError(f"{self.path}: row {line}, column {name!r}: {text!r} is not a number; {hint}")


_HOURS = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)")


def _seconds(text: str) -> float | None:
    """The seconds of a time of day (since midnight) or of a date and time in ISO 8601 (since 1970), or None."""
    match = _HOURS.fullmatch(text)
    if match:
        return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", "."))
    if text[4:5] != "-" or text[7:8] != "-":
        return None
    day, _, time = text.replace("T", " ").partition(" ")
    zone = time.rstrip("Z")
    match = _HOURS.fullmatch(zone)
    try:
        midnight = datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    return (
        midnight + 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3].replace(",", "."))
        if match
        else None
    )


def _is_value(text: str, si_suffixes: bool) -> bool:
    return _is_number(text) or (si_suffixes and text[-1:] in _SI_SUFFIX and _is_number(text[:-1]))


def _is_number(text: str) -> bool:
    try:
        float(text.strip())
    except ValueError:
        return False
    return True
