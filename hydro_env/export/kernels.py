"""Compiled functions that a traced controller calls, as C functions (`translate`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .symbols import Expr, Kernel, MaskedRows, Place
from .translate import Arr, Num, Rec, TranslationError, Translator, Value, constant_of

__all__ = ["KernelCall", "Kernels"]


@dataclass
class KernelCall:
    """How a recorded call is written: the C function, what it is handed (numbers of arrays, expressions, masks of rows, or text),
    and which arrays it changes."""

    name: str
    handed: list[int | Expr | MaskedRows | str]
    written: list[int]


@dataclass
class Kernels:
    """Translates the calls of one program."""

    translator: Translator = field(default_factory=Translator)

    def of(self, call: Kernel) -> KernelCall:
        """The C function for a call."""
        marks: dict[str, int | Expr | MaskedRows | str] = {}
        values = [self._value(each, marks) for each in call.arguments]
        called = self.translator.call(call.function, values)
        if called.result is not None:
            raise TranslationError(f"{call.function.__name__}: returns a value, which cannot be followed")
        changed = {marks[each] for each in called.roots if each in marks}
        handed = [marks.get(each, each) for each in called.handed]
        return KernelCall(called.name, handed, sorted(each for each in changed if isinstance(each, int)))

    def _value(self, argument: Any, marks: dict[str, int | Expr | MaskedRows | str]) -> Value:
        """An argument as a value whose text is a mark for what stands there."""
        mark = f"mark{len(marks)}"
        if isinstance(argument, Place):
            marks[mark] = argument.number
            return Arr(*_contiguous(argument, mark), root=mark)
        if isinstance(argument, MaskedRows):
            marks[mark] = argument
            marks[f"{mark}_count"] = argument.mask
            return Arr("int", mark, (f"{mark}_count",), (1,), root=mark)
        if isinstance(argument, Expr):
            if argument.op == "const":
                return constant_of(argument.value) or Num(argument.kind, mark)
            marks[mark] = argument
            return Num(argument.kind, mark)
        if isinstance(argument, dict):
            return Rec({name: self._value(each, marks) for name, each in argument.items()})
        if isinstance(argument, np.ndarray) and argument.ndim:
            return self.translator.table(argument)
        known = constant_of(argument.item() if isinstance(argument, np.ndarray) else argument)
        if known is None:
            raise TranslationError(f"an argument of type {type(argument).__name__} cannot be passed on")
        return known


def _contiguous(place: Place, mark: str) -> tuple[str, str, tuple[int, ...], tuple[int, ...]]:
    made = Arr.of(place.kind, mark, place.shape)
    return place.kind, mark, place.shape, made.strides  # type: ignore[return-value]
