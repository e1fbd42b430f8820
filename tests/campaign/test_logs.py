"""A campaign of malformed logs in every format: each is read rightly or refused in one line, in bounded time and memory.

Every case runs in a process of its own, with the command `diagnose --inspect` and with the reader of a diagnosis. None may end
with a traceback, print more than one line, hang, take more than a few gigabytes or run code. `python -m pytest -m slow
tests/campaign/test_logs.py`.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import os
import pickle
import resource
import signal
import socket
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env import cli
from hydro_env.diagnosis.input.checks import read_logs
from hydro_env.errors import InputError

pytestmark = pytest.mark.slow

Columns = dict[str, np.ndarray]
Build = Callable[[Path, np.random.Generator], Path]
#: What one case may take.
SECONDS, MEMORY = 60, 6 << 30
#: Damages of each format.
DAMAGES = 32


def columns(rows: int = 300) -> Columns:
    """A log of one axis at 100 Hz whose speed follows its command."""
    time = np.arange(rows) * 0.01
    noise = np.random.default_rng(0).normal(size=(4, rows))
    command = 30.0 * np.sin(2.0 * time) * (time > 0.3)
    speed = 10.0 * np.concatenate([np.zeros(10), command[:-10]])
    return {
        "time_s": np.round(time, 6),
        "command_1_V": np.round(command, 4),
        "current_1_A": np.round(0.01 * command + 1e-3 * noise[0], 5),
        "pressure_1_bar": np.round(0.5 * command + 0.05 * noise[1], 3),
        "speed_1_rpm": np.round(speed + noise[2], 3),
    }


# --- files of every format


def csv_text(log: Columns) -> str:
    rows = np.column_stack(list(log.values()))
    return "\n".join([",".join(log), *(",".join(f"{v:.10g}" for v in row) for row in rows)]) + "\n"


def as_csv(path: Path, log: Columns) -> None:
    path.write_text(csv_text(log))


def as_csv_gz(path: Path, log: Columns) -> None:
    path.write_bytes(gzip.compress(csv_text(log).encode()))


def as_parquet(path: Path, log: Columns) -> None:
    import pyarrow
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(log), path)


def as_mat5(path: Path, log: Columns) -> None:
    from scipy.io import savemat

    savemat(path, log)


def as_mat5_packed(path: Path, log: Columns) -> None:
    from scipy.io import savemat

    savemat(path, {**log, "deep": {"a": log["time_s"]}}, do_compression=True)


def as_mat73(path: Path, log: Columns, extra: Callable[[Any], None] = lambda file: None) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in log.items():
            file.create_dataset(name, data=values[None, :], compression="gzip")
        extra(file)
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")


def as_mdf(path: Path, log: Columns, version: str = "4.10", **options: Any) -> None:
    import asammdf

    time = log["time_s"]
    with asammdf.MDF(version=version) as file:
        for name, values in log.items():
            if name != "time_s":
                conversion = options.get("conversions", {}).get(name)
                comment = options.get("comments", {}).get(name, "")
                file.append([asammdf.Signal(values, time, name=name, conversion=conversion, comment=comment)])
        file.save(path, compression=options.get("compression", 0), overwrite=True)


def as_mdf3(path: Path, log: Columns) -> None:
    as_mdf(path, log, "3.30")


def as_mdf_packed(path: Path, log: Columns) -> None:
    as_mdf(path, log, compression=2)


def as_tdms(path: Path, log: Columns) -> None:
    import nptdms

    with nptdms.TdmsWriter(path) as writer:
        for half in (slice(0, 150), slice(150, None)):
            writer.write_segment(
                [nptdms.ChannelObject("run", name, values[half]) for name, values in log.items()]
            )


FORMATS: dict[str, tuple[str, Callable[[Path, Columns], None]]] = {
    "csv": ("csv", as_csv),
    "csv_gz": ("csv.gz", as_csv_gz),
    "parquet": ("parquet", as_parquet),
    "mat5": ("mat", as_mat5),
    "mat5_packed": ("mat", as_mat5_packed),
    "mat73": ("mat", as_mat73),
    "mdf4": ("mf4", as_mdf),
    "mdf4_packed": ("mf4", as_mdf_packed),
    "mdf3": ("mdf", as_mdf3),
    "tdms": ("tdms", as_tdms),
}


# --- one case in a process of its own


def outcome(build: Build, folder: Path, seed: int) -> dict[str, Any]:
    """What reading a file gives: `read` or `refused`, with what was said; or `bad`, with the reason."""
    folder.mkdir()
    result = folder / "result.json"
    child = os.fork()
    if child == 0:
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process, also inside a library
            path = build(folder, np.random.default_rng(seed))
            signal.alarm(SECONDS)
            found = _read(path, folder)
        except BaseException:
            found = {"bad": "traceback: " + traceback.format_exc()[-400:]}
        result.write_text(json.dumps(found))
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    if not result.exists():
        return {"bad": f"process ended by signal {status}"}
    found = dict(json.loads(result.read_text()))
    if (folder / "ran").exists() or Path("ran").exists():
        return {"bad": "code was run"}
    return found


def _read(path: Path, folder: Path) -> dict[str, Any]:
    handle = os.open(folder / "stderr", os.O_CREAT | os.O_RDWR)
    os.dup2(handle, 2)  # what C libraries print counts as well
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = cli.run(["diagnose", "--inspect", str(path), "--out", str(folder / "out")])
    lines = err.getvalue().splitlines() + (folder / "stderr").read_text(errors="replace").splitlines()
    if (
        status not in (0, 2)
        or len(lines) != status // 2
        or any(not line.startswith("error: ") for line in lines)
    ):
        return {"bad": f"inspect: status {status}, {len(lines)} lines: {' | '.join(lines)[:300]}"}
    if status and (folder / "out").exists():
        return {"bad": "inspect: left a folder behind"}
    sealed = folder / "sealed.csv"
    as_csv(sealed, {name: values + 0.001 * (name != "time_s") for name, values in columns().items()})
    with redirect_stdout(out), redirect_stderr(err):
        try:
            parts, _ = read_logs([str(path)], [sealed], None)
        except InputError as error:
            text = str(error)
            return (
                {"bad": f"several lines: {text}"}
                if "\n" in text
                else {"refused": text, "inspected": out.getvalue()}
            )
    lines = err.getvalue().splitlines() + (folder / "stderr").read_text(errors="replace").splitlines()
    if len(lines) != status // 2:
        return {"bad": f"reading printed {' | '.join(lines)[:300]}"}
    log = parts[0].log
    whole = (
        all(np.isfinite(x[:, list(log.channels)]).all() for x in (log.command_V,))
        and np.isfinite(log.time_s).all()
    )
    if not whole or not (np.diff(log.time_s) > 0.0).all() or np.nanmax(np.abs(log.speed)) > 1e18:
        return {"bad": "nonsense was read"}
    return {"read": [f.text for f in log.findings], "rows": len(log), "inspected": out.getvalue()}


# --- damages of bytes


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with a few bytes flipped, lost, doubled or exchanged; half of the damages are in its head or at its end."""
    size = len(data)
    place = int(
        rng.choice(
            [rng.integers(size), rng.integers(min(size, 512)), size - 1 - rng.integers(min(size, 512))]
        )
    )
    other, length = int(rng.integers(size)), int(rng.choice([1, 2, 8, 64, 512]))
    kind = rng.integers(8)
    if kind == 0:
        return data[: max(place, 1)]
    if kind == 1:
        return data[:place] + data[place + length :]
    if kind == 2:
        return data[:place] + rng.bytes(length) + data[place:]
    if kind == 3:
        return data[:place] + bytes(length) + data[place + length :]
    if kind == 4:
        return data[:place] + b"\xff" * length + data[place + length :]
    if kind == 5:
        return data[:place] + data[other : other + length] + data[place + length :]
    flipped = bytearray(data)
    for at in (place, *rng.integers(size, size=int(rng.integers(4)))):
        flipped[at] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


