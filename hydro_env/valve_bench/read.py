"""A measured curve from a file: columns and units become SI here.

CSV, tab or blank separated text (also gzipped, with or without a header, with suffixes such as 25.1m), and the binary
formats of `hydro_env.measured`. What is missing from the file is said by `Columns`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydro_env.errors import InputError, located
from hydro_env.measured.finding import SPELLING
from hydro_env.measured.formats import ENDINGS, read_table
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.names import named_unit
from hydro_env.measured.table import Table, place_of
from hydro_env.reading import check_file
from hydro_env.units import Unit, to_si, unit
from hydro_env.valve_bench.curve import Curve, Floats, branches_of

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
        found.update(_chosen(columns, names))
        return list(found.values())

    table = read_table(path, choose, TableStyle(si_suffixes=True))
    ending = max((each for each in ENDINGS if path.name.endswith(each)), key=len, default="")
    with located(path):
        curve = _curve(table, found, columns, name or path.name.removesuffix(ending))
    return replace(curve, findings=tuple(f"{path.name}: {each}" for each in curve.findings))


def _curve(table: Table, found: dict[str, str], columns: Columns, name: str) -> Curve:
    """The curve of a table; `found` are the columns of signal, flow and, if it is one, time."""
    findings = [each.message for each in table.findings if each.code not in SPELLING]
    cells = np.array([table.columns[column] for column in found.values()])
    whole = np.isfinite(cells).all(axis=0)
    if not whole.all():
        missing, first = int(np.count_nonzero(~whole)), table.row(int(np.argmin(whole)))
        if missing > HOLES * len(whole):
            told = f"{missing} of {len(whole)} rows lack a number in {', '.join(found.values())} (first: row {first})"
            raise InputError(f"{told}; name the columns of the curve")
        findings.append(f"{missing} rows without a number left out, the first is row {first}")
    values = dict(zip(found, cells[:, whole], strict=True))
    suffixed = any(each.code == "si_suffixes" for each in table.findings)
    signal_unit = _unit("signal", found["signal"], columns.signal_unit, suffixed, tuple(QUANTITIES))
    flow_unit = _unit("flow", found["flow"], columns.flow_unit, suffixed, ("flow",))
    signal = np.asarray(to_si(values["signal"], signal_unit.name))
    if columns.rated is None:
        rated = float(np.abs(signal).max()) if len(signal) else 0.0
        findings.append("rated signal taken to be the largest in the file; say --rated if it is another")
    else:
        rated = float(to_si(columns.rated, signal_unit.name))
    if not rated > 0.0:
        raise InputError(f"the rated signal is {rated:g}, column {found['signal']!r}; it must be positive")
    flow = np.asarray(to_si(values["flow"], flow_unit.name))
    curve = Curve(name, signal, flow, QUANTITIES[signal_unit.quantity], rated, findings=tuple(findings))
    branches = branches_of(curve)
    if "time" in found:
        time = _times(values["time"], found["time"], columns.time_unit, table.lines[whole])
        return replace(curve, time=time)
    if columns.row_period is not None:
        return replace(curve, time=np.asarray(np.flatnonzero(whole) * columns.row_period, dtype=float))
    if columns.sweep_period is None:
        return curve
    # A whole triangle passes its range twice.
    way = sum(abs(signal[branch.stop - 1] - signal[branch.start]) for branch in branches)
    rows = sum(branch.stop - branch.start for branch in branches)
    step = columns.sweep_period * way / (2.0 * float(np.ptp(signal)) * rows)
    return replace(curve, time=np.arange(len(signal)) * step)


def _chosen(wanted: Columns, names: tuple[str, ...]) -> dict[str, str]:
    """The columns of signal, flow and, if it is one, time."""
    if len(names) < 2:
        told = f"one column ({names[0] if names else 'none'})"
        raise InputError(f"{told}; a curve needs signal and flow, separated by commas, tabs or blanks")
    roles = {"signal": wanted.signal or "1", "flow": wanted.flow or "2", "time": wanted.time}
    found = {role: names[place_of(names, name)] for role, name in roles.items() if name is not None}
    if len(set(found.values())) < len(found):
        raise InputError(f"signal, flow and time must be different columns, not {found}")
    return found


def _times(values: Floats, column: str, given: str | None, lines: Floats) -> Floats:
    """The times of the rows, s, from a column; `lines` are those of the file."""
    name = given or _in_header(column) or "s"
    time = np.asarray(to_si(values, _unit("time", column, name, False, ("time",)).name))
    back = np.flatnonzero(np.diff(time) < 0.0)
    if len(back):
        n = int(back[0]) + 1
        told = f"row {lines[n]}, column {column!r}: time goes back from {time[n - 1]:g} s to {time[n]:g} s"
        raise InputError(f"{told}; sort the rows, or keep one recording per file")
    return time


def _in_header(column: str) -> str | None:
    """The unit that a column's name gives: `Current (mA)`, `flow [l/min]`, `flow_lpm`."""
    found, _ = named_unit(column)
    return found.name if found else None


def _unit(role: str, column: str, given: str | None, suffixed: bool, quantities: tuple[str, ...]) -> Unit:
    """The unit of a column, as given or as its name says it."""
    name = given if given is not None else _in_header(column)
    if name is None:
        usual = "mA, V or percent" if role == "signal" else "l/min"
        raise InputError(f"column {column!r} says no unit; give it by --{role}-unit, such as {usual}")
    try:
        known = unit(name)
    except InputError as problem:
        raise InputError(f"--{role}-unit: {problem}" if given else problem) from None
    if known.quantity not in quantities:
        told = f"{name!r} is a unit of {known.quantity}, the {role} needs one of {', '.join(quantities)}"
        raise InputError(f"column {column!r}: {told}; is it the right column?")
    if given is None and suffixed and known.name[:1] in "mku" and known.name not in ("m", "m3/s", "m3/h"):
        told = f"column {column!r}: numbers carry suffixes such as 1m and the header's unit is {name}"
        which = f"so the prefix may count once or twice; say which by --{role}-unit"
        raise InputError(f"{told}, {which}, {name[1:]} if 1m means 1 {name}")
    return known
