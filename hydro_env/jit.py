"""How functions are compiled: once, and kept for the next process.

Numba keeps machine code in files beside the source (or in $NUMBA_CACHE_DIR) and compiles again when a function's own
file has changed. Two cases are not covered by that, and are here: code that holds values or functions of other files,
and processes that compile the same function at the same time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from types import FunctionType
from typing import Any

import numpy as np
from numba import njit
from numba.core.caching import FunctionCache, IndexDataCacheFile

__all__ = ["compiled"]

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """The function in machine code; `options` are those of `numba.njit`."""
    dispatcher = njit(**_OPTIONS, **options)(function)
    with suppress(RuntimeError):  # Numba finds no folder it may write to: compile in every process
        dispatcher._cache = _Cache(function)
    return dispatcher


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


class _Cache(FunctionCache):  # type: ignore[misc]
    """Machine code of one function; that of changed callees or values of other files is not taken for it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, stamp)

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        held = hashlib.sha256(repr(_held(self._py_func)).encode()).hexdigest()
        return (*super()._index_key(signature, codegen), held)


class _Files(IndexDataCacheFile):  # type: ignore[misc]
    """The files of one function, which several processes may write at the same time.

    Numba counts its files and lists a number before the file is there, so two processes can take one number for
    different code. Here a file is named by what it holds and listed when it is there. At worst an entry gets lost.
    """

    def save(self, key: Any, data: Any) -> None:
        digest = hashlib.sha256(repr((self._source_stamp, key)).encode()).digest()
        name = self._data_name(int.from_bytes(digest[:8]))
        self._save_data(name, data)
        self._save_index({**self._load_index(), key: name})
