"""A file of any log format as a table of named columns: CSV, and here Parquet, MAT 5 and 7.3, MDF 3 and 4 and TDMS.

MAT 5 needs nothing beyond the core; the others need the libraries of the extra `measured`, imported on first use.
In MAT files a column is a numeric vector (structures are named with dots, `log.speed`; the columns of a matrix are
`data(:,1)`, ...), in TDMS files a channel (its name, or `group/channel` where that is ambiguous), in MDF files a channel
(all put on the fastest clock, as column `time_s` where the file has no such channel). Units that MDF and TDMS files carry
are in the table's `units`.

No file runs code. What a library would evaluate or fetch on behalf of a file is refused or not asked for: formulas, bus
databases and attachments of MDF files, data of HDF5 files that lie in other files.
"""

from __future__ import annotations

import importlib
import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, suggestion, to_install
from hydro_env.measured.csv_file import read_csv
from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.mat5 import read_mat5
from hydro_env.measured.table import Table, check_size
from hydro_env.reading import check_file

__all__ = ["ENDINGS", "is_binary", "read_table"]

Choose = Callable[[tuple[str, ...]], Sequence[str]]
#: The names of the columns of an open file, and what reads one of them.
Opened = tuple[Iterable[str], Callable[[str], Any]]


def is_binary(path: Path) -> bool:
    """Whether the name says that a file is in a binary format."""
    return (path.with_suffix("").suffix if path.suffix == ".gz" else path.suffix).lower() in BINARY


def read_table(path: Path, choose: Choose, style: TableStyle | None = None) -> Table:
    """Reads the columns that `choose(names)` asks for from a file of any format; `style` is that of a CSV file.

    `InputError` names the file and what would be right, of CSV also row and column.
    """
    check_file(path, "a log")
    try:
        table = read_binary(path, choose) if is_binary(path) else read_csv(path, choose, style)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); copy it again") from None
    except MemoryError:
        raise InputError(
            f"{path}: does not fit into memory; export a shorter part, or fewer columns"
        ) from None
    for name, values in table.columns.items():
        if (infinite := np.isinf(values)).any():
            raise InputError(
                f"{path}: row {table.row(int(np.argmax(infinite)))}, column {name!r}: infinite; leave it empty, or NaN, where "
                "nothing was measured"
            )
    return table


def read_binary(path: Path, choose: Choose) -> Table:
    """Reads the columns that `choose(names)` asks for; `InputError` names the file and what would be right."""
    if path.suffix == ".gz":
        raise InputError(f"{path}: only CSV files are read gzipped; unpack it first")
    reader, what = BINARY[path.suffix.lower()]
    if not path.stat().st_size:
        raise InputError(f"{path}: the file is empty; a log needs columns and rows")
    units: dict[str, str] = {}
    columns: dict[str, np.ndarray] = {}
    with _collected_warnings() as warned:
        try:
            with reader(path, units) as (available, read):
                names = tuple(available)
                if not names:
                    raise ValueError("no columns")
                for name in choose(names):
                    if name not in names:
                        raise InputError(
                            f"{path}: column {name!r} is not in the file; {suggestion(name, names)}"
                        )
                    columns[name] = _numbers(path, name, read(name))
                    check_size(path, len(columns[name]) * len(columns))
        except (InputError, MemoryError):
            raise
        except Exception as error:  # each library has its own family of errors
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            raise InputError(
                f"{path}: not readable as {what} ({reason}); export it again or save it as CSV"
            ) from None
    longest = max(columns, key=lambda name: len(columns[name]), default="")
    count = len(columns[longest]) if columns else 0
    for name, values in columns.items():
        if len(values) < count:
            raise InputError(
                f"{path}: column {name!r} holds {len(values)} values, {longest!r} {count}; put all signals on one clock before "
                "exporting"
            )
    if count == 0:
        raise InputError(f"{path}: no rows; a log needs at least two samples")
    findings = [
        Finding("damaged_file", f"reading it as {what} gave a warning: {text}", "is it complete?")
        for text in dict.fromkeys(warned)
    ]
    return Table(path, names, columns, np.arange(1, count + 1), findings, units=units)


