"""Symbols in place of measurements: a controller's own NumPy code runs on them once and leaves what it computes behind.

A `Symbols` is a NumPy array of expressions. Slices, stacks and assignments in place mean what they always mean, as NumPy itself
does them; arithmetic builds new expressions. An operation on many elements at once, and the product with a constant matrix, stay
together as a `Block`, so that a network becomes a few loops and not thousands of lines. Numbers keep the precision that NumPy
would give them.

Rows of a batch do not act on each other. So a question to the whole batch (`if moving.any():`), which only saves work, is
answered with yes, and `flatnonzero` of a mask gives an index that acts where the mask is true.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np

from hydro_env.ir import nodes

#: Elements from which on an operation stays together.
TOGETHER = 16
#: NumPy types by the kinds of numbers (`hydro_env.ir`).
DTYPES: dict[str, Any] = {"bool": np.bool_, "int": np.int64, "float": np.float32, "double": np.float64}


class TraceError(TypeError):
    """What a traced controller does that cannot be followed."""


class _Shared:
    """What copies of a controller have in common."""

    __slots__ = ()

    def __deepcopy__(self, memo: Any) -> Any:
        return self


class Expr(_Shared, nodes.Expr):
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

    def _plain(self, refused: str) -> Any:
        if self.op != "const":
            raise TraceError(refused)
        return self.value

    def __bool__(self) -> bool:
        why = "what is done depends on a measured value: an `if` on it cannot be followed, `np.where` can"
        return bool(self._plain(why))

    def __float__(self) -> float:
        return float(self._plain("a measured value is made a plain number"))

    def __index__(self) -> int:
        return int(self._plain("a measured value is used as an index"))


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
    """A call of a compiled function with `arguments`. Among them are `arrays`, which held the expressions `before`, and single
    `numbers`, masks of rows included, both in their order; `after`: what it leaves in the arrays that it writes to, by place."""

    function: Any
    arguments: tuple[Any, ...]
    arrays: "list[Symbols]"
    before: list[list[Expr]]
    numbers: list[Expr]
    after: "dict[int, Items]" = field(default_factory=dict)


@dataclass(eq=False)
class Items(_Shared):
    """An array that a `Kernel` leaves behind."""

    call: Kernel
    kind: str


def below(node: Any) -> list[Any]:
    """What an expression, block or call is computed from."""
    if isinstance(node, Expr):
        return list(node.args)
    if isinstance(node, Items):
        return [node.call]
    rows = [*node.before, node.numbers] if isinstance(node, Kernel) else node.operands
    return [x for row in rows for x in row]


def each_once(roots: Iterable[Any]) -> Iterator[Any]:
    """Some nodes and all below them, each after what it is computed from."""
    done: set[Any] = set()
    stack = [*roots][::-1]
    while stack:
        node = stack.pop()
        if node in done:
            continue
        if waiting := [each for each in below(node) if each not in done]:
            stack += [node, *reversed(waiting)]
        else:
            done.add(node)
            yield node


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
    key = (op, kind, tuple(map(id, args)), repr(value))  # repr tells -0.0 from 0.0
    made = _interned.get()
    if key not in made:
        made[key] = Expr(op, kind, args, value)
    return made[key]


def constant(value: Any, kind: str) -> Expr:
    """A number that is known, rounded to its kind."""
    return _made("const", kind, (), DTYPES[kind](value).item())


def leaf(name: str, index: int, kind: str) -> Expr:
    """Element `index` of an array that is given: measurements, or the state."""
    return _made("leaf", kind, (), (name, index))


def item(block: Block | Items, index: int) -> Expr:
    """Element `index` of what a block or kernel gives."""
    return _made("item", block.kind, (block,), index)


def kind_of(dtype: Any) -> str:
    """The kind of numbers of a NumPy type. TraceError for one that C has no number for."""
    dtype = np.dtype(dtype)
    kind = "int" if dtype.kind in "iu" else next((k for k, own in DTYPES.items() if own == dtype), None)
    if kind is None:
        raise TraceError(f"numbers of type {dtype} cannot be followed")
    return kind


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
_UFUNCS: dict[str, Any] = {
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal,
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not,
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "abs": np.absolute, "max": np.maximum,
    "min": np.minimum, "sign": np.sign, "div": np.true_divide, "sqrt": np.sqrt, "exp": np.exp, "expm1": np.expm1,
    "tanh": np.tanh, "hypot": np.hypot, "floor": np.floor, "log": np.log, "sin": np.sin, "cos": np.cos,
}  # fmt: skip
_BY_UFUNC = {function: name for name, function in _UFUNCS.items()} | {
    np.bitwise_and: "and", np.bitwise_or: "or", np.invert: "not", np.fabs: "abs",
}  # fmt: skip


@cache
def _promoted(op: str, given: tuple[Any, ...]) -> tuple[tuple[str, ...], str]:
    """The kinds in which an operation takes its operands, and that of its result, as NumPy promotes what is given: kinds, or
    `int` and `float` of Python, which are weak."""
    if op in ("and", "or", "not"):
        return ("bool",) * len(given), "bool"
    if op == "where":
        kinds, kind = _promoted("add", given[1:])
        return ("bool", *kinds), kind
    types = [each if isinstance(each, type) else np.dtype(DTYPES[each]) for each in given]
    *operands, result = map(kind_of, _UFUNCS[op].resolve_dtypes((*types, None)))
    return tuple(operands), result


def operate(op: str, args: Sequence[Expr]) -> Expr:
    """An operation on numbers; on known ones it is carried out, as NumPy does."""
    kinds, kind = _promoted(op, tuple(x.kind for x in args))
    operands = list(map(cast, args, kinds))
    simple = _simpler(op, operands)
    if simple is not None:
        return simple
    if any(x.op != "const" for x in operands):
        return _made(op, kind, tuple(operands))
    with np.errstate(all="ignore"):
        return constant(_UFUNCS[op](*(DTYPES[x.kind](x.value) for x in operands)), kind)


#: The place of an operand and its value at which an operation is the other operand.
_NEUTRAL: dict[str, tuple[tuple[int, Any], ...]] = {
    "mul": ((0, 1.0), (1, 1.0)), "div": ((1, 1.0),), "add": ((0, 0.0), (1, 0.0)), "sub": ((1, 0.0),),
    "and": ((0, True), (1, True)), "or": ((0, False), (1, False)),
}  # fmt: skip


def _simpler(op: str, a: Sequence[Expr]) -> Expr | None:
    """What changes no finite number: factors of one and zero, sums with nothing; and what a known truth decides."""
    known = [x.known for x in a]
    if op == "where":
        return a[2] if known[0] is False else a[1] if known[0] is True or a[1] is a[2] else None
    if None not in known:
        return None
    for place, neutral in _NEUTRAL.get(op, ()):
        if known[place] == neutral:
            return a[1 - place]
    if op == "mul" and 0.0 in known:  # what is multiplied is finite
        return constant(0.0, a[0].kind)
    if op in ("add", "sub") and math.inf in (abs(known[0] or 0.0), abs(known[1] or 0.0)):
        return operate(op, [constant(x.known or 0.0, x.kind) for x in a])
    if op in ("and", "or") and (op == "or") in known:
        return constant(op == "or", "bool")
    if op == "sub" and a[0] is a[1]:
        return constant(0.0, a[0].kind)
    if op in ("max", "min"):
        x, y = a if op == "max" else reversed(a)
        # The one that is never on the other's side, where their limits say so.
        return a[0] if x is y or x.low >= y.high else a[1] if y.low >= x.high else None
    return None


# --- arrays --------------------------------------------------------------------------------------------------------------
class MaskedRows:
    """`np.flatnonzero(mask)` of one rig: row 0 where the mask is true."""

    def __init__(self, mask: Expr) -> None:
        self.mask = mask

    size = 1

    def __len__(self) -> int:
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


class Symbols(np.ndarray):
    """An array of expressions, all of one kind."""

    @property
    def kind(self) -> str:
        return _kind(self.view(np.ndarray))

    def elements(self) -> list[Expr]:
        """All elements, row by row."""
        return list(self.view(np.ndarray).reshape(-1))

    def __getitem__(self, index: Any) -> Any:
        """What is measured in an index makes a choice among all that it can be. A mask of one rig (`x[~planned]`) chooses that
        rig: what is read there is only used where the mask holds."""
        parts, axis, _ = _parts_of(index)
        plain = self.view(np.ndarray)
        if axis is None:
            return _wrapped(plain[parts])
        if axis == 0 and parts[0].kind == "bool":
            return _wrapped(plain[(np.zeros(1, int), *parts[1:])])
        result = None
        for value in range(self.shape[axis]):
            one = _wrapped(plain[_with(parts, axis, value)])
            test = _extended(_blockwise("eq", [parts[axis], value]), one.ndim)
            result = one if result is None else _blockwise("where", [test, one, result])
        return result

    def __setitem__(self, index: Any, value: Any) -> None:
        parts, axis, mask = _parts_of(index)
        if axis is not None and parts[axis].kind == "bool":  # a mask of measured truth
            own = (...,) if len(parts) == 1 else (np.zeros(1, int), *parts[1:])
            old = self[own]
            self[own] = _blockwise("where", [_extended(parts[axis], old.ndim), value, old])
            return
        if axis is not None:  # each element whose place is measured, where the place is its own
            (place,) = parts[axis].elements()
            for n in range(self.shape[axis]):
                here = operate("eq", [place, constant(n, "int")])
                both = symbols([here if mask is None else operate("and", [here, mask])], ())
                own = _with(parts, axis, n)
                self[own] = _blockwise("where", [both, value, self[own]])
            return
        now, kind = self.view(np.ndarray), self.kind

        def put(new: Expr, old: Expr) -> Expr:
            return cast(new, kind) if mask is None else operate("where", [mask, cast(new, kind), old])

        now[parts] = np.frompyfunc(put, 2, 1)(_objects(value), now[parts])

    def astype(self, dtype: Any, *args: Any, **more: Any) -> "Symbols":  # type: ignore[override]
        return _wrapped(_cast(_objects(self), kind_of(dtype)))

    def mean(self, *args: Any, **more: Any) -> Any:
        return _mean(self, *args, **more)

    def __bool__(self) -> bool:
        return bool(self.view(np.ndarray).item())

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        out, where = more.pop("out", None), more.pop("where", True)
        if method == "reduce":
            return _reduced(_BY_UFUNC[ufunc], inputs[0], more.get("axis", 0), more.get("keepdims", False))
        if method != "__call__" or where is not True:
            raise TraceError(f"numpy.{ufunc.__name__}.{method} cannot be followed")
        result = _called(ufunc, inputs)
        if out is None:
            return result
        out[0][...] = result
        return out[0]

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        own = _FUNCTIONS.get(function)
        if own is not None:
            return own(*args, **kwargs)
        return _wrapped(super().__array_function__(function, types, tuple(map(_alike, args)), kwargs))


def symbols(elements: Iterable[Expr], shape: tuple[int, ...]) -> Symbols:
    """An array of these expressions."""
    return np.fromiter(elements, object).reshape(shape).view(Symbols)


def known(array: Any) -> Symbols:
    """A constant array as expressions."""
    array = np.asarray(array)
    return _wrapped(np.frompyfunc(partial(constant, kind=kind_of(array.dtype)), 1, 1)(array))


def _wrapped(result: Any) -> Any:
    if isinstance(result, Expr):
        return symbols([result], ())
    if isinstance(result, np.ndarray) and result.dtype == object:
        return result.view(Symbols)
    if isinstance(result, list | tuple):
        return type(result)(map(_wrapped, result))
    return result


def _alike(value: Any) -> Any:
    """A list that holds symbols with real arrays in it as constants."""
    if isinstance(value, list | tuple) and any(isinstance(each, Symbols) for each in value):
        return [_objects(each).view(Symbols) if isinstance(each, np.ndarray) else each for each in value]
    return value


def _objects(value: Any) -> Any:
    """Anything as a plain array of expressions."""
    if isinstance(value, Guard):
        value = symbols([value.truth], ())
    array = np.asarray(value)
    return array if array.dtype == object else known(array).view(np.ndarray)


def _kind(array: Any) -> str:
    """The kind of an array of expressions."""
    return array.flat[0].kind if array.size else "double"


def _cast(array: Any, kind: str) -> Any:
    """An array of expressions in another kind."""
    return np.frompyfunc(partial(cast, kind=kind), 1, 1)(array)


def _each(op: str, count: int = 2) -> Any:
    """An operation as NumPy's function of arrays of expressions."""
    return np.frompyfunc(lambda *row: operate(op, row), count, 1, identity=None)


