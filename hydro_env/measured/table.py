"""A recorded table: named columns of numbers with the lines of the file that hold them, and what a log file may be."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hydro_env.errors import InputError, suggestion
from hydro_env.measured.finding import Finding

#: Numbers that a log may hold: ten signals for a day at 1 kHz, 7 GB. A file that claims or unpacks to more is refused before
#: it fills the memory.
MAX_VALUES = 864_000_000


@dataclass
class Table:
    """Columns (T,) of float64 by name, NaN where a cell is empty; `lines` are the file's line numbers (T,); `units` what
    the file itself says of a column's unit."""

    names: tuple[str, ...]
    columns: dict[str, np.ndarray]
    lines: np.ndarray
    findings: list[Finding] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)

    def row(self, index: int) -> int:
        """The line of the file that holds sample `index` (the header is line 1)."""
        return int(self.lines[index])

    def refused(self, column: str, problem: str, index: int | None = None) -> InputError:
        """The error for a column that cannot be used, because of sample `index` if that is given."""
        where = "" if index is None else f"row {self.row(index)}, "
        return InputError(f"{where}column {column!r}: {problem}")


def place_of(names: Sequence[str], wanted: str) -> int:
    """The place of a column, by its name or, where the file has no such name, by its number from 1."""
    found = [place for place, name in enumerate(names) if name == wanted]
    if len(found) > 1:
        places = ", ".join(str(n + 1) for n in found)
        told = f"column {wanted!r} appears {len(found)} times (columns {places})"
        raise InputError(f"{told}; keep one of them, or call it by its number")
    if found:
        return found[0]
    if wanted.isdecimal() and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    raise InputError(f"column {wanted!r} is not in the header; {suggestion(wanted, names)}")


def check_size(values: int) -> None:
    """InputError if a log of `values` numbers (rows times columns) is too large to read."""
    if values > MAX_VALUES:
        told = f"holds or claims more than {MAX_VALUES:,} numbers (ten signals for a day at 1 kHz)"
        raise InputError(f"{told}; export a shorter part, or fewer columns")