def damages(tmp_path: Path, kind: str) -> Iterator[tuple[str, Build, str]]:
    ending, write = FORMATS[kind]
    write(tmp_path / f"whole.{ending}", columns())
    data = (tmp_path / f"whole.{ending}").read_bytes()

    def build(folder: Path, rng: np.random.Generator) -> Path:
        path = folder / f"log.{ending}"
        path.write_bytes(damaged(data, rng))
        return path

    for number in range(DAMAGES):
        yield f"{kind} {number}", build, "either"


# --- CSV files that are written wrongly: (what, text or bytes, how it must end: read, refused, or either)

HEAD = "time_s,command_1_V,speed_1_rpm\n"


def _with(name: str, row: int, text: str, log: Columns | None = None) -> str:
    """The log with one other cell."""
    lines = csv_text(log or columns()).splitlines()
    cells = lines[row].split(",")
    cells[list(columns()).index(name)] = text
    lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def _times(make: Callable[[np.ndarray], np.ndarray]) -> str:
    time = make(np.arange(300.0))
    rows = [
        f"{t!r},{10 * math.sin(n / 20)!r},{100 * math.sin(n / 20)!r}" for n, t in enumerate(time.tolist())
    ]
    return HEAD + "\n".join(rows) + "\n"


def spellings() -> Iterator[tuple[str, str | bytes, str]]:
    plain = csv_text(columns())
    body = plain.split("\n", 1)[1]
    for name in ("time_s", "command_1_V", "speed_1_rpm", "pressure_1_bar"):
        for text in (
            "x" * 131_073, "9" * 140_000, '"' + "1" * 131_073, "inf", "-Infinity", "1e400", "1e308", "-1e308", "1e38",
            "9.96921e36", "ERR", "#DIV/0!", "=cmd|' /C calc'!A0", "1.2.3", "0x10", "1e", "--1", "\x00", "１２", "5,5", "1_0",
        ):  # fmt: skip
            # Digits of other scripts and grouped ones are numbers to Python; both readers agree on that.
            yield (
                f"{name} {text[:12]!r}",
                _with(name, 20, text),
                "either" if text in ("１２", "1_0") else "refused",
            )
        for text in ("5e-324", "1e-310", "-0.0", "nan", "", "NULL", " 1.5 "):
            yield f"{name} {text!r}", _with(name, 20, text), "either"
        yield f"{name} twice in the header", plain.replace("current_1_A", name, 1), "refused"
        yield f"{name} quoted without end", _with(name, 20, '"1'), "refused"
    for sep in (";;", "sep", ",,,", "\t\t", "|;", "\x00", "1", '"', "ab", "٣", " ;;"):
        yield f"sep={sep!r}", f"sep={sep}\n{plain}", "refused"
    for sep in (";", "|", "\t", " ", "", "¦", "§", "^"):
        yield f"sep={sep!r}", f"sep={sep}\n{plain.replace(',', sep or ',')}", "read"
    yield "denormal times", _times(lambda n: n * 5e-324), "refused"
    yield "times of 1e-310", _times(lambda n: n * 1e-310), "refused"
    yield "times of 1e-12", _times(lambda n: n * 1e-12), "refused"
    yield "times of 1e-7", _times(lambda n: n * 1e-7), "refused"
    yield "times of 1e300", _times(lambda n: n * 1e300), "refused"
    yield (
        "times of -1e308 to 1e308",
        _times(lambda n: np.where(n < 150, -1e308, 1e308) * (1 + n * 1e-16)),
        "refused",
    )
    yield "times that stand", _times(lambda n: n * 0.0), "refused"
    yield "times backwards", _times(lambda n: -n), "refused"
    yield "times in squares", _times(lambda n: n**8), "refused"
    yield "times with jumps of 9 s", _times(lambda n: np.cumsum(np.where(n % 2 == 0, 1e-6, 9.0))), "refused"
    yield "times of powers of two", _times(lambda n: 2.0 ** (n - 200)), "refused"
    yield "times of 1e17", _times(lambda n: 1e17 + n), "refused"
    yield "times since 1970", _times(lambda n: 1.7e9 + 0.01 * n), "read"
    for rows in (0, 1, 2, 5, 19, 20):
        yield f"{rows} rows", "\n".join(plain.splitlines()[: rows + 1]) + "\n", "refused"
    yield "20 rows of 3 ms", _times(lambda n: 0.003 * n)[:-1], "refused"
    yield "0.2 s", _times(lambda n: 0.2 / 300 * n), "refused"
    yield "0.06 s", _times(lambda n: 0.06 / 300 * n), "refused"
    yield "header only", HEAD, "refused"
    yield "no header", body, "refused"
    yield "empty", "", "refused"
    yield "blank lines only", "\n" * 10_000, "refused"
    yield "blanks only", " " * 10_000, "refused"
    yield "one line of 10 MB", "a" * 10_000_000, "refused"
    yield "one row of 10 MB", HEAD + "1," * 5_000_000, "refused"
    yield "a row of 10 MB further down", plain + "1," * 5_000_000 + "\n", "refused"
    yield (
        "20,000 columns",
        ",".join(f"c{n}" for n in range(20_000)) + "\n" + ",".join("1" * 20_000) + "\n",
        "refused",
    )
    yield "5,000 columns more", _wide(5_000), "read"
    yield "a header of commas", "," * 100 + "\n" + plain, "refused"
    yield "delimiter of one column", plain.replace(",", "_"), "refused"
    yield "nul bytes", plain.encode()[:500] + b"\0" * 100 + plain.encode()[600:], "refused"
    yield "nul in the middle", plain.encode()[:6000] + b"\0" + plain.encode()[6001:], "refused"
    yield "utf-16", plain.encode("utf-16"), "read"
    yield "utf-16 cut", plain.encode("utf-16")[:-1], "either"
    yield "utf-16 without a mark", plain.encode("utf-16-le"), "refused"
    yield "utf-32", plain.encode("utf-32"), "refused"
    yield "utf-8 with a broken sign", plain.replace("time_s", "time_s,\xff", 1).encode("latin-1"), "refused"
    yield "latin-1 in a broken row", plain.encode() + b"\xff,\xff\n", "refused"
    yield "latin-1 with a long cell", b"\xff" + b"9" * 140_000 + b"\n" + plain.encode(), "refused"
    yield "gzip without its ending", gzip.compress(plain.encode()), "refused"
    yield "carriage returns", plain.replace("\n", "\r").encode(), "read"
    yield (
        "carriage returns, one line of 1 MB",
        (plain + "1" * 1_000_000).replace("\n", "\r").encode(),
        "refused",
    )
    yield "mixed ends of lines", plain.replace("\n", "\r\n", 50).encode(), "read"
    yield (
        "quotes around all",
        "\n".join(",".join(f'"{c}"' for c in line.split(",")) for line in plain.splitlines()),
        "read",
    )
    yield "html", "<html><body><table><tr><td>1</td></tr></table></body></html>", "refused"
    yield "json", json.dumps({name: values.tolist() for name, values in columns().items()}), "refused"
    yield "xml bomb", '<!DOCTYPE a [<!ENTITY b "cc"><!ENTITY d "&b;&b;">]><a>&d;</a>', "refused"
    yield "a pickle", pickle.dumps(columns()), "refused"
    yield "an elf", b"\x7fELF" + bytes(1000), "refused"
    for mark in "\u2028\u2029\x0b\x0c\x1c\x85":
        yield f"line mark {mark!r}", plain.replace("\n", mark + "\n", 3), "either"


