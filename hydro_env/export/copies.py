"""Private copies of modules, whose NumPy is another one: who uses the modules themselves meanwhile notices nothing."""

import builtins
import importlib
import io
import pickle
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, resolve_name
from operator import attrgetter
from types import ModuleType
from typing import Any


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
            specification = original.__spec__
            if name not in sys.modules or specification is None or specification.loader is None:
                raise ImportError(f"{name} has no source")
            made = self._modules[name] = module_from_spec(specification)
            vars(made)["__builtins__"] = {**vars(builtins), "__import__": self._import}
            specification.loader.exec_module(made)
            for key, value in list(vars(made).items()):
                setattr(made, key, self._changed(value, getattr(original, key, value)))
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


class _Unpickler(pickle.Unpickler):
    """Finds classes in the copies."""

    copies: Copies

    def find_class(self, module: str, name: str) -> Any:
        return attrgetter(name)(self.copies.module(module))
