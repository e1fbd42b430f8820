"""Symbols in place of measurements: a controller's own NumPy code runs on them once and leaves what it computes behind.

A `Symbols` is a NumPy array of expressions. Slices, stacks and assignments in place mean what they always mean, as NumPy itself
does them; arithmetic builds new expressions. An operation on many elements at once, and the product with a constant matrix, stay
together as a `Block`, so that a network becomes a few loops and not thousands of lines. Numbers keep the precision that NumPy
would give them.

Rows of a batch do not act on each other. So a question to the whole batch (`if moving.any():`), which only saves work, is
answered with yes, and `flatnonzero` of a mask gives an index that acts where the mask is true.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from hydro_env.ir import nodes
from hydro_env.ir.nodes import wider

__all__ = [
    "Block", "Expr", "Items", "Kernel", "MaskedRows", "Place", "RowNumbers", "Symbols", "TraceError", "below", "cast", "constant",
    "interned", "item", "known", "leaf", "operate", "symbols",
]  # fmt: skip

#: Elements from which on an operation stays together.
TOGETHER = 16
_DTYPES: dict[str, Any] = {"bool": np.bool_, "int": np.int64, "float": np.float32, "double": np.float64}


class TraceError(TypeError):
    """What a traced controller does that cannot be followed."""


class Expr(nodes.Expr):
    """A number, as an operation on others; equal ones are the same object.

    Beside operations `op` is "const" (`value`), "leaf" (`value`: the name of an array and an index into it), or "item" (`args[0]`
    a `Block` or `Items`, `value` the index). It is never below `low` nor above `high`.
    """

    __slots__ = ("high", "low")

    def __init__(self, op: str, kind: str, args: tuple[Any, ...], value: Any) -> None:
        super().__init__(op, kind, args, value)
        self.low, self.high = -math.inf, math.inf
        if op == "const":
            self.low = self.high = float(value)
        elif op in ("max", "min"):
            limit = max if op == "max" else min
            self.low, self.high = limit(x.low for x in args), limit(x.high for x in args)

    def __deepcopy__(self, memo: Any) -> Expr:
        return self

    def __bool__(self) -> bool:
        if self.op == "const":
            return bool(self.value)
        raise TraceError(
            "what is done depends on a measured value: an `if` on it cannot be followed, `np.where` can"
        )

    def __float__(self) -> float:
        if self.op == "const":
            return float(self.value)
        raise TraceError("a measured value is made a plain number")

    def __index__(self) -> int:
        if self.op == "const":
            return int(self.value)
        raise TraceError("a measured value is used as an index")


class _Shared:
    """What copies of a controller have in common."""

    def __deepcopy__(self, memo: Any) -> Any:
        return self


@dataclass(eq=False)
class Block(_Shared):
    """One operation on many elements: `op` of rows of operands, or "product" of a constant matrix (`matrix`) and a vector."""

    op: str
    kind: str
    operands: list[list[Expr]]
    size: int
    matrix: Any = None


@dataclass(eq=False)
class Kernel(_Shared):
    """A call of a compiled function. `arguments`: numbers, constant arrays, tables of named tuples, and a `Place` for each of the
    `arrays`, which held the expressions `before`."""

    function: Any
    arguments: list[Any]
    arrays: list[Symbols] = field(default_factory=list)
    before: list[list[Expr]] = field(default_factory=list)


@dataclass(eq=False)
class Items(_Shared):
    """An array that a `Kernel` leaves behind: number `place` of its arrays."""

    call: Kernel
    place: int
    kind: str


@dataclass(frozen=True)
class Place:
    """An array among the arguments of a recorded call: its number, kind and shape."""

    number: int
    kind: str
    shape: tuple[int, ...]


def _expressions_in(tree: Any) -> list[Expr]:
    """The expressions among the arguments of a call."""
    if isinstance(tree, Expr):
        return [tree]
    if isinstance(tree, MaskedRows):
        return [tree.mask]
    if isinstance(tree, dict):
        return [x for each in tree.values() for x in _expressions_in(each)]
    if isinstance(tree, list):
        return [x for each in tree for x in _expressions_in(each)]
    return []


def below(node: Any) -> list[Any]:
    """What an expression, block or call is computed from."""
    if isinstance(node, Expr):
        return list(node.args)
    if isinstance(node, Items):
        return [node.call]
    if isinstance(node, Kernel):
        return [x for row in node.before for x in row] + _expressions_in(node.arguments)
    return [x for row in node.operands for x in row]


#: The expressions of a trace by what they are.
_interned: ContextVar[dict[Any, Expr]] = ContextVar("expressions")


@contextmanager
def interned() -> Iterator[None]:
    """Inside, equal expressions are one object."""
    token = _interned.set({})
    try:
        yield
    finally:
        _interned.reset(token)


def _made(op: str, kind: str, args: tuple[Any, ...] = (), value: Any = None) -> Expr:
    shown = value
    if op == "const" and isinstance(value, float):
        shown = value.hex() if math.isfinite(value) else repr(value)
    key = (op, kind, tuple(map(id, args)), shown)
    made = _interned.get()
    if key not in made:
        made[key] = Expr(op, kind, args, value)
    return made[key]


def constant(value: Any, kind: str) -> Expr:
    """A number that is known, rounded to its kind."""
    plain = _DTYPES[kind](value)
    return _made("const", kind, (), plain.item())


def leaf(name: str, index: int, kind: str) -> Expr:
    """Element `index` of an array that is given: measurements, or the state."""
    return _made("leaf", kind, (), (name, index))


def item(block: Block | Items, index: int) -> Expr:
    """Element `index` of what a block or kernel gives."""
    return _made("item", block.kind, (block,), index)


def kind_of(dtype: Any) -> str:
    """The kind of numbers of a NumPy type. TraceError for one that C has no number for."""
    dtype = np.dtype(dtype)
    if dtype == np.bool_:
        return "bool"
    if dtype.kind in "iu":
        return "int"
    if dtype == np.float32:
        return "float"
    if dtype == np.float64:
        return "double"
    raise TraceError(f"numbers of type {dtype} cannot be followed")


def cast(x: Expr, kind: str) -> Expr:
    """The number in another kind."""
    if x.kind == kind:
        return x
    if x.op == "const":
        return constant(x.value, kind)
    if kind == "bool":
        return operate("ne", [x, constant(0, x.kind)])
    return _made("cast", kind, (x,))


# --- operations on numbers ---------------------------------------------------------------------------------------------
_COMPARED = {
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal,
}  # fmt: skip
_LOGIC = {"and": np.logical_and, "or": np.logical_or, "not": np.logical_not}
_WHOLE: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "abs": np.absolute, "max": np.maximum,
    "min": np.minimum, "sign": np.sign,
}  # fmt: skip
_REAL: dict[str, Callable[..., Any]] = {
    "div": np.true_divide, "sqrt": np.sqrt, "exp": np.exp, "expm1": np.expm1, "tanh": np.tanh, "hypot": np.hypot,
    "floor": np.floor, "log": np.log, "sin": np.sin, "cos": np.cos,
}  # fmt: skip
_NUMPY: dict[str, Any] = {**_COMPARED, **_LOGIC, **_WHOLE, **_REAL}
_BY_UFUNC = {function: name for name, function in _NUMPY.items()} | {np.bitwise_and: "and", np.bitwise_or: "or",
             np.invert: "not", np.fabs: "abs", np.positive: "positive"}  # fmt: skip


def kind_of_result(op: str, kinds: Sequence[str]) -> str:
    """The kind of the result, as NumPy promotes it."""
    widest = wider(*kinds)
    if op in _COMPARED or op in _LOGIC:
        return "bool"
    if "int" in kinds and "float" in kinds:
        widest = "double"
    if op in _REAL and widest in ("bool", "int"):
        return "double"
    return widest


def operate(op: str, args: Sequence[Expr]) -> Expr:
    """An operation on numbers; on known ones it is carried out, as NumPy does."""
    kind = kind_of_result(op, [a.kind for a in args])
    operands = [a if op in _COMPARED or op in _LOGIC else cast(a, kind) for a in args]
    if op in _COMPARED:
        widest = wider(*(a.kind for a in args))
        operands = [cast(a, widest) for a in args]
    if op in _LOGIC:
        operands = [cast(a, "bool") for a in args]
    if all(a.op == "const" for a in operands):
        with np.errstate(all="ignore"):
            values: list[Any] = [_DTYPES[a.kind](a.value) for a in operands]
            return constant(_NUMPY[op](*values), kind)
    simple = _simpler(op, operands)
    return simple if simple is not None else _made(op, kind, tuple(operands))


def _simpler(op: str, a: Sequence[Expr]) -> Expr | None:
    """What changes no finite number: factors of one and zero, sums with nothing; and what a known truth decides."""
    known = [x.value if x.op == "const" else None for x in a]
    if op == "mul" and known[0] == 1.0:
        return a[1]
    if op == "mul" and 0.0 in known:  # what is multiplied is finite
        return constant(0.0, a[0].kind)
    if op == "add" and 0.0 in known:
        return a[1] if known[0] == 0.0 else a[0]
    if op == "sub" and known[1] == 0.0:
        return a[0]
    if op in ("add", "sub") and math.inf in (abs(known[0] or 0.0), abs(known[1] or 0.0)):
        sign = -1.0 if op == "sub" and known[0] is None else 1.0
        return constant(sign * float(known[1] if known[0] is None else known[0]), a[0].kind)  # type: ignore[arg-type]
    if op in ("mul", "div") and known[1] == 1.0:
        return a[0]
    if op == "and":
        if False in known:
            return constant(False, "bool")
        return a[1] if known[0] is True else a[0] if known[1] is True else None
    if op == "or":
        if True in known:
            return constant(True, "bool")
        return a[1] if known[0] is False else a[0] if known[1] is False else None
    if op == "sub" and a[0] is a[1]:
        return constant(0.0, a[0].kind)
    if op in ("max", "min"):
        return _limited(op, a[0], a[1])
    return None


def _limited(op: str, x: Expr, y: Expr) -> Expr | None:
    """The one of two that is never the other's side, where their limits say so."""
    if x is y:
        return x
    if op == "max":
        return x if x.low >= y.high else y if y.low >= x.high else None
    return x if x.high <= y.low else y if y.high <= x.low else None


