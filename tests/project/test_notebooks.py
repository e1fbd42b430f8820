"""The notebooks hold the outputs of a whole run. They run small in every run of the tests, and whole in the slow ones."""

from __future__ import annotations

import json
import os
import runpy
import shlex
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hydro_env.plant import CATALOGUE, unregister

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
#: What stands in the cell `parameters` of a notebook when it runs small.
SMALL = {
    "first_agent": "STEPS, PAIRS = 8192, 2",
    "log_to_model": "SECONDS, DIAGNOSE = 3.0, False",
    "own_controller": "PAIRS, CANDIDATES = 2, 2",
    "own_effect": "SECONDS, DIAGNOSE = 3.0, False",
}


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request: pytest.FixtureRequest) -> Path:
    return request.param


def cells(path: Path) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]


def test_it_was_run_from_top_to_bottom(notebook: Path) -> None:
    assert [cell["execution_count"] for cell in cells(notebook)] == [*range(1, len(cells(notebook)) + 1)]
    outputs = [output for cell in cells(notebook) for output in cell["outputs"]]
    assert {output["output_type"] for output in outputs} <= {"stream", "display_data", "execute_result"}
    assert "stderr" not in {output.get("name") for output in outputs}
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(" at 0x" in json.dumps(output) for output in outputs)
    assert notebook.stat().st_size < 300_000


@pytest.fixture
def clean(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An empty folder, pictures that nobody sees, and no effect of a notebook's afterwards."""
    monkeypatch.chdir(tmp_path)
    matplotlib = pytest.importorskip("matplotlib")
    backend = matplotlib.get_backend()
    matplotlib.use("agg")
    yield
    matplotlib.pyplot.close("all")
    matplotlib.use(backend)
    if "narrowing_edge" in CATALOGUE:
        unregister("narrowing_edge")


def test_it_runs_small(notebook: Path, clean: None) -> None:
    scope: dict[str, Any] = {"__name__": notebook.stem}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "FigureCanvasAgg is non-interactive")
        for number, cell in enumerate(cells(notebook), 1):
            code = "".join(cell["source"])
            if "parameters" in cell["metadata"].get("tags", ()):
                code += "\n" + SMALL[notebook.stem]
            exec(compile(code, f"{notebook.stem}, cell {number}", "exec"), scope)


@pytest.mark.slow
def test_it_runs_whole(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nbclient")
    root = str(DOCS.parent)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])]))
    run = runpy.run_path(str(DOCS / "run_notebooks.py"))["executed"]
    assert run(notebook).cells[-1]


def test_the_commands_that_it_names_exist(notebook: Path) -> None:
    from tests.project.test_docs import COMMANDS

    for line in "".join(
        "".join(c["source"]) for c in json.loads(notebook.read_text("utf-8"))["cells"]
    ).splitlines():
        if line.startswith("hydro-env "):
            command, *words = shlex.split(line, comments=True)[1:]
            known = {option for parameter in COMMANDS[command].params for option in parameter.opts}
            assert {word for word in words if word.startswith("--")} <= known, line
