"""A disk that is full from its n-th write on, for every n in turn."""

from __future__ import annotations

import builtins
import errno
import io
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


class FullDisk:
    """What is written below `root` is counted; from write `full_at` on (None: never) there is no space left.

    Counted are files and folders that are made, what is written to files, and renames. Renames after the first that fails
    succeed, since most need no space.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, root: Path) -> None:
        self.root, self.count, self.full_at = root, 0, None
        for module, name, wrap in (
            (builtins, "open", self._opening), (io, "open", self._opening), (os, "replace", self._replace),
            (tempfile, "mkdtemp", self._making), (os, "mkdir", self._mkdir), (os, "rename", self._replace),
        ):  # fmt: skip
            monkeypatch.setattr(module, name, wrap(getattr(module, name)))

    def begin(self, full_at: int | None) -> None:
        """Empties the disk."""
        self.count, self.full_at = 0, full_at

    def write(self, path: object, *, named: bool = True, later: bool = True) -> None:
        """Counts a write; OSError if the disk is full."""
        try:
            inside = Path(os.fspath(path)).absolute().is_relative_to(self.root)  # type: ignore[arg-type]
        except TypeError:  # a file descriptor
            return
        if not inside:
            return
        self.count += 1
        if self.full_at is not None and (self.count == self.full_at or (later and self.count > self.full_at)):
            raise OSError(errno.ENOSPC, "No space left on device", *([str(path)] if named else []))

    def _opening(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def opened(file: Any, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
            if not set(mode) & set("wax+") or (set(mode) & set("r+") == set("r+") and "w" not in mode):
                return real(file, mode, *args, **kwargs)
            self.write(file)
            return _File(real(file, mode, *args, **kwargs), self, file)

        return opened

    def _making(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def made(*args: Any, **kwargs: Any) -> Any:
            self.write(kwargs.get("dir") or os.devnull)
            return real(*args, **kwargs)

        return made

    def _mkdir(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def made(path: Any, *args: Any, **kwargs: Any) -> Any:
            if not os.path.isdir(path):
                self.write(path)
            return real(path, *args, **kwargs)

        return made

    def _replace(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def moved(source: Any, target: Any, *args: Any, **kwargs: Any) -> Any:
            try:
                self.write(target, later=False)
            except OSError as problem:
                raise OSError(problem.errno, problem.strerror, str(source), None, str(target)) from None
            return real(source, target, *args, **kwargs)

        return moved


class _File:
    """A file on that disk. Its errors name no file, as those of `write` do."""

    def __init__(self, real: Any, disk: FullDisk, path: Any) -> None:
        self._real, self._disk, self._path = real, disk, path

    def write(self, data: Any) -> Any:
        self._disk.write(self._path, named=False)
        return self._real.write(data)

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *problem: object) -> None:
        self._real.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)
