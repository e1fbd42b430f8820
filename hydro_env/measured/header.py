"""Where the table of a text file begins: what stands above it, its delimiter, the names and units of its columns.

A table is many lines alike, so its shape is taken from the last lines of the beginning of a file, and its first row is the
first line of that shape. The line above holds the names (or units, and the one above that the names). What stands further up
is passed over: titles, lines of key and value, the header of LabVIEW. Columns without names are called "1", "2", ...
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hydro_env.errors import InputError
from hydro_env.measured.cell_text import MISSING, is_number, is_value, seconds
from hydro_env.measured.finding import Finding
from hydro_env.measured.names import bracketed, unit_of

_MARKS = ("\t", ";", ",", "|", " ")
#: Lines alike that make a table; lines from whose end its shape is taken.
_ALIKE, _TAIL = 3, 10
_COMMENT = re.compile(r"\s*(#|%|//)+\s*")


@dataclass(frozen=True)
class Header:
    """Column names, delimiter (" ": any run of blanks), the units that the file gives by name, and the number of the first
    row among the lines looked at. Rows may hold more cells than there are names if `open_end`."""

    names: tuple[str, ...]
    delimiter: str
    units: dict[str, str]
    first: int
    open_end: bool = False


class _Line(NamedTuple):
    """The cells of a line without blanks around them, none without letter or digit; whether it was written as a comment."""

    cells: list[str]
    comment: bool


def _line(text: str, delimiter: str) -> _Line:
    mark = _COMMENT.match(text)
    text = text[mark.end() :] if mark else text
    if delimiter == " ":  # a unit in brackets belongs to the name before it
        text, delimiter = "\t".join(re.sub(r"\s+(?=[(\[])", "", text).split()), "\t"
    cells = [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter), [])]
    # Lines of dashes or stars say nothing.
    return _Line(cells if any(c.isalnum() for c in text) else [], mark is not None)


@dataclass(frozen=True)
class _Shape:
    """What the rows of a table have in common: `width` cells, the last of them empty from `filled` on, numbers in the
    `numeric` columns."""

    width: int
    filled: int
    numeric: tuple[int, ...]

    def is_row(self, line: _Line) -> bool:
        kinds = self._kinds(line)
        # One more cell may be a remark; what a row may not hold is said when it is read.
        fits = self.filled <= len(line.cells) and not any(line.cells[self.width + 1 :]) and not line.comment
        return fits and kinds[0] != "text" and 2 * kinds.count("text") < len(kinds) and "value" in kinds

    def is_names(self, line: _Line) -> bool:
        kinds = self._kinds(line)
        fits = self.filled <= len(line.cells) <= self.width or _with_comment(line.cells, self.width)
        plain = "text" in kinds and "value" not in kinds
        return fits and (plain or (kinds[0] == "text" and not line.comment))

    def is_damaged_row(self, line: _Line) -> bool:
        return len(line.cells) > 1 and not line.comment and self._kinds(line)[0] == "value"

    def _kinds(self, line: _Line) -> list[str]:
        return [_kind(line.cells[place]) if place < len(line.cells) else "missing" for place in self.numeric]


def find_header(lines: Sequence[str], row: int, delimiter: str | None, findings: list[Finding]) -> Header:
    """The header in the first lines of a file, of which the first is row `row`. InputError for a delimiter that cannot be."""
    begin = next((n for n, line in enumerate(lines) if line.strip()), 0)
    if delimiter is None and lines and lines[begin].lower().startswith("sep="):
        delimiter = lines[begin].strip("\r\n")[4:] or ","
        if len(delimiter) > 1 and delimiter.strip():  # a blank or tab may be the separator itself
            delimiter = delimiter.strip()
        begin += 1
    elif delimiter is None:
        delimiter = _delimiter(lines)
        if delimiter != ",":
            name = {"\t": "tab", " ": "blanks"}.get(delimiter, delimiter)
            message = f"columns are separated by {name!r}, read so"
            findings.append(Finding("delimiter", message, "write commas"))
    if len(delimiter) != 1 or delimiter in '"\r\n' or delimiter.isalnum():
        told = f"columns cannot be separated by {delimiter!r}"
        raise InputError(f"{told}; one mark is right, such as ; in `sep=;` or in the mapping")
    parsed = [_Line([], False)] * begin + [_line(line, delimiter) for line in lines[begin:]]
    full = [n for n, line in enumerate(parsed) if line.cells]
    shape = _shape([parsed[n] for n in full])
    top = _top(parsed, full, shape) if shape else None
    if shape is None or top is None:
        # No table is seen: the first line holds the names, and reading says the rest.
        place = full[0] if full else 0
        return _named(parsed[place].cells if full else [], delimiter, place + 1)
    above = [n for n in full if n < top]
    names, units = _names_and_units(parsed, above, shape, top)
    if names is None:
        message = "no line of column names: the columns are called by their numbers, 1, 2, ..."
        findings.append(Finding("no_names", message, row=row + top))
        return Header(tuple(str(place + 1) for place in range(shape.filled)), delimiter, {}, top)
    if names > above[0]:
        message = f"the column names stand in row {row + names}; what is above them is passed over"
        findings.append(Finding("preamble", message, row=row + names))
    if units:
        place = row + above[-1]
        findings.append(Finding("units_row", f"row {place} holds units, read so", row=place))
    return _named(parsed[names].cells, delimiter, top, shape, units)


def _names_and_units(
    lines: Sequence[_Line], above: Sequence[int], shape: _Shape, top: int
) -> tuple[int | None, dict[int, str]]:
    """Which of the lines above the first row holds the names, and the units by place of a line below it that holds units."""
    if not above:
        return None, {}
    if len(above) > 1 and shape.is_names(lines[above[-2]]) and (units := _units(lines[above[-1]])):
        return above[-2], units
    names = above[-1]
    # Too few or too many names are an error that reading finds; titles, comments and what stands apart are none.
    apart = len(lines[names].cells) == 1 or lines[names].comment or names < top - 1
    return (None if apart and not shape.is_names(lines[names]) else names), {}


def _top(lines: Sequence[_Line], full: Sequence[int], shape: _Shape) -> int | None:
    """The first of several rows alike. Where a damaged row is above, the first row of all; None where that has none above it."""
    alike = [shape.is_row(lines[n]) for n in full]
    if True not in alike:
        return None
    first = alike.index(True)
    for n in range(first, len(full)):
        if all(alike[n : n + _ALIKE]):
            if n == 0 or not shape.is_damaged_row(lines[full[n - 1]]):
                return full[n]
            return full[first] if first < n else None
    return full[first]


def _shape(lines: Sequence[_Line]) -> _Shape | None:
    """The shape of the last lines, most of which are alike; None without numbers."""
    tail = [line.cells for line in lines[-min(_TAIL, len(lines) // 3 + 1) :]]
    counted: Counter[int] = Counter()
    for cells in tail:
        counted[len(cells)] += len(cells)
    width = max(counted, key=lambda each: counted[each], default=0)
    alike = [cells for cells in tail if len(cells) == width]
    kinds = [[_kind(cells[place]) for cells in alike] for place in range(width)]
    numeric = tuple(place for place in range(width) if 2 * kinds[place].count("value") >= len(alike))
    if not numeric:
        return None
    filled = 1 + max(place for place in range(width) if any(cells[place] for cells in alike))
    return _Shape(width, filled, numeric)


def _delimiter(lines: Sequence[str]) -> str:
    """The mark that makes most columns of numbers of the last lines; the most frequent of the first line where there are no
    numbers."""
    full = [line for line in lines if line.strip()]
    scores: dict[str, float] = {}
    for mark in _MARKS:
        shape = _shape([_line(line, mark) for line in full[-3 * _TAIL :]])
        if shape and shape.width > 1:
            scores[mark] = len(shape.numeric) - 0.5 * (shape.filled - len(shape.numeric))
    if not scores and full:
        scores = {mark: full[0].count(mark) for mark in _MARKS[:-1] if mark in full[0]}
    if scores:
        return max(scores, key=lambda mark: scores[mark])
    return " " if full and len(full[0].split()) > 1 else ","


def _kind(cell: str) -> str:
    if cell.lower() in MISSING:
        return "missing"
    comma = cell.count(",") == 1 and is_number(cell.replace(",", "."))
    return "value" if comma or is_value(cell) or seconds(cell) is not None else "text"


def _named(
    cells: Sequence[str],
    delimiter: str,
    first: int,
    shape: _Shape | None = None,
    below: dict[int, str] | None = None,
) -> Header:
    """The header of a line of names; units that do not stand behind the names stand in a line `below`, by place."""
    names = tuple(cells)
    while len(names) > (shape.filled if shape else 0) and not names[-1]:
        names = names[:-1]
    open_end = shape is not None and _with_comment(names, shape.width)
    names = names[:-1] if open_end else names
    units = {name: unit.name for name in names if (unit := bracketed(name))}
    units |= {names[place]: unit for place, unit in (below or {}).items() if place < len(names)}
    return Header(names, delimiter, units, first, open_end)


def _with_comment(names: Sequence[str], width: int) -> bool:
    """Whether the last name is that of LabVIEW's column of remarks: rows without one have no cell for it."""
    return len(names) == width + 1 and names[-1].lower() == "comment"


def _units(line: _Line) -> dict[int, str]:
    """Units by place where a line holds units, at least two."""
    found = [unit_of(cell.strip("[]()")) if cell.lower() not in MISSING else None for cell in line.cells]
    units = {place: unit.name for place, unit in enumerate(found) if unit}
    return units if len(units) > 1 else {}
