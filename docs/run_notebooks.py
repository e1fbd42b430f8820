"""Runs the notebooks of docs/notebooks and keeps what they print and draw: `python docs/run_notebooks.py [FILE.ipynb ...]`.

Needs the extra `docs`. A cell with the tag `parameters` holds the sizes; tests replace them with smaller ones.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
NOTEBOOKS = sorted((HERE / "notebooks").glob("*.ipynb"))


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook with its outputs, run in an empty folder. CellExecutionError if a cell raises."""
    notebook = nbformat.read(path, as_version=4)
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, timeout=1800, record_timing=False, resources={"metadata": {"path": folder}}
        ).execute()
    notebook.metadata["language_info"] = {"name": "python"}
    return notebook


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]) if sys.argv[1:] else NOTEBOOKS:
        nbformat.write(executed(path), path)
        print(f"run: {path.relative_to(HERE.parent) if path.is_relative_to(HERE) else path}")
