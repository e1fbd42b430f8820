"""The code passes the linter, the formatter and the type checker."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LONG

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    "command",
    [["ruff", "check", "."], ["ruff", "format", "--check", "."], ["mypy"]],
    ids=["ruff", "format", "mypy"],
)
def test_checker(command: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_entry_of_the_long_tests_is_a_test() -> None:
    for entry in LONG:
        file, _, name = entry.partition("::")
        (path,) = (ROOT / "tests").rglob(file)
        assert f"def {name.partition('[')[0]}" in path.read_text(encoding="utf-8"), entry
