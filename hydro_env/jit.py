"""How functions are compiled: by Numba, once, and kept for the next process.

A file holds the machine code of one function for one signature. Its name is a hash of all that the code depends on,
so it is never stale, and processes that compile at the same time write the same file. A damaged file is removed and
compiled again. Numba's own cache (`cache=True`) has none of that: it misses changed values and functions of other files,
mixes up code that two processes save, and ends with a traceback at a damaged file.

Machine code is kept in $HYDRO_ENV_CACHE, else in the user's cache folder, else in the folder for temporary files. Where
other users could have written it is not read: it would run. Without any such folder every process compiles.
"""

from __future__ import annotations

import gc
import hashlib
import inspect
import linecache
import logging
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import numba.np.linalg as numba_linalg
import numpy as np
from numba import njit
from numba.core import event
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from hydro_env.files import write_bytes
from hydro_env.pickles import Damaged, distrust, seal, unseal

__all__ = ["compiled", "keep", "kept"]

MOST_BYTES = 1 << 30
"""Machine code to keep. All tests together compile a fifth of it; what was not used for longest is removed beyond."""

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(
    function: Callable[..., Any], *, nogil: bool = False, allocates: bool = True
) -> Callable[..., Any]:
    """The function in machine code.

    `nogil`: other threads run meanwhile. `allocates`: false for a function that makes no arrays; it compiles in less time, as
    none are counted.
    """
    dispatcher = njit(nogil=nogil, _nrt=allocates, **_OPTIONS)(function)
    dispatcher._cache = _Cache(function)
    return dispatcher


class _CollectorWaits(event.Listener):  # type: ignore[misc]
    """Python's collector of cyclic garbage waits while Numba compiles: going through all that a compiler holds, again and again,
    took a tenth of the time. Functions that are compiled on the way, for the one that calls them, are inside."""

    def __init__(self) -> None:
        self._inside, self._was_on = 0, False

    def on_start(self, event: event.Event) -> None:
        if self._inside == 0:
            self._was_on = gc.isenabled()
            gc.disable()
        self._inside += 1

    def on_end(self, event: event.Event) -> None:
        self._inside -= 1
        if self._inside == 0 and self._was_on:
            gc.enable()


event.register("numba:compile", _CollectorWaits())


def _load_array_functions() -> None:
    """Loads Numba's functions of arrays, as its first compilation would, without asking for a BLAS.

    To learn that there is one it imports all of `scipy.linalg`, which takes a tenth of a second of every start. SciPy is required
    here, and whatever makes use of a BLAS asks for it again."""
    asked = getattr(numba_linalg, "ensure_blas", None)
    if asked is None:  # another version of Numba asks in another way
        return
    numba_linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        numba_linalg.ensure_blas = asked


_load_array_functions()


def _held(function: FunctionType) -> list[object]:
    """What the machine code of a function holds beside its own text: values of globals, and the functions it calls."""
    held: list[object] = []
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        called = getattr(value, "py_func", None)
        if called is not None:
            held += [name, called.__code__.co_code, called.__code__.co_consts]
            held += [] if called is function else _held(called)
        elif isinstance(value, np.ndarray):
            held += [name, value.tobytes()]
        elif isinstance(value, int | float | str | tuple):
            held += [name, value]
    return held


def _text(function: FunctionType) -> str:
    """The text of the whole file of a function, as it was when the function was made."""
    file = inspect.getfile(function)
    linecache.checkcache(file)
    return "".join(linecache.getlines(file))


class _Cache(NullCache):  # type: ignore[misc]
    """Machine code of one function, as Numba's dispatcher asks for it and hands it over."""

    def __init__(self, function: Any) -> None:
        self._function = function
        self._text = hashlib.sha256(_text(function).encode()).hexdigest()

    @property
    def cache_path(self) -> str | None:
        folder = _folder()
        return None if folder is None else str(folder)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The compiled function, None if it is not there or damaged."""
        target.refresh()
        return _read(
            self._name(signature, target.codegen()),
            lambda content: CompileResult._rebuild(target, *pickle.loads(content)),
        )

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keeps a compiled function, unless it holds addresses of this process."""
        if not result.library.has_dynamic_globals and all(x.can_cache for x in result.lifted):
            keep(self._name(signature, result.codegen), dumps(result._reduce()))

    def _name(self, signature: Any, codegen: Any) -> str:
        """The file for a signature. Numba names a tuple type by its class alone, so its fields are added."""
        function = self._function
        closed = tuple(cell.cell_contents for cell in function.__closure__ or ())
        depends = (
            function.__module__, function.__qualname__, self._text, function.__code__.co_code, _held(function),
            signature, [getattr(each, "fields", None) for each in signature], codegen.magic_tuple(),
            numba.__version__, sys.implementation.cache_tag, dumps(closed) if closed else b"",
        )  # fmt: skip
        return f"{hashlib.sha256(repr(depends).encode()).hexdigest()[:32]}.nbc"


# --- files ---------------------------------------------------------------------------------------------------------


def kept(name: str) -> bytes | None:
    """The content of a file of this name, None if it is not there or damaged."""
    return _read(name, lambda content: content)


def _read(name: str, made_of: Callable[[bytes], Any]) -> Any:
    folder = _folder()
    if folder is None:
        return None
    path = folder / name
    try:
        if not stat.S_ISREG(path.lstat().st_mode):  # reading a pipe or a device might never end
            raise Damaged("it is no file")
        found = made_of(unseal(path.read_bytes()))
        os.utime(path)  # used last now, see `_make_room`
        return found
    except FileNotFoundError:
        return None
    except Exception:  # damaged, or a class in it has gone: what was compiled can always be compiled again
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
        write_bytes(folder / name, seal(content))
        _make_room(folder, MOST_BYTES)
    except OSError as problem:
        _say(f"{folder}: machine code cannot be kept there ({problem.strerror}); every process compiles")


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


def _make_room(folder: Path, most: int) -> None:
    """Removes the files that were not used for longest while all together are larger than `most` bytes."""
    files = []
    for path in folder.iterdir():
        with suppress(FileNotFoundError):  # another process makes room, too
            files.append((path.stat(), path))
    total = sum(about.st_size for about, _ in files)
    for about, path in sorted(files, key=lambda each: each[0].st_mtime):
        if total <= most:
            return
        path.unlink(missing_ok=True)
        total -= about.st_size


@cache
def _say(text: str) -> None:
    """One line on stderr, unless the program has set up logging; the same text once in a process."""
    logging.getLogger(__name__).warning(text)
