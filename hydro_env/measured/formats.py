"""A file of any log format as a table of named columns: CSV, and here Parquet, MAT 5 and 7.3, MDF 3 and 4 and TDMS.

MAT 5 needs nothing beyond the core; the others need the libraries of the extra `measured`, imported on first use.
In MAT files a column is a numeric vector (structures are named with dots, `log.speed`; the columns of a matrix are
`data(:,1)`, ...), in TDMS files a channel (its name, or `group/channel` where that is ambiguous), in MDF files a channel
(all put on the fastest clock, as column `time_s` where the file has no such channel). Units that MDF and TDMS files carry
are in the table's `units`.

No file runs code. What a library would evaluate or fetch on behalf of a file is refused or not asked for: formulas, bus
databases and attachments of MDF files, data of HDF5 files that lie in other files.
"""

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, located, to_install
from hydro_env.measured.csv_file import Choose, read_csv
from hydro_env.measured.finding import Finding
from hydro_env.measured.mapping import TableStyle
from hydro_env.measured.mat5 import read_mat5
from hydro_env.measured.table import Table, check_size, place_of
from hydro_env.reading import check_file

#: What reads each column of an open file, by name.
Opened = dict[str, Callable[[], Any]]


def read_table(path: Path, choose: Choose, style: TableStyle | None = None) -> Table:
    """Reads the columns that `choose(names)` asks for from a file of any format; `style` is that of a CSV file.

    `InputError` names the file and what would be right, of CSV also row and column.
    """
    check_file(path, "a log")
    packed = path.suffix == ".gz"
    ending = (path.with_suffix("").suffix if packed else path.suffix).lower()
    with located(path):
        try:
            if ending not in BINARY:
                return read_csv(path, choose, style or TableStyle())
            if packed:
                raise InputError("only CSV files are read gzipped; unpack it first")
            return _read_binary(path, choose, *BINARY[ending])
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror or error}); copy it again") from None
        except MemoryError:
            raise InputError("does not fit into memory; export a shorter part, or fewer columns") from None


def _read_binary(path: Path, choose: Choose, reader: "Reader", what: str) -> Table:
    """Reads the columns that `choose(names)` asks for; `InputError` says what would be right."""
    if not path.stat().st_size:
        raise InputError("the file is empty; a log needs columns and rows")
    units: dict[str, str] = {}
    columns: dict[str, np.ndarray] = {}
    with _collected_warnings() as warned:
        try:
            with reader(path, units) as opened:
                if not opened:
                    raise ValueError("no columns")
                names = tuple(opened)
                for name in choose(names):
                    columns[name] = _numbers(name, opened[names[place_of(names, name)]]())
                    check_size(len(columns[name]) * len(columns))
        except (InputError, MemoryError):
            raise
        except ImportError as error:
            told = f"reading {path.suffix} needs a library ({error})"
            raise InputError(f"{told}: {to_install('measured')}") from None
        except Exception as error:  # each library has its own family of errors
            reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
            told = f"not readable as {what} ({reason}); export it again or save it as CSV"
            raise InputError(told) from None
    longest = max(columns, key=lambda name: len(columns[name]), default="")
    count = len(columns[longest]) if columns else 0
    for name, values in columns.items():
        if len(values) < count:
            told = f"column {name!r} holds {len(values)} values, {longest!r} {count}"
            raise InputError(f"{told}; put all signals on one clock before exporting")
    if count == 0:
        raise InputError("no rows; a log needs at least two samples")
    findings = [
        Finding("damaged_file", f"reading it as {what} gave a warning: {text}", "is it complete?")
        for text in dict.fromkeys(warned)
    ]
    return Table(names, columns, np.arange(1, count + 1), findings, units)


def _numbers(name: str, values: Any) -> np.ndarray:
    """A column as numbers (T,)."""
    values = np.asarray(values)
    try:
        if values.dtype.kind in "mM":  # dates and durations, as seconds
            values = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64) / 1e9
        elif values.dtype.kind not in "biuf":
            values = np.array([np.nan if value is None else value for value in values.ravel()])
        return values.astype(float).ravel()
    except (TypeError, ValueError):
        raise InputError(f"column {name!r} holds no numbers; a log's columns are plain numbers") from None


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
        with warnings.catch_warnings(action="ignore"):
            yield found
    finally:
        for logger in loggers:
            logger.removeFilter(keep)