def _wide(count: int) -> str:
    lines = csv_text(columns()).splitlines()
    extra = ",".join(f"extra{n}" for n in range(count))
    return "\n".join([f"{lines[0]},{extra}", *(line + ",1" * count for line in lines[1:])]) + "\n"


# --- paths, code and bombs


def paths() -> Iterator[tuple[str, Build, str]]:
    def named(name: str) -> Build:
        return lambda folder, rng: Path(name)

    def fifo(folder: Path, rng: np.random.Generator) -> Path:
        os.mkfifo(folder / "log.csv")
        return folder / "log.csv"

    def a_socket(folder: Path, rng: np.random.Generator) -> Path:
        os.chdir(folder)
        socket.socket(socket.AF_UNIX).bind("log.csv")
        return folder / "log.csv"

    def loop(folder: Path, rng: np.random.Generator) -> Path:
        (folder / "log.csv").symlink_to(folder / "log.csv")
        return folder / "log.csv"

    def a_folder(ending: str) -> Build:
        def build(folder: Path, rng: np.random.Generator) -> Path:
            (folder / f"log.{ending}").mkdir()
            return folder / f"log.{ending}"

        return build

    def forbidden(folder: Path, rng: np.random.Generator) -> Path:
        as_csv(folder / "log.csv", columns())
        (folder / "log.csv").chmod(0)
        folder.chmod(0o777)
        for place in folder.parents:
            if place.is_relative_to(tempfile.gettempdir()) and place != Path(tempfile.gettempdir()):
                place.chmod(0o711)
        os.setuid(65534)
        return folder / "log.csv"

    def in_a_file(folder: Path, rng: np.random.Generator) -> Path:
        (folder / "file").write_text("x")
        return folder / "file" / "log.csv"

    def zipped(ending: str) -> Build:
        def build(folder: Path, rng: np.random.Generator) -> Path:
            path = folder / f"log.{ending}.gz"
            path.write_bytes(gzip.compress(b"anything"))
            return path

        return build

    yield "too long a name", named("x" * 300 + ".csv"), "refused"
    yield "too long a path", named("/".join(["x" * 200] * 100) + ".csv"), "refused"
    yield "a long path with a window", named("x" * 5000 + "@0:2"), "refused"
    yield "a zero byte in the path", named("a\0b.csv"), "refused"
    yield "no path", named(""), "refused"
    for device in ("/dev/zero", "/dev/null", "/dev/urandom", "/proc/self/mem", "/", "."):
        yield device, named(device), "refused"
    yield "fifo", fifo, "refused"
    yield "socket", a_socket, "refused"
    yield "a link to itself", loop, "refused"
    yield "in a file", in_a_file, "refused"
    if os.geteuid() == 0:
        yield "no permission", forbidden, "refused"
    for ending in ("csv", "csv.gz", "mat", "mf4", "tdms", "parquet"):
        yield f"a folder .{ending}", a_folder(ending), "refused"
    for ending in ("mat", "mf4", "mdf", "tdms", "parquet"):
        yield f"gzipped .{ending}", zipped(ending), "refused"


