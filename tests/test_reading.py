"""YAML and JSON from strangers: plain data, or one line that names the file."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_env.controllers import make_controller
from hydro_env.errors import InputError
from hydro_env.measured import load_mapping, read_log
from hydro_env.plant import load_effects, load_model
from hydro_env.practice.manoeuvres import plans_of
from hydro_env.reading import DEPTH, MAX_BYTES_OF_YAML, parse_json, parse_yaml, read_yaml
from hydro_env.valve_bench import read_curve

LETTERS = st.characters(exclude_categories=["Cs", "Cc"])
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(LETTERS)
)
TREES = st.recursive(
    LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(LETTERS), inner), max_leaves=20
)
#: Pieces of which YAML that means something is likely to be made.
PIECES = st.sampled_from([
    "a", ": ", "- ", "\n", "  ", "[", "]", "{", "}", ",", "&a ", "*a", "!!int ", "!!set ", "!!binary ", "<<", "'", '"', "\\ud800",
    "1:30", "2024-13-01", "9" * 60, ".inf", "~", "on", "#", "|\n", ">\n", "? ", "\t", "\0", "---\n", "%", "\ufeff", "0x1f", "010",
])  # fmt: skip
#: Nine of the list before, in each of eight lists.
LAUGHS = "a: &a [1]\n" + "".join(
    f"{c}: &{c} [{f'*{p},' * 9}]\n" for p, c in zip("abcdefgh", "bcdefghi", strict=True)
)


@given(TREES)
@settings(deadline=None)
def test_plain_data_come_back_as_they_were_written(tree: Any) -> None:
    assert parse_json(json.dumps(tree), "x.json") == tree
    assert parse_yaml(yaml.safe_dump(tree, allow_unicode=True), "x.yaml") == tree


@given(st.text() | st.lists(PIECES, max_size=25).map("".join))
@settings(deadline=None, max_examples=400)
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    for parse in (parse_yaml, parse_json):
        try:
            data = parse(text, "x.any")
        except InputError as problem:
            assert (
                str(problem).startswith("x.any") and str(problem).isprintable() and len(str(problem)) < 1500
            )
        else:
            json.dumps(data).encode()


@given(st.binary(max_size=200))
@settings(deadline=None)
def test_any_bytes_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "x.yaml"
    path.write_bytes(data)
    try:
        read_yaml(path, "a model")
    except InputError as problem:
        assert str(path) in str(problem) and str(problem).isprintable()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 400 + "]" * 400, "nested too deep"),
        ("[" * (DEPTH + 1) + "]" * (DEPTH + 1), "nested too deep"),
        ("a: !!int foo", "line 1: not YAML: 'foo' is not a !!int"),
        ("a:\n  b: " + "9" * 5000, "line 2: not YAML: .* is too long"),
        ("a: 1\nb: !!set {c}", "line 2: not YAML: the tag '!!set' is not known here"),
        ("a: !!python/object/apply:os.system [ls]", "is not known here"),
        ("&a [*a]", "nested too deep|recursive"),
        (LAUGHS, "more than"),
        ('a: "\\ud800"', "cannot be written"),
        ("a: b\0", "line 1: not YAML: it holds the character"),
        ("1: a", "the key 1 is not text"),
        ("\ta: 1", "line 1"),
    ],
)  # fmt: skip
def test_yaml_is_refused_with_place_and_reason(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_yaml(text, "x.yaml")


def test_dates_and_clock_times_are_text() -> None:
    text = "a: 2024-13-01\nb: 2024-01-05\nc: 12:30:00\nd: 1_000\ne: 010\nf: 1.5\n"
    expected = {"a": "2024-13-01", "b": "2024-01-05", "c": "12:30:00", "d": 1000, "e": "010", "f": 1.5}
    assert parse_yaml(text, "x.yaml") == expected


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-32"])
def test_another_encoding_is_named(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "x.yaml").write_bytes("name: Prüfstand\n".encode(encoding))
    with pytest.raises(InputError, match=r"x\.yaml line 1: not a UTF-8 text file; expected a model"):
        read_yaml(tmp_path / "x.yaml", "a model")


def test_a_large_or_endless_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.yaml").write_bytes(b"#" * (MAX_BYTES_OF_YAML + 1))
    with pytest.raises(InputError, match="larger than"):
        read_yaml(tmp_path / "x.yaml", "a model")
    with pytest.raises(InputError, match="/dev/zero: a pipe or a device"):
        read_yaml("/dev/zero", "a model")


@pytest.fixture
def in_time() -> Iterator[None]:
    """Ends a test that waits for a pipe for ever."""
    signal.alarm(60)
    yield
    signal.alarm(0)


@pytest.mark.usefixtures("in_time")
@pytest.mark.parametrize(
    ("ending", "read"),
    [
        ("yaml", load_model),
        ("yaml", lambda path: load_model({"schema": "hydro_env/model/1", "base": path})),
        ("yaml", load_mapping),
        ("csv", read_log),
        ("parquet", read_log),
        ("py", lambda path: load_effects([path])),
        ("py", lambda path: make_controller(f"{path}:Mine")),
        ("json", make_controller),
        ("npz", make_controller),
        ("zip", lambda path: make_controller(path, trust=True)),
        ("csv", read_curve),
        ("csv", lambda path: plans_of(path, (73.0, 73.0), 0.01)),
    ],
)
def test_a_pipe_or_a_folder_is_refused(tmp_path: Path, ending: str, read: Callable[[str], object]) -> None:
    pipe, folder = tmp_path / f"pipe.{ending}", tmp_path / f"folder.{ending}"
    os.mkfifo(pipe)
    folder.mkdir()
    for path, said in ((pipe, "a pipe or a device"), (folder, "a folder")):
        with pytest.raises(InputError, match=f"{path.name}.*: {said}"):
            read(str(path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": NaN}', "NaN is not a JSON number"),
        ('{"a": 1, "a": 2}', "'a' is given twice"),
        ("[" * 100_000, "nested too deep"),
        ("9" * 5000, "more than 40 digits"),
        ('{"a": "\\ud800"}', "cannot be written"),
        ("{\n\n'a': 1}", "line 3: not JSON"),
    ],
)
def test_json_is_refused_with_its_reason(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_json(text, "x.json")
