"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.S)


@pytest.mark.parametrize("code", BLOCKS, ids=[block.strip().splitlines()[-1][:40] for block in BLOCKS])
def test_python_example(code: str) -> None:
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_model_file(tmp_path: Path) -> None:
    from hydro_env.plant import load_model

    (text,) = re.findall(r"```yaml\n(schema: hydro_env/model/1.*?)```", README, flags=re.S)
    (tmp_path / "model.yaml").write_text(text, encoding="utf-8")
    model = load_model(tmp_path / "model.yaml")
    assert model.value("dead_zone.overlap_negative", 0) == 6e-5


def test_commands_exist() -> None:
    from hydro_env import cli

    known = {command.name or command.callback.__name__ for command in cli.app.registered_commands}  # type: ignore[union-attr]
    assert set(re.findall(r"hydro-env ([a-z-]+)", README)) <= known


def test_links_lead_somewhere() -> None:
    root = Path(__file__).parent.parent
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target


def test_tests_are_run_as_the_readme_says() -> None:
    """What the continuous integration runs is the README's second command."""
    root = Path(__file__).parent.parent
    (command,) = re.findall(r"Run the tests:\n\n```sh\n(.*?)\n```", README, flags=re.S)
    assert command in (root / ".ci" / "run").read_text(encoding="utf-8").splitlines()
