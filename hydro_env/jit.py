"""How functions are compiled: by Numba, once, and kept for the next process.

Numba's own cache keeps the machine code. It notices a change of the file of a function, but not of values and functions that
come from other files; so the folder of each function is named by a hash of these and of the sources of its room. What kernels
are made of (`kept`, `keep`) lies beside it, under names that are hashes of all that it depends on.

Machine code is kept in $HYDRO_ENV_CACHE, else in the user's cache folder, else in the folder for temporary files. Where
other users could have written it is not read: it would run. Without any such folder every process compiles.
"""

import gc
import hashlib
import logging
import os
import shutil
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event

from hydro_env.files import write_bytes
from hydro_env.pickles import Damaged, distrust, sign, verified

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: Machine code to keep. All tests together compile a fifth of it; beyond that the oldest is removed.
MAX_BYTES = 1 << 30


def compiled(function: Callable[..., Any], *, nogil: bool = False) -> Callable[..., Any]:
    """The function in machine code. `nogil`: other threads run meanwhile."""
    options = {"error_model": "numpy", "nogil": nogil}
    folder = _folder()
    if folder is None:
        return numba.njit(**options)(function)
    others = repr([sources_of_room(function.__code__.co_filename), *_held(function)])
    others = hashlib.sha256(others.encode()).hexdigest()[:16]
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder / others)
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


@cache
def sources_of_room(file: str) -> str:
    """Hash of the sources of the room of this package that a file belongs to: named tuples and settings that functions take from
    its other files, which Numba knows by the names of their classes alone."""
    here, path = Path(__file__).parent, Path(file)
    if here not in path.parents:
        return ""
    first = here / path.relative_to(here).parts[0]
    sources = sorted(first.rglob("*.py") if first.is_dir() else here.glob("*.py"))
    return hashlib.sha256(b"\0".join(source.read_bytes() for source in sources)).hexdigest()


def _held(function: Any) -> list[object]:
    """What the machine code of a function holds beside its own text: values of globals, and the functions it calls."""
    held: list[object] = []
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        called = getattr(value, "py_func", None)
        if called is not None:
            held += [name, called.__code__.co_code, called.__code__.co_consts, *_held(called)]
        elif isinstance(value, np.ndarray):
            held += [name, value.tobytes()]
        elif isinstance(value, int | float | str | tuple):
            held += [name, value]
    return held


@contextmanager
def collector_waits() -> Iterator[None]:
    """Python's collector of cyclic garbage waits: it would go through all that a compiler holds, again and again, which takes a
    tenth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _Compiling(event.Listener):  # type: ignore[misc]
    """One process compiles at a time: two that save different signatures of one function at once would mix up their files. The
    others then find what it compiled."""

    def __init__(self) -> None:
        self._guard, self._inside, self._meanwhile = threading.Lock(), 0, ExitStack()

    def on_start(self, event: event.Event) -> None:
        with self._guard:
            if self._inside == 0:
                self._meanwhile.enter_context(_locked())
                self._meanwhile.enter_context(collector_waits())
            self._inside += 1

    def on_end(self, event: event.Event) -> None:
        with self._guard:
            self._inside -= 1
            if self._inside == 0:
                self._meanwhile.close()


event.register("numba:compiler_lock", _Compiling())


def _locked() -> ExitStack:
    """A file whose lock this process has until it is closed; nothing where there is no folder or are no locks."""
    folder, held = _folder(), ExitStack()
    if folder is not None and fcntl is not None:
        with suppress(OSError):  # a full disk, a file system without locks
            fcntl.flock(held.enter_context((folder / "lock").open("wb")), fcntl.LOCK_EX)
    return held


# --- files ---------------------------------------------------------------------------------------------------------


def kept(name: str) -> bytes | None:
    """The content of a file of this name, None if it is not there or damaged."""
    folder = _folder()
    if folder is None:
        return None
    path = folder / name
    try:
        return verified(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, Damaged):
        _say(f"{folder}: damaged machine code was removed and is compiled again")
        with suppress(OSError):
            path.unlink()
        return None


def keep(name: str, content: bytes) -> None:
    """Keeps machine code under this name, a hash of all that it depends on."""
    folder = _folder()
    if folder is None:
        return
    try:
        write_bytes(folder / name, sign(content))
        _make_room(folder, MAX_BYTES)
    except OSError as problem:
        _say(f"{folder}: machine code cannot be kept there ({problem.strerror}); every process compiles")


def removed_if_damaged(problem: BaseException) -> Path | None:
    """The folder, removed, if Numba raised this where it reads kept machine code: a file that is not whole, as after a power
    failure; None otherwise. The same work then compiles again."""
    folder = _folder()
    place, frames = os.path.join("numba", "core", "caching.py"), traceback.extract_tb(problem.__traceback__)
    if folder is None or not any(frame.filename.endswith(place) for frame in frames):
        return None
    shutil.rmtree(folder, ignore_errors=True)
    return folder


# --- the folder ----------------------------------------------------------------------------------------------------


def _folder() -> Path | None:
    """Where machine code is kept: the first folder that this user, and no other, can write; None if there is none."""
    return next((folder for folder in _folders() if _usable(folder)), None)


def _folders() -> Iterator[Path]:
    named, user = os.environ.get("HYDRO_ENV_CACHE"), os.environ.get("XDG_CACHE_HOME")
    if named:
        yield Path(named).absolute() / "machine_code"
    elif user and Path(user).is_absolute():
        yield Path(user) / "hydro_env" / "machine_code"
    else:
        with suppress(RuntimeError):  # a user without $HOME and without an entry in passwd, as in containers
            home = Path.home()
            if home.is_absolute() and home.is_dir():
                yield home / ".cache" / "hydro_env" / "machine_code"
    with suppress(OSError):  # no folder for temporary files either
        yield Path(tempfile.gettempdir()) / f"hydro_env_{os.geteuid() if hasattr(os, 'geteuid') else 'cache'}"


@cache
def _usable(folder: Path) -> bool:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        reason = distrust(folder)
    except OSError:
        return False
    if reason:
        _say(f"{folder}: machine code is not read from there: {reason}")
    return not reason


@cache
def _make_room(folder: Path, max_bytes: int) -> None:
    """Removes the oldest files while all together are larger than `max_bytes`; looks once in a process."""
    files = []
    for path in folder.rglob("*"):
        with suppress(FileNotFoundError):  # another process makes room, too
            if path.is_file():
                files.append((path.stat(), path))
    total = sum(about.st_size for about, _ in files)
    for about, path in sorted(files, key=lambda each: each[0].st_mtime):
        if total <= max_bytes:
            return
        path.unlink(missing_ok=True)
        total -= about.st_size


@cache
def _say(text: str) -> None:
    """One line on stderr, unless the program has set up logging; the same text once in a process."""
    logging.getLogger(__name__).warning(text)
