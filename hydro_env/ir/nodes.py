"""Typed expressions, statements and functions: what is left of Python source once names, types and shapes are known."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

#: Kinds of numbers, from the narrowest to the widest; "float" is in single precision.
KINDS = ("bool", "int", "float", "double")
_COMPARED = ("lt", "le", "gt", "ge", "eq", "ne")


class Expr:
    """A number of a kind: an operation on others.

    `op` is "const" (`value`), "var" (`value`: its name), "load" (an element of the array `value` at the index `args[0]`),
    "address" (of that element), "call" (of the function `value`), or an operation: "add", "sub", "mul", "div", "floordiv", "mod",
    "neg", "and", "or", "not", "lt", "le", "gt", "ge", "eq", "ne", "where" (test, then, else), "cast", "min", "max", "abs",
    "sign", "argmin" (of the elements from an address on, and how many), or a function of the mathematical library.
    """

    __slots__ = ("args", "kind", "op", "value")

    def __init__(self, op: str, kind: str, args: tuple[Any, ...] = (), value: Any = None) -> None:
        self.op, self.kind, self.args, self.value = op, kind, args, value

    @property
    def known(self) -> Any:
        """Its value, where that is known beforehand; else None."""
        return self.value if self.op == "const" else None


def const(value: Any, kind: str) -> Expr:
    """A number that is known."""
    made = {"bool": bool, "int": int}.get(kind, float)(value)
    return Expr("const", kind, (), made)


def var(name: str, kind: str) -> Expr:
    """A variable."""
    return Expr("var", kind, (), name)


def wider(*kinds: str) -> str:
    """The widest of some kinds."""
    return max(kinds, key=KINDS.index)


def cast(x: Expr, kind: str) -> Expr:
    """The number in another kind."""
    if x.kind == kind:
        return x
    if x.op == "const":
        return const(x.value, kind)
    return Expr("cast", kind, (x,))


def op(name: str, *args: Expr, kind: str = "") -> Expr:
    """An operation on numbers, which get the same kind first."""
    if name in ("and", "or", "not"):
        return Expr(name, "bool", tuple(cast(x, "bool") for x in args))
    common = kind or wider(*(x.kind for x in args))
    if common == "bool" and name not in _COMPARED:
        common = "int"
    return Expr(name, "bool" if name in _COMPARED else common, tuple(cast(x, common) for x in args))


def add(a: Expr, b: Expr) -> Expr:
    """The sum of two whole numbers."""
    if a.known == 0 or b.known == 0:
        return b if a.known == 0 else a
    return const(a.known + b.known, "int") if None not in (a.known, b.known) else op("add", a, b)


def mul(a: Expr, b: Expr) -> Expr:
    """The product of two whole numbers."""
    if a.known == 1 or b.known == 1:
        return b if a.known == 1 else a
    return const(a.known * b.known, "int") if None not in (a.known, b.known) else op("mul", a, b)


# --- statements ---------------------------------------------------------------------------------------------------------
@dataclass
class Assign:
    """name = value."""

    name: str
    value: Expr


@dataclass
class Store:
    """array[index] = value."""

    array: str
    index: Expr
    value: Expr


@dataclass
class If:
    test: Expr
    body: "list[Statement]"
    orelse: "list[Statement]" = field(default_factory=list)


@dataclass
class For:
    """for name from `start` to before `stop`, by `step`, which is 1 or -1."""

    name: str
    start: Expr
    stop: Expr
    step: int
    body: "list[Statement]"


@dataclass
class Run:
    """A call of a function for what it writes."""

    call: Expr


@dataclass
class Return:
    value: Expr | None


@dataclass
class Jump:
    """`break` or `continue`."""

    word: str


Statement = Assign | Store | If | For | Run | Return | Jump


@dataclass
class Table:
    """A constant array."""

    name: str
    kind: str
    numbers: list[Any]


@dataclass
class Function:
    """A function: `parameters` as (name, kind, whether it is an array); `variables` by name with their kind and size,
    0 but for arrays; `result`: the kind of what it returns, "" for nothing; `written`: parameters that it writes to."""

    name: str
    parameters: list[tuple[str, str, bool]]
    variables: dict[str, tuple[str, int]]
    body: list[Statement]
    result: str
    written: set[str]


def _walk(body: Iterable[Statement]) -> Iterator[Statement]:
    """All statements, also those inside of others."""
    for each in body:
        yield each
        if isinstance(each, If | For):
            yield from _walk([*each.body, *getattr(each, "orelse", ())])


def _inside(expressions: Iterable[Expr]) -> Iterator[Expr]:
    stack = list(expressions)
    while stack:
        x = stack.pop()
        yield x
        stack += x.args


def names_read(body: Iterable[Statement]) -> Counter[str]:
    """How often variables, arrays and functions are read or called; arrays also where they are written to."""
    found: Counter[str] = Counter()
    for each in _walk(body):
        inside = _inside(x for x in vars(each).values() if isinstance(x, Expr))
        found.update(x.value for x in inside if x.op in ("var", "load", "address", "call"))
        if isinstance(each, Store):
            found[each.array] += 1
    return found


def without_unread(
    body: list[Statement], declared: dict[str, tuple[str, int]], changing: set[str]
) -> tuple[list[Statement], dict[str, tuple[str, int]]]:
    """Statements without assignments to variables that nothing reads, unless they call a function that is `changing` arrays; and
    the declared variables that are left."""
    read = names_read(body)
    kept = _kept(body, read, changing)
    if sum(1 for _ in _walk(kept)) < sum(1 for _ in _walk(body)):
        return without_unread(kept, declared, changing)
    used = {each.name for each in _walk(kept) if isinstance(each, Assign | For)} | set(+read)
    return kept, {name: kind for name, kind in declared.items() if name in used}


def _kept(body: list[Statement], read: Counter[str], changing: set[str]) -> list[Statement]:
    kept: list[Statement] = []
    for each in body:
        match each:
            case Assign(name, value) if not read[name]:
                if any(x.op == "call" and x.value in changing for x in _inside([value])):
                    kept.append(each)
            case _:
                parts = [part for part in ("body", "orelse") if hasattr(each, part)]
                inner: dict[str, Any] = {part: _kept(getattr(each, part), read, changing) for part in parts}
                kept.append(replace(each, **inner))
    return kept
