"""An interpreter of the Structured Text that `hydro_env.export` writes: a function block or program becomes a Python object.

It knows that subset alone, and is strict where IEC 61131-3 is: operands have one type, nothing is converted but by a function
that says so, arrays are declared and read within their bounds. REAL is single precision, LREAL double.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

TOKEN = re.compile(
    r"\s*(?:(?P<comment>\(\*.*?\*\))|(?P<literal>(?:LREAL|REAL|DINT)#-?[0-9.]+(?:E-?[0-9]+)?)|(?P<address>%[IQ]\*)|(?P<number>-?[0-9]+\.[0-9]+(?:E-?[0-9]+)?|[0-9]+(?!\.[0-9]))"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)|(?P<sign>:=|<=|>=|<>|\.\.|[-+*/()\[\],;:<>=.]))",
    re.DOTALL,
)
PYTHON = {"=": "==", "<>": "!=", "AND": "and", "OR": "or"}
WHOLE = ("INT", "DINT", "ANY_INT")
UNIT = re.compile(r"^(FUNCTION_BLOCK|PROGRAM) (\w+)\n.*?^END_\1$", re.DOTALL | re.MULTILINE)
FUNCTIONS = {"ABS": "abs", "MIN": "min", "MAX": "max", "SQRT": "sqrt", "EXP": "exp", "LN": "log"}


def tokens(text: str) -> list[str]:
    found, at = [], 0
    text = text.rstrip()
    while at < len(text):
        match = TOKEN.match(text, at)
        if match is None:
            raise SyntaxError(f"what is {text[at : at + 30]!r}?")
        at = match.end()
        if not match["comment"]:
            found.append(match[0].strip())
    return found


def int16(x: int) -> int:
    if not -32768 <= x <= 32767:
        raise OverflowError(f"INT of {x}")
    return x


def common(one: str, other: str) -> str:
    """The type of both operands; a whole literal takes the other's."""
    if one == other or (other == "ANY_INT" and one in WHOLE):
        return one
    if one == "ANY_INT" and other in WHOLE:
        return other
    raise TypeError(f"{one} with {other}")


def units_of(text: str) -> dict[str, str]:
    """The units of a file by name."""
    return {unit[2]: unit[0] for unit in UNIT.finditer(text)}


def project(text: str) -> Block:
    """The program of a file of several units."""
    units = units_of(text)
    (program,) = [name for name, unit in units.items() if unit.startswith("PROGRAM")]
    return Block(units[program], units)


@dataclass
class Variable:
    kind: str
    size: int  # 0: no array
    initial: list[float]


