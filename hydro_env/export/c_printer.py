"""Typed statements (`hydro_env.ir`) as C99.

The result is the same as in Python bit for bit as long as the C compiler fuses and reorders nothing (`-std=c99`, or
`-ffp-contract=off`). It needs nothing but math.h.
"""

import math
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator

import numpy as np

from ..ir.nodes import Assign, Expr, For, Function, If, Jump, Return, Run, Statement, Store, Table
from ..ir.reader import Reader
from .templates import template

#: C types of kinds of numbers.
TYPES = {"bool": "int", "int": "int", "float": "float", "double": "double"}
#: How operations on two numbers are written between them.
BINARY = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=",
    "and": "&&", "or": "||",
}  # fmt: skip
#: How operations are written, as `filled` takes it; others are functions of the mathematical library.
_FORMS = {
    **{op: f"({{0}} {sign} {{1}})" for op, sign in BINARY.items()},
    **{op: f"py_{op}({{inside}})" for op in ("mod", "min", "max", "sign", "argmin")},
    "neg": "(-{0})", "not": "(!{0})", "where": "({0} ? {1} : {2})", "load": "{value}[{inside}]", "call": "{value}({inside})",
    "floordiv": "py_div({inside})", "address": "&{value}[{inside}]", "cast": "({type}){0}",
}  # fmt: skip
#: The same of whole numbers, of truths, and in single precision.
_FORMS_OF_KIND = {
    ("min", "int"): "py_min_int({inside})", ("max", "int"): "py_max_int({inside})", ("abs", "int"): "py_abs_int({inside})",
    ("abs", "float"): "fabsf({inside})", ("abs", "double"): "fabs({inside})", ("cast", "bool"): "({0} != 0)",
}  # fmt: skip
#: Words of C, and functions of its library, that are no names.
RESERVED = frozenset((
    "double", "float", "int", "long", "short", "char", "const", "static", "register", "volatile", "signed", "auto", "default",
    "switch", "case", "do", "goto", "union", "struct", "void", "inline", "restrict", "extern", "enum", "typedef", "sizeof",
    "y0", "y1", "yn", "j0", "j1", "jn", "gamma", "exp", "tanh", "sin", "cos",
))  # fmt: skip
#: Python's `%` and `//` of whole numbers, its `min` and `max`, and the like.
_HELPERS = [f"{each}\n" for each in template("helpers.c").template.rstrip().split("\n\n")]


def literal(value: float | int | bool, kind: str) -> str:
    """A number as C reads it back without a loss."""
    if kind in ("int", "bool"):
        return str(int(value)) if value >= 0 else f"({int(value)})"
    number = float(value)
    if math.isnan(number):
        return "NAN"
    if math.isinf(number):
        return "INFINITY" if number > 0.0 else "(-INFINITY)"
    text = repr(number) if kind == "double" else str(np.float32(number))
    text = text if any(c in text for c in ".en") else text + ".0"
    text += "f" if kind == "float" else ""
    return f"({text})" if text.startswith("-") else text


def bare(code: str) -> str:
    """An expression without the parentheses around the whole of it."""
    if not (code.startswith("(") and code.endswith(")")):
        return code
    depth = 0
    for n, c in enumerate(code):
        depth += (c == "(") - (c == ")")
        if depth == 0 and n < len(code) - 1:
            return code
    return code[1:-1]


