"""How large the package and its documents may grow: to raise a number is a decision, made here."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

#: Lines of code, without blank ones, comments and docstrings, of everything below a folder.
MAX_LINES = {
    "hydro_env": 30_200,
    "hydro_env/diagnosis": 4_700,
    "hydro_env/export": 1_900,
    "hydro_env/experiments": 1_800,
}
#: Words, without generated parts, of everything that matches.
MAX_WORDS = {"docs/**/*.md": 25_500, "CHANGELOG.md": 2_500, "README.md": 700}

_LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
}  # fmt: skip


@cache
def lines_of_code(path: Path) -> int:
    text = path.read_text(encoding="utf-8")
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    held = {n for t in tokens if t.type not in _LAYOUT for n in range(t.start[0], t.end[0] + 1)}
    return len(held - set(docstring_lines(ast.parse(text))))


def docstring_lines(tree: ast.Module) -> Iterable[int]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(getattr(first.value, "value", None), str):
                yield from range(first.lineno, (first.end_lineno or first.lineno) + 1)


@pytest.mark.parametrize("folder", MAX_LINES)
def test_code_stays_within_its_budget(folder: str) -> None:
    lines = sum(lines_of_code(path) for path in (ROOT / folder).rglob("*.py"))
    assert lines <= MAX_LINES[folder], f"{folder} has {lines} lines of code"


@pytest.mark.parametrize("pattern", MAX_WORDS)
def test_documents_stay_within_their_budget(pattern: str) -> None:
    texts = [path.read_text(encoding="utf-8") for path in ROOT.glob(pattern)]
    written = [re.sub(r"<!-- generated: .*?<!-- end -->", "", text, flags=re.DOTALL) for text in texts]
    words = sum(len(text.split()) for text in written)
    assert words <= MAX_WORDS[pattern], f"{pattern} has {words} words"
