"""Products and sums of the generated text as fused operations, a * b + c in one rounding.

The compiler may not fuse on its own: what it fuses would depend on the effects compiled in and on the width of the block. Fused
here, statement by statement, a statement gives the same bits wherever it stands.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import lru_cache

__all__ = ["fuse", "fused_lines"]


class _Fuse(ast.NodeTransformer):
    """Writes a * b + c, c + a * b, a * b - c and c - a * b as one fused operation."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        node = self.generic_visit(node)  # type: ignore[assignment]
        if not isinstance(node.op, ast.Add | ast.Sub):
            return node
        minus = isinstance(node.op, ast.Sub)
        left, right = node.left, node.right
        if isinstance(right, ast.BinOp) and isinstance(right.op, ast.Mult):
            factor = ast.UnaryOp(ast.USub(), right.left) if minus else right.left
            return _fma(factor, right.right, left)
        if isinstance(left, ast.BinOp) and isinstance(left.op, ast.Mult):
            term = ast.UnaryOp(ast.USub(), right) if minus else right
            return _fma(left.left, left.right, term)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        return node  # an index is whole numbers


def _fma(*operands: ast.expr) -> ast.Call:
    return ast.Call(ast.Name("fma", ast.Load()), list(operands), [])


def fuse(node: ast.AST) -> ast.AST:
    """A syntax tree with its products and sums fused, in place."""
    return _Fuse().visit(node)


@lru_cache(maxsize=1 << 14)  # kernels of different effects share most of their statements
def _fused(line: str) -> str:
    if line.endswith(":"):  # the first line of an `if`
        return _fused(f"{line} pass").splitlines()[0]
    return ast.unparse(fuse(ast.parse(line)))


def fused_lines(lines: Iterable[str]) -> Iterator[str]:
    """Each line with its products and sums fused; what has no product stays as it is."""
    for line in lines:
        text = line.lstrip()
        yield line[: len(line) - len(text)] + _fused(text) if "*" in text else line
