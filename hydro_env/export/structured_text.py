"""A traced controller as a function block in Structured Text (IEC 61131-3, third edition).

Only what every system has is used: LREAL, REAL, INT, BOOL, arrays, IF, FOR, and the standard functions ABS, EXP, SQRT, SEL, MIN,
MAX, LREAL_TO_REAL and the like. What the standard lacks (tanh) is made of EXP. The state lies in the block's VAR.
"""

import re
import textwrap
from collections.abc import Iterable, Iterator
from string import ascii_lowercase
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.controllers.input_guard import HOLD, MAX_VALUE, held_samples
from hydro_env.ir.nodes import Assign, Expr, For, Statement, Store, Table
from hydro_env.ir.reader import Reader

from .c_printer import BINARY as IN_C
from .c_printer import bare, filled, identifier
from .schedule import Schedule
from .symbols import TraceError, below
from .templates import template
from .tracing import GAIN, MEASURED, Program, divisors

_TYPES = {"bool": "BOOL", "int": "DINT", "float": "REAL", "double": "LREAL"}
_BINARY = IN_C | {"eq": "=", "ne": "<>", "and": "AND", "or": "OR"}
#: How operations are written, as `filled` takes it; tanh as 1 - 2 / (exp(2 x) + 1), which saturates without a division of
#: infinities.
_FORMS = {
    **{op: f"({{0}} {sign} {{1}})" for op, sign in _BINARY.items()},
    **{op: f"{op.upper()}({{inside}})" for op in ("abs", "sqrt", "exp", "sin", "cos", "max", "min")}, "log": "LN({inside})",
    "load": "{value}[{inside}]", "neg": "(-{0})", "not": "(NOT {0})", "where": "SEL({bare[0]}, {bare[2]}, {bare[1]})",
    "cast": "{given}_TO_{wanted}({inside})", "expm1": "(EXP({inside}) - {one})",
    "tanh": "({one} - {two} / (EXP({two} * MIN(MAX({inside}, {least}), {most})) + {one}))",
}  # fmt: skip
#: The inputs of the block by the names of the field, and their units.
INPUTS = {
    "SpeedSetpoint": "rad/s", "Speed1": "rad/s", "Speed2": "rad/s", "Current1": "A", "Current2": "A", "Pressure1": "Pa",
    "Pressure2": "Pa", "CommandInForce1": "-1 to 1", "CommandInForce2": "-1 to 1",
}  # fmt: skip
#: What else the block declares.
_OWN = (
    "Reset", "Command1", "Command2", "Fault", "Fresh", "Started", "Missed", "Given", "Measured", "HoldCalls", "Index",
)  # fmt: skip
#: What a project declares beside it.
_OTHERS = ("AnalogInput", "Controller", "Fallback", "SpeedSynchronisation", "Plc", "Main")
#: Words that are no name of a variable in IEC 61131-3 or in tools after it, as far as Python's variables could be called so.
_WORDS = """abs abstract action add adr and any array at bool by byte case class concat constant continue delete do else elsif end
enum exit exp extends external final find for from function global goto if implements in ini initial insert int interface interval
internal left len limit ln log max method mid min mod move mul mux namespace new not null of on or overlap override persistent
pointer priority private program property protected public read real ref reference repeat replace resource retain return right rol
ror round sel self shl shr single sizeof step string struct sub super task then this time to true trunc type union until using var
while with word write xor"""
#: What a variable is called that holds no value of the controller, by the first letter that it has in a schedule.
_HELPERS = {"g": "Gathered", "s": "Sum", "a": "Copied", "x": "Value", "v": "Values", "i": "Index", "j": "Column"}  # fmt: skip


def structured_text(program: Program, about: str) -> dict[str, str]:
    """The text of NAME.st for a readable program, by file. `about`: a sentence on the controller. TraceError for one that calls
    compiled functions."""
    reader, gains, divided = Reader(), list(_gains(program)), divisors(program)
    schedules = [Schedule(program.first, reader, "s_", "a"), Schedule(program.next, reader, "s_", "b")]
    names = Names((*INPUTS, *_OWN, *(name for name, _, _ in gains)))
    renamed = {"i": "Index", "measured": "Measured"} | {f"s_{old}[{n}]": name for name, (old, n), _ in gains}
    renamed |= {f"s_{each}": names.new(pascal(each), "state") for each in program.state}
    renamed |= {each.name: names.new(pascal(each.name), "table") for each in reader.tables.values()}
    variables, bodies = {"Index": ("int", 0), "Measured": ("double", len(MEASURED))}, []
    for schedule in schedules:
        called = names.of_part(schedule, program.names) | renamed
        variables |= {called[name]: kind for name, kind in schedule.variables.items()}
        bodies.append("\n".join("    " + _renamed(line, called) for line in _statements(schedule.body)))
    inputs = [f"    {each} : LREAL; (* {unit} *)\n" for each, unit in INPUTS.items()]
    inputs += [declared for _, _, declared in gains]
    state = [f"    {renamed[f's_{name}']} : {_type(*each)};\n" for name, each in program.state.items()]
    gathered = "".join(f"Given[{n}] := {each};\n" for n, each in enumerate(INPUTS))
    most = _literal(MAX_VALUE, "double")
    within = [f"ABS({name}) <= {most}" for name, _, _ in gains]
    within += [f"{name} > LREAL#0.0" for name, old, _ in gains if old in divided]
    checked = f"IF NOT ({' AND '.join(within)}) THEN\n    Fault := TRUE;\nEND_IF;\n" if within else ""
    samples, last = held_samples(program.period), len(MEASURED) - 1
    text = template("controller.st").substitute(
        name=block_name(program), period=repr(program.period), about=about, version=__version__,
        state="".join(state), inputs="".join(inputs),
        variables="".join(f"    {name} : {_type(*each)};\n" for name, each in variables.items()),
        constants="".join(_table(renamed[each.name], each) for each in reader.tables.values()), gathered=gathered, hold=HOLD,
        samples=samples, last=last, most=most, checked=checked, first=bodies[0], next=bodies[1],
    )  # fmt: skip
    return {f"{identifier(program.name)}.st": text}


