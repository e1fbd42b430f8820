"""The code passes the linter and the type checker, and the generated tables of the documents are up to date."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize("command", [["ruff", "check", "."], ["mypy"]], ids=["ruff", "mypy"])
def test_checker(command: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", ["README.md", "docs/plant.md", "docs/effects.md", "docs/losses.md"])
def test_tables_of_the_documents(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    filled = runpy.run_path(str(ROOT / "docs" / "tables.py"))["filled"]
    assert text == filled(text), "out of date: run `python docs/tables.py`"


def test_nothing_depends_on_the_code_above_it() -> None:
    """The arrows between the packages go one way."""
    below = {
        "plant": ("tasks", "envs", "controllers", "benchmark", "diagnosis", "experiments", "cli", "sb3"),
        "tasks": ("envs", "controllers", "benchmark", "diagnosis", "experiments", "cli", "sb3"),
        "envs": ("benchmark", "diagnosis", "experiments", "cli"),
        "controllers": ("benchmark", "diagnosis", "experiments", "cli"),
        "valve_bench": (
            "tasks",
            "envs",
            "controllers",
            "benchmark",
            "diagnosis",
            "experiments",
            "cli",
            "sb3",
        ),
        "diagnosis": ("benchmark", "experiments", "cli"),
        "benchmark": ("experiments", "cli"),
    }
    wrong = []
    for package, above in below.items():
        for path in (ROOT / "hydro_env" / package).rglob("*.py"):
            for line in path.read_text(encoding="utf-8").splitlines():
                words = line.split()
                if words[:1] not in (["from"], ["import"]):
                    continue
                module = words[1].removeprefix("hydro_env.").removeprefix("..")
                if module.split(".")[0] in above and words[1] != module:
                    wrong.append(f"{path.relative_to(ROOT)}: {line.strip()}")
                if words[1].split(".")[0] == "agents":
                    wrong.append(f"{path.relative_to(ROOT)}: {line.strip()}")
    assert not wrong
