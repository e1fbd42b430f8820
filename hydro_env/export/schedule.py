"""The order in which a program's numbers are computed, as typed statements (`hydro_env.ir`).

An expression that is needed once is written where it is needed; one that is needed more often gets a variable. Blocks become
loops over arrays, whose operands are read in place where they lie side by side in another array, else gathered first.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from hydro_env.ir import nodes
from hydro_env.ir.nodes import Assign, For, Run, Statement, Store, add, cast, const, mul, op, var
from hydro_env.ir.reader import Arr, Reader, Rec, TranslationError, Value, constant_of

from .symbols import DTYPES, Block, Expr, Kernel, MaskedRows, Symbols, below, each_once

#: Operations that an expression may hold inside of one another.
MAX_DEPTH = 5
#: Neighbours in an array from which on they are moved in a loop, and numbers of a table from which on it is in single precision
#: where that holds them exactly.
MIN_LOOP, MIN_TABLE = 4, 64
_I, _J = var("i", "int"), var("j", "int")
#: What a recorded call hands over: the number of an array, an expression, or the mask that says whether there is a row.
Handed = int | Expr | MaskedRows


def _part(array: str, kind: str, start: int = 0) -> Arr:
    """The elements of an array from `start` on."""
    return Arr(kind, array, const(start, "int"), (), ())


def _at(part: Arr, index: nodes.Expr) -> nodes.Expr:
    return nodes.Expr("load", part.kind, (add(index, part.offset),), part.name)


class Schedule:
    """The statements (`body`) for `assignments` (array, index) -> expression, with the stores at their end, and their
    `variables`. Arrays of the state are called what they are with `state` before it; `part` ends all names of variables."""

    def __init__(
        self, assignments: dict[tuple[str, int], Expr], reader: Reader, state: str, part: str = ""
    ) -> None:
        self.body: list[Statement] = []
        self.variables: dict[str, tuple[str, int]] = {}
        self.assignments, self._reader, self._state, self._part = assignments, reader, state, part
        #: The variables of expressions, and the arrays of blocks and of what calls leave.
        self.names: dict[Any, str] = {}
        self._depth: dict[Any, int] = {}
        self._uses = _uses(assignments.values())
        for node in each_once(assignments.values()):
            self._prepare(node)
        self.body += list(self._stores(assignments))

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
        name = self.names[x] = self._fresh("x", x.kind)
        self.body.append(Assign(name, value))
        return var(name, x.kind)

    def _lowered(self, x: Expr) -> nodes.Expr:
        if x in self.names:
            return var(self.names[x], x.kind)
        if x.op == "const":
            return const(x.value, x.kind)
        if place := self._place(x):
            return nodes.Expr("load", x.kind, (const(place[1], "int"),), place[0])
        return nodes.Expr(x.op, x.kind, tuple(map(self._lowered, x.args)))

    # --- what is computed before ----------------------------------------------------------------------------------
    def _prepare(self, node: Any) -> None:
        """Adds the statements for a node, where it has a variable, once all below it has its own."""
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

    def _place(self, x: Expr) -> tuple[str, int] | None:
        """The array in which a number lies and its index there, None where it has yet to be computed."""
        if x.op == "leaf":
            name, index = x.value
            return (name if name == "measured" else self._state + name), index
        return (self.names[x.args[0]], x.value) if x.op == "item" else None

    def _slice_of(self, row: list[Expr]) -> Arr | None:
        """Where expressions lie side by side in an array."""
        place = self._place(row[0])
        if place is None or any(self._place(x) != (place[0], place[1] + n) for n, x in enumerate(row)):
            return None
        return _part(place[0], row[0].kind, place[1])

    def _runs(self, row: list[Expr]) -> Iterator[tuple[int, list[Expr]]]:
        """Expressions cut into those that lie side by side in one array, and single ones where these are few; each with the place
        of its first one."""
        n = 0
        while n < len(row):
            count = 1
            while n + count < len(row) and self._slice_of(row[n : n + count + 1]) is not None:
                count += 1
            run = row[n : n + count] if count >= MIN_LOOP else row[n : n + 1]
            yield n, run
            n += len(run)

    def _gathered(self, row: list[Expr]) -> Arr:
        """Where expressions lie: in an array that holds them, a table where all are known, or a new one."""
        found = self._slice_of(row)
        if found is None and all(x.op == "const" for x in row):
            return self._table([x.value for x in row], row[0].kind)
        return found or self._filled("g", row)

    def _filled(self, letter: str, row: list[Expr]) -> Arr:
        """A new array of expressions."""
        kind = row[0].kind
        name = self._fresh(letter, kind, len(row))
        for n, run in self._runs(row):
            found = self._slice_of(run)
            if len(run) > 1 and found is not None:
                self.body.append(
                    self._loop(len(run), [Store(name, add(_I, const(n, "int")), _at(found, _I))])
                )
            else:
                self.body.append(Store(name, const(n, "int"), self._lowered(run[0])))
        return _part(name, kind)

    def _table(self, numbers: Any, kind: str, name: str = "table") -> Arr:
        array: np.ndarray[Any, Any] = np.asarray(numbers, DTYPES[kind])
        single = array.astype(np.float32)
        if kind == "double" and array.size >= MIN_TABLE and bool(np.all(single == array)):
            array = single
        return self._reader.table(array, name)

    def _operand(self, row: list[Expr]) -> nodes.Expr:
        """An operand in a loop over `i`."""
        if all(x is row[0] for x in row):
            simple = row[0].op in ("const", "leaf", "item") or row[0] in self.names
            return self._lowered(row[0]) if simple else self._variable(row[0])
        return _at(self._gathered(row), _I)

    def _block(self, block: Block) -> None:
        if block.op == "product":
            self._product(block)
            return
        operands = tuple(cast(self._operand(row), row[0].kind) for row in block.operands)
        name = self.names[block] = self._fresh("v", block.kind, block.size)
        value = nodes.Expr(block.op, block.kind, operands)
        self.body.append(self._loop(block.size, [Store(name, _I, value)]))

    def _product(self, block: Block) -> None:
        (row,), (rows, columns) = block.operands, block.matrix.shape
        operand = self._gathered(row)
        weights = self._table(block.matrix, block.kind, "weights")
        name = self.names[block] = self._fresh("v", block.kind, rows)
        total = var(self._fresh("sum", block.kind), block.kind)
        weight = cast(_at(weights, add(mul(const(columns, "int"), _I), _J)), block.kind)
        more = Assign(total.value, op("add", total, op("mul", weight, cast(_at(operand, _J), block.kind))))
        inner: list[Statement] = [
            Assign(total.value, const(0, block.kind)),
            self._loop(columns, [more], _J),
            Store(name, _I, total),
        ]
        self.body.append(self._loop(rows, inner))

    def _call(self, call: Kernel) -> None:
        name, handed, written = kernel_call(call, self._reader)
        places: dict[int, Arr] = {}
        for place in {each for each in handed if isinstance(each, int)} | {*written}:
            before = call.before[place]
            if place in written:
                places[place] = self._filled("a", before)
                self.names[call.after[place]] = places[place].name
            else:
                places[place] = self._slice_of(before) or self._filled("a", before)
        given = tuple(self._handed(each, places) for each in handed)
        self.body.append(Run(nodes.Expr("call", "int", given, name)))

    def _handed(self, each: Handed, places: dict[int, Arr]) -> nodes.Expr:
        if isinstance(each, int):
            return places[each].address
        if isinstance(each, MaskedRows):
            return self._reader.table(np.zeros(1, int)).address
        return self._lowered(each)

    # --- the end ----------------------------------------------------------------------------------------------------
    def _stores(self, assignments: dict[tuple[str, int], Expr]) -> Iterator[Statement]:
        """Stores, with neighbours from the same array together. What reads the state gets a variable first."""
        rows: dict[tuple[str, int], list[Expr]] = {}  # of neighbours, by the array and the index of the first
        for (name, index), x in assignments.items():
            first = next(reversed(rows), None)
            if first is not None and first[0] == name and first[1] + len(rows[first]) == index:
                rows[first].append(x)
            else:
                rows[name, index] = [x]
        for (name, start), row in rows.items():
            array = name if name == "command" else self._state + name
            for n, run in self._runs(row):
                x, place = run[0], const(start + n, "int")
                if len(run) > 1:
                    in_state = x.op == "leaf" and x.value[0] != "measured"  # which is stored to
                    value = _at(self._filled("a", run) if in_state else self._gathered(run), _I)
                    yield self._loop(len(run), [Store(array, add(_I, place), value)])
                else:
                    at_hand = x.op in ("const", "item") or x in self.names
                    yield Store(array, place, self._lowered(x) if at_hand else self._variable(x))


def _uses(roots: Iterable[Expr]) -> Counter[Any]:
    """How often each node is read."""
    counts: Counter[Any] = Counter(roots)
    for node in each_once(roots):
        counts.update(below(node))
    return counts


def kernel_call(call: Kernel, reader: Reader) -> tuple[str, list[Handed], list[int]]:
    """A recorded call of a compiled function, which `reader` reads: its name, what it is handed, and which arrays it changes."""
    marks: dict[str, Handed] = {}
    numbers = iter(call.numbers)

    def value(argument: Any) -> Value:
        """An argument as a value whose name is a mark for what stands there."""
        mark = f"mark{len(marks)}"
        if isinstance(argument, Symbols) and argument.ndim:
            marks[mark] = next(n for n, each in enumerate(call.arrays) if each is argument)
            return Arr.of(argument.kind, mark, argument.shape)
        if isinstance(argument, Symbols):
            number = next(numbers)
            if number.op == "const":
                return const(number.value, number.kind)
            marks[mark] = number
            return var(mark, number.kind)
        if isinstance(argument, MaskedRows):
            marks[mark] = argument
            marks[f"{mark}_count"] = next(numbers)
            return Arr.of("int", mark, [var(f"{mark}_count", "int")])
        if hasattr(argument, "_fields"):
            return Rec({name: value(getattr(argument, name)) for name in argument._fields})
        if isinstance(argument, np.ndarray) and argument.ndim:
            return reader.table(argument)
        known = constant_of(argument.item() if isinstance(argument, np.ndarray) else argument)
        if known is None:
            raise TranslationError(f"an argument of type {type(argument).__name__} cannot be passed on")
        return known

    called = reader.call(call.function, list(map(value, call.arguments)))
    if called.result is not None:
        raise TranslationError(f"{call.function.__name__}: returns a value, which cannot be followed")
    changed = {marks[each] for each in called.written if each in marks}
    handed = [marks[each.value] for each in called.handed]
    return called.name, handed, sorted(each for each in changed if isinstance(each, int))