def _parts_of(index: Any) -> tuple[tuple[Any, ...], int | None, Expr | None]:
    """The parts of an index without masks of rows, the place of the one that is measured, and the mask."""
    given = index if isinstance(index, tuple) else (index,)
    mask = next((each.mask for each in given if isinstance(each, MaskedRows)), None)
    parts = tuple(np.zeros(1, int) if isinstance(each, MaskedRows) else each for each in given)
    return parts, next((n for n, each in enumerate(parts) if isinstance(each, Symbols)), None), mask


def _with(parts: tuple[Any, ...], axis: int, value: int) -> tuple[Any, ...]:
    """An index with a known number in the place of the measured one."""
    return (*parts[:axis], np.full(parts[axis].shape, value), *parts[axis + 1 :])


def _extended(mask: Symbols, ndim: int) -> Symbols:
    """A mask of rigs with axes behind it."""
    plain = mask.view(np.ndarray)
    return plain.reshape(plain.shape + (1,) * (ndim - plain.ndim)).view(Symbols)


def _called(ufunc: Any, inputs: Sequence[Any]) -> Any:
    if ufunc in _FUNCTIONS:
        return _FUNCTIONS[ufunc](*inputs)
    if ufunc not in _BY_UFUNC:
        raise TraceError(f"numpy.{ufunc.__name__} cannot be followed")
    return _blockwise(_BY_UFUNC[ufunc], inputs)


