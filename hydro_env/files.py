"""Writing files so that nothing half-written is ever left behind.

`write_text` and `write_json` replace one file in one go. `output_folder` does the same for a command that
writes several: they are made in a hidden folder next to their place and moved in when all of them are there.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError

__all__ = ["output_folder", "to_json", "write_json", "write_text"]


def write_text(path: Path, text: str) -> None:
    """Writes a text file in one go: a temporary file beside it, then a rename."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def write_json(path: Path, data: Any, *, indent: int | None = 1) -> None:
    """Writes `to_json(data)` in one go."""
    write_text(path, to_json(data, indent=indent) + "\n")


def to_json(data: Any, *, indent: int | None = None) -> str:
    """JSON that every reader takes: NumPy values become plain ones, and a number that is not finite, which
    JSON cannot hold, becomes null.
    """
    return json.dumps(_plain(data), indent=indent, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


@contextmanager
def output_folder(out: str | Path) -> Iterator[Path]:
    """A folder to write to, whose content becomes that of `out` when the block ends without an error.

    Whether `out` can be written is checked at once, not after minutes of work. Files of the same name are
    replaced, others in `out` stay. After an error or an interruption `out` is as it was.

    Raises InputError if `out` is not a folder or cannot be written.
    """
    out = Path(out)
    made: list[Path] = []
    try:
        if not out.is_dir():
            made = _make_parents(out)
        # Inside `out` where that exists: its parent may belong to somebody else or to another disk.
        work = Path(tempfile.mkdtemp(dir=out if out.is_dir() else out.parent, prefix=f".{out.name}-"))
    except OSError as problem:
        _remove(made)
        reason = problem.strerror or problem
        raise InputError(
            f"--out {out}: cannot write there ({reason}); name a folder that can be written"
        ) from None
    try:
        yield work
        os.chmod(work, 0o777 & ~_umask())
        if out.is_dir():
            _move_into(work, out)
            shutil.rmtree(work)
        else:
            os.replace(work, out)
    except BaseException:
        shutil.rmtree(work, ignore_errors=True)
        _remove(made)
        raise


def _make_parents(out: Path) -> list[Path]:
    """Makes the folders above `out` and returns those that were missing, innermost first."""
    if out.exists():
        raise NotADirectoryError(0, "it is a file")
    missing = [parent for parent in out.parents if not parent.exists()]
    out.parent.mkdir(parents=True, exist_ok=True)
    return missing


def _remove(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:  # never made, or somebody else has put something there
            return


def _move_into(source: Path, target: Path) -> None:
    for item in source.iterdir():
        place = target / item.name
        if item.is_dir() and place.is_dir():
            _move_into(item, place)
        else:
            os.replace(item, place)


def _umask() -> int:
    """The umask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
