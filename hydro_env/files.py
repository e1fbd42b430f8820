"""Writing files so that nothing half-written is ever left behind, also when the disk is full.

`write_text`, `write_bytes` and `write_json` replace one file in one go. `output_folder` does the same for a command that
writes several: they are made in a hidden folder next to their place and moved in when all of them are there.
What cannot be written raises an OSError that names the file. `sha256_of` tells whether a file is still the same.
"""

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from hydro_env.errors import InputError


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """A file to write bytes to, which takes the place of `path` when the block ends without an error."""
    temporary = path.with_name(_hidden(path))
    try:
        with open(temporary, "xb") as file:
            yield file
        os.replace(temporary, path)
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror or str(problem), str(path)) from None
    finally:
        with suppress(OSError):  # in its place, or never made
            temporary.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file in one go: a temporary file beside it, then a rename."""
    with replacing(path) as file:
        file.write(content)


def write_text(path: Path, text: str) -> None:
    """Writes a text file in one go, in UTF-8."""
    write_bytes(path, text.encode())


def write_json(path: Path, data: Any, *, indent: int | None = 1) -> None:
    """Writes `to_json(data)` in one go."""
    write_text(path, to_json(data, indent=indent) + "\n")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """A full disk that some library met without a word about the file: the OSError names `path`."""
    try:
        yield
    except OSError as problem:
        if problem.filename is not None or problem.errno not in _FULL:
            raise
        raise OSError(problem.errno, problem.strerror, str(path)) from None


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def to_json(data: Any, *, indent: int | None = None) -> str:
    """JSON that every reader takes: NumPy values become plain ones, and a number that is not finite, which
    JSON cannot hold, becomes null.
    """
    from pydantic_core import to_jsonable_python

    plain = to_jsonable_python(data, inf_nan_mode="null", fallback=_plain)
    return json.dumps(plain, indent=indent, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"no JSON of {type(value).__name__}")


@contextmanager
def output_folder(out: str | Path) -> Iterator[Path]:
    """A folder to write to, whose content becomes that of `out` when the block ends without an error.

    Whether `out` can be written is checked at once, not after minutes of work. Files of the same name are
    replaced, others in `out` stay. After an error or an interruption `out` is as it was.

    Raises InputError if `out` is not a folder or cannot be written, OSError with the final name of a file for which there
    was no room.
    """
    out = Path(out)
    made: list[Path] = []
    try:
        if not out.is_dir():
            made = _make_parents(out)
        # Inside `out` where that exists: its parent may belong to somebody else or to another disk.
        work = (out if out.is_dir() else out.parent) / _hidden(out)
        work.mkdir()
    except OSError as problem:
        _remove(made)
        reason = problem.strerror or problem
        raise InputError(
            f"--out {out}: cannot write there ({reason}); name a folder that can be written"
        ) from None
    try:
        with naming(out):
            yield work
            if out.is_dir():
                _move_into(work, out)
            else:
                os.replace(work, out)
    except BaseException as problem:
        shutil.rmtree(work, ignore_errors=True)
        _remove(made)
        if isinstance(problem, OSError) and problem.filename:
            place = Path(problem.filename).absolute()
            if place.is_relative_to(work.absolute()):
                problem.filename = str(out / place.relative_to(work.absolute()))
        raise


def _make_parents(out: Path) -> list[Path]:
    """Makes the folders above `out` and returns those that were missing, innermost first."""
    if out.exists():
        raise NotADirectoryError(0, "it is a file")
    missing = [parent for parent in out.parents if not parent.exists()]
    out.parent.mkdir(parents=True, exist_ok=True)
    return missing


def _remove(folders: list[Path]) -> None:
    """Removes `folders` as far as they are empty, innermost first."""
    with suppress(OSError):  # never made, or somebody else has put something there
        for folder in folders:
            folder.rmdir()


def _move_into(work: Path, out: Path) -> None:
    """Moves what is in `work` to `out` and removes `work`. If a move fails, `out` is as it was before."""
    replaced = out / _hidden(out)
    try:
        replaced.mkdir()
    except OSError as problem:
        raise OSError(problem.errno, problem.strerror, str(out)) from None
    moves: list[tuple[Path, Path]] = []

    def move(item: Path, place: Path) -> None:
        os.replace(item, place)
        moves.append((item, place))

    def merge(source: Path, target: Path) -> None:
        for item in sorted(source.iterdir()):
            place = target / item.name
            if item.is_dir() and place.is_dir():
                merge(item, place)
                continue
            if place.is_file() and not item.is_dir():
                move(place, replaced / str(len(moves)))
            move(item, place)

    try:
        merge(work, out)
    except BaseException:
        for item, place in reversed(moves):
            with suppress(OSError):
                os.replace(place, item)
        replaced.rmdir()
        raise
    shutil.rmtree(replaced, ignore_errors=True)
    shutil.rmtree(work, ignore_errors=True)


def _hidden(path: Path) -> str:
    """A name for what is to become `path`."""
    return f".{path.name}-{secrets.token_hex(4)}"