def _blockwise(op: str, inputs: Sequence[Any]) -> Any:
    """An operation element by element; many stay together."""
    arrays = [_objects(each) for each in inputs]
    weak = [type(each) in (int, float) for each in inputs]
    given = tuple(type(x) if w else _kind(a) for x, a, w in zip(inputs, arrays, weak, strict=True))
    kinds, kind = _promoted(op, given)
    arrays = [_cast(a, k) if w else a for a, k, w in zip(arrays, kinds, weak, strict=True)]
    together = np.broadcast(*arrays)
    if together.size >= TOGETHER:
        rows = [list(np.broadcast_to(each, together.shape).flat) for each in arrays]
        if any(x.op != "const" for row in rows for x in row):
            block = Block(op, kind, list(map(_cast_row, rows, kinds)), together.size)
            return symbols((item(block, n) for n in range(block.size)), together.shape)
    return _wrapped(_each(op, len(arrays))(*arrays))


def _cast_row(row: list[Expr], kind: str) -> list[Expr]:
    """A row of operands in another kind, together if they are many and not known."""
    if all(x.kind == kind or x.op == "const" for x in row) or len(set(map(id, row))) == 1:
        return [cast(x, kind) for x in row]
    block = Block("cast", kind, [row], len(row))
    return [item(block, n) for n in range(len(row))]


