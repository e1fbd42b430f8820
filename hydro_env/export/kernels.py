"""Compiled functions that a traced controller calls, read as typed functions (`hydro_env.ir.reader`)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hydro_env.ir.nodes import const, var
from hydro_env.ir.reader import Arr, Reader, Rec, TranslationError, Value, constant_of

from .symbols import Expr, Kernel, MaskedRows, Symbols

#: What a recorded call hands over: the number of an array, an expression, or the mask that says whether there is a row.
Handed = int | Expr | MaskedRows


class KernelCall(NamedTuple):
    """How a recorded call is written: the function, what it is handed, and which arrays it changes."""

    name: str
    handed: list[Handed]
    written: list[int]


def kernel_call(call: Kernel, reader: Reader) -> KernelCall:
    """The function for a call."""
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
    return KernelCall(called.name, handed, sorted(each for each in changed if isinstance(each, int)))
