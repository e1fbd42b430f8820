"""Commands from a table that a practice rig plays, such as the next experiment that a diagnosis proposes."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..reading import read_text
from .hidden import number
from .manoeuvres import Plan

#: Longest log that is played, s.
MAX_DURATION = 3600.0
_COMMANDS, _LOADS = ("command_1_V", "command_2_V"), ("load_1_Nm", "load_2_Nm")


def plans_of(path: str | Path, rated_V: tuple[float, float], period: float) -> list[Plan]:
    """The plan of each channel from a CSV file with `time_s` and `command_1_V`, `command_2_V` or both; `load_1_Nm` and
    `load_2_Nm` may be there.

    Each row holds until the next one, the last as long as the one before it; a channel without a column is at rest. Rows are
    taken at every `period` s. InputError for a file that cannot be read, a column that is missing, a value that is no number
    or beyond the rated command, and times that do not rise.
    """
    columns = _columns(path)
    time = columns["time_s"]
    if len(time) < 2:
        raise InputError(f"{path}: one row; expected at least two rows with rising time_s")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if late.size:
        raise InputError(
            f"{path}: row {late[0] + 3}: time_s does not rise; each row must be later than the one before"
        )
    end = 2.0 * time[-1] - time[-2] - time[0]
    if end > MAX_DURATION:
        raise InputError(f"{path}: {end:g} s of commands; expected {MAX_DURATION:g} s at most")
    at = np.arange(max(1, round(end / period))) * period
    rows = np.searchsorted(time - time[0], at + 1e-9 * period, side="right") - 1
    nothing = np.zeros(len(time))
    found = []
    for command, load, rated in zip(_COMMANDS, _LOADS, rated_V, strict=True):
        volts = columns.get(command, nothing)
        beyond = np.flatnonzero(np.abs(volts) > rated * (1.0 + 1e-9))
        if beyond.size:
            raise InputError(
                f"{path}: row {beyond[0] + 2}: {command} is {volts[beyond[0]]:g}; the rated command is {rated:g} V"
            )
        closed = np.zeros(len(at), bool)
        found.append(Plan((volts / rated)[rows], closed, columns.get(load, nothing)[rows]))
    return found


def _columns(path: str | Path) -> dict[str, NDArray[np.float64]]:
    """The columns that are understood; row numbers in messages count the header as row 1."""
    text = read_text(path, "a CSV file of commands")
    try:
        rows = list(csv.DictReader(text.splitlines()))
    except csv.Error as error:
        raise InputError(f"{path}: not a CSV file of commands: {error}") from None
    names = [n for n in ("time_s", *_COMMANDS, *_LOADS) if rows and n in rows[0]]
    if "time_s" not in names or not {*names} & {*_COMMANDS}:
        raise InputError(
            f"{path}: columns time_s and command_1_V, command_2_V or both are needed, with rows below them"
        )
    found = {name: np.array([number(row[name]) for row in rows]) for name in names}
    for name, values in found.items():
        for n in np.flatnonzero(np.isnan(values))[:1]:
            raise InputError(f"{path}: row {n + 2}, column {name!r}: {rows[n][name]!r} is not a number")
    return found