def choose(test: Expr, a: Expr, b: Expr) -> Expr:
    """`a` where the test holds, else `b`."""
    kind = kind_of_result("add", [a.kind, b.kind])
    test, a, b = cast(test, "bool"), cast(a, kind), cast(b, kind)
    if test.op == "const":
        return a if test.value else b
    return a if a is b else _made("where", kind, (test, a, b))


# --- arrays --------------------------------------------------------------------------------------------------------------
class MaskedRows:
    """`np.flatnonzero(mask)` of one rig: row 0 where the mask is true."""

    def __init__(self, mask: Expr) -> None:
        self.mask = mask

    def __len__(self) -> int:
        return 1

    @property
    def size(self) -> int:
        return 1


class RowNumbers(np.ndarray):
    """`np.arange` of the rigs: what masked rows choose of it are these rows."""

    def __getitem__(self, index: Any) -> Any:
        return index if isinstance(index, MaskedRows) else super().__getitem__(index)


class Guard:
    """The answer to a question to the whole batch, which only saves work: yes, or no where that is known."""

    def __init__(self, truth: Expr) -> None:
        self.truth = truth

    def __bool__(self) -> bool:
        return self.truth.op != "const" or bool(self.truth.value)


def _method(name: str) -> Any:
    """A method of an array that is the function of its name among `_FUNCTIONS`."""
    return lambda array, *args, **more: _FUNCTIONS[name](array, *args, **more)


