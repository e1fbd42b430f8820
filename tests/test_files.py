"""Files are written whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.files import output_folder, to_json, write_json, write_text


def listing(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_write_text_replaces_and_leaves_no_temporary_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    write_text(path, "naïve")
    assert path.read_text(encoding="utf-8") == "naïve"
    assert listing(tmp_path) == ["a.txt"]


def test_write_text_keeps_the_old_file_when_it_fails(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "half \ud800")
    assert path.read_text() == "old"
    assert listing(tmp_path) == ["a.txt"]


def test_json_is_plain_and_finite(tmp_path: Path) -> None:
    data = {
        "array": np.array([1.0, np.nan, -np.inf]),
        "scalar": np.float32(0.5),
        "whole": np.int64(3),
        "truth": np.bool_(True),
        1: (float("inf"), Path("x")),
    }
    write_json(tmp_path / "a.json", data)
    text = (tmp_path / "a.json").read_text()
    assert "NaN" not in text and "Infinity" not in text
    expected = {"array": [1.0, None, None], "scalar": 0.5, "whole": 3, "truth": True, "1": [None, "x"]}
    assert json.loads(text) == expected
    assert json.loads(to_json(data)) == expected


def test_json_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(TypeError):
        to_json({"x": object()})


def test_output_folder_appears_at_the_end(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "out"
    with output_folder(out) as folder:
        (folder / "a.txt").write_text("a")
        assert not out.exists()
    assert listing(out) == ["a.txt"]
    assert listing(tmp_path) == ["deep", "deep/out", "deep/out/a.txt"]
    assert out.stat().st_mode & 0o777 == out.parent.stat().st_mode & 0o777


def test_output_folder_keeps_other_files_and_merges(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "mine.txt").write_text("mine")
    (tmp_path / "a.txt").write_text("old")
    with output_folder(tmp_path) as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "new.txt").write_text("new")
        (folder / "a.txt").write_text("new")
    assert listing(tmp_path) == ["a.txt", "sub", "sub/mine.txt", "sub/new.txt"]
    assert (tmp_path / "a.txt").read_text() == "new"


@pytest.mark.parametrize("problem", [RuntimeError, KeyboardInterrupt])
@pytest.mark.parametrize("exists", [False, True])
def test_output_folder_leaves_nothing_after_a_failure(
    tmp_path: Path, problem: type[BaseException], exists: bool
) -> None:
    out = tmp_path / "deep" / "out"
    if exists:
        out.mkdir(parents=True)
        (out / "a.txt").write_text("old")
    before = listing(tmp_path)
    with pytest.raises(problem), output_folder(out) as folder:
        (folder / "a.txt").write_text("half")
        raise problem
    assert listing(tmp_path) == before
    assert not exists or (out / "a.txt").read_text() == "old"


@pytest.mark.parametrize("at", range(7))
def test_output_folder_is_as_before_when_a_move_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    """Whichever of the renames at the end finds the disk full."""
    out = tmp_path / "out"
    for name in ("a", "b", "sub/c"):
        (out / name).parent.mkdir(exist_ok=True, parents=True)
        (out / name).write_text("old")
    left, replace = [at], os.replace

    def full(item, place) -> None:
        if not left[0]:
            left[0] = -1
            raise OSError(errno.ENOSPC, "No space left on device", str(item), None, str(place))
        left[0] -= 1
        replace(item, place)

    with contextlib.suppress(OSError), output_folder(out) as folder:
        (folder / "sub").mkdir()
        for name in ("a", "b", "sub/c", "sub/new"):
            (folder / name).write_text("new")
        monkeypatch.setattr(os, "replace", full)
    assert left[0] < 0
    assert listing(tmp_path) == ["out", "out/a", "out/b", "out/sub", "out/sub/c"]
    assert {(out / name).read_text() for name in ("a", "b", "sub/c")} == {"old"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_met_with_the_name_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file, mode="r", *more, real=open, **named):
        return real("/dev/full", "wb") if mode == "xb" else real(file, mode, *more, **named)

    (tmp_path / "a.txt").write_text("old")
    monkeypatch.setattr("builtins.open", full)
    with pytest.raises(OSError) as caught, output_folder(tmp_path) as folder:
        write_text(folder / "a.txt", "new")
    assert (caught.value.filename, caught.value.errno) == (str(tmp_path / "a.txt"), errno.ENOSPC)
    with pytest.raises(OSError) as caught, output_folder(tmp_path), open("/dev/full", "w") as file:
        file.write("of a library that says no name")
        file.flush()
    assert caught.value.filename == str(tmp_path)
    assert listing(tmp_path) == ["a.txt"] and (tmp_path / "a.txt").read_text() == "old"


def test_output_folder_may_be_the_current_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with output_folder(".") as folder:
        (folder / "a.txt").write_text("a")
    assert listing(tmp_path) == ["a.txt"]


def test_output_folder_that_is_a_file_or_below_one(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "out", tmp_path / "file" / "deep" / "out"):
        with pytest.raises(InputError, match="cannot write there"), output_folder(out):
            raise AssertionError("must not be reached")
    assert listing(tmp_path) == ["file"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_output_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        for out in (tmp_path, tmp_path / "out", tmp_path / "deep" / "out"):
            with pytest.raises(InputError, match="cannot write there"), output_folder(out):
                raise AssertionError("must not be reached")
    finally:
        tmp_path.chmod(0o700)
