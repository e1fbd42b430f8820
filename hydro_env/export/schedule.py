"""The order in which a program's numbers are computed, as typed statements (`hydro_env.ir`).

An expression that is needed once is written where it is needed; one that is needed more often gets a variable. Blocks become
loops over arrays, whose operands are read in place where they lie side by side in another array, else gathered first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_env.ir import nodes
from hydro_env.ir.nodes import Assign, For, Run, Statement, Store, add, cast, const, mul, op, var
from hydro_env.ir.reader import Reader

from .kernels import Handed, kernel_call
from .symbols import Block, Expr, Items, Kernel, MaskedRows, below

__all__ = ["Schedule"]

#: Operations that an expression may hold inside of one another.
MAX_DEPTH = 5
#: Neighbours in an array from which on they are moved in a loop, and numbers of a table from which on it is in single precision
#: where that holds them exactly.
MIN_LOOP, MIN_TABLE = 4, 64
_DTYPES: dict[str, Any] = {"bool": np.bool_, "int": np.int64, "float": np.float32, "double": np.float64}
_I, _J = var("i", "int"), var("j", "int")


@dataclass
class _Slice:
    """Elements of an array, from `start` on."""

    array: str
    kind: str
    start: int

    def at(self, index: nodes.Expr) -> nodes.Expr:
        return nodes.Expr("load", self.kind, (add(index, const(self.start, "int")),), self.array)


class Schedule:
    """The statements (`body`) for assignments (array, index) -> expression, with the stores at their end, and their `variables`.
    Arrays of the state are called what they are with `state` before it; `part` ends all names of variables."""

    def __init__(
        self, assignments: dict[tuple[str, int], Expr], reader: Reader, state: str, part: str = ""
    ) -> None:
        self.body: list[Statement] = []
        self.variables: dict[str, tuple[str, int]] = {}
        self._reader, self._state, self._part = reader, state, part
        self._names: dict[Expr, str] = {}  # variables of expressions
        self._arrays: dict[Any, _Slice] = {}  # and of blocks, and arrays of calls
        self._depth: dict[Any, int] = {}
        self._uses = _uses(assignments.values())
        for expression in assignments.values():
            self._prepare(expression)
        stores = self._stores(assignments)
        self.body += stores

    def name_of(self, node: Any) -> str | None:
        """The variable or array that holds an expression, block or what a call leaves; None if nothing does."""
        return self._names.get(node) or (self._arrays[node].array if node in self._arrays else None)

    # --- names ----------------------------------------------------------------------------------------------------
    def _fresh(self, letter: str, kind: str, size: int = 0) -> str:
        name = f"{letter}{len(self.variables) + 1}{self._part}"
        self.variables[name] = kind, size
        return name

    def _loop(self, count: int, body: list[Statement], index: nodes.Expr = _I) -> For:
        self.variables.setdefault(index.value, ("int", 0))
        return For(index.value, const(0, "int"), const(count, "int"), 1, body)

    def _variable(self, x: Expr) -> nodes.Expr:
        """The expression in a variable of its own."""
        value = self._lowered(x)
        name = self._names[x] = self._fresh("x", x.kind)
        self.body.append(Assign(name, value))
        return var(name, x.kind)

    def _lowered(self, x: Expr) -> nodes.Expr:
        if x in self._names:
            return var(self._names[x], x.kind)
        if x.op == "const":
            return const(x.value, x.kind)
        if x.op in ("leaf", "item"):
            found = self._slice_of([x])
            assert found is not None
            return found.at(const(0, "int"))
        return nodes.Expr(x.op, x.kind, tuple(map(self._lowered, x.args)))

    # --- what is computed before ----------------------------------------------------------------------------------
    def _prepare(self, root: Any) -> None:
        """Adds the statements for everything below a node, and the node itself where it has a variable."""
        stack = [(root, False)]
        while stack:
            node, ready = stack.pop()
            if node in self._depth:
                continue
            if not ready:
                stack.append((node, True))
                stack += [(each, False) for each in reversed(below(node)) if each not in self._depth]
                continue
            self._depth[node] = 0
            if isinstance(node, Expr) and node.op not in ("const", "leaf", "item"):
                depth = 1 + max((self._depth[each] for each in node.args), default=0)
                if self._uses[node] > 1 or depth > MAX_DEPTH:
                    self._variable(node)
                else:
                    self._depth[node] = depth
            elif isinstance(node, Block):
                self._block(node)
            elif isinstance(node, Kernel):
                self._call(node)

    def _slice_of(self, row: list[Expr]) -> _Slice | None:
        """Where expressions lie side by side in an array."""
        first = row[0]
        if first.op == "leaf":
            name, start = first.value
            if all(x.op == "leaf" and x.value == (name, start + n) for n, x in enumerate(row)):
                return _Slice(name if name == "measured" else self._state + name, first.kind, start)
        if first.op == "item":
            source, start = first.args[0], first.value
            if all(
                x.op == "item" and x.args[0] is source and x.value == start + n for n, x in enumerate(row)
            ):
                own = (source.call, source.place) if isinstance(source, Items) else source
                return _Slice(self._arrays[own].array, first.kind, start)
        return None

    def _longest(self, run: list[Expr]) -> int:
        """How many of the first lie side by side in one array; 1 where these are few."""
        length = 1
        while length < len(run) and self._slice_of(run[: length + 1]) is not None:
            length += 1
        return length if length >= MIN_LOOP else 1

    def _gathered(self, row: list[Expr]) -> _Slice:
        """Where expressions lie: in an array that holds them, a table where all are known, or a new one."""
        found = self._slice_of(row)
        if found is None and all(x.op == "const" for x in row):
            return self._table([x.value for x in row], row[0].kind)
        return found or self._filled("g", row)

    def _filled(self, letter: str, row: list[Expr]) -> _Slice:
        """A new array of expressions."""
        kind = row[0].kind
        name, n = self._fresh(letter, kind, len(row)), 0
        while n < len(row):
            count = self._longest(row[n:])
            found = self._slice_of(row[n : n + count])
            if count > 1 and found is not None:
                self.body.append(self._loop(count, [Store(name, add(_I, const(n, "int")), found.at(_I))]))
            else:
                self.body.append(Store(name, const(n, "int"), self._lowered(row[n])))
            n += count
        return _Slice(name, kind, 0)

    def _table(self, numbers: Any, kind: str, name: str = "table") -> _Slice:
        array: np.ndarray[Any, Any] = np.asarray(numbers, _DTYPES[kind])
        single = array.astype(np.float32)
        if kind == "double" and array.size >= MIN_TABLE and bool(np.all(single == array)):
            array = single
        made = self._reader.table(array, name)
        return _Slice(made.name, made.kind, 0)

    def _operand(self, row: list[Expr]) -> _Slice | nodes.Expr:
        if all(x is row[0] for x in row):
            simple = row[0].op in ("const", "leaf", "item") or row[0] in self._names
            return self._lowered(row[0]) if simple else self._variable(row[0])
        return self._gathered(row)

    def _block(self, block: Block) -> None:
        if block.op == "product":
            self._product(block)
            return
        operands = [self._operand(row) for row in block.operands]
        name = self._fresh("v", block.kind, block.size)
        self._arrays[block] = _Slice(name, block.kind, 0)
        texts = [each.at(_I) if isinstance(each, _Slice) else each for each in operands]
        kinds = [row[0].kind for row in block.operands]
        texts = [cast(each, kind) for each, kind in zip(texts, kinds, strict=True)]
        value = nodes.Expr(block.op, block.kind, tuple(texts)) if block.op != "copy" else texts[0]
        self.body.append(self._loop(block.size, [Store(name, _I, value)]))

    def _product(self, block: Block) -> None:
        (row,), (rows, columns) = block.operands, block.matrix.shape
        operand = self._gathered(row)
        weights = self._table(block.matrix, block.kind, "weights")
        name, total = self._fresh("v", block.kind, rows), var(self._fresh("sum", block.kind), block.kind)
        self._arrays[block] = _Slice(name, block.kind, 0)
        weight = cast(weights.at(add(mul(const(columns, "int"), _I), _J)), block.kind)
        more = Assign(total.value, op("add", total, op("mul", weight, cast(operand.at(_J), block.kind))))
        inner: list[Statement] = [
            Assign(total.value, const(0, block.kind)),
            self._loop(columns, [more], _J),
            Store(name, _I, total),
        ]
        self.body.append(self._loop(rows, inner))

    def _call(self, call: Kernel) -> None:
        how = kernel_call(call, self._reader)
        places: dict[int, _Slice] = {}
        for place in {each for each in how.handed if isinstance(each, int)} | {*how.written}:
            before = call.before[place]
            found = self._slice_of(before)
            if place in how.written:
                self._arrays[call, place] = places[place] = self._copied(before)
            else:
                places[place] = found or self._filled("a", before)
        handed = [self._handed(each, places) for each in how.handed]
        self.body.append(Run(nodes.Expr("call", "int", tuple(handed), how.name)))

    def _copied(self, row: list[Expr]) -> _Slice:
        """A new array of expressions that may lie side by side in another one."""
        found = self._slice_of(row)
        if found is None:
            return self._filled("a", row)
        name = self._fresh("a", row[0].kind, len(row))
        self.body.append(self._loop(len(row), [Store(name, _I, found.at(_I))]))
        return _Slice(name, row[0].kind, 0)

    def _handed(self, each: Handed, places: dict[int, _Slice]) -> nodes.Expr:
        if isinstance(each, int):
            place = places[each]
            return nodes.Expr("address", place.kind, (const(place.start, "int"),), place.array)
        if isinstance(each, MaskedRows):
            return self._reader.table(np.zeros(1, int)).address
        return self._lowered(each)

    # --- the end ----------------------------------------------------------------------------------------------------
    def _stores(self, assignments: dict[tuple[str, int], Expr]) -> list[Statement]:
        """Stores, with neighbours from the same array together. What reads the state gets a variable first."""
        stores: list[Statement] = []
        items = list(assignments.items())
        n = 0
        while n < len(items):
            (name, start), first = items[n]
            array = name if name == "command" else self._state + name
            count = 1
            while n + count < len(items) and items[n + count][0] == (name, start + count):
                count += 1
            count = self._longest([value for _, value in items[n : n + count]])
            if count > 1:
                value = self._safe([value for _, value in items[n : n + count]]).at(_I)
                stores.append(self._loop(count, [Store(array, add(_I, const(start, "int")), value)]))
            elif first.op in ("const", "item") or first in self._names:
                stores.append(Store(array, const(start, "int"), self._lowered(first)))
            else:
                stores.append(Store(array, const(start, "int"), self._variable(first)))
            n += count
        return stores

    def _safe(self, run: list[Expr]) -> _Slice:
        """Where expressions lie, which is not in the state that is stored to."""
        in_state = run[0].op == "leaf" and run[0].value[0] != "measured"
        return self._copied(run) if in_state else self._gathered(run)


def _uses(roots: Iterable[Expr]) -> Counter[Any]:
    """How often each node is read."""
    counts: Counter[Any] = Counter()
    stack: list[Any] = list(roots)
    counts.update(stack)
    seen: set[Any] = set()
    while stack:
        node = stack.pop()
        if node in seen:
            continue
        seen.add(node)
        counts.update(below(node))
        stack += below(node)
    return counts