@contextmanager
def _parquet(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        check_size(file.metadata.num_rows)
        yield {name: partial(_parquet_values, file, name) for name in file.schema_arrow.names}


def _parquet_values(file: Any, name: str) -> Any:
    return file.read([name]).column(0).to_numpy()


@contextmanager
def _mat(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    with open(path, "rb") as file:
        is_hdf = b"MATLAB 7.3" in file.read(128)
    found: Opened = {}
    if is_hdf:
        import h5py

        with h5py.File(path, "r") as hdf:
            hdf.visititems(partial(_add_columns, found))
            yield found
        return
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import matfile_version

    if matfile_version(path)[0] == 1:
        matrices = read_mat5(path)
    else:
        check_size(sum(math.prod(shape) for _, shape, _ in whosmat(path)))
        matrices = {name: values for name, values in loadmat(path).items() if not name.startswith("__")}
    for name, values in matrices.items():
        _add_columns(found, name, values.T)
    yield found


def _add_columns(found: Opened, name: str, item: Any) -> None:
    """Adds the columns of a matrix that lies on its side, as MATLAB writes it into HDF5: column by column."""
    # A group, what MATLAB keeps for itself, one number.
    if not getattr(item, "shape", None) or name.startswith("#") or item.size < 2:
        return
    name = name.replace("/", ".")
    if item.size == max(item.shape):
        found[name] = partial(_row_of, item, ())
    elif item.ndim == 2 and item.shape[0] <= 64 < item.shape[1]:
        found |= {f"{name}(:,{n + 1})": partial(_row_of, item, n) for n in range(item.shape[0])}


def _row_of(item: Any, row: Any) -> Any:
    check_size(item.size)
    if getattr(item, "external", None) or getattr(item, "is_virtual", False):
        raise InputError(f"{item.name} lies in another file; save the values themselves")
    return item[row]


@contextmanager
def _mdf(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    import asammdf

    # Bus logging would read databases that the file brings along.
    with closing(asammdf.MDF(path, process_bus_logging=False)) as file:  # type: ignore[call-arg]
        for each in file.groups:
            rows = each.channel_group
            record = rows.samples_byte_nr + getattr(rows, "invalidation_bytes_nr", 0)
            check_size(rows.cycles_nr * max(record // 8, 1))
        for group, number in file.masters_db.items():
            _check_channel(file.groups[group], number)

        clocks = [np.asarray(file.get_master(group)) for group in range(len(file.groups))]
        common = max(clocks, key=len, default=np.zeros(0))

        def read(group: int, number: int) -> Any:
            _check_channel(file.groups[group], number)
            signal = file.get(group=group, index=number)
            own, values = clocks[group], signal.samples
            if len(values) < len(own):  # samples that the file marks as invalid are left out
                values = np.full(len(own), np.nan)
                values[np.searchsorted(own, signal.timestamps)] = signal.samples.astype(float)
            if len(own) == len(common) and np.array_equal(own, common):
                return values
            # A slower raster holds its last value until the next one; before its first sample nothing is known.
            last = np.searchsorted(own, common, side="right") - 1
            return np.where(last >= 0, values[np.maximum(last, 0)].astype(float), np.nan)

        found: Opened = {}
        for name, ((group, number), *_) in file.channels_db.items():
            if file.groups[group].channel_dependencies[number]:  # a structure or an array, no signal
                continue
            found[name] = partial(read, group, number)
            channel = file.groups[group].channels[number]
            if unit := getattr(channel, "unit", "") or getattr(channel.conversion, "unit", ""):
                units[name] = str(unit)
        found.setdefault("time_s", lambda: common)
        yield found


def _check_channel(group: Any, number: int) -> None:
    """InputError for a channel whose values a formula of the file, or a table of texts and formulas, would make, and for one
    that lies outside its record: the library reads there unchecked."""
    channel = group.channels[number]
    blocks = type(channel).__module__.rpartition(".")[2]
    rule = channel.conversion
    if rule is not None and rule.conversion_type not in _ARITHMETIC[blocks]:
        told = f"the values of channel {channel.name!r} come from a formula or a table of texts, which is never run"
        raise InputError(f"{told}; export physical values (no conversion, or a linear one)")
    if blocks == "v4_blocks":
        # Of a channel with an attachment the library opens whatever file is named.
        if channel.channel_type == _VARIABLE_LENGTH or channel.attachment is not None:
            raise InputError(f"column {channel.name!r} holds texts, bytes or an attached file, no numbers")
        bits = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
        validity = channel.pos_invalidation_bit // 8 if group.channel_group.invalidation_bytes_nr else -1
        outside = validity >= group.channel_group.invalidation_bytes_nr
    else:
        bits = 8 * channel.additional_byte_offset + channel.start_offset + channel.bit_count
        outside = False
    if outside or bits > 8 * group.channel_group.samples_byte_nr:
        raise InputError(f"channel {channel.name!r} lies outside its record: damaged; export the file again")


@contextmanager
def _tdms(path: Path, units: dict[str, str]) -> Iterator[Opened]:
    from nptdms import TdmsFile

    with TdmsFile.open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        names = [channel.name for channel in channels]
        found: Opened = {}
        for channel in channels:
            alone = names.count(channel.name) == 1
            name = channel.name if alone else f"{channel.group_name}/{channel.name}"
            check_size(len(channel))
            found[name] = channel.read_data
            if channel.properties.get("unit_string"):
                units[name] = str(channel.properties["unit_string"])
        if channels and "wf_increment" in channels[0].properties:
            found.setdefault("time_s", channels[0].time_track)
        yield found


#: Loggers of the libraries that print unless asked not to.
_TALKATIVE = (
    "asammdf", "nptdms.base_segment", "nptdms.reader", "nptdms.scaling", "nptdms.tdms_segment", "nptdms.types",
)  # fmt: skip
#: Conversions that are arithmetic on numbers, by the versions' modules in asammdf: none, linear, rational and tables of numbers;
#: in MDF 3 also polynomials, exponentials and logarithms. And the type of channels whose samples are of any length.
_ARITHMETIC = {"v4_blocks": {0, 1, 2, 4, 5, 6}, "v2_v3_blocks": {0, 1, 2, 6, 7, 8, 9, 65535}}
_VARIABLE_LENGTH = 1

#: Opens a file for reading and adds the units that it carries.
Reader = Callable[[Path, dict[str, str]], AbstractContextManager[Opened]]
BINARY: dict[str, tuple[Reader, str]] = {
    ".parquet": (_parquet, "Parquet"),
    ".mat": (_mat, "a MAT file"),
    ".mf4": (_mdf, "MDF 4"),
    ".mdf": (_mdf, "MDF"),
    ".tdms": (_tdms, "TDMS"),
}
_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm")
#: How the names of files end that are read here; any other ending is taken for text.
ENDINGS = (*_TEXT, *(f"{ending}.gz" for ending in _TEXT), *BINARY)
