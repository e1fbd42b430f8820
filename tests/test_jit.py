"""Compiled functions are kept, and never taken from a file that no longer fits."""

from __future__ import annotations

import gc
import importlib
import logging
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numba import TypingError

from hydro_env import jit
from hydro_env.jit import compiled
from tests.damage import damages

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
    monkeypatch.setenv("HYDRO_ENV_CACHE", str(tmp_path / "cache"))
    for each in (jit._say, jit._usable, jit._make_room):
        each.cache_clear()
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


def test_damaged_files_of_numba_are_removed(calling, tmp_path: Path) -> None:
    """A file that is not whole raises something of Numba's; other errors say nothing of the files."""
    assert calling(2.0, 1.0).outer(1.0) == 4.0
    kept = [*(tmp_path / "cache").rglob("*.nb[ci]")]
    assert kept
    for path in kept:
        path.write_bytes(path.read_bytes()[:10])
    with pytest.raises(Exception) as raised:
        calling(2.0, 1.0).outer(1.0)
    assert jit.removed_if_damaged(ValueError("another")) is None
    assert jit.removed_if_damaged(raised.value) == tmp_path / "cache" / "machine_code"
    jit._usable.cache_clear()
    assert calling(2.0, 1.0).outer(1.0) == 4.0


@pytest.mark.skipif(jit.fcntl is None, reason="no locks of this kind")
def test_a_process_waits_while_another_one_compiles(calling, tmp_path: Path) -> None:
    """Two that save at once would mix up their files."""
    outer, results = calling(2.0, 1.0).outer, []
    thread = threading.Thread(target=lambda: results.append(outer(1.0)))
    with (tmp_path / "cache" / "machine_code" / "lock").open("wb") as lock:
        jit.fcntl.flock(lock, jit.fcntl.LOCK_EX)
        thread.start()
        thread.join(0.3)
        assert results == []
    thread.join()
    assert results == [4.0]


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_removed(calling, tmp_path: Path, caplog, data: st.DataObject) -> None:
    """Whatever bytes are lost or changed: one line, and the file counts as not there."""
    jit._say.cache_clear()
    caplog.clear()
    jit.keep("x.o", b"machine code")
    path = tmp_path / "cache" / "machine_code" / "x.o"
    whole = path.read_bytes()
    damaged = data.draw(damages(whole))
    path.write_bytes(damaged)
    changed = damaged != whole
    assert jit.kept("x.o") == (None if changed else b"machine code")
    assert [record.levelno for record in caplog.records] == [logging.WARNING] * changed
    assert all("damaged machine code" in record.getMessage() for record in caplog.records)
    assert path.exists() != changed


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions of this kind")
def test_code_that_others_could_have_written_is_not_read(calling, tmp_path: Path, caplog) -> None:
    assert calling(2.0, 1.0).outer(1.0) == 4.0
    (tmp_path / "cache" / "machine_code").chmod(0o770)
    jit._usable.cache_clear()
    again = calling(2.0, 1.0).outer
    assert again(1.0) == 4.0
    assert not again.stats.cache_path.startswith(str(tmp_path / "cache" / "machine_code"))
    (line,) = {record.getMessage() for record in caplog.records}
    assert "other users can write there" in line and "chmod go-w" in line


def test_a_full_disk_only_costs_time(calling, monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(jit, "write_bytes", full)
    jit.keep("x.o", b"machine code")
    (line,) = [record.getMessage() for record in caplog.records]
    assert "cannot be kept there (No space left on device)" in line


def test_the_folder_stays_below_its_limit(tmp_path: Path) -> None:
    for number in range(6):
        path = tmp_path / str(number)
        path.write_bytes(bytes(100))
        os.utime(path, (number, number))
    os.utime(tmp_path / "0", (9, 9))  # used again
    jit._make_room(tmp_path, 300)
    assert {path.name for path in tmp_path.iterdir()} == {"0", "4", "5"}


def test_without_a_folder_to_write_to_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "_folders", lambda: iter(()))
    assert compiled(lambda x: x + 1)(1) == 2


HOMELESS = """
import pwd

def unknown(user):
    raise KeyError(f"no such user: {user}")

pwd.getpwuid = pwd.getpwnam = unknown
import gymnasium
env = gymnasium.make("hydro_env:HydraulicSync-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


@pytest.mark.skipif(os.name != "posix", reason="users without an entry in passwd")
@pytest.mark.parametrize("home", [None, "/nonexistent", "nowhere", "/proc"])
def test_a_user_without_a_home_can_use_it(tmp_path: Path, home: str | None) -> None:
    """As in a container: no $HOME, or one that is not there or cannot be written, and no entry in passwd."""
    own: dict[str, str] = {
        name: value for name, value in os.environ.items() if name not in ("HOME", "HYDRO_ENV_CACHE")
    }
    own.update({"HOME": home} if home is not None else {})
    own["TMPDIR"] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", HOMELESS], env=own, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert [path for path in tmp_path.iterdir() if path.name.startswith("hydro_env_")]


def test_garbage_is_collected_again_after_compiling():
    """Also after a function that cannot be compiled, and not where it was off before."""
    one = compiled(lambda x: x + 1)
    assert one(1) == 2 and gc.isenabled()
    with pytest.raises(TypingError):
        compiled(lambda x: x.nothing)(1)
    assert gc.isenabled()
    gc.disable()
    try:
        assert one(1.0) == 2.0 and not gc.isenabled()
    finally:
        gc.enable()