def _power(base: Any, power: Any = 2) -> Any:
    if not isinstance(power, int | float) or power not in (0.5, 2, 3):
        raise TraceError(f"the power {power} cannot be followed; 0.5, 2 and 3 can")
    if power == 0.5:
        return _blockwise("sqrt", [base])
    squared = _blockwise("mul", [base, base])
    return squared if power == 2 else _blockwise("mul", [squared, base])


def _product(a: Any, b: Any) -> Symbols:
    """a (..., m, n) @ b (n, k) with a constant `b`."""
    if isinstance(b, Symbols) or not isinstance(a, Symbols):
        raise TraceError("only a product with a constant matrix on the right can be followed")
    matrix, plain = np.asarray(b), a.view(np.ndarray)
    weights, size = np.ascontiguousarray(matrix.T), matrix.shape[1]
    (kind, _), _ = _promoted("mul", (a.kind, kind_of(matrix.dtype)))
    rows = [_cast_row(list(row), kind) for row in plain.reshape(-1, plain.shape[-1])]
    blocks = [Block("product", kind, [row], size, weights) for row in rows]
    return symbols((item(block, n) for block in blocks for n in range(size)), (*plain.shape[:-1], size))


def _reduced(op: str, array: Any, axis: Any, keepdims: bool = False) -> Any:
    plain = _objects(array).copy(order="C")  # so that elements are taken row by row
    if op == "add" and _kind(plain) == "bool":
        plain = _cast(plain, "int")
    result = _each(op).reduce(plain, axis=axis, keepdims=keepdims)
    return Guard(result) if op == "or" and axis is None else _wrapped(result)


