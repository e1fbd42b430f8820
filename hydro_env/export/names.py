"""Names for what Structured Text declares, after the controller's own variables: `grown` of motor 1 is `Grown1`."""

from __future__ import annotations

from collections.abc import Iterable
from string import ascii_lowercase
from typing import Any

from .c_printer import identifier
from .schedule import Schedule
from .symbols import Expr, below

#: Words that are no name of a variable in IEC 61131-3 or in tools after it, as far as Python's variables could be called so.
_WORDS = """abs abstract action add adr and any array at bool by byte case class concat constant continue delete do else elsif end
enum exit exp extends external final find for from function global goto if implements in ini initial insert int interface interval
internal left len limit ln log max method mid min mod move mul mux namespace new not null of on or overlap override persistent
pointer priority private program property protected public read real ref reference repeat replace resource retain return right rol
ror round sel self shl shr single sizeof step string struct sub super task then this time to true trunc type union until using var
while with word write xor"""
#: What a variable is called that holds no value of the controller, by the first letter that it has in a schedule.
_HELPERS = {"g": "Gathered", "s": "Sum", "a": "Copied", "x": "Value", "v": "Values", "i": "Index", "j": "Column"}  # fmt: skip


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

    def of_part(self, schedule: Schedule, named: dict[Expr, tuple[str, int]]) -> dict[str, str]:
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
