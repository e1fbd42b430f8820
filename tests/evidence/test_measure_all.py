"""A step is measured again where its commands, or code that it runs, have changed."""

from __future__ import annotations

import shutil
from typing import Any

import pytest

from docs.evidence import measure_all
from docs.evidence.measure_all import STEPS, is_current


@pytest.mark.skipif(shutil.which("git") is None, reason="no git")
@pytest.mark.parametrize(
    ("changed", "again"),
    [
        ("hydro_env/plant/rhs.py", {*STEPS}),
        ("hydro_env/controllers/data/pid.json", {*STEPS}),
        ("hydro_env/diagnosis/workflow.py", {*measure_all.DIAGNOSED}),
        ("docs/evidence/scaling.py", {*measure_all.DIAGNOSED, "scaling"}),
        ("tests/lab/picture.py", {"lab"}),
        ("docs/evidence/results.json", set()),
        ("hydro_env/controllers/policies/gru.md", set()),
        ("docs/results.md", set()),
    ],
)
def test_what_runs_changed_code_is_measured_again(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, changed: str, again: set[str]
) -> None:
    monkeypatch.setattr(measure_all, "ROOT", tmp_path)

    def git(*words: str) -> str:
        return measure_all.git("-c", "user.name=a", "-c", "user.email=a@b.c", *words)

    git("init", "-q")
    for name in (changed, "other.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("before")
        git("add", name)
    git("commit", "-q", "-m", "before")
    done = {
        name: {"commit": git("rev-parse", "HEAD"), "commands": list(s.commands)} for name, s in STEPS.items()
    }
    assert all(is_current(name, row) for name, row in done.items())
    (tmp_path / changed).write_text("after")
    assert {name for name, row in done.items() if not is_current(name, row)} == again


def test_other_commands_are_measured_again() -> None:
    assert not is_current("speed", None)
    assert not is_current("speed", {"commit": "HEAD", "minutes": 1.0})
    assert not is_current("speed", {"commit": "HEAD", "commands": ["hydro-env speed"]})
