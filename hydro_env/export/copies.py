"""Private copies of modules, whose NumPy is another one: who uses the modules themselves meanwhile notices nothing."""

from __future__ import annotations

import builtins
import importlib
import io
import pickle
import sys
from collections.abc import Callable
from importlib.util import resolve_name
from types import ModuleType
from typing import Any

__all__ = ["Copies"]


class Copies:
    """Copies of the modules that `private` names, made as they are asked for.

    In them `import numpy` gives `numpy`, and each value that `changed(value, original)` returns stands in the place of one of
    the module; `original` is what the module itself has by that name.
    """

    def __init__(
        self, private: Callable[[str], bool], numpy: Any, changed: Callable[[Any, Any], Any]
    ) -> None:
        self._private, self._numpy, self._changed = private, numpy, changed
        self._modules: dict[str, ModuleType] = {}

    def of(self, value: Any) -> Any:
        """A copy of an object, and of all below it, with its classes from the copied modules."""
        loader = _Unpickler(io.BytesIO(pickle.dumps(value)))
        loader.copies = self
        return loader.load()

    def module(self, name: str) -> Any:
        """The module of a name: a copy where it is private."""
        original = importlib.import_module(name)
        if not self._private(name):
            return original
        if name not in self._modules:
            made = self._modules[name] = ModuleType(name)
            space = vars(made)
            space |= {key: value for key, value in vars(original).items() if key.startswith("__")}
            space["__builtins__"] = {**vars(builtins), "__import__": self._import}
            exec(_code(original), space)
            for key, value in list(space.items()):
                space[key] = self._changed(value, getattr(original, key, value))
        return self._modules[name]

    def _import(
        self, name: str, space: Any = None, local: Any = None, wanted: Any = (), level: int = 0
    ) -> Any:
        """What an import statement in a copy gives."""
        name = resolve_name("." * level + name, space["__package__"]) if level else name
        if name.partition(".")[0] == "numpy" and (name == "numpy" or not wanted):
            return self._numpy
        if not wanted:
            return builtins.__import__(name)
        found = self.module(name)
        for inner in (f"{name}.{each}" for each in wanted):
            if self._private(inner) and not hasattr(found, inner.rpartition(".")[2]):
                setattr(found, inner.rpartition(".")[2], self.module(inner))
        return found


def _code(module: ModuleType) -> Any:
    specification = module.__spec__
    loader: Any = specification.loader if specification is not None else None
    if module.__name__ not in sys.modules or loader is None:
        raise ImportError(f"{module.__name__} has no source")
    return compile(loader.get_data(module.__file__), str(module.__file__), "exec")


class _Unpickler(pickle.Unpickler):
    """Finds classes in the copies."""

    copies: Copies

    def find_class(self, module: str, name: str) -> Any:
        found = self.copies.module(module)
        for part in name.split("."):
            found = getattr(found, part)
        return found
