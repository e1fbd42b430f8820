"""Compiled functions as C99: the same Python source that Numba compiles, statement by statement.

What is translated is the part of Python that compiled functions of this package are written in: numbers, booleans, arrays
of fixed shape, named tuples; assignments, `if`, loops over `range`, over literal tuples and over arrays; slices that are
views; calls of other such functions. A function is translated once for each set of argument types, as Numba compiles it,
so every shape is known and nothing is allocated. Numbers that are known beforehand (settings) become constants.

The result is the same bit for bit as long as the C compiler fuses and reorders nothing (`-std=c99`, or `-ffp-contract=off`).
It needs nothing but math.h. `TranslationError`, which names the function and the statement, for anything else.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any

import numpy as np

__all__ = [
    "KINDS", "Arr", "Num", "Rec", "TranslationError", "Translator", "Value", "bare", "constant_of", "identifier", "literal",
    "plain_functions", "without_unread",
]  # fmt: skip

#: C types of kinds of numbers, from the narrowest to the widest.
KINDS = {"bool": "int", "int": "int", "float": "float", "double": "double"}
_WIDTH = {kind: n for n, kind in enumerate(KINDS)}

_ARITHMETIC = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARED = {ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
#: Functions of math.h by the names that compiled functions call.
_MATH = {
    name: name for name in ("sqrt", "floor", "exp", "tanh", "cos", "sin", "fma", "hypot", "expm1", "log")
}

#: Python's `%` and `//` of whole numbers, its `min` and `max`, and the like, in C.
_HELPERS = (
    "static inline int py_mod(int a, int b) { int r = a % b; return r != 0 && (r < 0) != (b < 0) ? r + b : r; }\n",
    "static inline int py_div(int a, int b) { return (a - py_mod(a, b)) / b; }\n",
    "static inline int py_min_int(int a, int b) { return b < a ? b : a; }\n",
    "static inline int py_max_int(int a, int b) { return b > a ? b : a; }\n",
    "static inline double py_sign(double a) { return (double)((a > 0.0) - (a < 0.0)); }\n",
    """static inline int py_argmin(const double *a, int n) {
    int i, found = 0;
    for (i = 1; i < n; i++)
        if (a[i] < a[found]) found = i;
    return found;
}
""",
    "static inline double py_min(double a, double b) { return b < a ? b : a; }\n",
    "static inline double py_max(double a, double b) { return b > a ? b : a; }\n",
)
_ASSIGNED = re.compile(r"\s*(?:(?:const )?(?:double|float|int) (?:\*const )?)?(\w+) = (.*);")


class TranslationError(TypeError):
    """What cannot be said in C, and where it stands."""


def literal(value: float | int | bool, kind: str) -> str:
    """A number as C reads it back without a loss."""
    if kind in ("int", "bool"):
        return str(int(value))
    number = float(value)
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0.0 else "(-INFINITY)"
    text = repr(number) if kind == "double" else str(np.float32(number))
    text = text if any(c in text for c in ".en") else text + ".0"
    text += "f" if kind == "float" else ""
    return f"({text})" if number < 0.0 or text.startswith("-") else text


@dataclass(frozen=True)
class Num:
    """A number: its kind, what computes it in C, and its value where that is known beforehand."""

    kind: str
    code: str
    value: float | None = None


@dataclass(frozen=True)
class Arr:
    """An array: kind of its elements, what points to its first one, shape (numbers, or names of C variables), strides."""

    kind: str
    code: str
    shape: tuple[int | str, ...]
    strides: tuple[int | str, ...]
    fixed: bool = False
    """A constant of the file, which need not be passed on."""
    root: str = ""
    """The argument of the function that it is, or lies in."""

    @classmethod
    def of(cls, kind: str, code: str, shape: Sequence[int | str], fixed: bool = False) -> Arr:
        """A contiguous array."""
        strides: list[int | str] = []
        step: int | str = 1
        for size in reversed(shape):
            strides.insert(0, step)
            step = _times(step, size)
        return cls(kind, code, tuple(shape), tuple(strides), fixed)


@dataclass(frozen=True)
class Rec:
    """A named tuple."""

    fields: Mapping[str, Value]


@dataclass(frozen=True)
class Tup:
    """Several values, as a function returns them."""

    items: tuple[Value, ...]


Value = Num | Arr | Rec | Tup


def _times(a: int | str, b: int | str) -> int | str:
    if isinstance(a, int) and isinstance(b, int):
        return a * b
    return b if a == 1 else a if b == 1 else f"({a} * {b})"


def _plus(a: str, b: str) -> str:
    return b if a == "0" else a if b == "0" else f"{a} + {b}"


def constant_of(value: Any) -> Num | None:
    """A Python or NumPy number as a value that is known beforehand; None for anything else."""
    if isinstance(value, bool | np.bool_):
        return Num("bool", literal(bool(value), "bool"), bool(value))
    if isinstance(value, int | np.integer):
        return Num("int", literal(int(value), "int"), int(value))
    if isinstance(value, float | np.floating):
        return Num("double", literal(float(value), "double"), float(value))
    return None


def _signature(value: Value) -> Any:
    """What a function is translated anew for."""
    match value:
        case Num(kind, _, known):
            return kind, known if known is None or known == known else "nan"
        case Arr(kind, code, shape, strides, fixed):
            return kind, shape, strides, code if fixed else ""
        case Rec(fields):
            return tuple((name, _signature(each)) for name, each in fields.items())
        case Tup(items):
            return tuple(map(_signature, items))


def _passed(value: Value, name: str, given: list[tuple[str, str]], handed: list[str]) -> Value:
    """The value as the called function knows it: what is not known beforehand becomes C parameters (`given`: type and name,
    `handed`: what the caller writes there)."""
    match value:
        case Num(kind, code, None):
            given.append((KINDS[kind] + " ", name))
            handed.append(code)
            return Num(kind, name)
        case Arr(kind, code, shape, _, False):
            given.append((KINDS[kind] + " *", name))
            handed.append(code)
            sizes: list[int | str] = []
            for n, size in enumerate(shape):
                if isinstance(size, str):  # known only when it runs
                    given.append(("int ", f"{name}_size{n}"))
                    handed.append(size)
                    size = f"{name}_size{n}"
                sizes.append(size)
            return replace(value, code=name, shape=tuple(sizes), root=name)
        case Rec(fields):
            return Rec({key: _passed(each, f"{name}_{key}", given, handed) for key, each in fields.items()})
        case Tup(items) if not all(isinstance(x, Num) and x.value is not None for x in items):
            raise TranslationError(f"{name}: a tuple of what is not known beforehand cannot be passed on")
    return value


@dataclass(frozen=True)
class Called:
    """A C function: its name, what it returns, what it is handed, which of its own array parameters it writes to, and which
    arguments of the calling function these lie in."""

    name: str
    result: Value | None
    handed: list[str]
    written: frozenset[str]
    roots: frozenset[str]


def _pairs(inner: Iterable[Value], outer: Iterable[Value]) -> Iterator[tuple[Arr, Arr]]:
    """The arrays of a call, as the called and as the calling function know them."""
    for one, other in zip(inner, outer, strict=True):
        if isinstance(one, Arr) and isinstance(other, Arr):
            yield one, other
        elif isinstance(one, Rec) and isinstance(other, Rec):
            yield from _pairs(one.fields.values(), other.fields.values())


@dataclass
class Translator:
    """Collects C functions and tables."""

    functions: dict[Any, tuple[str, Value | None, set[str], list[bool]]] = field(default_factory=dict)
    bodies: list[str] = field(default_factory=list)
    tables: dict[Any, str] = field(default_factory=dict)
    _names: dict[str, int] = field(default_factory=dict)

    def reserve(self, *names: str) -> None:
        """Names that C has already and a translated function must not get."""
        self._names |= dict.fromkeys(names, 1)

    def source(self, *users: str) -> str:
        """`users`, text in C, below the tables and functions that they need, callees first."""
        parts, words = list(users), set(_words(users))
        for text in reversed([*_HELPERS, *self.tables.values(), *self.bodies]):
            name = re.search(r"\w+(?=[\[(])", text)
            if name is not None and name[0] in words:
                parts.insert(0, text)
                words.update(_words([text]))
        return "\n".join(["#include <math.h>\n", *parts])

    def unused(self, name: str) -> str:
        """A name that no other function or table of the file has."""
        number = self._names[name] = self._names.get(name, 0) + 1
        return name if number == 1 else f"{name}_{number}"

    def table(self, array: Any, name: str = "table") -> Arr:
        """A constant array as one of the file."""
        array = np.asarray(array)
        kind = {"b": "bool", "i": "int", "u": "int"}.get(array.dtype.kind, "double")
        kind = "float" if array.dtype == np.float32 else kind
        key = (kind, array.tobytes(), array.shape)
        if key not in self.tables:
            given = self.unused(name)
            numbers = ", ".join(literal(x, kind) for x in array.reshape(-1).tolist())
            lines = textwrap.wrap(numbers, 120, break_long_words=False)
            joined = "\n    ".join(lines)
            self.tables[key] = f"static const {KINDS[kind]} {given}[{array.size}] = {{\n    {joined}}};\n"
        given = self.tables[key].split("[")[0].split()[-1]
        pointer = f"({KINDS[kind]} *){given}"
        return Arr.of(kind, pointer, array.shape, fixed=True)

    def call(self, function: Any, values: Sequence[Value]) -> Called:
        """The C function for values of these types."""
        handed: list[str] = []
        python = getattr(function, "py_func", function)
        key = (python, tuple(map(_signature, values)))
        given: list[tuple[str, str]] = []
        node = self._node(python)
        names = {
            a.arg: _passed(value, _safe(a.arg), given, handed)
            for a, value in zip(node.args.args, values, strict=True)
        }
        if key not in self.functions:
            body = _Body(self, python, node, names)
            lines = body.translate()
            words = set(_words(lines))
            kept = [each in words for _, each in given]
            name = self.unused(python.__name__.strip("_"))
            outs = body.outputs
            parameters = [f"{kind}{each}" for kind, each in compress(given, kept)] + [
                f"{KINDS[k]} *{n}" for k, n in outs
            ]
            returned = body.result
            kind = KINDS[returned.kind] if isinstance(returned, Num) else "void"
            head = f"static {kind} {name}({', '.join(parameters) or 'void'})"
            self.bodies.append("\n".join([head + " {", *("    " + line for line in lines), "}", ""]))
            self.functions[key] = name, returned, body.written, kept
        name, returned, written, kept = self.functions[key]
        roots = {inner.root: outer.root for inner, outer in _pairs(names.values(), values)}
        changed = frozenset(roots[each] for each in written)
        return Called(name, returned, list(compress(handed, kept)), frozenset(written), changed)

    def _node(self, function: Any) -> ast.FunctionDef:
        known = getattr(function, "__syntax__", None)
        if known is not None:
            return known
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        node = tree.body[0]
        assert isinstance(node, ast.FunctionDef)
        return node


_RESERVED = {"double", "float", "int", "long", "short", "char", "const", "static", "register", "volatile", "signed", "auto",
             "default", "switch", "case", "do", "goto", "union", "struct", "void", "inline", "restrict", "extern", "enum",
             "typedef", "sizeof", "y0", "y1", "yn", "j0", "j1", "jn", "gamma", "exp", "tanh", "sin", "cos"}  # fmt: skip


def _safe(name: str) -> str:
    """A Python name as C may use it: not a word of C, nor a function of its library."""
    return f"{name}_" if name in _RESERVED else name


class _Body:
    """The translation of one function for arguments of known types."""

    def __init__(
        self, whole: Translator, function: Any, node: ast.FunctionDef, names: dict[str, Value]
    ) -> None:
        self.whole, self.function, self.node, self.given = whole, function, node, names
        self.world: dict[str, Any] = getattr(function, "__globals__", {})
        self.kinds: dict[str, str] = {}
        self.outputs: list[tuple[str, str]] = []
        self.written: set[str] = set()
        self.result: Value | None = None
        stores = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        self.once = {name for name in stores if stores.count(name) == 1 and name not in names}

    def translate(self) -> list[str]:
        """The lines of the C function's body."""
        while True:  # until no variable has to be wider than it was thought to be
            before = dict(self.kinds)
            self.names = dict(self.given)
            self.declared: dict[str, str] = {}
            self.count, self.result, self.outputs = 0, None, []
            lines: list[str] = []
            for name, value in self.given.items():
                if isinstance(value, Num) and name in self._stored:
                    self._assign(name, value, lines)  # a variable of the function's own
            self.block(self.node.body, lines)
            if before == self.kinds:
                changing = {name for name, _, written, _ in self.whole.functions.values() if written}
                lines = without_unread(lines, changing)
                words = set(_words(lines))
                declared = [
                    (name, kind) for name, kind in self.declared.items() if name.split("[")[0] in words
                ]
                return [f"{kind}{name};" for name, kind in declared] + lines

    @property
    def _stored(self) -> set[str]:
        return {n.id for n in ast.walk(self.node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}

    def fail(self, node: ast.AST, why: str = "cannot be translated") -> TranslationError:
        return TranslationError(f"{self.function.__name__}: {ast.unparse(node).splitlines()[0]!r} {why}")

    def fresh(self, name: str) -> str:
        self.count += 1
        return f"{name}_{self.count}"

    # --- statements -------------------------------------------------------------------------------------------------
    def block(self, statements: Sequence[ast.stmt], lines: list[str]) -> None:
        for node in statements:
            self.statement(node, lines)

    def _inner(self, statements: Sequence[ast.stmt], lines: list[str]) -> None:
        inner: list[str] = []
        self.block(statements, inner)
        lines += ["    " + line for line in inner]

    def statement(self, node: ast.stmt, lines: list[str]) -> None:
        match node:
            case ast.Expr(ast.Constant()) | ast.Pass():
                pass
            case ast.Expr(ast.Call() as called):
                self._statement_call(called, lines)
            case ast.Assign(targets, value):
                self._assignment(targets, value, lines)
            case ast.AugAssign(target, operator, value):
                now = ast.BinOp(_loaded(target), operator, value)
                ast.copy_location(now, node)
                self._store(target, self.value(now, lines), lines)
            case ast.If(test, body, orelse):
                self._if(test, body, orelse, lines)
            case ast.For(target, over, body, []):
                self._for(target, over, body, lines)
            case ast.Continue():
                lines.append("continue;")
            case ast.Break():
                lines.append("break;")
            case ast.Return(value):
                self._return(value, lines)
            case _:
                raise self.fail(node)

    def _statement_call(self, called: ast.Call, lines: list[str]) -> None:
        result = self.value(called, lines)
        if isinstance(result, Num):
            lines.append(f"{result.code};")

    def _if(self, test: ast.expr, body: list[ast.stmt], orelse: list[ast.stmt], lines: list[str]) -> None:
        chosen = self.number(test, lines)
        if chosen.value is not None:
            self.block(body if chosen.value else orelse, lines)
            return
        lines.append(f"if ({bare(chosen.code)}) {{")
        self._inner(body, lines)
        if orelse:
            lines.append("} else {")
            self._inner(orelse, lines)
        lines.append("}")

    def _for(self, target: ast.expr, over: ast.expr, body: list[ast.stmt], lines: list[str]) -> None:
        match over:
            case ast.Call(ast.Name("range"), bounds):
                numbers = [self.number(bound, lines) for bound in bounds]
                assert isinstance(target, ast.Name)
                start = numbers[0] if len(numbers) > 1 else Num("int", "0", 0)
                stop = numbers[min(1, len(numbers) - 1)]
                step = numbers[2].value if len(numbers) > 2 else 1
                if stop.value is not None and stop.value <= 0 and start.value == 0:
                    return
                name = self.fresh("n") if target.id == "_" else self._variable(target.id, "int")
                if target.id == "_":
                    self.declared[name] = "int "
                sign, change = ("<", "++") if step == 1 else (">", "--")
                if step not in (1, -1):
                    raise self.fail(over, "has a step that is not 1 or -1")
                lines.append(f"for ({name} = {start.code}; {name} {sign} {stop.code}; {name}{change}) {{")
                self._inner(body, lines)
                lines.append("}")
            case ast.Tuple(items):
                for item in items:
                    self._assignment([target], item, lines)
                    self.block(body, lines)
            case _:
                array = self.value(over, lines)
                if not isinstance(array, Arr) or not isinstance(target, ast.Name):
                    raise self.fail(over)
                at = self.fresh("at")
                self.declared[at] = "int "
                lines.append(f"for ({at} = 0; {at} < {array.shape[0]}; {at}++) {{")
                inner: list[str] = []
                self._assign(target.id, self._element(array, [Num("int", at)]), inner)
                lines += ["    " + line for line in inner]
                self._inner(body, lines)
                lines.append("}")

    def _return(self, node: ast.expr | None, lines: list[str]) -> None:
        if node is None:
            lines.append("return;")
            return
        if isinstance(node, ast.Tuple):
            values = [self.number(each, lines) for each in node.elts]
            if not self.outputs:
                self.outputs = [(each.kind, f"out_{n}") for n, each in enumerate(values)]
            self.outputs = [(_wider(a, b.kind), n) for (a, n), b in zip(self.outputs, values, strict=True)]
            self.result = Tup(tuple(Num(kind, name) for kind, name in self.outputs))
            # What is returned may read what an output is: all of it is computed first.
            held = []
            for each in values:
                name = self.fresh("returned")
                self.declared[name] = KINDS[each.kind] + " "
                lines.append(f"{name} = {each.code};")
                held.append(name)
            lines += [f"*{name} = {value};" for (_, name), value in zip(self.outputs, held, strict=True)]
            lines.append("return;")
            return
        value = self.number(node, lines)
        kind = _wider(self.result.kind, value.kind) if isinstance(self.result, Num) else value.kind
        self.result = Num(kind, "")
        lines.append(f"return {bare(value.code)};")

    def _assignment(self, targets: list[ast.expr], node: ast.expr, lines: list[str]) -> None:
        first = targets[0]
        if isinstance(first, ast.Tuple) and isinstance(node, ast.Tuple) and len(targets) == 1:
            read = {n.id for each in node.elts[1:] for n in ast.walk(each) if isinstance(n, ast.Name)}
            stored = {each.id if isinstance(each, ast.Name) else "" for each in first.elts}
            if stored & {*read, ""}:  # what is stored first may be read by what comes after
                values = [self._held(self.value(each, lines), lines) for each in node.elts]
                for target, value in zip(first.elts, values, strict=True):
                    self._store(target, value, lines)
            else:
                for target, each in zip(first.elts, node.elts, strict=True):
                    self._store(target, self.value(each, lines), lines)
            return
        value = self.value(node, lines)
        if len(targets) > 1:
            value = self._held(value, lines)
        for target in targets:
            self._store(target, value, lines)

    def _held(self, value: Value, lines: list[str]) -> Value:
        """The value in a variable of its own, so that what it is computed from may change."""
        if not isinstance(value, Num) or value.value is not None:
            return value
        name = self.fresh("held")
        self.declared[name] = KINDS[value.kind] + " "
        lines.append(f"{name} = {bare(value.code)};")
        return Num(value.kind, name)

    def _store(self, target: ast.expr, value: Value, lines: list[str]) -> None:
        match target:
            case ast.Name("_"):
                pass
            case ast.Name(name):
                self._assign(name, value, lines)
            case ast.Subscript(base, index):
                array = self.value(base, lines)
                if isinstance(array, Arr) and array.root:
                    self.written.add(array.root)
                place = self._subscript(array, index, lines, target)
                if isinstance(place, Arr):
                    self._copy(place, value, target, lines)
                elif isinstance(place, Num) and isinstance(value, Num):
                    lines.append(f"{place.code} = {bare(value.code)};")
                else:
                    raise self.fail(target)
            case ast.Tuple(parts) if isinstance(value, Tup):
                for part, each in zip(parts, value.items, strict=True):
                    self._store(part, each, lines)
            case ast.Tuple(parts) if isinstance(value, Arr) and value.shape[0] == len(parts):
                for n, part in enumerate(parts):
                    self._store(part, self._element(value, [Num("int", str(n), n)]), lines)
            case _:
                raise self.fail(target)

    def _variable(self, name: str, kind: str) -> str:
        """A C variable of this kind at least."""
        kind = self.kinds[name] = _wider(self.kinds.get(name, kind), kind)
        own = f"{_safe(name)}_own" if name in self.given else _safe(name)
        self.declared[own] = KINDS[kind] + " "
        self.names[name] = Num(kind, own)
        return own

    def _assign(self, name: str, value: Value, lines: list[str]) -> None:
        match value:
            case Num(_, _, known) if known is not None and name in self.once:
                self.names[name] = value
            case Num(kind, code, _):
                own = self._variable(name, kind)
                lines.append(f"{own} = {bare(code)};")
            case Arr(kind, code, _, _, fixed):
                if fixed or code.isidentifier():
                    self.names[name] = value
                    return
                own = _safe(name)
                self.declared[own] = f"{KINDS[kind]} *"
                self.names[name] = replace(value, code=own)
                lines.append(f"{own} = {code};")
            case _:
                self.names[name] = value

    def _copy(self, place: Arr, value: Value, node: ast.AST, lines: list[str]) -> None:
        """place[...] = value, element by element."""
        indices = []
        for depth, size in enumerate(place.shape):
            at = self.fresh("i")
            self.declared[at] = "int "
            indices.append(Num("int", at))
            lines.append("    " * depth + f"for ({at} = 0; {at} < {size}; {at}++)")
        to = self._element(place, indices)
        if isinstance(value, Arr):
            own = indices[len(indices) - len(value.shape) :]
            value = self._element(value, own)
        if not isinstance(value, Num) or not isinstance(to, Num):
            raise self.fail(node)
        lines.append("    " * len(indices) + f"{to.code} = {bare(value.code)};")

    # --- expressions ------------------------------------------------------------------------------------------------
    def number(self, node: ast.expr, lines: list[str]) -> Num:
        value = self.value(node, lines)
        if not isinstance(value, Num):
            raise self.fail(node, "is no number")
        return value

    def value(self, node: ast.expr, lines: list[str]) -> Value:
        """The value of an expression; what has to be computed before goes to `lines`."""
        match node:
            case ast.Constant(value):
                found = constant_of(value)
                if found is None:
                    raise self.fail(node)
                return found
            case ast.Name(name):
                return self._name(name, node)
            case ast.Attribute():
                return self._attribute(node, lines)
            case ast.Subscript(base, index):
                return self._subscript(self.value(base, lines), index, lines, node)
            case ast.BinOp(left, operator, right):
                return self._binary(node, operator, self.number(left, lines), right, lines)
            case ast.BoolOp(operator, parts):
                return self._logic(isinstance(operator, ast.And), [self.number(p, lines) for p in parts])
            case ast.UnaryOp(ast.USub(), operand):
                one = self.number(operand, lines)
                known = None if one.value is None else -one.value
                code = f"(-{one.code})" if known is None else literal(known, one.kind)
                return Num(one.kind, code, known)
            case ast.UnaryOp(ast.Not(), operand):
                one = self.number(operand, lines)
                return Num("bool", f"(!{one.code})", None if one.value is None else not one.value)
            case ast.Compare(left, operators, others):
                return self._comparison(left, operators, others, lines)
            case ast.IfExp():
                return self._choice(node, lines)
            case ast.Call():
                return self._call(node, lines)
            case ast.Tuple(items):
                return Tup(tuple(self.value(each, lines) for each in items))
        raise self.fail(node)

    def _name(self, name: str, node: ast.AST) -> Value:
        if name in self.names:
            return self.names[name]
        if name in self.world:
            return self._world(self.world[name], name, node)
        raise self.fail(node, "is not known")

    def _world(self, value: Any, name: str, node: ast.AST) -> Value:
        """A global of the function's module."""
        found = constant_of(value)
        if found is not None:
            return found
        if isinstance(value, np.ndarray | tuple):
            return self.whole.table(value, name.lower())
        raise self.fail(node, "is not a number or array")

    def _attribute(self, node: ast.Attribute, lines: list[str]) -> Value:
        base = self.value(node.value, lines)
        if isinstance(base, Rec) and node.attr in base.fields:
            return base.fields[node.attr]
        if isinstance(base, Arr) and node.attr == "size":
            size: int | str = 1
            for each in base.shape:
                size = _times(size, each)
            return _whole(size)
        if isinstance(base, Arr) and node.attr == "shape":
            return Tup(tuple(_whole(size) for size in base.shape))
        raise self.fail(node)

    def _subscript(self, base: Value, index: ast.expr, lines: list[str], node: ast.AST) -> Value:
        if isinstance(base, Tup):
            at = self.number(index, lines)
            if at.value is None:
                raise self.fail(node)
            return base.items[int(at.value)]
        if not isinstance(base, Arr):
            raise self.fail(node)
        indices: list[Num | slice] = []
        for each in index.elts if isinstance(index, ast.Tuple) else [index]:
            if isinstance(each, ast.Slice):
                ends = [None if end is None else self.number(end, lines) for end in (each.lower, each.upper)]
                if each.step is not None:
                    raise self.fail(node)
                indices.append(slice(*ends))
            else:
                indices.append(self.number(each, lines))
        return self._element(base, indices)

    def _element(self, base: Arr, indices: Sequence[Num | slice]) -> Value:
        """base[indices]: a number, or a view."""
        offset, shape, strides = "0", [], []
        for n, size in enumerate(base.shape):
            stride = base.strides[n]
            each = indices[n] if n < len(indices) else slice(None, None)
            if isinstance(each, Num):
                at: int | str = each.code
                if each.value is not None:
                    at = int(each.value)
                    if at < 0:
                        at = f"({size} - {-at})" if isinstance(size, str) else size + at
                elif not each.code.isidentifier():
                    at = f"({bare(each.code)})"
                offset = _plus(offset, str(_times(at, stride)))
            else:
                first = 0 if each.start is None else int(each.start.value)
                last = size if each.stop is None else int(each.stop.value)
                offset = _plus(offset, str(_times(first, stride)))
                shape.append(last - first if isinstance(last, int) else last)
                strides.append(stride)
        if shape:
            code = base.code if offset == "0" else f"({base.code} + {offset})"
            return replace(
                base,
                code=code,
                shape=tuple(shape),
                strides=tuple(strides),
                fixed=base.fixed and offset == "0",
            )
        pointer = base.code if base.code.isidentifier() else f"({base.code})"
        return Num(base.kind, f"{pointer}[{offset}]")

    def _binary(
        self, node: ast.AST, operator: ast.operator, left: Num, right_node: ast.expr, lines: list[str]
    ) -> Num:
        right = self.number(right_node, lines)
        kind = _wider(left.kind, right.kind)
        if isinstance(operator, ast.BitAnd | ast.BitOr):
            return Num(
                "bool", f"({left.code} {'&' if isinstance(operator, ast.BitAnd) else '|'} {right.code})"
            )
        if isinstance(operator, ast.Pow):
            return self._power(node, left, right, lines)
        kind = "int" if kind == "bool" else kind
        known = None
        if left.value is not None and right.value is not None:
            known = _computed(operator, left.value, right.value)
        if isinstance(operator, ast.Div):
            kind = "double" if kind == "int" else kind
        if known is not None:
            return Num(kind, literal(known, kind), known)
        if isinstance(operator, ast.FloorDiv | ast.Mod) and kind == "int":
            name = "py_div" if isinstance(operator, ast.FloorDiv) else "py_mod"
            return Num("int", f"{name}({left.code}, {right.code})")
        if type(operator) not in _ARITHMETIC:
            raise self.fail(node)
        first = f"(double){left.code}" if isinstance(operator, ast.Div) and left.kind == "int" else left.code
        return Num(kind, f"({first} {_ARITHMETIC[type(operator)]} {right.code})")

    def _logic(self, both: bool, parts: list[Num]) -> Num:
        """`and` or `or` of numbers; what is known beforehand decides or drops out."""
        if any(part.value is not None and bool(part.value) is not both for part in parts):
            return Num("bool", str(int(not both)), not both)
        left = [part.code for part in parts if part.value is None]
        if not left:
            return Num("bool", str(int(both)), both)
        return Num("bool", f"({(' && ' if both else ' || ').join(left)})")

    def _power(self, node: ast.AST, base: Num, power: Num, lines: list[str]) -> Num:
        if power.value is None or power.value != int(power.value) or not 1 <= power.value <= 8:
            raise self.fail(node, "has a power that is no whole number")
        held = self._held(base, lines)
        assert isinstance(held, Num)
        if held.value is not None:
            known = held.value ** int(power.value)
            return Num(held.kind, literal(known, held.kind), known)
        return Num(base.kind, f"({' * '.join([held.code] * int(power.value))})")

    def _comparison(
        self, left: ast.expr, operators: Sequence[ast.cmpop], others: Sequence[ast.expr], lines: list[str]
    ) -> Num:
        parts, first, known = [], self.number(left, lines), None
        for operator, other in zip(operators, others, strict=True):
            second = self.number(other, lines)
            parts.append(f"{first.code} {_COMPARED[type(operator)]} {second.code}")
            if first.value is not None and second.value is not None and len(operators) == 1:
                known = bool(eval(parts[0], {"INFINITY": math.inf}))
            first = second
        if known is not None:
            return Num("bool", str(int(known)), known)
        return Num("bool", f"({' && '.join(parts)})")

    def _choice(self, node: ast.IfExp, lines: list[str]) -> Value:
        test, body, orelse = node.test, node.body, node.orelse
        chosen = self.number(test, lines)
        if chosen.value is not None:
            return self.value(body if chosen.value else orelse, lines)
        one, other = self.value(body, lines), self.value(orelse, lines)
        if isinstance(one, Tup) and isinstance(other, Tup):
            held = self._held(chosen, lines)
            assert isinstance(held, Num)
            return Tup(
                tuple(self._either(held, a, b, node) for a, b in zip(one.items, other.items, strict=True))
            )
        return self._either(chosen, one, other, node)

    def _either(self, chosen: Num, first: Value, second: Value, node: ast.AST) -> Num:
        if not isinstance(first, Num) or not isinstance(second, Num):
            raise self.fail(node, "is no number")
        return Num(_wider(first.kind, second.kind), f"({chosen.code} ? {first.code} : {second.code})")

    # --- calls ------------------------------------------------------------------------------------------------------
    def _call(self, node: ast.Call, lines: list[str]) -> Value:
        name = ast.unparse(node.func)
        own = self.world.get(name)
        short = name.removeprefix("np.").removeprefix("math.")
        if (
            name in self.world
            and callable(own)
            and hasattr(own, "__code__")
            and name not in ("floor", "sqrt")
        ):
            return self._function(own, node.args, lines)
        if hasattr(own, "py_func"):
            return self._function(own, node.args, lines)
        if short in ("empty", "zeros"):
            return self._local(node, lines, zero=short == "zeros")
        if short == "argmin":
            array = self.value(node.args[0], lines)
            if not isinstance(array, Arr) or array.strides != (1,):
                raise self.fail(node)
            return Num("int", f"py_argmin({array.code}, {array.shape[0]})")
        values = [self.number(each, lines) for each in node.args]
        kind = values[0].kind
        for each in values[1:]:
            kind = _wider(kind, each.kind)
        codes = [each.code for each in values]
        match short:
            case "cells.dtype.type" | "float" | "float64":
                return Num("double", codes[0] if kind == "double" else f"(double){codes[0]}", values[0].value)
            case "int":
                return Num("int", f"(int){codes[0]}")
            case "bool":
                return Num("bool", f"({codes[0]} != 0)")
            case "abs":
                return Num(
                    kind,
                    f"fabs({bare(codes[0])})"
                    if kind == "double"
                    else f"({codes[0]} < 0 ? -{codes[0]} : {codes[0]})",
                )
            case "min" | "max":
                function = f"py_{short}" + ("_int" if kind in ("int", "bool") else "")
                code = codes[0]
                for other in codes[1:]:
                    code = f"{function}({bare(code)}, {bare(other)})"
                return Num(kind, code)
            case "sign":
                return Num("double", f"py_sign({bare(codes[0])})")
            case _ if short in _MATH:
                return Num("double", f"{_MATH[short]}({', '.join(map(bare, codes))})")
        raise self.fail(node)

    def _function(self, function: Any, arguments: Sequence[ast.expr], lines: list[str]) -> Value:
        values = [self.value(each, lines) for each in arguments]
        called = self.whole.call(function, values)
        self.written |= called.roots - {""}
        name, result, handed = called.name, called.result, called.handed
        if isinstance(result, Num):
            return Num(result.kind, f"{name}({', '.join(map(bare, handed))})")
        if isinstance(result, Tup):
            made = []
            for each in result.items:
                assert isinstance(each, Num)
                own = self.fresh("result")
                self.declared[own] = KINDS[each.kind] + " "
                made.append(Num(each.kind, own))
            handed = handed + [f"&{each.code}" for each in made]
            lines.append(f"{name}({', '.join(map(bare, handed))});")
            return Tup(tuple(made))
        lines.append(f"{name}({', '.join(map(bare, handed))});")
        return Tup(())

    def _local(self, node: ast.Call, lines: list[str], zero: bool) -> Arr:
        """An array on the stack."""
        shape = self.value(node.args[0], lines)
        sizes = shape.items if isinstance(shape, Tup) else (shape,)
        known = [each.value if isinstance(each, Num) else None for each in sizes]
        if any(each is None for each in known):
            raise self.fail(node, "has a size that is not known beforehand")
        kind = "double"
        if len(node.args) > 1:
            kind = (
                "int"
                if "int" in ast.unparse(node.args[1])
                else "bool"
                if "bool" in ast.unparse(node.args[1])
                else "double"
            )
        name = self.fresh("room")
        sizes_known = [int(each) for each in known if each is not None]
        total = math.prod(sizes_known)
        self.declared[f"{name}[{total}]"] = KINDS[kind] + " "
        array = Arr.of(kind, name, sizes_known)
        if zero:
            self._copy(array, Num(kind, literal(0, kind)), node, lines)
        return array


def _computed(operator: ast.operator, a: float, b: float) -> float | None:
    match operator:
        case ast.Add():
            return a + b
        case ast.Sub():
            return a - b
        case ast.Mult():
            return a * b
        case ast.Div():
            return a / b if b else None
        case ast.FloorDiv():
            return a // b if b else None
        case ast.Mod():
            return a % b if b else None
    return None


def _whole(size: int | str) -> Num:
    return Num("int", str(size), size if isinstance(size, int) else None)


def _wider(a: str, b: str) -> str:
    return a if _WIDTH[a] >= _WIDTH[b] else b


def bare(code: str) -> str:
    """A C expression without the parentheses around the whole of it."""
    if not (code.startswith("(") and code.endswith(")")):
        return code
    depth = 0
    for n, c in enumerate(code):
        depth += (c == "(") - (c == ")")
        if depth == 0 and n < len(code) - 1:
            return code
    return code[1:-1]


def _words(texts: Iterable[str]) -> list[str]:
    return re.findall(r"\w+", "\n".join(texts))


def without_unread(lines: list[str], changing: Collection[str] = ()) -> list[str]:
    """Lines of C without assignments to variables that nothing reads, unless they call a function that is `changing` arrays."""
    while True:
        stores = [_ASSIGNED.fullmatch(line) for line in lines]
        reads = Counter(_words(lines))
        reads.subtract(store[1] for store in stores if store)
        kept = [
            line for line, store in zip(lines, stores, strict=True)
            if not store or reads[store[1]] or not set(_words([store[2]])).isdisjoint(changing)
        ]  # fmt: skip
        if len(kept) == len(lines):
            return lines
        lines = kept


def identifier(text: str) -> str:
    """A name of a user's as C, IEC 61131-3 and FMI know names: ASCII, and no underscores at its ends or side by side."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    name = re.sub(r"[^0-9A-Za-z]+", "_", plain).strip("_")
    return name if name[:1].isalpha() else f"x_{name}".rstrip("_")


def _loaded(target: ast.expr) -> ast.expr:
    """The target of an assignment as a value."""
    again = ast.parse(ast.unparse(target), mode="eval").body
    return again


def plain_functions(text: str) -> dict[str, Any]:
    """The namespace of a generated module as plain Python: its functions without their decorators."""
    tree = ast.parse(text)
    kept = [
        n
        for n in tree.body
        if not (isinstance(n, ast.ImportFrom) and (n.module or "").startswith("hydro_env"))
    ]
    for node in kept:
        if isinstance(node, ast.FunctionDef):
            node.decorator_list = []
    tree.body = kept
    space: dict[str, Any] = {}
    exec(compile(tree, "<plain>", "exec"), space)
    for node in kept:
        if isinstance(node, ast.FunctionDef):
            space[node.name].__syntax__ = node
    return space