class Block:
    """`FUNCTION_BLOCK` or `PROGRAM` as an object: call it with its inputs, then read its outputs. `units`: texts of the blocks
    that it has instances of, by name."""

    def __init__(self, text: str, units: dict[str, str] | None = None) -> None:
        self.words, self.units = tokens(text), units or {}
        self.at = 0
        self.variables: dict[str, Variable] = {}
        self.instances: dict[str, Block] = {}
        self.inputs: list[str] = []
        unit = self.next()
        assert unit in ("FUNCTION_BLOCK", "PROGRAM")
        self.name = self.next()
        while self.peek().startswith("VAR"):
            self.section()
        lines = self.statements((f"END_{unit}",), 1)
        self.source = "\n".join(["def body(v):", *lines])
        space: dict[str, Any] = {
            "math": math, "f32": np.float32, "sel": lambda g, a, b: b if g else a, "int16": int16,
        }  # fmt: skip
        exec(compile(self.source, self.name, "exec"), space)
        self.body = space["body"]
        self.values = self.instances | {name: self.fresh(each) for name, each in self.variables.items()}

    @staticmethod
    def fresh(each: Variable) -> Any:
        make = {"REAL": np.float32, "LREAL": float, "DINT": int, "INT": int, "BOOL": bool}[each.kind]
        numbers = [make(x) for x in (each.initial or [0] * max(1, each.size))]
        return numbers if each.size else numbers[0]

    def __call__(self, **inputs: Any) -> dict[str, Any]:
        self.values |= inputs
        self.body(self.values)
        return self.values

    # --- words ---
    def peek(self) -> str:
        return self.words[self.at]

    def next(self) -> str:
        self.at += 1
        return self.words[self.at - 1]

    def take(self, *expected: str) -> None:
        for each in expected:
            found = self.next()
            if found != each:
                raise SyntaxError(f"{each!r} expected, found {found!r}")

    # --- declarations ---
    def section(self) -> None:
        kind = self.next()
        if kind not in ("VAR_INPUT", "VAR_OUTPUT", "VAR"):
            raise SyntaxError(f"{kind}: matiec does not translate its arrays")
        if kind == "VAR" and self.peek() == "CONSTANT":
            self.next()
        while self.peek() != "END_VAR":
            name = self.next()
            if self.peek() == "AT":
                self.at += 2
            self.take(":")
            size = 0
            if self.peek() == "ARRAY":
                self.take("ARRAY", "[", "0", "..")
                size = int(self.next()) + 1
                self.take("]", "OF")
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name):
                raise SyntaxError(f"{name} is no identifier")
            own = self.next()
            if own in self.units and name not in self.variables:
                self.instances[name] = Block(self.units[own], self.units)
                self.take(";")
                continue
            initial: list[float] = []
            if self.peek() == ":=":
                self.next()
                initial = self.initial()
            self.take(";")
            if own not in ("LREAL", "REAL", "DINT", "INT", "BOOL") or name in self.variables:
                raise SyntaxError(f"{name}: {own} is no type, or declared twice")
            if size and initial and len(initial) != size:
                raise SyntaxError(f"{name}: {len(initial)} initial values for {size}")
            self.variables[name] = Variable(own, size, initial)
            if kind == "VAR_INPUT":
                self.inputs.append(name)
        self.take("END_VAR")

    def initial(self) -> list[float]:
        if self.peek() != "[":
            sign = -1.0 if self.peek() == "-" else 1.0
            self.at += sign < 0.0
            return [sign * self.constant(self.next())]
        self.next()
        numbers = [self.constant(self.next())]
        while self.peek() == ",":
            self.next()
            numbers.append(self.constant(self.next()))
        self.take("]")
        return numbers

    @staticmethod
    def constant(word: str) -> float:
        return float(word == "TRUE") if word in ("FALSE", "TRUE") else float(word.split("#")[-1])

    # --- statements ---
    def statements(self, ends: tuple[str, ...], depth: int) -> list[str]:
        lines = []
        while self.peek() not in ends:
            lines += self.statement(depth)
        return lines or ["    " * depth + "pass"]

    def statement(self, depth: int) -> list[str]:
        indent, word = "    " * depth, self.next()
        if word == "IF":
            test, kind = self.expression()
            assert kind == "BOOL", test
            self.take("THEN")
            lines = [f"{indent}if {test}:", *self.statements(("ELSIF", "ELSE", "END_IF"), depth + 1)]
            ended = self.next()
            if ended == "ELSIF":  # an IF inside of ELSE that takes the common end
                self.at -= 1
                self.words[self.at] = "IF"
                return [*lines, f"{indent}else:", *self.statement(depth + 1)]
            if ended == "ELSE":
                lines += [f"{indent}else:", *self.statements(("END_IF",), depth + 1)]
                self.next()
            self.take(";")
            return lines
        if word == "FOR":
            counter = self.next()
            assert self.variables[counter].kind == "DINT"
            self.take(":=")
            first, _ = self.expression()
            self.take("TO")
            last, _ = self.expression()
            self.take("DO")
            lines = [f"{indent}for v[{counter!r}] in range({first}, {last} + 1):"]
            lines += self.statements(("END_FOR",), depth + 1)
            self.take("END_FOR", ";")
            return lines
        if word in self.instances:
            return [indent + self.call_of_instance(word)]
        target, kind = self.place(word)
        self.take(":=")
        value = self.value_for(kind)
        self.take(";")
        return [f"{indent}{target} = {value}"]

    def value_for(self, kind: str) -> str:
        """An expression for a variable of a type."""
        value, own = self.expression()
        if common(kind, own) != kind:
            raise TypeError(f"{own} for {kind}: {value}")
        return f"int16({value})" if kind == "INT" else value

    def call_of_instance(self, name: str) -> str:
        """`Name(Input := value, ...);`"""
        block, given, sign = self.instances[name], [], "("
        while sign != ")":
            self.take(sign)
            wanted = self.next()
            assert wanted in block.inputs, (name, wanted)
            self.take(":=")
            given.append(f"{wanted}={self.value_for(block.variables[wanted].kind)}")
            sign = self.peek()
        self.take(")", ";")
        return f"v[{name!r}]({', '.join(given)})"

    def place(self, name: str) -> tuple[str, str]:
        if name in self.instances:
            self.take(".")
            inner, block = self.next(), self.instances[name]
            return f"v[{name!r}].values[{inner!r}]", block.variables[inner].kind
        variable = self.variables[name]
        if not variable.size:
            return f"v[{name!r}]", variable.kind
        self.take("[")
        index, kind = self.expression()
        self.take("]")
        assert kind in ("DINT", "ANY_INT"), index
        return f"v[{name!r}][{index}]", variable.kind

    # --- expressions ---
    def expression(self, level: int = 0) -> tuple[str, str]:
        levels = (("OR",), ("AND",), ("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
        if level == len(levels):
            return self.factor()
        left, kind = self.expression(level + 1)
        while self.peek() in levels[level]:
            sign = self.next()
            right, other = self.expression(level + 1)
            kind = common(kind, other)
            left = f"({left} {PYTHON.get(sign, sign)} {right})"
            kind = "BOOL" if level <= 2 else kind
        return left, kind

    def factor(self) -> tuple[str, str]:
        word = self.next()
        if word == "(":
            inner = self.expression()
            self.take(")")
            return f"({inner[0]})", inner[1]
        if word == "-":
            inner = self.factor()
            return f"(-{inner[0]})", inner[1]
        if word == "NOT":
            inner = self.factor()
            assert inner[1] == "BOOL"
            return f"(not {inner[0]})", "BOOL"
        if "#" in word:
            kind, number = word.split("#")
            return (f"f32({float(number)!r})" if kind == "REAL" else repr(float(number))), kind
        if word in ("TRUE", "FALSE"):
            return word.title(), "BOOL"
        if word.isdigit():
            return word, "ANY_INT"
        if self.peek() == "(":
            return self.call(word)
        return self.place(word)

    def call(self, name: str) -> tuple[str, str]:
        self.take("(")
        values = [self.expression()]
        while self.peek() == ",":
            self.next()
            values.append(self.expression())
        self.take(")")
        texts, kinds = [each[0] for each in values], [each[1] for each in values]
        converted = re.fullmatch(r"(L?REAL|DINT|INT|BOOL)_TO_(L?REAL|DINT|INT)", name)
        if converted:
            assert kinds == [converted[1]], (name, kinds)
            make = {"REAL": "f32", "LREAL": "float", "DINT": "round", "INT": "round"}[converted[2]]
            return f"{make}({texts[0]})", converted[2]
        if name == "SEL":
            assert kinds[0] == "BOOL" and kinds[1] == kinds[2], (name, kinds)
            return f"sel({', '.join(texts)})", kinds[1]
        if name not in FUNCTIONS or len(set(kinds)) != 1:
            raise TypeError(f"{name} of {kinds}")
        function = FUNCTIONS[name] if name in ("ABS", "MIN", "MAX") else f"math.{FUNCTIONS[name]}"
        text = f"{function}({', '.join(texts)})"
        return (f"f32({text})" if kinds[0] == "REAL" else text), kinds[0]