def _mean(array: Any, axis: Any = None, keepdims: bool = False, **more: Any) -> Any:
    total = _reduced("add", array, axis, keepdims)
    return _blockwise("div", [total, array.size // max(1, total.size)])


def _copyto(to: Symbols, value: Any, where: Any = True) -> None:
    to[...] = value if where is True else _blockwise("where", [where, value, to])


def _filled(value: float, array: Any, dtype: Any = None, **more: Any) -> Symbols:
    return known(np.full(array.shape, value, dtype or DTYPES[array.kind]))


def _take_along_axis(array: Any, indices: Any, axis: int) -> Symbols:
    plain, picked = np.moveaxis(_objects(array), axis, -1), np.moveaxis(_objects(indices), axis, -1)
    result = np.broadcast_to(plain[..., :1], picked.shape)
    for n in range(1, plain.shape[-1]):
        result = _each("where", 3)(_each("eq")(picked, constant(n, "int")), plain[..., n : n + 1], result)
    return np.moveaxis(result, -1, axis).view(Symbols)


def _flatnonzero(mask: Any) -> Any:
    elements = _objects(mask).reshape(-1)
    if len(elements) != 1:
        raise TraceError("flatnonzero of more than one rig cannot be followed")
    return MaskedRows(cast(elements[0], "bool"))


def _sort(array: Any, axis: int = -1) -> Symbols:
    """By exchanges of neighbours, the last axis."""
    result = _objects(array).copy()
    low, high = _each("min"), _each("max")
    for end in range(result.shape[-1] - 1, 0, -1):
        for n in range(end):
            one, other = result[..., n], result[..., n + 1]
            result[..., n], result[..., n + 1] = low(one, other), high(one, other)
    return result.view(Symbols)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: lambda *inputs: _blockwise("where", inputs), np.mean: _mean, np.copyto: _copyto,
    np.clip: lambda array, low, high, out=None: np.minimum(np.maximum(array, low), high, out=out),
    np.zeros_like: partial(_filled, 0.0), np.ones_like: partial(_filled, 1.0), np.empty_like: partial(_filled, 0.0),
    np.take_along_axis: _take_along_axis, np.flatnonzero: _flatnonzero, np.sort: _sort, np.matmul: _product,
    np.isfinite: lambda x: _blockwise("lt", [_blockwise("abs", [x]), math.inf]), np.positive: lambda x: x,
    np.power: _power, np.square: _power,
}  # fmt: skip
