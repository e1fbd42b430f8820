"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.S)


@pytest.mark.parametrize("code", BLOCKS, ids=[block.strip().splitlines()[-1][:40] for block in BLOCKS])
def test_python_example(code: str) -> None:
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_tests_are_run_as_the_readme_says() -> None:
    """What the continuous integration runs is the README's second command."""
    root = Path(__file__).parents[2]
    (command,) = re.findall(r"Run the tests:\n\n```sh\n(.*?)\n```", README, flags=re.S)
    assert command in (root / ".ci" / "run").read_text(encoding="utf-8").splitlines()