def _numbers(path: Path, name: str, values: Any) -> np.ndarray:
    """A column as numbers (T,)."""
    values = np.asarray(values)
    try:
        if values.dtype.kind in "mM":  # dates and durations, as seconds
            values = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64) / 1e9
        elif values.dtype.kind not in "biuf":
            values = np.array([np.nan if value is None else value for value in values.ravel()])
        return values.astype(float).ravel()
    except (TypeError, ValueError):
        raise InputError(
            f"{path}: column {name!r} holds no numbers; a log's columns are plain numbers"
        ) from None


@contextmanager
def _collected_warnings() -> Iterator[list[str]]:
    """What the libraries say of a file while it is read, rather than print: some report damage in no other way."""
    found: list[str] = []

    def keep(record: logging.LogRecord) -> bool:
        found.append(record.getMessage().strip().partition("\n")[0])
        return False

    loggers = [logging.getLogger(name) for name in _TALKATIVE]
    for logger in loggers:
        logger.addFilter(keep)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield found
    finally:
        for logger in loggers:
            logger.removeFilter(keep)


def _library(name: str, path: Path) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.split(".")[0]
        raise InputError(f"{path}: reading {path.suffix} needs {package}: {to_install('measured')}") from None


@contextmanager
def _parquet(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    parquet = _library("pyarrow.parquet", path)
    with parquet.ParquetFile(path) as file:
        check_size(path, file.metadata.num_rows)
        yield file.schema_arrow.names, lambda name: file.read([name]).column(0).to_numpy()


@contextmanager
def _mat(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    with open(path, "rb") as file:
        is_hdf = b"MATLAB 7.3" in file.read(128)
    if is_hdf:
        with _mat73(path) as opened:
            yield opened
        return
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import matfile_version

    if matfile_version(path)[0] == 1:
        matrices = read_mat5(path)
    else:
        check_size(path, sum(math.prod(shape) for _, shape, _ in whosmat(path)))
        matrices = {name: values for name, values in loadmat(path).items() if not name.startswith("__")}
    vectors = dict(_vectors(matrices))
    yield vectors, vectors.__getitem__


def _vectors(matrices: dict[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    for name, values in matrices.items():
        if values.size > 1 and values.size == max(values.shape):
            yield name, values.ravel()
        elif values.ndim == 2 and values.shape[1] <= 64 < values.shape[0]:
            for number in range(values.shape[1]):
                yield f"{name}(:,{number + 1})", values[:, number]


@contextmanager
def _mat73(path: Path) -> Iterator[Opened]:
    h5py = _library("h5py", path)
    places: dict[str, tuple[Any, Any]] = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, item: Any) -> None:
            if not isinstance(item, h5py.Dataset) or name.startswith("#") or not item.shape:
                return
            dotted = name.replace("/", ".")
            if item.size == max(item.shape):
                places[dotted] = item, ()
            elif item.ndim == 2 and item.shape[0] <= 64 < item.shape[1]:
                # MATLAB writes column by column, so a matrix lies on its side here.
                places.update({f"{dotted}(:,{row + 1})": (item, row) for row in range(item.shape[0])})

        def read(name: str) -> Any:
            item, row = places[name]
            check_size(path, item.size)
            if item.external or item.is_virtual:
                raise InputError(f"{path}: {item.name} lies in another file; save the values themselves")
            return item[row]

        file.visititems(visit)
        yield places, read


@contextmanager
def _mdf(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    asammdf = _library("asammdf", path)
    # Bus logging would read databases that the file brings along.
    with closing(asammdf.MDF(path, process_bus_logging=False)) as file:
        for group in file.groups:
            record = group.channel_group.samples_byte_nr + getattr(
                group.channel_group, "invalidation_bytes_nr", 0
            )
            check_size(path, group.channel_group.cycles_nr * max(record // 8, 1))
        for group, number in file.masters_db.items():
            _check_channel(path, file.groups[group], number)

        @cache
        def clock_of(group: int) -> np.ndarray:
            return np.asarray(file.get_master(group))

        @cache
        def clock() -> np.ndarray:
            return max((clock_of(number) for number in range(len(file.groups))), key=len)

        def read(name: str) -> Any:
            if name not in places:
                return clock()
            group, number = places[name]
            _check_channel(path, file.groups[group], number)
            signal = file.get(group=group, index=number)
            own, common, values = clock_of(group), clock(), signal.samples
            if len(values) < len(own):  # samples that the file marks as invalid are left out
                values = np.full(len(own), np.nan)
                values[np.searchsorted(own, signal.timestamps)] = signal.samples.astype(float)
            if len(own) == len(common) and np.array_equal(own, common):
                return values
            # A slower raster holds its last value until the next one; before its first sample nothing is known.
            last = np.searchsorted(own, common, side="right") - 1
            return np.where(last >= 0, values[np.maximum(last, 0)].astype(float), np.nan)

        places: dict[str, tuple[int, int]] = {}
        for name, ((group, number), *_) in file.channels_db.items():
            if file.groups[group].channel_dependencies[number]:  # a structure or an array, no signal
                continue
            places[name] = group, number
            channel = file.groups[group].channels[number]
            if unit := getattr(channel, "unit", "") or getattr(channel.conversion, "unit", ""):
                units[name] = str(unit)
        yield dict.fromkeys((*places, "time_s")), read


def _check_channel(path: Path, group: Any, number: int) -> None:
    """InputError for a channel whose values a formula of the file, or a table of texts and formulas, would make, and for one
    that lies outside its record: the library reads there unchecked."""
    channel = group.channels[number]
    blocks = type(channel).__module__.rpartition(".")[2]
    rule = channel.conversion
    if rule is not None and rule.conversion_type not in _ARITHMETIC[blocks]:
        raise InputError(
            f"{path}: the values of channel {channel.name!r} come from a formula or a table of texts in the file, which is "
            "never run; export physical values (no conversion, or a linear one)"
        )
    if blocks == "v4_blocks":
        # Of a channel with an attachment the library opens whatever file is named.
        if channel.channel_type == _VARIABLE_LENGTH or channel.attachment is not None:
            raise InputError(
                f"{path}: column {channel.name!r} holds texts, blocks of bytes or an attached file, no numbers"
            )
        bits = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
        validity = channel.pos_invalidation_bit // 8 if group.channel_group.invalidation_bytes_nr else -1
        outside = validity >= group.channel_group.invalidation_bytes_nr
    else:
        bits = 8 * channel.additional_byte_offset + channel.start_offset + channel.bit_count
        outside = False
    if outside or bits > 8 * group.channel_group.samples_byte_nr:
        raise InputError(
            f"{path}: channel {channel.name!r} lies outside its record: the file is damaged; export it again"
        )


@contextmanager
def _tdms(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    tdms = _library("nptdms", path)
    with tdms.TdmsFile.open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        names = [channel.name for channel in channels]
        columns = {
            each.name if names.count(each.name) == 1 else f"{each.group_name}/{each.name}": each
            for each in channels
        }
        for name, channel in columns.items():
            if channel.properties.get("unit_string"):
                units[name] = str(channel.properties["unit_string"])
        clocked = channels and "wf_increment" in channels[0].properties

        def read(name: str) -> Any:
            if name not in columns:
                return channels[0].time_track()
            check_size(path, len(columns[name]))
            return columns[name][:]

        yield dict.fromkeys((*columns, *(("time_s",) if clocked else ()))), read


#: Loggers of the libraries that print unless asked not to.
_TALKATIVE = (
    "asammdf", "nptdms.base_segment", "nptdms.reader", "nptdms.scaling", "nptdms.tdms_segment", "nptdms.types",
)  # fmt: skip
#: Conversions that are arithmetic on numbers, by the versions' modules in asammdf: none, linear, rational and tables of numbers;
#: in MDF 3 also polynomials, exponentials and logarithms. And the type of channels whose samples are of any length.
_ARITHMETIC = {"v4_blocks": {0, 1, 2, 4, 5, 6}, "v2_v3_blocks": {0, 1, 2, 6, 7, 8, 9, 65535}}
_VARIABLE_LENGTH = 1

BINARY: dict[str, tuple[Callable[[Path, dict[str, str]], AbstractContextManager[Opened]], str]] = {
    ".parquet": (_parquet, "Parquet"),
    ".mat": (_mat, "a MAT file"),
    ".mf4": (_mdf, "MDF 4"),
    ".mdf": (_mdf, "MDF"),
    ".tdms": (_tdms, "TDMS"),
}
_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm")
#: How the names of files end that are read here; any other ending is taken for text.
ENDINGS = (*_TEXT, *(f"{ending}.gz" for ending in _TEXT), *BINARY)
