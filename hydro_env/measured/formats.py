"""A file of any log format as a table of named columns: CSV, and here Parquet, MAT 5 and 7.3, MDF 4 and TDMS.

MAT 5 needs nothing beyond the core; the others need the libraries of the extra `measured`, imported on first use.
In MAT files a column is a numeric vector (structures are named with dots, `log.speed`; the columns of a matrix are
`data(:,1)`, ...), in TDMS files a channel (its name, or `group/channel` where that is ambiguous), in MDF files a channel
(all put on the fastest clock, as column `time_s` where the file has no such channel). Units that MDF and TDMS files carry
are in the table's `units`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError
from hydro_env.measured.csv_file import CsvStyle, read_csv
from hydro_env.measured.table import Table

__all__ = ["is_binary", "read_table"]

Choose = Callable[[tuple[str, ...]], Sequence[str]]


def is_binary(path: Path) -> bool:
    """Whether the name says that a file is in a binary format."""
    return (path.with_suffix("").suffix if path.suffix == ".gz" else path.suffix).lower() in BINARY


def read_table(path: Path, choose: Choose, style: CsvStyle | None = None) -> Table:
    """Reads the columns that `choose(names)` asks for from a file of any format; `style` is that of a CSV file.

    `InputError` names the file and what would be right, of CSV also row and column.
    """
    return read_binary(path, choose) if is_binary(path) else read_csv(path, choose, style)


def read_binary(path: Path, choose: Choose) -> Table:
    """Reads the columns that `choose(names)` asks for; `InputError` names the file and what would be right."""
    reader, what = BINARY[path.suffix.lower()]
    units: dict[str, str] = {}
    if not path.stat().st_size:
        raise InputError(f"{path}: the file is empty; a log needs columns and rows")
    try:
        available = reader(path, units)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # each library has its own family of errors
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InputError(
            f"{path}: not readable as {what} ({reason}); export it again or save it as CSV"
        ) from None
    if not available:
        raise InputError(f"{path}: not readable as {what} (no columns); export it again or save it as CSV")
    columns: dict[str, np.ndarray] = {}
    for name in choose(tuple(available)):
        try:
            values = np.asarray(available[name]())
            if values.dtype.kind in "mM":  # dates and durations, as seconds
                values = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64) / 1e9
            columns[name] = values.astype(float).ravel()
        except (TypeError, ValueError):
            raise InputError(
                f"{path}: column {name!r} holds no numbers; a log's columns are plain numbers"
            ) from None
        infinite = np.flatnonzero(np.isinf(columns[name]))
        if len(infinite):
            raise InputError(
                f"{path}: row {infinite[0] + 1}, column {name!r}: infinite; put NaN where nothing was measured"
            )
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name!r} {count}" for name, count in lengths.items())
        raise InputError(
            f"{path}: columns of different lengths ({shown}); put all signals on one clock before exporting"
        )
    count = next(iter(lengths.values()), 0)
    if count == 0:
        raise InputError(f"{path}: no rows; a log needs at least two samples")
    return Table(path, tuple(available), columns, np.arange(1, count + 1), units=units)


def _library(name: str, path: Path) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.split(".")[0]
        raise InputError(
            f"{path}: reading {path.suffix} needs {package}; install the extra: pip install 'hydro_env[measured]'"
        ) from None


def _parquet(path: Path, units: dict[str, str]) -> dict[str, Callable[[], Any]]:
    parquet = _library("pyarrow.parquet", path)
    file = parquet.ParquetFile(path)

    def column(name: str) -> Callable[[], Any]:
        return lambda: file.read([name]).column(0).to_numpy()

    return {name: column(name) for name in file.schema_arrow.names}


def _mat(path: Path, units: dict[str, str]) -> dict[str, Callable[[], Any]]:
    with open(path, "rb") as file:
        is_hdf = b"MATLAB 7.3" in file.read(128)
    if is_hdf:
        return _mat73(path)
    from scipy.io import loadmat

    content = loadmat(path, squeeze_me=True, struct_as_record=False)
    columns: dict[str, Callable[[], Any]] = {}
    for name, values in _vectors({key: value for key, value in content.items() if not key.startswith("__")}):
        columns[name] = lambda values=values: values  # type: ignore[misc]
    return columns


def _vectors(content: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        fields = getattr(value, "_fieldnames", None)
        if fields:
            yield from _vectors({field: getattr(value, field) for field in fields}, f"{prefix}{key}.")
        elif isinstance(value, np.ndarray) and value.ndim == 1:
            yield prefix + key, value
        elif isinstance(value, np.ndarray) and value.ndim == 2 and value.dtype.kind in "biuf":
            for number in range(value.shape[1] if value.shape[1] <= 64 < value.shape[0] else 0):
                yield f"{prefix}{key}(:,{number + 1})", value[:, number]


def _mat73(path: Path) -> dict[str, Callable[[], Any]]:
    h5py = _library("h5py", path)
    columns: dict[str, Callable[[], Any]] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, item: Any) -> None:
            if (
                isinstance(item, h5py.Dataset)
                and not name.startswith("#")
                and item.size == max(item.shape, default=0)
            ):
                values = item[()]
                columns[name.replace("/", ".")] = lambda: values
            elif isinstance(item, h5py.Dataset) and not name.startswith("#") and item.ndim == 2:
                matrix = item[()]  # MATLAB writes column by column, so a matrix lies on its side here
                for number in range(matrix.shape[0] if matrix.shape[0] <= 64 < matrix.shape[1] else 0):
                    columns[f"{name.replace('/', '.')}(:,{number + 1})"] = lambda row=matrix[number]: row  # type: ignore[misc]

        file.visititems(visit)
    return columns


def _mdf(path: Path, units: dict[str, str]) -> dict[str, Callable[[], Any]]:
    asammdf = _library("asammdf", path)
    with asammdf.MDF(path) as file:
        signals = {
            name: file.get(name, group=places[0][0], index=places[0][1])
            for name, places in file.channels_db.items()
        }
    masters = [signal.timestamps for signal in signals.values() if len(signal)]
    clock = max(masters, key=len) if masters else np.zeros(0)
    columns: dict[str, Callable[[], Any]] = {}
    for name, signal in signals.items():
        if signal.samples.dtype.kind not in "biuf":
            continue

        def values(signal: Any = signal) -> Any:
            if len(signal.timestamps) == len(clock) and np.array_equal(signal.timestamps, clock):
                return signal.samples
            # A slower raster holds its last value until the next one; before its first sample nothing is known.
            last = np.searchsorted(signal.timestamps, clock, side="right") - 1
            return np.where(last >= 0, signal.samples[np.maximum(last, 0)].astype(float), np.nan)

        columns[name] = values
        if signal.unit:
            units[name] = str(signal.unit)
    columns.setdefault("time_s", lambda: clock)
    return columns


def _tdms(path: Path, units: dict[str, str]) -> dict[str, Callable[[], Any]]:
    tdms = _library("nptdms", path)
    file = tdms.TdmsFile.read(path)
    channels = [channel for group in file.groups() for channel in group.channels()]
    names = [channel.name for channel in channels]
    columns: dict[str, Callable[[], Any]] = {}
    for channel in channels:
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        columns[name] = lambda channel=channel: channel[:]  # type: ignore[misc]
        if channel.properties.get("unit_string"):
            units[name] = str(channel.properties["unit_string"])
    if "time_s" not in columns and channels and "wf_increment" in channels[0].properties:
        columns["time_s"] = lambda: channels[0].time_track()
    return columns


BINARY: dict[str, tuple[Callable[[Path, dict[str, str]], dict[str, Callable[[], Any]]], str]] = {
    ".parquet": (_parquet, "Parquet"),
    ".mat": (_mat, "a MAT file"),
    ".mf4": (_mdf, "MDF 4"),
    ".mdf": (_mdf, "MDF"),
    ".tdms": (_tdms, "TDMS"),
}
