"""What all tests share: one thread to a process, and the longest test first."""

from __future__ import annotations

import os

import pytest

# Workers share the cores (`pytest -n auto`), and so do the processes that tests start: none takes more than one.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begins with the type checker: at the end of the list one worker would run it while the others wait."""
    items.sort(key=lambda item: "test_checker[mypy]" not in item.nodeid)
