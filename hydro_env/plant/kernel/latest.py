"""Adds last what is known last, so that as little as possible waits for it.

A block of few lanes is bound by the longest chain of operations that wait for each other's results. In a stage it goes through
the friction of the spool: a polynomial and a division. All that follows, up to the change of the spool's speed, is linear in
the quotient: so the rest is summed meanwhile, and a multiple of the quotient is added at the end.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from typing import NamedTuple

from .layout import uses

__all__ = ["added_last"]


class _Split(NamedTuple):
    """A value without the late one, and the factor with which that comes in; none if it does not."""

    early: ast.expr
    share: ast.expr | None


class _NotLinear(Exception):
    pass


def added_last(lines: Sequence[str], late: str, goal: str, shared: bool = False) -> list[str]:
    """Assignments, in which `goal` gets what it owes to `late` as one product at its end.

    Those between the two that depend on `late` are there as `name__early`, without it, and `name__share`, its factor. Where a
    later line uses one, its sum follows `goal`, or comes before what is not linear. `shared`: the factor of `goal` is known.
    """
    targets = [line.split(" = ", 1)[0] for line in lines]
    first, last = targets.index(late) + 1, targets.index(goal) + 1
    known = {late: _Split(ast.Constant(0.0), ast.Constant(1.0))}
    found = [*lines[:first]]
    for line in lines[first:last]:
        target, expression = line.split(" = ", 1)
        node = ast.parse(expression, mode="eval").body
        try:
            early, share = _split(node, known)
        except _NotLinear:
            found += _sums(known, late)
            known = {}
            early, share = node, None
        if share is None:
            known.pop(target, None)
            found.append(line)
            continue
        found.append(f"{target}__early = {ast.unparse(early)}")
        if not (shared and target == goal):
            found.append(f"{target}__share = {ast.unparse(share)}")
        known[target] = _Split(
            ast.Name(f"{target}__early", ast.Load()), ast.Name(f"{target}__share", ast.Load())
        )
    rest = "\n".join(lines[last:])
    used = {name: own for name, own in known.items() if name == goal or uses(name, rest)}
    return [*found, *_sums(used, late), *lines[last:]]


def _sums(known: dict[str, _Split], late: str) -> list[str]:
    return [f"{name} = {name}__early + {name}__share * {late}" for name in known if name != late]


def _split(node: ast.expr, known: dict[str, _Split]) -> _Split:
    """An expression of sums and products, with the names that are `known` split already."""
    if isinstance(node, ast.Name):
        return known.get(node.id, _Split(node, None))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        early, share = _split(node.operand, known)
        return _Split(ast.UnaryOp(node.op, early), None if share is None else ast.UnaryOp(node.op, share))
    if isinstance(node, ast.BinOp):
        left, right = _split(node.left, known), _split(node.right, known)
        if left.share is None and right.share is None:
            return _Split(node, None)
        early = ast.BinOp(left.early, node.op, right.early)
        if isinstance(node.op, ast.Add | ast.Sub):
            if left.share is None:
                assert right.share is not None
                minus = isinstance(node.op, ast.Sub)
                return _Split(early, ast.UnaryOp(ast.USub(), right.share) if minus else right.share)
            if right.share is None:
                return _Split(early, left.share)
            return _Split(early, ast.BinOp(left.share, node.op, right.share))
        if isinstance(node.op, ast.Mult) and (left.share is None or right.share is None):
            factors = (left.share or left.early, right.share or right.early)
            return _Split(early, ast.BinOp(factors[0], node.op, factors[1]))
        raise _NotLinear
    if any(isinstance(n, ast.Name) and n.id in known for n in ast.walk(node)):
        raise _NotLinear
    return _Split(node, None)
