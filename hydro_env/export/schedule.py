"""The order in which a program's numbers are computed: a list of steps that a language writes one after the other.

An expression that is needed once is written where it is needed; one that is needed more often gets a variable. Blocks become
loops over arrays, whose operands are read in place where they lie side by side in another array, else gathered first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .kernels import KernelCall, Kernels
from .symbols import Block, Expr, Items, Kernel, expressions_in

__all__ = ["Call", "Fill", "Let", "Loop", "Matrix", "Schedule", "Slice", "Store"]

#: Operations that an expression may hold inside of one another.
DEEPEST = 5


@dataclass
class Slice:
    """Elements of an array, from `start` on. `array` names a variable, "measured", or an array of the state (`kept`)."""

    array: str
    start: int
    kept: bool = False


@dataclass
class Let:
    """name = expression."""

    name: str
    expression: Expr


@dataclass
class Fill:
    """An array of expressions that do not lie side by side."""

    name: str
    kind: str
    elements: list[Expr]


@dataclass
class Loop:
    """name[i] = operation of operands[i], for all i."""

    name: str
    kind: str
    size: int
    op: str
    operands: list[Slice | Expr]


@dataclass
class Matrix:
    """name = matrix @ operand."""

    name: str
    kind: str
    matrix: Any
    operand: Slice


@dataclass
class Call:
    """A call of a translated function: `arrays` are copied to variables of their own (None: read in place), then changed."""

    names: list[str]
    kinds: list[str]
    sizes: list[int]
    contents: list[Slice | list[Expr]]
    in_place: list[bool]
    how: KernelCall


@dataclass
class Store:
    """Elements of the state, or a command, set at the end: one expression, a variable, or a slice of `count`."""

    array: str
    start: int
    value: Expr | Slice | str
    count: int = 1


Step = Let | Fill | Loop | Matrix | Call


class Schedule:
    """The steps for assignments (array, index) -> expression, and the stores at their end."""

    def __init__(self, assignments: dict[tuple[str, int], Expr], kernels: Kernels) -> None:
        self.steps: list[Step] = []
        self.names: dict[int, str] = {}  # variables of expressions, by identity
        self.arrays: dict[int, str] = {}  # and of blocks and arrays of calls
        self._kernels = kernels
        self._keep: list[Any] = []
        self._depth: dict[int, int] = {}
        self._uses = _uses(assignments.values())
        self._count = 0
        for expression in assignments.values():
            self._prepare(expression)
        self.stores = self._stores(assignments)

    # --- what is computed before ----------------------------------------------------------------------------------
    def _fresh(self, letter: str) -> str:
        self._count += 1
        return f"{letter}{self._count}"

    def _prepare(self, root: Any) -> None:
        """Adds the steps for everything below a node, and the node itself where it has a variable."""
        stack = [(root, False)]
        done = self._depth
        while stack:
            node, ready = stack.pop()
            if id(node) in done:
                continue
            if not ready:
                stack.append((node, True))
                stack += [(each, False) for each in reversed(_below(node)) if id(each) not in done]
                continue
            self._finish(node)

    def _finish(self, node: Any) -> None:
        self._keep.append(node)
        depth = 0
        if isinstance(node, Expr):
            depth = (
                1 + max((self._depth[id(each)] for each in node.args), default=0)
                if node.op not in ("const", "leaf", "item")
                else 0
            )
            if depth and (self._uses[id(node)] > 1 or depth > DEEPEST):
                name = self.names[id(node)] = self._fresh("x")
                self.steps.append(Let(name, node))
                depth = 0
        elif isinstance(node, Block):
            self._block(node)
        elif isinstance(node, Kernel):
            self._call(node)
        self._depth[id(node)] = depth

    def slice_of(self, row: list[Expr]) -> Slice | None:
        """Where expressions lie side by side in an array."""
        first = row[0]
        if first.op == "leaf":
            name, start = first.value
            if all(x.op == "leaf" and x.value == (name, start + n) for n, x in enumerate(row)):
                return Slice(name, start, kept=name != "measured")
        if first.op == "item":
            source, start = first.args[0], first.value
            if all(
                x.op == "item" and x.args[0] is source and x.value == start + n for n, x in enumerate(row)
            ):
                return Slice(self.array_of(source), start)
        return None

    def runs(self, elements: list[Expr]) -> Iterator[tuple[int, int, Slice | None]]:
        """Elements as (first, count, where so many lie side by side; None for a single one)."""
        n = 0
        while n < len(elements):
            count = self._longest(elements[n:])
            yield n, count, self.slice_of(elements[n : n + count]) if count > 1 else None
            n += count

    def array_of(self, source: Block | Items) -> str:
        """The variable of a block, or of an array that a call leaves behind."""
        if isinstance(source, Items):
            return self.arrays[id(source.call), source.place]  # type: ignore[index]
        return self.arrays[id(source)]

    def _operand(self, row: list[Expr]) -> Slice | Expr:
        if all(x is row[0] for x in row):
            if row[0].op not in ("const", "leaf", "item") and id(row[0]) not in self.names:
                name = self.names[id(row[0])] = self._fresh("x")
                self.steps.append(Let(name, row[0]))
            return row[0]
        found = self.slice_of(row)
        if found is not None:
            return found
        name = self._fresh("g")
        self.steps.append(Fill(name, row[0].kind, row))
        return Slice(name, 0)

    def _block(self, block: Block) -> None:
        operands = [self._operand(row) for row in block.operands]
        name = self.arrays[id(block)] = self._fresh("v")
        if block.op == "product":
            (operand,) = operands
            if isinstance(operand, Expr):
                fill = self._fresh("g")
                self.steps.append(Fill(fill, block.kind, block.operands[0]))
                operand = Slice(fill, 0)
            self.steps.append(Matrix(name, block.kind, block.matrix, operand))
        else:
            self.steps.append(Loop(name, block.kind, block.size, block.op, operands))

    def _call(self, call: Kernel) -> None:
        how = self._kernels.of(call)
        names, contents, in_place = [], [], []
        for place, before in enumerate(call.before):
            found = self.slice_of(before)
            here = found is not None and place not in how.written and found.array != "measured"
            name = self._fresh("a")
            self.arrays[id(call), place] = name  # type: ignore[index]
            names.append(name)
            contents.append(found if found is not None else before)
            in_place.append(here)
        kinds, lengths = [array.kind for array in call.arrays], [len(before) for before in call.before]
        self.steps.append(Call(names, kinds, lengths, contents, in_place, how))

    # --- the end ----------------------------------------------------------------------------------------------------
    def _stores(self, assignments: dict[tuple[str, int], Expr]) -> list[Store]:
        """Stores, with neighbours from the same array together. What reads the state gets a variable first."""
        stores: list[Store] = []
        items = list(assignments.items())
        n = 0
        while n < len(items):
            (array, start), _ = items[n]
            count = 1
            while n + count < len(items) and items[n + count][0] == (array, start + count):
                count += 1
            run = [value for _, value in items[n : n + count]]
            while run:
                length = self._longest(run)
                if length > 1:
                    stores.append(Store(array, start, self._safe_slice(run[:length]), length))
                else:
                    stores.append(Store(array, start, self._own(run[0])))
                run, start = run[length:], start + length
            n += count
        return stores

    def _longest(self, run: list[Expr]) -> int:
        """How many of the first lie side by side in one array."""
        length = 1
        while length < len(run) and self.slice_of(run[: length + 1]) is not None:
            length += 1
        return length if length >= 4 else 1

    def _safe_slice(self, run: list[Expr]) -> Slice:
        found = self.slice_of(run)
        assert found is not None
        if not found.kept:
            return found
        name = self._fresh("g")
        self.steps.append(Loop(name, run[0].kind, len(run), "copy", [found]))
        return Slice(name, 0)

    def _own(self, value: Expr) -> Expr | str:
        if value.op in ("const", "item") or id(value) in self.names:
            return value
        name = self._fresh("x")
        self.steps.append(Let(name, value))
        return name


def _below(node: Any) -> list[Any]:
    """What has to be there before a node."""
    if isinstance(node, Expr):
        return list(node.args)
    if isinstance(node, Items):
        return [node.call]
    if isinstance(node, Kernel):
        return [x for row in node.before for x in row] + expressions_in(node.arguments)
    return [x for row in node.operands for x in row]


def _uses(roots: Iterable[Expr]) -> Counter[int]:
    """How often each node is read; by a block or call always more than once, so that it has a variable."""
    counts: Counter[int] = Counter()
    seen: set[int] = set()
    stack: list[Any] = list(roots)
    counts.update(map(id, stack))
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        below = _below(node)
        counts.update(map(id, below))
        if isinstance(node, Kernel):
            counts.update(id(x) for x in expressions_in(node.arguments))
        stack += below
    return counts
