"""A traced controller as a function block in Structured Text (IEC 61131-3, third edition).

Only what every system has is used: LREAL, REAL, INT, BOOL, arrays, IF, FOR, and the standard functions ABS, EXP, SQRT, SEL, MIN,
MAX, LREAL_TO_REAL and the like. What the standard lacks (tanh) is made of EXP. The state lies in the block's VAR.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator

import numpy as np

from hydro_env import __version__
from hydro_env.controllers.input_guard import HOLD, MAX_VALUE, held_samples
from hydro_env.ir.nodes import Assign, Expr, For, Statement, Store, Table
from hydro_env.ir.reader import Reader

from .c_printer import bare, identifier
from .schedule import Schedule
from .symbols import TraceError
from .templates import template
from .tracing import MEASURED, Program

__all__ = ["structured_text"]

_TYPES = {"bool": "BOOL", "int": "DINT", "float": "REAL", "double": "LREAL"}
_BINARY = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=", "ne": "<>",
    "and": "AND", "or": "OR",
}  # fmt: skip
_CALLED = {
    "abs": "ABS", "sqrt": "SQRT", "exp": "EXP", "log": "LN", "sin": "SIN", "cos": "COS", "max": "MAX", "min": "MIN",
}  # fmt: skip
_UNITS = ("rad/s", "rad/s", "rad/s", "A", "A", "Pa", "Pa", "1", "1")


def structured_text(program: Program, about: str) -> dict[str, str]:
    """The text of NAME.st for a program, by file. `about`: a sentence on the controller. TraceError for a controller that calls
    compiled functions."""
    name = identifier(program.name)
    reader, bodies = Reader(), []
    variables = {"i": ("int", 0), "measured": ("double", len(MEASURED))}
    for part, assignments in (("a", program.first), ("b", program.next)):
        schedule = Schedule(assignments, reader, "s_", part)
        bodies.append("\n".join("    " + line for line in _statements(schedule.body)))
        variables |= schedule.variables
    inputs = "".join(
        f"    {each} : LREAL; (* {unit} *)\n" for each, unit in zip(MEASURED, _UNITS, strict=True)
    )
    state = "".join(f"    s_{each.name} : {_type(each.kind, each.size)};\n" for each in program.state)
    gathered = "".join(f"given[{n}] := {each};\n" for n, each in enumerate(MEASURED))
    samples, last = held_samples(program.period), len(MEASURED) - 1
    text = template("controller.st").substitute(
        name=name, period=repr(program.period), about=about, version=__version__, inputs=inputs, state=state,
        variables="".join(f"    {name} : {_type(*each)};\n" for name, each in variables.items()),
        constants="".join(map(_table, reader.tables.values())), gathered=gathered, hold=HOLD, samples=samples, last=last,
        most=_literal(MAX_VALUE, "double").partition("#")[2], first=bodies[0], next=bodies[1],
    )  # fmt: skip
    return {f"{name}.st": text}


def _type(kind: str, size: int) -> str:
    return f"ARRAY[0..{size - 1}] OF {_TYPES[kind]}" if size else _TYPES[kind]


def _table(table: Table) -> str:
    """The declaration of an array of constants."""
    numbers = (_literal(x, table.kind).rpartition("#")[2] for x in table.numbers)
    wrapped = "\n        ".join(textwrap.wrap(", ".join(numbers), 120))
    return f"    {table.name} : {_type(table.kind, len(table.numbers))} := [\n        {wrapped}];\n"


# --- statements -------------------------------------------------------------------------------------------------------
def _statements(body: Iterable[Statement]) -> Iterator[str]:
    for each in body:
        match each:
            case Assign(name, value):
                yield f"{name} := {bare(_expression(value))};"
            case Store("command", index, value):
                yield f"next_command_{index.known + 1} := {bare(_expression(value))};"
            case Store(array, index, value):
                yield f"{array}[{bare(_expression(index))}] := {bare(_expression(value))};"
            case For(name, start, stop, 1, inner):
                yield f"FOR {name} := {_expression(start)} TO {stop.known - 1} DO"
                yield from ("    " + line for line in _statements(inner))
                yield "END_FOR;"
            case _:
                raise TraceError("compiled functions have no Structured Text; export this controller as C")


def _expression(x: Expr) -> str:
    """An expression, in parentheses where it needs them."""
    if x.op == "const":
        return _literal(x.value, x.kind)
    if x.op == "var":
        return str(x.value)
    texts = [_expression(each) for each in x.args]
    inside = ", ".join(map(bare, texts))
    one, two, limit = (_literal(number, x.kind) for number in (1.0, 2.0, 20.0))
    if x.op in _BINARY:
        return f"({texts[0]} {_BINARY[x.op]} {texts[1]})"
    if x.op in _CALLED:
        return f"{_CALLED[x.op]}({inside})"
    match x.op:
        case "load":
            return f"{x.value}[{inside}]"
        case "neg":
            return f"(-{texts[0]})"
        case "not":
            return f"(NOT {texts[0]})"
        case "cast":
            return f"{_TYPES[x.args[0].kind]}_TO_{_TYPES[x.kind]}({inside})"
        case "where":
            return f"SEL({bare(texts[0])}, {bare(texts[2])}, {bare(texts[1])})"
        case "tanh":
            # 1 - 2 / (exp(2 x) + 1), which saturates without a division of infinities
            limited = f"MIN(MAX({inside}, {_literal(-20.0, x.kind)}), {limit})"
            return f"({one} - {two} / (EXP({two} * {limited}) + {one}))"
        case "expm1":
            return f"(EXP({inside}) - {one})"
    raise TraceError(f"{x.op} has no Structured Text; export this controller as C")


def _literal(value: float | int | bool, kind: str) -> str:
    if kind == "bool":
        return "TRUE" if value else "FALSE"
    if kind == "int":
        return str(int(value))
    text = repr(float(value)) if kind == "double" else str(np.float32(value))
    mantissa, _, exponent = text.partition("e")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    text = f"{mantissa}E{int(exponent)}" if exponent else mantissa
    return f"{_TYPES[kind]}#{text}"