def identifier(text: str) -> str:
    """A name of a user's as C, IEC 61131-3 and FMI know names: ASCII, and no underscores at its ends or side by side."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    name = re.sub(r"[^0-9A-Za-z]+", "_", plain).strip("_")
    return name if name[:1].isalpha() else f"x_{name}".rstrip("_")


# --- expressions ------------------------------------------------------------------------------------------------------
def filled(form: str, x: Expr, operands: Iterable[str], **more: str) -> str:
    """The form of an operation with its operands: `{0}`, ... in parentheses where they need them, `{bare[0]}`, ... without,
    `{inside}`: all of these."""
    texts = list(operands)
    plain = list(map(bare, texts))
    return form.format(*texts, bare=plain, inside=", ".join(plain), value=x.value, **more)


def expression(x: Expr) -> str:
    """An expression, in parentheses where it needs them."""
    if x.op == "const":
        return literal(x.value, x.kind)
    if x.op == "var":
        return str(x.value)
    if x.op == "address" and (not x.args or x.args[0].known == 0):
        return f"&{x.value}" if not x.args else str(x.value)
    function = f"{x.op}{'f' * (x.kind == 'float')}({{inside}})"
    form = _FORMS_OF_KIND.get((x.op, x.kind)) or _FORMS.get(x.op, function)
    return filled(form, x, map(expression, x.args), type=TYPES[x.kind])


# --- statements -------------------------------------------------------------------------------------------------------
def statements(body: Iterable[Statement]) -> list[str]:
    """The lines of statements."""
    return [line for each in body for line in _statement(each)]


def _block(head: str, body: Iterable[Statement]) -> list[str]:
    return [f"{head} {{", *("    " + line for line in statements(body)), "}"]


def _statement(each: Statement) -> list[str]:
    match each:
        case Assign(name, value):
            return [f"{name} = {bare(expression(value))};"]
        case Store(array, index, value):
            return [f"{array}[{bare(expression(index))}] = {bare(expression(value))};"]
        case If(test, body, []):
            return _block(f"if ({bare(expression(test))})", body)
        case If(test, body, orelse):
            return [*_block(f"if ({bare(expression(test))})", body)[:-1], *_block("} else", orelse)]
        case For(name, start, stop, step, body):
            sign, change = ("<", "++") if step == 1 else (">", "--")
            limit = bare(expression(stop))
            head = f"for ({name} = {bare(expression(start))}; {name} {sign} {limit}; {name}{change})"
            return _block(head, body)
        case Run(call):
            return [f"{expression(call)};"]
        case Return(value):
            return ["return;" if value is None else f"return {bare(expression(value))};"]
        case Jump(word):
            return [f"{word};"]


def variables(declared: dict[str, tuple[str, int]]) -> Iterator[str]:
    """The declarations of variables, by name with their kind and, for arrays, their size."""
    for type_ in dict.fromkeys(TYPES.values()):
        mine = {name: size for name, (kind, size) in declared.items() if TYPES[kind] == type_}
        own = [f"{name}[{size}]" if size else name for name, size in mine.items()]
        if own:
            yield from textwrap.wrap(f"{type_} {', '.join(own)};", 120)


def _function(made: Function) -> str:
    parameters = ", ".join(
        f"{'const ' * (array and name not in made.written)}{TYPES[kind]} {'*' * array}{name}"
        for name, kind, array in made.parameters
    )
    head = f"static {TYPES.get(made.result, 'void')} {made.name}({parameters or 'void'}) {{"
    lines = ["    " + line for line in (*variables(made.variables), *statements(made.body))]
    return "\n".join([head, *lines, "}", ""])


def _table(table: Table) -> str:
    lines = listed(bare(literal(x, table.kind)) for x in table.numbers)
    return f"static const {TYPES[table.kind]} {table.name}[{len(table.numbers)}] = {{\n    {lines}}};\n"


def listed(numbers: Iterable[str]) -> str:
    """Numbers with commas between them, in lines."""
    return "\n    ".join(textwrap.wrap(", ".join(numbers), 120, break_long_words=False))


def source(reader: Reader, *users: str) -> str:
    """`users`, text in C, below the tables and functions that they need, callees first."""
    tables, functions = map(_table, reader.tables.values()), map(_function, reader.functions.values())
    parts, words = list(users), set(re.findall(r"\w+", "\n".join(users)))
    for text in reversed([*_HELPERS, *tables, *functions]):
        name = re.search(r"\w+(?=[\[(])", text)
        if name is not None and name[0] in words:
            parts.insert(0, text)
            words.update(re.findall(r"\w+", text))
    return "\n".join(["#include <math.h>\n", *parts])
