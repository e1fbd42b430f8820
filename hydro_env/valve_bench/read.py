"""A measured curve from a file: columns and units become SI here.

CSV, tab or blank separated text (also gzipped, with or without a header, with suffixes such as 25.1m), and the binary
formats of `hydro_env.measured`. What is missing from the file is said by `Columns`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydro_env.errors import InputError, suggestion
from hydro_env.measured.finding import SPELLING
from hydro_env.measured.formats import ENDINGS, read_table
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.names import named_unit
from hydro_env.reading import check_file
from hydro_env.units import Unit, to_si, unit
from hydro_env.valve_bench.curve import Curve, Floats, branches_of

__all__ = ["Columns", "read_curve"]

#: What a valve's input may be measured as, and the unit it has in a curve.
QUANTITIES = {"current": "A", "voltage": "V", "fraction": "1", "length": "m"}
#: Most rows of a file that may lack a number.
HOLES = 0.5


@dataclass(frozen=True)
class Columns:
    """What the columns are. A column is a name of the header or its number from 1; None means: the first column is
    the signal, the second the flow, and a unit stands in the header.

    `rated` is the rated signal in its unit. Time is a column, or follows from `row_period` (s between rows) or
    `sweep_period` (s for one whole triangle); without any the sweep rate is unknown.
    """

    signal: str | None = None
    flow: str | None = None
    time: str | None = None
    signal_unit: str | None = None
    flow_unit: str | None = None
    time_unit: str | None = None
    rated: float | None = None
    row_period: float | None = None
    sweep_period: float | None = None


def read_curve(path: str | Path, columns: Columns | None = None, *, name: str | None = None) -> Curve:
    """Reads a measured curve. InputError, naming file, row or column, for whatever cannot be used."""
    path, columns = Path(path), columns or Columns()
    check_file(path, "a measured curve, a model or a preset")
    found: dict[str, str] = {}

    def choose(names: tuple[str, ...]) -> list[str]:
        found.update(_chosen(path, columns, names))
        return list(found.values())

    table = read_table(path, choose, TableStyle(si_suffixes=True))
    findings = [each.message for each in table.findings if each.code not in SPELLING]
    cells = np.array([table.columns[column] for column in found.values()])
    whole = np.isfinite(cells).all(axis=0)
    if not whole.all():
        missing, first = int(np.count_nonzero(~whole)), table.row(int(np.argmin(whole)))
        if missing > HOLES * len(whole):
            raise InputError(
                f"{path}: {missing} of {len(whole)} rows lack a number in {', '.join(found.values())} (first: row {first}); "
                "name the columns of the curve"
            )
        findings.append(f"{missing} rows without a number left out, the first is row {first}")
    values = dict(zip(found, cells[:, whole], strict=True))
    suffixed = any(each.code == "si_suffixes" for each in table.findings)
    signal_unit = _unit(path, "signal", found["signal"], columns.signal_unit, suffixed, tuple(QUANTITIES))
    flow_unit = _unit(path, "flow", found["flow"], columns.flow_unit, suffixed, ("flow",))
    signal = np.asarray(to_si(values["signal"], signal_unit.name))
    if columns.rated is None:
        rated = float(np.abs(signal).max()) if len(signal) else 0.0
        findings.append("rated signal taken to be the largest in the file; say --rated if it is another")
    else:
        rated = float(to_si(columns.rated, signal_unit.name))
    if not rated > 0.0:
        raise InputError(
            f"{path}: the rated signal is {rated:g}, column {found['signal']!r}; it must be positive"
        )
    ending = max((each for each in ENDINGS if path.name.endswith(each)), key=len, default="")
    try:
        curve = Curve(
            name=name or path.name.removesuffix(ending),
            signal=signal,
            flow=np.asarray(to_si(values["flow"], flow_unit.name)),
            signal_unit=QUANTITIES[signal_unit.quantity],
            rated=rated,
            findings=tuple(f"{path.name}: {each}" for each in findings),
        )
        return replace(curve, time=_time(path, curve, columns, found, values, whole, table.lines[whole]))
    except InputError as problem:
        raise InputError(str(problem) if str(path) in str(problem) else f"{path}: {problem}") from None


def _chosen(path: Path, wanted: Columns, names: tuple[str, ...]) -> dict[str, str]:
    """The columns of signal, flow and, if it is one, time."""
    if len(names) < 2:
        raise InputError(
            f"{path}: one column ({names[0] if names else 'none'}); a curve needs signal and flow, separated by commas, tabs or "
            "blanks"
        )
    roles = {"signal": wanted.signal or "1", "flow": wanted.flow or "2", "time": wanted.time}
    found: dict[str, str] = {}
    for role, name in roles.items():
        if name in names:
            found[role] = name
        elif name is not None and name.isdigit() and 1 <= int(name) <= len(names):
            found[role] = names[int(name) - 1]
        elif name is not None:
            raise InputError(f"{path}: no column {name!r} for the {role}; {suggestion(name, names)}")
    if len(set(found.values())) < len(found):
        raise InputError(f"{path}: signal, flow and time must be different columns, not {found}")
    return found


def _time(
    path: Path, curve: Curve, columns: Columns, found: dict[str, str], values: dict[str, Floats], whole: np.ndarray,
    lines: np.ndarray,
) -> Floats | None:  # fmt: skip
    """The times of the rows, s, from a column or a period; None where nothing says them."""
    branches = branches_of(curve)
    for option in ("row_period", "sweep_period"):
        period = getattr(columns, option)
        if period is not None and not period > 0.0 and "time" not in found:
            raise InputError(f"--{option.replace('_', '-')} is {period:g}, expected more than 0 s")
    if "time" in found:
        column = found["time"]
        time_unit = columns.time_unit or _in_header(column) or "s"
        if unit(time_unit).quantity != "time":
            raise InputError(f"{path}: column {column!r}: {time_unit!r} is no unit of time")
        time = np.asarray(to_si(values["time"], time_unit))
        back = np.flatnonzero(np.diff(time) < 0.0)
        if len(back):
            n = int(back[0]) + 1
            raise InputError(
                f"{path}: row {lines[n]}, column {column!r}: time goes back from {time[n - 1]:g} s to {time[n]:g} s; "
                "sort the rows, or keep one recording per file"
            )
        return time
    if columns.row_period is not None:
        return np.asarray(np.flatnonzero(whole) * columns.row_period, dtype=float)
    if columns.sweep_period is None:
        return None
    # A whole triangle passes its range twice.
    way = sum(abs(curve.signal[branch.stop - 1] - curve.signal[branch.start]) for branch in branches)
    rows = sum(branch.stop - branch.start for branch in branches)
    step = columns.sweep_period * way / (2.0 * float(np.ptp(curve.signal)) * rows)
    return np.asarray(np.arange(len(curve.signal)) * step)


def _in_header(column: str) -> str | None:
    """The unit that a column's name gives: `Current (mA)`, `flow [l/min]`, `flow_lpm`."""
    found, _ = named_unit(column)
    return found.name if found else None


def _unit(
    path: Path, role: str, column: str, given: str | None, suffixed: bool, quantities: tuple[str, ...]
) -> Unit:
    name = given if given is not None else _in_header(column)
    if name is None:
        raise InputError(f"{path}: column {column!r} says no unit; give it by --{role}-unit, such as " + (
            "mA, V or percent" if role == "signal" else "l/min"))  # fmt: skip
    try:
        known = unit(name)
    except InputError as problem:
        raise InputError(f"--{role}-unit: {problem}" if given else f"{path}: {problem}") from None
    if known.quantity not in quantities:
        raise InputError(
            f"{path}: column {column!r}: {name!r} is a unit of {known.quantity}, the {role} needs one of "
            f"{', '.join(quantities)}; is it the right column?"
        )
    if given is None and suffixed and known.name[:1] in "mku" and known.name not in ("m", "m3/s", "m3/h"):
        raise InputError(
            f"{path}: column {column!r}: numbers carry suffixes such as 1m and the header's unit is {name}, so the prefix may "
            f"count once or twice; say which by --{role}-unit, {name[1:]} if 1m means 1 {name}"
        )
    return known
