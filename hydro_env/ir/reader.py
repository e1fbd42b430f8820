"""The part of Python that compiled functions are written in, as typed statements.

What is read: numbers, booleans, arrays, named tuples; assignments, `if`, loops over `range`, over literal tuples and over arrays;
slices that are views; calls of other such functions. A function is read once for each set of argument types, as Numba compiles
it, so every shape is known and nothing is allocated. Whole numbers, truths, and settings that are known beforehand become
constants; arithmetic with real numbers is left to the program, which rounds it in its own precision.
"""

import ast
import inspect
import math
import operator
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import compress
from typing import Any

import numpy as np

from .nodes import (
    KINDS,
    Assign,
    Expr,
    For,
    Function,
    If,
    Jump,
    Return,
    Run,
    Statement,
    Store,
    Table,
    add,
    cast,
    const,
    mul,
    names_read,
    op,
    var,
    wider,
    without_unread,
)  # fmt: skip

_BINARY = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.FloorDiv: "floordiv", ast.Mod: "mod",
    ast.BitAnd: "and", ast.BitOr: "or",
}  # fmt: skip
_COMPARED = {ast.Lt: "lt", ast.Gt: "gt", ast.LtE: "le", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}
#: Functions of numbers by the names that compiled functions call, and whether they work on whole numbers as well.
_MATH = {
    **dict.fromkeys(("abs", "min", "max"), True),
    **dict.fromkeys(("sqrt", "floor", "exp", "tanh", "cos", "sin", "fma", "hypot", "expm1", "log", "sign"), False),
}  # fmt: skip
_WHOLE = frozenset({"add", "sub", "mul", "floordiv", "mod", "lt", "le", "gt", "ge", "eq", "ne"})


class TranslationError(TypeError):
    """What the intermediate form cannot say, and where it stands."""


# --- values -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Arr:
    """An array, or a part of one: kind of its elements, name of the whole, index of its first element, shape and strides."""

    kind: str
    name: str
    offset: Expr
    shape: tuple[Expr, ...]
    strides: tuple[Expr, ...]
    fixed: bool = False
    """A table, which need not be passed on."""

    @classmethod
    def of(cls, kind: str, name: str, shape: Sequence[int | Expr], fixed: bool = False) -> "Arr":
        """A contiguous array."""
        sizes = [const(size, "int") if isinstance(size, int) else size for size in shape]
        strides: list[Expr] = []
        step = const(1, "int")
        for size in reversed(sizes):
            strides.insert(0, step)
            step = mul(step, size)
        return cls(kind, name, const(0, "int"), tuple(sizes), tuple(strides), fixed)

    @property
    def address(self) -> Expr:
        return Expr("address", self.kind, (self.offset,), self.name)


@dataclass(frozen=True)
class Rec:
    """A named tuple."""

    fields: "Mapping[str, Value]"


#: A tuple holds several values, as a function returns them.
Value = Expr | Arr | Rec | tuple["Value", ...]


def constant_of(value: Any) -> Expr | None:
    """A Python or NumPy number that is known beforehand; None for anything else."""
    if isinstance(value, bool | np.bool_):
        return const(value, "bool")
    if isinstance(value, int | np.integer):
        return const(value, "int")
    return const(value, "double") if isinstance(value, float | np.floating) else None


def _signature(value: Value) -> Any:
    """What a function is read once more for."""
    match value:
        case Expr():
            return value.kind, repr(value.known)
        case Arr(kind, name, offset, shape, strides, fixed):
            sizes = tuple(x.known for x in (*shape, *strides))
            return kind, sizes, (name, offset.known) if fixed else ""
        case Rec(fields):
            return tuple((name, _signature(each)) for name, each in fields.items())
        case _:
            return tuple(map(_signature, value))