class Symbols(np.ndarray):
    """An array of expressions, all of one kind."""

    def __array_finalize__(self, other: Any) -> None:
        pass

    @property
    def kind(self) -> str:
        flat = self.view(np.ndarray).reshape(-1)
        return flat[0].kind if flat.size else "double"

    def elements(self) -> list[Expr]:
        """All elements, row by row."""
        return list(self.view(np.ndarray).reshape(-1))

    def __getitem__(self, index: Any) -> Any:
        index, _ = _plain_index(index)
        chosen = _gathered(self, index)
        return chosen if chosen is not None else _wrapped(super().__getitem__(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        index, mask = _plain_index(index)
        if isinstance(index, Symbols) and index.kind == "bool":  # a mask of measured truth
            mask_array, index = index, Ellipsis
            value = _where(_extended(mask_array, self.ndim), value, self)
        parts = index if isinstance(index, tuple) else (index,)
        measured = [n for n, each in enumerate(parts) if isinstance(each, Symbols)]
        if measured:
            self._put(parts, measured[0], value, mask)
            return
        now: Any = self.view(np.ndarray)[index]
        kind = self.kind
        values: Any = np.broadcast_to(_objects(value), np.shape(now))
        made = np.empty(np.shape(now), object)
        for place in np.ndindex(made.shape):
            new = cast(values[place], kind)
            old: Any = now[place] if made.shape else now
            made[place] = new if mask is None else choose(mask, new, old)
        self.view(np.ndarray)[index] = made if made.shape else made[()]

    def _put(self, parts: tuple[Any, ...], axis: int, value: Any, mask: Expr | None) -> None:
        """Sets elements whose place is measured: each one where the place is its own."""
        (place,) = parts[axis].elements()
        for n in range(self.shape[axis]):
            here = operate("eq", [place, constant(n, "int")])
            both = here if mask is None else operate("and", [here, mask])
            at = np.full(parts[axis].shape, n)
            index = (*parts[:axis], at, *parts[axis + 1 :])
            old = _wrapped(self.view(np.ndarray)[index])
            self[index] = _where(symbols([both], ()), value, old)

    def astype(self, dtype: Any, *args: Any, **more: Any) -> Symbols:  # type: ignore[override]
        kind = kind_of(dtype)
        return _mapped(lambda x: cast(x, kind), self)

    any, all, max, min, sum, mean = map(_method, ("any", "all", "max", "min", "sum", "mean"))  # type: ignore[assignment]

    def __bool__(self) -> bool:
        return bool(self.view(np.ndarray).item())

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        out, where = more.pop("out", None), more.pop("where", True)
        more.pop("dtype", None)
        if method == "reduce":
            axis, keepdims = more.get("axis", 0), more.get("keepdims", False)
            return _reduced(_BY_UFUNC[ufunc], inputs[0], axis, keepdims)
        if method != "__call__" or where is not True:
            raise TraceError(f"numpy.{ufunc.__name__}.{method} cannot be followed")
        result = _product(*inputs) if ufunc is np.matmul else _elementwise(ufunc, inputs)
        if out is None:
            return result
        out[0][...] = result
        return out[0]

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        own = _FUNCTIONS.get(function.__name__)
        if own is not None:
            return own(*args, **kwargs)
        return _wrapped(function(*map(_bare, args), **{key: _bare(value) for key, value in kwargs.items()}))


def symbols(elements: Iterable[Expr], shape: tuple[int, ...]) -> Symbols:
    """An array of these expressions."""
    array = np.empty(math.prod(shape), object)
    for n, each in enumerate(elements):
        array[n] = each
    return array.reshape(shape).view(Symbols)


def known(array: Any) -> Symbols:
    """A constant array as expressions."""
    array = np.asarray(array)
    kind = kind_of(array.dtype)
    return symbols((constant(x, kind) for x in array.reshape(-1)), array.shape)


def _wrapped(result: Any) -> Any:
    if isinstance(result, Expr):
        return symbols([result], ())
    if isinstance(result, np.ndarray) and result.dtype == object:
        return result.view(Symbols)
    if isinstance(result, list | tuple):
        return type(result)(map(_wrapped, result))
    return result


def _bare(value: Any) -> Any:
    """Symbols as plain arrays of objects, also in lists; real arrays beside them as constants."""
    if isinstance(value, Symbols):
        return value.view(np.ndarray)
    if isinstance(value, list | tuple) and any(isinstance(each, Symbols) for each in value):
        return [
            _bare(known(each) if isinstance(each, np.ndarray) and each.dtype != object else each)
            for each in value
        ]
    return value


def _objects(value: Any) -> Any:
    """Anything as an array of expressions; Python numbers are weak: they take the kind of what they meet."""
    if isinstance(value, Symbols):
        return value.view(np.ndarray)
    if isinstance(value, Guard):
        return symbols([value.truth], ()).view(np.ndarray)
    array = np.asarray(value)
    if array.dtype == object:
        return array
    return known(array).view(np.ndarray)


def _plain_index(index: Any) -> tuple[Any, Expr | None]:
    """An index without masks of rows, and the mask."""
    if isinstance(index, MaskedRows):
        return np.zeros(1, int), index.mask
    if isinstance(index, tuple) and any(isinstance(each, MaskedRows) for each in index):
        mask = next(each.mask for each in index if isinstance(each, MaskedRows))
        return tuple(np.zeros(1, int) if isinstance(each, MaskedRows) else each for each in index), mask
    return index, None


def _gathered(array: Symbols, index: Any) -> Any:
    """array[index] where a part of the index is measured: a choice among all that it can be. None for plain indices.

    A mask of one rig (`x[~planned]`) chooses that rig: what is read there is only used where the mask holds."""
    parts = index if isinstance(index, tuple) else (index,)
    if not any(isinstance(each, Symbols) for each in parts):
        return None
    first = parts[0]
    if isinstance(first, Symbols) and first.kind == "bool":
        return _wrapped(array.view(np.ndarray)[(np.zeros(1, int), *parts[1:])])
    axis, measured = next((n, each) for n, each in enumerate(parts) if isinstance(each, Symbols))
    result = None
    for value in range(array.shape[axis]):
        here = tuple(np.full(measured.shape, value) if n == axis else each for n, each in enumerate(parts))
        one = _wrapped(array.view(np.ndarray)[here])
        test = _elementwise(np.equal, (measured, value))
        result = one if result is None else _where(_extended(test, one.ndim), one, result)
    return result


def _extended(mask: Symbols, ndim: int) -> Symbols:
    """A mask of rigs with axes behind it."""
    plain = mask.view(np.ndarray)
    return plain.reshape(plain.shape + (1,) * (ndim - plain.ndim)).view(Symbols)


def _mapped(function: Callable[..., Expr], *arrays: Any) -> Symbols:
    together = np.broadcast_arrays(*(_objects(each) for each in arrays))
    flat = [each.reshape(-1) for each in together]
    return symbols((function(*row) for row in zip(*flat, strict=True)), together[0].shape)


def _weak(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool | np.generic)


def _strong(inputs: Sequence[Any]) -> list[Any]:
    """Inputs whose plain Python numbers have taken the kind that NumPy gives them beside the others."""
    kinds = [_objects(each).reshape(-1)[0].kind for each in inputs if not _weak(each) and _objects(each).size]
    widest = wider(*kinds) if kinds else "int"
    made = []
    for each in inputs:
        if _weak(each):
            own = "int" if isinstance(each, int) else "double"
            kind = widest if widest in ("float", "double") or (own == "int" and widest == "int") else own
            each = symbols([constant(each, kind)], ())
        made.append(each)
    return made


def _elementwise(ufunc: Any, inputs: Sequence[Any]) -> Any:
    if ufunc is np.power:
        return _power(*inputs)
    if ufunc is np.isfinite:
        return _elementwise(np.less, (_elementwise(np.absolute, inputs), math.inf))
    if ufunc is np.square:
        return _power(inputs[0], 2)
    op = _BY_UFUNC.get(ufunc)
    if op is None:
        raise TraceError(f"numpy.{ufunc.__name__} cannot be followed")
    if op == "positive":
        return inputs[0]
    return _blockwise(op, _strong(inputs))


def _blockwise(op: str, inputs: Sequence[Any]) -> Symbols:
    """An operation element by element; many stay together."""
    together = np.broadcast_arrays(*(_objects(each) for each in inputs))
    shape = together[0].shape
    rows = [list(each.reshape(-1)) for each in together]
    size = len(rows[0])
    if not size:
        return symbols([], shape)
    act = (lambda *row: choose(*row)) if op == "where" else (lambda *row: operate(op, row))
    # The first and the last say whether there is anything to do at all.
    if size < TOGETHER or all(x.op == "const" for row in rows for x in row):
        return symbols((act(*row) for row in zip(*rows, strict=True)), shape)
    kinds = [row[0].kind for row in rows]
    if op == "where":
        kind = kind_of_result("add", kinds[1:])
        rows = [[cast(x, "bool") for x in rows[0]], *(_cast_row(row, kind) for row in rows[1:])]
    else:
        kind = kind_of_result(op, kinds)
        common = "bool" if op in _LOGIC else wider(*kinds) if op in _COMPARED else kind
        rows = [_cast_row(row, common) for row in rows]
    block = Block(op, kind, rows, size)
    return symbols((item(block, n) for n in range(size)), shape)


def _cast_row(row: list[Expr], kind: str) -> list[Expr]:
    """A row of operands in another kind, together if they are many and not known."""
    if all(x.kind == kind or x.op == "const" for x in row) or len(set(map(id, row))) == 1:
        return [cast(x, kind) for x in row]
    block = Block("cast", kind, [row], len(row))
    return [item(block, n) for n in range(len(row))]


def _power(base: Any, power: Any) -> Any:
    if not isinstance(power, int | float) or power not in (0.5, 2, 3):
        raise TraceError(f"the power {power} cannot be followed; 0.5, 2 and 3 can")
    if power == 0.5:
        return _elementwise(np.sqrt, (base,))
    squared = _elementwise(np.multiply, (base, base))
    return squared if power == 2 else _elementwise(np.multiply, (squared, base))


def _product(a: Any, b: Any) -> Symbols:
    """a (..., m, n) @ b (n, k) with a constant `b`."""
    if isinstance(b, Symbols) or not isinstance(a, Symbols):
        raise TraceError("only a product with a constant matrix on the right can be followed")
    matrix = np.asarray(b)
    plain = a.view(np.ndarray)
    rows = plain.reshape(-1, plain.shape[-1])
    kind = kind_of_result("mul", [rows[0][0].kind, kind_of(matrix.dtype)])
    made: list[Expr] = []
    for row in rows:
        operands, weights = [_cast_row(list(row), kind)], np.ascontiguousarray(matrix.T)
        block = Block("product", kind, operands, matrix.shape[1], weights)
        made += [item(block, n) for n in range(matrix.shape[1])]
    return symbols(made, (*plain.shape[:-1], matrix.shape[1]))


def _reduced(
    op: str, array: Any, axis: Any = None, keepdims: bool = False, out: Any = None, **more: Any
) -> Any:
    plain = _objects(array)
    axes = tuple(range(plain.ndim)) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    axes = tuple(each % plain.ndim for each in axes)
    kept = [n for n in range(plain.ndim) if n not in axes]
    moved = np.transpose(plain, (*kept, *axes)).reshape(*(plain.shape[n] for n in kept), -1)
    result = np.empty(moved.shape[:-1], object)
    for place in np.ndindex(result.shape):
        row = moved[place]
        total = cast(row[0], "int") if op == "add" and row[0].kind == "bool" else row[0]
        for each in row[1:]:
            total = operate(op, [total, each])
        result[place] = total
    if keepdims:
        result = result.reshape([1 if n in axes else plain.shape[n] for n in range(plain.ndim)])
    return result.view(Symbols)


def _any(array: Any, axis: Any = None, **more: Any) -> Any:
    found = _reduced("or", array, axis, **more)
    return Guard(found.view(np.ndarray).item()) if axis is None else found


def _mean(array: Any, axis: Any = None, keepdims: bool = False, **more: Any) -> Any:
    plain = _objects(array)
    total = _reduced("add", array, axis, keepdims)
    return _elementwise(np.true_divide, (total, plain.size // max(1, total.size)))


def _where(test: Any, a: Any, b: Any) -> Symbols:
    return _blockwise("where", [test, *_strong([a, b])])


def _clip(array: Any, low: Any, high: Any, out: Any = None) -> Any:
    result = _elementwise(np.minimum, (_elementwise(np.maximum, (array, low)), high))
    if out is not None:
        out[...] = result
    return result


def _copyto(to: Symbols, value: Any, where: Any = True) -> None:
    if where is not True:
        value = _where(np.broadcast_to(_objects(where), to.shape).view(Symbols), value, to)
    to[...] = value


def _like(value: float) -> Callable[..., Symbols]:
    def made(array: Any, dtype: Any = None, **more: Any) -> Symbols:
        kind = kind_of(dtype) if dtype is not None else array.kind
        return symbols((constant(value, kind) for _ in range(array.size)), array.shape)

    return made


def _take_along_axis(array: Any, indices: Any, axis: int) -> Symbols:
    plain, picked = np.moveaxis(_objects(array), axis, -1), np.moveaxis(_objects(indices), axis, -1)
    result = np.empty(picked.shape, object)
    for place in np.ndindex(result.shape):
        choices = np.broadcast_to(plain, (*picked.shape[:-1], plain.shape[-1]))[place[:-1]]
        value = choices[0]
        for n in range(1, len(choices)):
            value = choose(operate("eq", [picked[place], constant(n, "int")]), choices[n], value)
        result[place] = value
    return np.moveaxis(result, -1, axis).view(Symbols)


def _flatnonzero(mask: Any) -> Any:
    elements = _objects(mask).reshape(-1)
    if len(elements) != 1:
        raise TraceError("flatnonzero of more than one rig cannot be followed")
    return MaskedRows(cast(elements[0], "bool"))


def _sort(array: Any, axis: int = -1) -> Symbols:
    """By exchanges of neighbours, the last axis."""
    result = _objects(array).copy()
    rows = result.reshape(-1, result.shape[-1])
    for row in rows:
        for end in range(len(row) - 1, 0, -1):
            for n in range(end):
                low, high = operate("min", [row[n], row[n + 1]]), operate("max", [row[n], row[n + 1]])
                row[n], row[n + 1] = low, high
    return result.view(Symbols)


_REDUCTIONS = {"all": "and", "sum": "add", "max": "max", "amax": "max", "min": "min", "amin": "min"}
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "where": _where, "clip": _clip, "mean": _mean, "any": _any, "copyto": _copyto, "sort": _sort,
    **{name: partial(_reduced, op) for name, op in _REDUCTIONS.items()},
    "zeros_like": _like(0.0), "ones_like": _like(1.0), "empty_like": _like(0.0), "take_along_axis": _take_along_axis,
    "flatnonzero": _flatnonzero, "copy": lambda array, **more: array.copy(),
}  # fmt: skip
