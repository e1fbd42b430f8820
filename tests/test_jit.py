"""Compiled functions are kept, and never taken from a file that no longer fits."""

from __future__ import annotations

import importlib
import itertools
import sys
from pathlib import Path
from types import ModuleType

import pytest

from hydro_env.jit import compiled

CALLED = """
from hydro_env.jit import compiled
FACTOR = {factor}

@compiled
def inner(x):
    return x + {summand}
"""
CALLING = """
from called import FACTOR, inner
from hydro_env.jit import compiled

@compiled
def outer(x):
    return FACTOR * inner(x)
"""


@pytest.fixture
def calling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Writes `called`, with a factor and a summand, and imports `calling` as a new process would."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "calling.py").write_text(CALLING)

    def imported(factor: float, summand: float) -> ModuleType:
        (tmp_path / "called.py").write_text(CALLED.format(factor=factor, summand=summand))
        for name in ("called", "calling"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("calling")

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield imported
    for name in ("called", "calling"):
        sys.modules.pop(name, None)


def test_a_changed_function_or_value_of_another_file_is_noticed(calling) -> None:
    for factor, summand in ((2.0, 1.0), (2.0, 5.0), (3.0, 5.0)):
        assert calling(factor, summand).outer(10.0) == factor * (10.0 + summand)


def test_what_was_compiled_is_loaded(calling) -> None:
    first, again = (calling(2.0, 1.0).outer for _ in range(2))
    assert first(1.0) == again(1.0) == 4.0
    assert (sum(first.stats.cache_hits.values()), sum(again.stats.cache_hits.values())) == (0, 1)


def test_processes_that_save_at_the_same_time_keep_their_own_code(calling) -> None:
    """Two processes read the list of files before either writes: one entry is lost, none is another's."""
    one, other, later = (calling(2.0, 1.0).outer for _ in range(3))
    one(1.0)
    files = other._cache._cache_file
    before, listed = {}, files._load_index
    reads = itertools.chain([before, before], itertools.repeat(None))
    files._load_index = lambda: listed() if (stale := next(reads)) is None else stale
    other(1)  # whole numbers: another signature of the same function
    assert (later(1.5), later(3)) == (5.0, 8.0)


def test_without_a_folder_to_write_to_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(function):
        raise RuntimeError("no locator available")

    monkeypatch.setattr("hydro_env.jit._Cache", refuse)
    assert compiled(lambda x: x + 1)(1) == 2