def _passed(value: Value, name: str, given: list[tuple[str, str, bool]], handed: list[Expr]) -> Value:
    """The value as the called function knows it: what is not known beforehand becomes parameters (`given`, and `handed`: what the
    caller writes there)."""
    match value:
        case Expr() if value.known is None:
            given.append((name, value.kind, False))
            handed.append(value)
            return var(name, value.kind)
        case Arr(kind, _, _, shape, _, False):
            given.append((name, kind, True))
            handed.append(value.address)
            sizes = []
            for n, size in enumerate(shape):
                if size.known is None:
                    given.append((f"{name}_size{n}", "int", False))
                    handed.append(size)
                    size = var(f"{name}_size{n}", "int")
                sizes.append(size)
            return replace(value, name=name, offset=const(0, "int"), shape=tuple(sizes))
        case Rec(fields):
            return Rec({key: _passed(each, f"{name}_{key}", given, handed) for key, each in fields.items()})
        case tuple() if not all(isinstance(x, Expr) and x.known is not None for x in value):
            raise TranslationError(f"{name}: a tuple of what is not known beforehand cannot be passed on")
    return value


# --- sources ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Source:
    """The syntax tree of a function, and the names around it."""

    node: ast.FunctionDef
    world: Mapping[str, Any]


def module_sources(text: str) -> dict[str, Source]:
    """The functions of a generated module."""
    tree, world = ast.parse(text), dict[str, Any]()
    found = {node.name: Source(node, world) for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            exec(compile(ast.Module([node], []), "<constants>", "exec"), world)
    world |= found
    return found


@dataclass(frozen=True)
class Called:
    """How a function is called: its name, what it returns, what it is handed, and which of these arrays it writes to."""

    name: str
    result: Value | None
    handed: list[Expr]
    written: frozenset[str]


@dataclass
class Reader:
    """Collects functions, callees first, and tables."""

    functions: dict[Any, Function] = field(default_factory=dict)
    tables: dict[Any, Table] = field(default_factory=dict)
    reserved: frozenset[str] = frozenset()
    """Words of the language to be printed, which are no names."""
    fuses: bool = False
    """Whether a product and a sum in one statement are one operation, a * b + c in one rounding."""
    _results: dict[str, Value | None] = field(default_factory=dict)
    _kept: dict[str, list[bool]] = field(default_factory=dict)
    _sources: dict[Any, Source] = field(default_factory=dict)
    _names: dict[str, int] = field(default_factory=dict)

    def reserve(self, *names: str) -> None:
        """Names that a function must not get."""
        self._names |= dict.fromkeys(names, 1)

    def unused(self, name: str) -> str:
        """A name that no other function or table has."""
        number = self._names[name] = self._names.get(name, 0) + 1
        return name if number == 1 else f"{name}_{number}"

    def safe(self, name: str) -> str:
        """A name that is no word of the language to be printed."""
        return f"{name}_" if name in self.reserved else name

    def table(self, array: Any, name: str = "table") -> Arr:
        """A constant array."""
        array = np.asarray(array)
        kind = {"b": "bool", "i": "int", "u": "int"}.get(array.dtype.kind, "double")
        kind = "float" if array.dtype == np.float32 else kind
        key = (kind, array.tobytes(), array.shape)
        if key not in self.tables:
            self.tables[key] = Table(self.unused(name), kind, array.reshape(-1).tolist())
        return Arr.of(kind, self.tables[key].name, array.shape, fixed=True)

    def source(self, function: Any) -> Source:
        """The source of a function: of a compiled one that of its Python."""
        if isinstance(function, Source):
            return function
        python = getattr(function, "py_func", function)
        if python not in self._sources:
            node = ast.parse(textwrap.dedent(inspect.getsource(python))).body[0]
            assert isinstance(node, ast.FunctionDef)
            self._sources[python] = Source(node, python.__globals__)
        return self._sources[python]

    def call(self, function: Any, values: Sequence[Value]) -> Called:
        """A call of a function with values of these types, which is read if it was not yet."""
        source = self.source(function)
        handed: list[Expr] = []
        given: list[tuple[str, str, bool]] = []
        names = {
            a.arg: _passed(value, self.safe(a.arg), given, handed)
            for a, value in zip(source.node.args.args, values, strict=True)
        }
        key = (source, tuple(map(_signature, values)))
        if key not in self.functions:
            self.functions[key] = self._read(source, names, given)
        made = self.functions[key]
        kept = self._kept[made.name]
        arrays = [is_array for _, _, is_array in given]
        whole = {
            inner: outer.value for (inner, _, _), outer in compress(zip(given, handed, strict=True), arrays)
        }
        written = frozenset(whole[each] for each in made.written if each in whole)
        return Called(made.name, self._results[made.name], list(compress(handed, kept)), written)

    def _read(self, source: Source, names: dict[str, Value], given: list[tuple[str, str, bool]]) -> Function:
        body = _Body(self, source, names, {each for each, _, is_array in given if is_array})
        changing = {made.name for made in self.functions.values() if made.written}
        statements, variables = without_unread(body.read(), body.declared, changing)
        used = names_read(statements)
        name = self.unused(source.node.name.strip("_"))
        self._results[name], self._kept[name] = body.result, [used[each] > 0 for each, _, _ in given]
        outputs = [(own, kind, True) for kind, own in body.outputs]
        parameters = [*compress(given, self._kept[name]), *outputs]
        result = body.result.kind if isinstance(body.result, Expr) else ""
        written = body.written | {own for own, _, _ in outputs}
        return Function(name, parameters, variables, statements, result, written)


def _is_product(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult)


def _negative(x: Expr) -> Expr:
    return op("neg", x) if x.known is None else const(-x.known, x.kind)


# --- functions --------------------------------------------------------------------------------------------------------
class _Body:
    """One function for arguments of known types."""

    def __init__(self, whole: Reader, source: Source, names: dict[str, Value], arrays: set[str]) -> None:
        self.whole, self.node, self.world, self.given, self.arrays = (
            whole,
            source.node,
            source.world,
            names,
            arrays,
        )
        self.kinds: dict[str, str] = {}
        self.written: set[str] = set()
        inside = ast.walk(self.node)
        stores = Counter(n.id for n in inside if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
        self.stored = set(stores)
        self.once = {name for name, count in stores.items() if count == 1 and name not in names}

    def read(self) -> list[Statement]:
        """The statements of the function."""
        while True:  # until no variable has to be wider than it was thought to be
            self.widened = False
            self.names = dict(self.given)
            self.declared: dict[str, tuple[str, int]] = {}
            self.count = 0
            self.result: Value | None = None
            self.outputs: list[tuple[str, str]] = []
            into: list[Statement] = []
            for name, value in self.given.items():
                if isinstance(value, Expr) and name in self.stored:
                    self._assign(name, value, into)  # a variable of the function's own
            self.block(self.node.body, into)
            if not self.widened:
                return into

    def fail(self, node: ast.AST, why: str = "cannot be translated") -> TranslationError:
        return TranslationError(f"{self.node.name}: {ast.unparse(node).splitlines()[0]!r} {why}")

    def fresh(self, name: str, kind: str, size: int = 0) -> str:
        """A new variable."""
        self.count += 1
        self.declared[f"{name}_{self.count}"] = kind, size
        return f"{name}_{self.count}"

    # --- statements -------------------------------------------------------------------------------------------------
    def block(self, statements: Sequence[ast.stmt], into: list[Statement]) -> None:
        for node in statements:
            self.statement(node, into)

    def _inner(self, statements: Sequence[ast.stmt]) -> list[Statement]:
        inner: list[Statement] = []
        self.block(statements, inner)
        return inner

    def statement(self, node: ast.stmt, into: list[Statement]) -> None:
        match node:
            case ast.Expr(ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(ast.Call() as called):
                result = self.value(called, into)
                if isinstance(result, Expr):
                    into.append(Run(result))
            case ast.Assign(targets, value):
                self._assignment(targets, value, into)
            case ast.AugAssign(target, operator, value):
                now = ast.BinOp(ast.parse(ast.unparse(target), mode="eval").body, operator, value)
                self._store(target, self.value(ast.copy_location(now, node), into), into)
            case ast.If(test, body, orelse):
                chosen = self.number(test, into)
                if chosen.known is not None:
                    self.block(body if chosen.known else orelse, into)
                else:
                    into.append(If(chosen, self._inner(body), self._inner(orelse)))
            case ast.For(target, over, body, []):
                self._for(target, over, body, into)
            case ast.Break() | ast.Continue():
                into.append(Jump(ast.unparse(node)))
            case ast.Return(value):
                self._return(value, into)
            case _:
                raise self.fail(node)

    def _for(self, target: ast.expr, over: ast.expr, body: list[ast.stmt], into: list[Statement]) -> None:
        match over:
            case ast.Call(ast.Name("range"), bounds) if isinstance(target, ast.Name):
                numbers = [self.number(bound, into) for bound in bounds]
                start = numbers[0] if len(numbers) > 1 else const(0, "int")
                stop = numbers[min(1, len(numbers) - 1)]
                step = numbers[2].known if len(numbers) > 2 else 1
                if step not in (1, -1):
                    raise self.fail(over, "has a step that is not 1 or -1")
                if stop.known is not None and stop.known <= 0 and start.known == 0:
                    return
                name = self.fresh("n", "int") if target.id == "_" else self._variable(target.id, "int")
                into.append(For(name, start, stop, step, self._inner(body)))
            case ast.Tuple(items):
                for item in items:
                    self._assignment([target], item, into)
                    self.block(body, into)
            case _:
                array = self.value(over, into)
                if not isinstance(array, Arr) or not isinstance(target, ast.Name):
                    raise self.fail(over)
                at = self.fresh("at", "int")
                inner: list[Statement] = []
                self._assign(target.id, self._element(array, [var(at, "int")], over), inner)
                into.append(For(at, const(0, "int"), array.shape[0], 1, inner))
                self.block(body, inner)

    def _return(self, node: ast.expr | None, into: list[Statement]) -> None:
        if isinstance(node, ast.Tuple):
            values = [self.number(each, into) for each in node.elts]
            before = self.outputs or [(each.kind, "") for each in values]
            kinds = [wider(kind, x.kind) for (kind, _), x in zip(before, values, strict=True)]
            self.outputs = [(kind, f"out_{n}") for n, kind in enumerate(kinds)]
            self.result = tuple(var(name, kind) for kind, name in self.outputs)
            # What is returned may read what an output is: all of it is computed first.
            held = [self._held(each, into) for each in values]
            for (kind, name), value in zip(self.outputs, held, strict=True):
                into.append(Store(name, const(0, "int"), cast(value, kind)))
            into.append(Return(None))
        elif node is not None:
            value = self.number(node, into)
            kind = wider(self.result.kind, value.kind) if isinstance(self.result, Expr) else value.kind
            self.result = var("", kind)
            into.append(Return(cast(value, kind)))
        else:
            into.append(Return(None))

    def _assignment(self, targets: list[ast.expr], node: ast.expr, into: list[Statement]) -> None:
        first = targets[0]
        if isinstance(first, ast.Tuple) and isinstance(node, ast.Tuple) and len(targets) == 1:
            read = {n.id for each in node.elts[1:] for n in ast.walk(each) if isinstance(n, ast.Name)}
            stored = {each.id if isinstance(each, ast.Name) else "" for each in first.elts}
            if stored & {*read, ""}:  # what is stored first may be read by what comes after
                values = [self._held(self.value(each, into), into) for each in node.elts]
                for target, value in zip(first.elts, values, strict=True):
                    self._store(target, value, into)
            else:
                for target, each in zip(first.elts, node.elts, strict=True):
                    self._store(target, self.value(each, into), into)
            return
        value = self.value(node, into)
        if len(targets) > 1:
            value = self._held(value, into)
        for target in targets:
            self._store(target, value, into)

    def _held(self, value: Any, into: list[Statement]) -> Any:
        """A number in a variable of its own, so that what it is computed from may change."""
        if not isinstance(value, Expr) or value.known is not None:
            return value
        name = self.fresh("held", value.kind)
        into.append(Assign(name, value))
        return var(name, value.kind)

    def _store(self, target: ast.expr, value: Value, into: list[Statement]) -> None:
        match target:
            case ast.Name("_"):
                pass
            case ast.Name(name):
                self._assign(name, value, into)
            case ast.Subscript(base, index):
                array = self.value(base, into)
                if not isinstance(array, Arr):
                    raise self.fail(target)
                self._write(self._subscript(array, index, into, target), array, value, target, into)
            case ast.Tuple(parts) if isinstance(value, tuple):
                for part, each in zip(parts, value, strict=True):
                    self._store(part, each, into)
            case ast.Tuple(parts) if isinstance(value, Arr) and value.shape[0].known == len(parts):
                for n, part in enumerate(parts):
                    self._store(part, self._element(value, [const(n, "int")], target), into)
            case _:
                raise self.fail(target)

    def _write(self, place: Value, array: Arr, value: Value, node: ast.AST, into: list[Statement]) -> None:
        """place = value, where `place` is an element of an array, or a part of it."""
        self.written |= {array.name} & self.arrays
        indices: list[Expr] = []
        while isinstance(place, Arr):  # a loop around for each axis
            loop = For(self.fresh("i", "int"), const(0, "int"), place.shape[0], 1, [])
            indices.append(var(loop.name, "int"))
            into.append(loop)
            into, place = loop.body, self._element(place, indices[-1:], node)
        if isinstance(value, Arr):
            value = self._element(value, indices[len(indices) - len(value.shape) :], node)
        if not isinstance(value, Expr) or not isinstance(place, Expr):
            raise self.fail(node)
        into.append(Store(place.value, place.args[0], cast(value, place.kind)))

    def _variable(self, name: str, kind: str) -> str:
        """A variable of this kind at least."""
        before = self.kinds.get(name, kind)
        kind = self.kinds[name] = wider(before, kind)
        self.widened |= kind != before
        own = f"{self.whole.safe(name)}_own" if name in self.given else self.whole.safe(name)
        self.declared[own] = kind, 0
        self.names[name] = var(own, kind)
        return own

    def _assign(self, name: str, value: Value, into: list[Statement]) -> None:
        match value:
            case Expr() if value.known is None or name not in self.once:
                own = self._variable(name, value.kind)
                into.append(Assign(own, cast(value, self.kinds[name])))
            # Which one it is would depend on the way that led here.
            case Arr() | Rec() | tuple() if name not in self.once:
                raise TranslationError(f"{self.node.name}: {name!r} stands for several arrays")
            case Arr(offset=offset) if offset.known is None:  # what it is computed from may change
                self.names[name] = replace(value, offset=self._held(offset, into))
            case _:
                self.names[name] = value

    # --- expressions ------------------------------------------------------------------------------------------------
    def number(self, node: ast.expr, into: list[Statement]) -> Expr:
        value = self.value(node, into)
        if not isinstance(value, Expr):
            raise self.fail(node, "is no number")
        return value

    def value(self, node: ast.expr, into: list[Statement]) -> Value:
        """The value of an expression; what has to be computed before goes to `into`."""
        match node:
            case ast.Constant(value):
                found = constant_of(value)
                if found is None:
                    raise self.fail(node)
                return found
            case ast.Name(name):
                return self._name(name, node)
            case ast.Attribute(base, name):
                return self._attribute(self.value(base, into), name, node)
            case ast.Subscript(base, index):
                return self._subscript(self.value(base, into), index, into, node)
            case ast.BinOp(left, ast.Pow(), right):
                return self._power(node, self.number(left, into), self.number(right, into).known, into)
            case ast.BinOp(left, ast.Add() | ast.Sub(), right) if self.whole.fuses and (
                _is_product(left) or _is_product(right)
            ):
                return self._fused(left, right, isinstance(node.op, ast.Sub), into)
            case ast.BinOp(left, operator, right) if type(operator) in _BINARY:
                numbers = [self.number(each, into) for each in (left, right)]
                return self._operation(_BINARY[type(operator)], numbers)
            case ast.BoolOp(operator, parts):
                return self._logic(isinstance(operator, ast.And), [self.number(p, into) for p in parts])
            case ast.UnaryOp(ast.USub(), operand):
                return _negative(self.number(operand, into))
            case ast.UnaryOp(ast.Not(), operand):
                one = self.number(operand, into)
                return op("not", one) if one.known is None else const(not one.known, "bool")
            case ast.Compare(left, operators, others):
                numbers = [self.number(each, into) for each in (left, *others)]
                pairs = zip(operators, numbers[:-1], numbers[1:], strict=True)
                return self._logic(True, [self._operation(_COMPARED[type(o)], [a, b]) for o, a, b in pairs])
            case ast.IfExp():
                return self._choice(node, into)
            case ast.Call():
                return self._call(node, into)
            case ast.Tuple(items):
                return tuple(self.value(each, into) for each in items)
        raise self.fail(node)

    def _name(self, name: str, node: ast.AST) -> Value:
        if name in self.names:
            return self.names[name]
        value = self.world.get(name)
        found = constant_of(value)
        if found is not None:
            return found
        if isinstance(value, np.ndarray | tuple):
            return self.whole.table(value, name.lower())
        raise self.fail(node, "is not known" if name not in self.world else "is not a number or array")

    def _attribute(self, base: Value, name: str, node: ast.AST) -> Value:
        if isinstance(base, Rec) and name in base.fields:
            return base.fields[name]
        if isinstance(base, Arr) and name == "size":
            return reduce(mul, base.shape, const(1, "int"))
        if isinstance(base, Arr) and name == "shape":
            return base.shape
        raise self.fail(node)

    def _subscript(self, base: Value, index: ast.expr, into: list[Statement], node: ast.AST) -> Value:
        if isinstance(base, tuple):
            at = self.number(index, into).known
            if at is None:
                raise self.fail(node)
            return base[at]
        if not isinstance(base, Arr):
            raise self.fail(node)
        indices: list[Expr | slice] = []
        for each in index.elts if isinstance(index, ast.Tuple) else [index]:
            if isinstance(each, ast.Slice):
                first, last = (end and self.number(end, into) for end in (each.lower, each.upper))
                if each.step is not None or any(end and end.known is None for end in (first, last)):
                    raise self.fail(node)
                indices.append(slice(first and first.known, last and last.known))
            else:
                indices.append(self.number(each, into))
        return self._element(base, indices, node)

    def _element(self, base: Arr, indices: Sequence[Expr | slice], node: ast.AST) -> Value:
        """base[indices]: a number, or a view."""
        offset, shape, strides = base.offset, [], []
        if len(indices) > len(base.shape):
            raise self.fail(node)
        for n, (size, stride) in enumerate(zip(base.shape, base.strides, strict=True)):
            each = indices[n] if n < len(indices) else slice(None, None)
            if isinstance(each, Expr):
                if each.known is not None and each.known < 0:
                    each = add(size, each)
                offset = add(offset, mul(each, stride))
            else:
                offset = add(offset, mul(const(each.start or 0, "int"), stride))
                last = size if each.stop is None else const(each.stop, "int")
                shape.append(add(last, const(-(each.start or 0), "int")))
                strides.append(stride)
        if shape:
            fixed = base.fixed and offset.known == 0
            return replace(base, offset=offset, shape=tuple(shape), strides=tuple(strides), fixed=fixed)
        return Expr("load", base.kind, (offset,), base.name)

    def _operation(self, name: str, numbers: list[Expr]) -> Expr:
        """An operation; it is carried out on whole numbers that are known, and so is a comparison of any."""
        a, b = numbers
        if name in ("and", "or"):
            return op(name, a, b)
        whole = all(x.kind in ("int", "bool") for x in numbers)
        if None not in (a.known, b.known) and name in _WHOLE and (whole or name in _COMPARED.values()):
            found = constant_of(getattr(operator, name)(a.known, b.known))
            assert found is not None
            return found
        return op(name, a, b, kind="double" if name == "div" and whole else "")

    def _fused(self, left: Any, right: Any, less: bool, into: list[Statement]) -> Expr:
        """A sum, or difference (`less`), with a product; one operation unless they are whole numbers."""
        product, term = (right, left) if _is_product(right) else (left, right)
        a, b, c = (self.number(each, into) for each in (product.left, product.right, term))
        if less:
            a, c = (_negative(a), c) if product is right else (a, _negative(c))
        if all(x.kind in ("int", "bool") for x in (a, b, c)):
            return self._operation("add", [self._operation("mul", [a, b]), c])
        return op("fma", a, b, c, kind="double")

    def _logic(self, both: bool, parts: list[Expr]) -> Expr:
        """`and` or `or` of numbers; what is known beforehand decides or drops out."""
        if any(part.known is not None and bool(part.known) is not both for part in parts):
            return const(not both, "bool")
        left = [part for part in parts if part.known is None]
        if not left:
            return const(both, "bool")
        word = "and" if both else "or"
        return reduce(lambda a, b: op(word, a, b), left[1:], cast(left[0], "bool"))

    def _power(self, node: ast.AST, base: Expr, power: Any, into: list[Statement]) -> Expr:
        if power is None or power != int(power) or not 1 <= power <= 8:
            raise self.fail(node, "has a power that is no whole number")
        factors: list[Expr] = [self._held(base, into)] * int(power)
        return reduce(lambda a, b: op("mul", a, b), factors)

    def _choice(self, node: ast.IfExp, into: list[Statement]) -> Value:
        chosen = self.number(node.test, into)
        if chosen.known is not None:
            return self.value(node.body if chosen.known else node.orelse, into)
        one, other = self.value(node.body, into), self.value(node.orelse, into)
        if isinstance(one, tuple) and isinstance(other, tuple):
            held = self._held(chosen, into)
            return tuple(self._either(held, a, b, node) for a, b in zip(one, other, strict=True))
        return self._either(chosen, one, other, node)

    def _either(self, chosen: Expr, first: Value, second: Value, node: ast.AST) -> Expr:
        if not isinstance(first, Expr) or not isinstance(second, Expr):
            raise self.fail(node, "is no number")
        kind = wider(first.kind, second.kind)
        return Expr("where", kind, (cast(chosen, "bool"), cast(first, kind), cast(second, kind)))

    # --- calls ------------------------------------------------------------------------------------------------------
    def _call(self, node: ast.Call, into: list[Statement]) -> Value:
        name = ast.unparse(node.func)
        own = self.world.get(name)
        if isinstance(own, Source) or hasattr(own, "py_func") or hasattr(own, "__code__"):
            return self._function(own, [self.value(each, into) for each in node.args], into)
        short = name.removeprefix("np.").removeprefix("math.")
        if short in ("empty", "zeros"):
            return self._local(node, into, zero=short == "zeros")
        if short == "argmin":
            array = self.value(node.args[0], into)
            if not isinstance(array, Arr) or [each.known for each in array.strides] != [1]:
                raise self.fail(node)
            return Expr("argmin", "int", (array.address, array.shape[0]))
        values = [self.number(each, into) for each in node.args]
        if short in ("float", "float64", "int", "bool"):
            return cast(values[0], "double" if short.startswith("float") else short)
        if short not in _MATH:
            raise self.fail(node)
        kind = wider(*(each.kind for each in values)) if _MATH[short] else "double"
        if short in ("min", "max"):
            return reduce(lambda a, b: op(short, a, b, kind=kind), values)
        return op(short, *values, kind=kind)

    def _function(self, function: Any, values: list[Value], into: list[Statement]) -> Value:
        called = self.whole.call(function, values)
        self.written |= called.written & self.arrays
        if isinstance(called.result, Expr):
            return Expr("call", called.result.kind, tuple(called.handed), called.name)
        made: list[Expr] = []
        for each in called.result if isinstance(called.result, tuple) else ():
            assert isinstance(each, Expr)
            made.append(var(self.fresh("result", each.kind), each.kind))
        outputs = [Expr("address", x.kind, (), x.value) for x in made]
        into.append(Run(Expr("call", "int", (*called.handed, *outputs), called.name)))
        return tuple(made)

    def _local(self, node: ast.Call, into: list[Statement], zero: bool) -> Arr:
        """An array of the function's own."""
        shape = self.value(node.args[0], into)
        items = shape if isinstance(shape, tuple) else (shape,)
        sizes = [each.known for each in items if isinstance(each, Expr)]
        if not sizes or None in sizes:
            raise self.fail(node, "has a size that is not known beforehand")
        asked = ast.unparse(node.args[1]) if len(node.args) > 1 else ""
        kind = next((each for each in KINDS[:2] if each in asked), "double")
        array = Arr.of(kind, self.fresh("room", kind, math.prod(sizes)), sizes)
        if zero:
            self._write(array, array, const(0, kind), node, into)
        return array
