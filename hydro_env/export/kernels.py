"""Compiled functions that a traced controller calls, read as typed functions (`hydro_env.ir.reader`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_env.ir.nodes import const, var
from hydro_env.ir.reader import Arr, Reader, Rec, TranslationError, Value, constant_of

from .symbols import Expr, Kernel, MaskedRows, Place

__all__ = ["KernelCall", "kernel_call"]

#: What a recorded call hands over: the number of an array, an expression, or the mask that says whether there is a row.
Handed = int | Expr | MaskedRows


@dataclass
class KernelCall:
    """How a recorded call is written: the function, what it is handed, and which arrays it changes."""

    name: str
    handed: list[Handed]
    written: list[int]


def kernel_call(call: Kernel, reader: Reader) -> KernelCall:
    """The function for a call."""
    marks: dict[str, Handed] = {}
    values = [_value(each, marks, reader) for each in call.arguments]
    called = reader.call(call.function, values)
    if called.result is not None:
        raise TranslationError(f"{call.function.__name__}: returns a value, which cannot be followed")
    changed = {marks[each] for each in called.written if each in marks}
    handed = [marks[each.value] for each in called.handed]
    return KernelCall(called.name, handed, sorted(each for each in changed if isinstance(each, int)))


def _value(argument: Any, marks: dict[str, Handed], reader: Reader) -> Value:
    """An argument as a value whose name is a mark for what stands there."""
    mark = f"mark{len(marks)}"
    if isinstance(argument, Place):
        marks[mark] = argument.number
        return Arr.of(argument.kind, mark, argument.shape)
    if isinstance(argument, MaskedRows):
        marks[mark] = argument
        marks[f"{mark}_count"] = argument.mask
        return Arr.of("int", mark, [var(f"{mark}_count", "int")])
    if isinstance(argument, Expr):
        if argument.op == "const":
            return const(argument.value, argument.kind)
        marks[mark] = argument
        return var(mark, argument.kind)
    if isinstance(argument, dict):
        return Rec({name: _value(each, marks, reader) for name, each in argument.items()})
    if isinstance(argument, np.ndarray) and argument.ndim:
        return reader.table(argument)
    known = constant_of(argument.item() if isinstance(argument, np.ndarray) else argument)
    if known is None:
        raise TranslationError(f"an argument of type {type(argument).__name__} cannot be passed on")
    return known