def block_name(program: Program) -> str:
    """What the function block of a program is called, so that nothing else in a project is."""
    return Names(_OTHERS).new(pascal(program.name), "block")


def _gains(program: Program) -> Iterator[tuple[str, tuple[str, int], str]]:
    """Of each input for a gain: its name, its leaf in the program, and its declaration."""
    for gain, values in program.gains:
        about = f"{gain.unit}, tuned from {gain.low:g} to {gain.high:g}: {gain.summary}".replace("*)", ")")
        for n, value in enumerate(values):
            name = f"{GAIN}{identifier(gain.name)}" + ("" if len(values) == 1 else f"_{n + 1}")
            declared = f"    {name} : LREAL := {_literal(value, 'double')}; (* {about} *)\n"
            yield name, (GAIN + gain.name, n), declared


def _renamed(line: str, names: dict[str, str]) -> str:
    """A statement with the new names in it."""
    return re.sub(rf"s_{GAIN}\w+\[\d\]|[A-Za-z_]\w*", lambda word: names.get(word[0], word[0]), line)


def _type(kind: str, size: int) -> str:
    return f"ARRAY[0..{size - 1}] OF {_TYPES[kind]}" if size else _TYPES[kind]


def _table(name: str, table: Table) -> str:
    """The declaration of an array of constants."""
    numbers = (_literal(x, table.kind).rpartition("#")[2] for x in table.numbers)
    wrapped = "\n        ".join(textwrap.wrap(", ".join(numbers), 120))
    return f"    {name} : {_type(table.kind, len(table.numbers))} := [\n        {wrapped}];\n"


# --- names, after the controller's own variables: `grown` of motor 1 is `Grown1` ----------------------------------------
def pascal(name: str) -> str:
    """`pid_integral` as `PidIntegral`, with ASCII letters."""
    return "".join(word[:1].upper() + word[1:] for word in identifier(name).split("_"))


class Names:
    """Names that differ, also for a language that does not tell `a` from `A`; `taken` are those that others have. The parts of a
    program, of which one runs at a time, share a name for what is of one type."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._types: dict[str, Any] = dict.fromkeys((name.lower() for name in taken), "taken")
        self._types |= dict.fromkeys(_WORDS.split(), "word")
        self._here: set[str] = set()

    def new(self, name: str, kind: Any) -> str:
        """The name, or the first of `name_b`, `name_c`, ... that is free."""
        made, n = name, 1
        while (key := made.lower()) in self._here or self._types.get(key, kind) != kind:
            made = f"{name}_{ascii_lowercase[n] if n < 26 else n}"
            n += 1
        self._types[key] = kind
        self._here.add(key)
        return made

    def of_part(self, schedule: Schedule, named: dict[Any, tuple[str, int]]) -> dict[str, str]:
        """New names of the variables of a part, by their old ones: what the controller's own variable is called (`named`), else
        what it is a part of."""
        self._here = set()
        called: dict[str, str] = {}
        seen: set[int] = set()
        stack: list[tuple[Any, str]] = []
        for (array, n), root in reversed(schedule.assignments.items()):
            stack.append((root, f"{'' if array == 'command' else 'New'}{pascal(array)}{n + 1}"))
        while stack:
            node, label = stack.pop()
            if id(node) in seen:
                continue
            seen.add(id(node))
            if isinstance(node, Expr) and node in named:
                name, n = named[node]
                label = pascal(name) + (str(n + 1) if n >= 0 and node.op != "item" else "")
            elif isinstance(node, Expr) and node.op != "item" and "Part" not in label:
                label += "Part"
            old = schedule.names.get(node, "")
            if old in schedule.variables and old not in called:
                called[old] = self.new(label, schedule.variables[old])
            stack += [(each, label) for each in reversed(below(node))]
        others = {old: kind for old, kind in schedule.variables.items() if old not in called}
        return called | {old: self.new(_HELPERS[old[0]], kind) for old, kind in others.items()}


# --- statements -------------------------------------------------------------------------------------------------------
def _statements(body: Iterable[Statement]) -> Iterator[str]:
    for each in body:
        match each:
            case Assign(name, value):
                yield f"{name} := {bare(_expression(value))};"
            case Store("command", index, value):
                yield f"Command{index.known + 1} := {bare(_expression(value))};"
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
    if x.op not in _FORMS:
        raise TraceError(f"{x.op} has no Structured Text; export this controller as C")
    numbers = {"one": 1.0, "two": 2.0, "least": -20.0, "most": 20.0}
    literals = {name: _literal(number, x.kind) for name, number in numbers.items()}
    kinds = {"given": _TYPES[x.args[0].kind], "wanted": _TYPES[x.kind]}
    return filled(_FORMS[x.op], x, map(_expression, x.args), **literals, **kinds)


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