class _Touch:
    """Pickled, it makes a file when it is read."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.path}",)


FORMULAS = (
    "__import__('os').system('touch {ran}')", "open('{ran}', 'w')", "X1+open('{ran}','w').fileno()",
    "[c for c in ().__class__.__base__.__subclasses__()][0] and open('{ran}', 'w')", "exec('open(\"{ran}\",\"w\")')", "2*X1",
    "getattr(open('{ran}','w'),'fileno')()*X1", "X1 if open('{ran}', 'w') else X1",
)  # fmt: skip
BOMB = (
    '<?xml version="1.0"?><!DOCTYPE CNcomment [<!ENTITY a0 "ha">'
    + "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12))
    + "]><CNcomment><TX>&a11;</TX></CNcomment>"
)


def formula(text: str, where: str, version: str = "4.10") -> Build:
    """An MDF file in which a formula makes the values of a channel, or of the clock."""

    def build(folder: Path, rng: np.random.Generator) -> Path:
        import asammdf

        from_formula = {
            "conversion_type": 3 if version >= "4" else 10,
            "formula": text.format(ran=folder / "ran"),
        }
        blocks = asammdf.blocks.v4_blocks if version >= "4" else asammdf.blocks.v2_v3_blocks
        path = folder / ("log.mf4" if version >= "4" else "log.mdf")
        if where == "clock":
            with asammdf.MDF(version=version) as file:
                log = columns()
                for name in list(log)[1:]:
                    file.append([asammdf.Signal(log[name], log["time_s"], name=name)])
                for group in file.groups:
                    group.channels[0].conversion = blocks.ChannelConversion(**from_formula)
                file.save(path, overwrite=True)
        else:
            as_mdf(path, columns(), version, conversions={where: from_formula})
        return path

    return build


def hostile() -> Iterator[tuple[str, Build, str]]:
    """Files that would run code, fetch other files or fill the memory."""
    for number, text in enumerate(FORMULAS):
        for where in ("speed_1_rpm", "pressure_1_bar", "clock"):
            yield f"MDF 4 formula {number} of {where}", formula(text, where), "refused"
        yield f"MDF 3 formula {number}", formula(text, "speed_1_rpm", "3.30"), "refused"
    yield "MDF 4 formula of an unused channel", _formula_aside, "read"
    yield "MDF 4 with an XML bomb", _mdf_bomb, "either"
    yield "MDF 4 that claims 10^15 rows", _mdf_rows, "refused"
    yield "Parquet with a pickled type", _parquet_pickle, "either"
    yield "Parquet of a billion rows", _parquet_rows, "refused"
    yield "MAT 7.3 with a pickle", _hdf_pickle, "either"
    yield "MAT 7.3 with data in another file", _hdf_external, "refused"
    yield "MAT 7.3 with data in a pipe", _hdf_pipe, "refused"
    yield "MAT 7.3 of virtual data", _hdf_virtual, "refused"
    yield "MAT 7.3 that claims 10^12 rows", _hdf_rows, "refused"
    yield "MAT 7.3 with a link in a circle", _hdf_circle, "read"
    yield "MAT 5 of objects", _mat_objects, "either"
    yield "MAT 5 that unpacks to 8 GB", _mat_bomb, "refused"
    yield "TDMS that claims 10^15 rows", _tdms_rows, "either"
    yield "gzip of blank lines", _gzip(b"\n" * 1_000_000, 2_000), "refused"
    yield "gzip of one long line", _gzip(b"1" * 1_000_000, 2_000), "refused"
    yield "gzip of spaces", _gzip(b" " * 1_000_000, 1_000), "refused"


def _formula_aside(folder: Path, rng: np.random.Generator) -> Path:
    log = columns() | {"other": columns()["speed_1_rpm"]}
    rule = {"conversion_type": 3, "formula": FORMULAS[0].format(ran=folder / "ran")}
    as_mdf(folder / "log.mf4", log, conversions={"other": rule})
    return folder / "log.mf4"


def _mdf_bomb(folder: Path, rng: np.random.Generator) -> Path:
    as_mdf(folder / "log.mf4", columns(), comments={"speed_1_rpm": BOMB, "command_1_V": BOMB})
    return folder / "log.mf4"


def _mdf_rows(folder: Path, rng: np.random.Generator) -> Path:
    path = folder / "log.mf4"
    as_mdf(path, columns())
    data = bytearray(path.read_bytes())
    at = -1
    while (at := data.find((300).to_bytes(8, "little"), at + 1)) >= 0:
        data[at : at + 8] = (10**15).to_bytes(8, "little")
    path.write_bytes(data)
    return path


def _parquet_pickle(folder: Path, rng: np.random.Generator) -> Path:
    import pyarrow
    from pyarrow import parquet

    payload = pickle.dumps(_Touch(str(folder / "ran")))
    marks = {b"ARROW:extension:name": b"arrow.py_extension_type", b"ARROW:extension:metadata": payload}
    fields = [pyarrow.field(name, pyarrow.float64(), metadata=marks) for name in columns()]
    pandas = {b"pandas": json.dumps({"index_columns": [], "columns": []}).encode(), b"PANDAS": payload}
    table = pyarrow.table(list(columns().values()), schema=pyarrow.schema(fields, metadata=pandas))
    parquet.write_table(table, folder / "log.parquet")
    return folder / "log.parquet"


def _parquet_rows(folder: Path, rng: np.random.Generator) -> Path:
    import pyarrow
    from pyarrow import parquet

    table = pyarrow.table({"time_s": np.zeros(10_000_000)})
    with parquet.ParquetWriter(folder / "log.parquet", table.schema, compression="zstd") as writer:
        for _ in range(100):
            writer.write_table(table)
    return folder / "log.parquet"


def _hdf(extra: Callable[[Any, Path], None], without: str = "speed_1_rpm") -> Build:
    def build(folder: Path, rng: np.random.Generator) -> Path:
        log = columns()
        log.pop(without, None)
        as_mat73(folder / "log.mat", log, lambda file: extra(file, folder))
        return folder / "log.mat"

    return build


def _add_pickle(file: Any, folder: Path) -> None:
    file["pickled"] = np.void(pickle.dumps(_Touch(str(folder / "ran"))))
    file["pickled"].attrs["PICKLED"] = np.void(pickle.dumps(_Touch(str(folder / "ran"))))


def _add_external(file: Any, folder: Path) -> None:
    (folder / "other").write_bytes(bytes(2400))
    file.create_dataset("speed_1_rpm", (1, 300), "f8", external=[(str(folder / "other"), 0, 2400)])


def _add_pipe(file: Any, folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    file.create_dataset("speed_1_rpm", (1, 300), "f8", external=[(str(folder / "pipe"), 0, 2400)])


def _add_virtual(file: Any, folder: Path) -> None:
    import h5py

    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = np.zeros((1, 300))
    layout = h5py.VirtualLayout((1, 300), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "x", (1, 300))
    file.create_virtual_dataset("speed_1_rpm", layout)


def _add_rows(file: Any, folder: Path) -> None:
    file.create_dataset("speed_1_rpm", (1, 10**12), "f8", chunks=(1, 10**6))


def _add_circle(file: Any, folder: Path) -> None:
    import h5py

    file["group/again"] = h5py.SoftLink("/group")
    file["elsewhere"] = h5py.ExternalLink("/dev/zero", "/")


_hdf_pickle = _hdf(_add_pickle, "")
_hdf_external, _hdf_pipe, _hdf_virtual = (_hdf(each) for each in (_add_external, _add_pipe, _add_virtual))
_hdf_rows, _hdf_circle = _hdf(_add_rows), _hdf(_add_circle, "")


def _mat_objects(folder: Path, rng: np.random.Generator) -> Path:
    from scipy.io import savemat

    cells = np.array([FORMULAS[0], np.arange(3), {"a": 1}], dtype=object)
    savemat(folder / "log.mat", {**columns(), "cells": cells})
    return folder / "log.mat"


def _mat_bomb(folder: Path, rng: np.random.Generator) -> Path:
    import zlib

    count = 8 << 30
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"

    def tag(kind: int, length: int) -> bytes:
        return kind.to_bytes(4, "little") + (length % (1 << 32)).to_bytes(4, "little")

    name = b"speed_1_rpm".ljust(16, b"\0")
    array = tag(6, 8) + b"\x06\0\0\0\0\0\0\0" + tag(5, 8) + (count // 8).to_bytes(4, "little") + b"\x01\0\0\0"
    array += tag(1, 11) + name + tag(9, count)
    pack = zlib.compressobj(9)
    first = pack.compress(tag(14, len(array) + count) + array) + pack.flush(zlib.Z_FULL_FLUSH)
    block = pack.compress(bytes(1 << 24)) + pack.flush(zlib.Z_FULL_FLUSH)  # may be repeated as it is
    whole = first + (count >> 24) * block + pack.flush()
    (folder / "log.mat").write_bytes(head + tag(15, len(whole)) + whole)
    return folder / "log.mat"


def _tdms_rows(folder: Path, rng: np.random.Generator) -> Path:
    path = folder / "log.tdms"
    as_tdms(path, columns())
    data = path.read_bytes().replace((150).to_bytes(8, "little"), (10**15).to_bytes(8, "little"))
    path.write_bytes(data)
    return path


def _gzip(block: bytes, times: int) -> Build:
    def build(folder: Path, rng: np.random.Generator) -> Path:
        with gzip.open(folder / "log.csv.gz", "wb", compresslevel=1) as file:
            file.write(HEAD.encode())
            for _ in range(times):
                file.write(block)
        return folder / "log.csv.gz"

    return build


# --- the campaign


def texts() -> Iterator[tuple[str, Build, str]]:
    def of(text: str | bytes) -> Build:
        def build(folder: Path, rng: np.random.Generator) -> Path:
            (folder / "log.csv").write_bytes(
                text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
            )
            return folder / "log.csv"

        return build

    for name, text, end in spellings():
        yield name, of(text), end


def campaign(tmp_path: Path, cases: Iterator[tuple[str, Build, str]]) -> tuple[int, list[str]]:
    """How many cases were tried, and those that ended badly with the reason."""
    tried, bad = 0, []
    for name, build, end in cases:
        found = outcome(build, tmp_path / str(tried), tried)
        tried += 1
        if "bad" in found:
            bad.append(f"{name}: {found['bad']}")
        elif end != "either" and end not in found:
            bad.append(f"{name}: not {end} but {str(found)[:300]}")
    return tried, bad


@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    tried, bad = campaign(tmp_path, damages(tmp_path, kind))
    assert tried == DAMAGES and not bad, "\n".join(bad)


def test_csv_files_that_are_written_wrongly(tmp_path: Path) -> None:
    tried, bad = campaign(tmp_path, texts())
    assert tried > 150 and not bad, "\n".join(bad)


def test_paths_that_are_no_plain_file(tmp_path: Path) -> None:
    tried, bad = campaign(tmp_path, paths())
    assert tried > 25 and not bad, "\n".join(bad)


def test_files_that_would_run_code_or_fill_the_memory(tmp_path: Path) -> None:
    tried, bad = campaign(tmp_path, hostile())
    assert tried > 45 and not bad, "\n".join(bad)


def test_an_undamaged_log_is_read_rightly_from_every_format(tmp_path: Path) -> None:
    for kind, (ending, write) in FORMATS.items():
        path = tmp_path / f"{kind}.{ending}"
        write(path, columns())
        sealed = tmp_path / "sealed.csv"
        as_csv(sealed, {name: values + 0.001 * (name != "time_s") for name, values in columns().items()})
        log = read_logs([path], [sealed], None)[0][0].log
        np.testing.assert_allclose(log.time_s, columns()["time_s"], atol=1e-9)
        np.testing.assert_allclose(
            log.speed[:, 0] * 30.0 / np.pi, columns()["speed_1_rpm"], rtol=1e-9, atol=1e-9
        )
