"""Controllers from Python code of the user's: `file.py:Class` and `package.module:Class`."""

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

from hydro_env.errors import InputError, place_of, suggestion
from hydro_env.reading import check_file, run_python


def controllers_in(path: str) -> list[str]:
    """`file.py:Class` of every class in a file that has `reset` and `act`, in the order in which they stand there.

    InputError if the file cannot be run or has none.
    """
    module = _load_file(Path(path))
    own = [each for each in vars(module).values() if getattr(each, "__module__", "") == module.__name__]
    names = [each.__name__ for each in own if isinstance(each, type) and not _lacking(each)]
    names = [name for name in names if not name.startswith("_")]
    if not names:
        raise InputError(f"{path}: has no class with the methods 'reset' and 'act'")
    return [f"{path}:{name}" for name in names]


def loaded(text: str) -> Any:
    """What `file.py:NAME` or `package.module:NAME` stands for. InputError if the code cannot be run or lacks the name."""
    where, _, attribute = text.rpartition(":")
    module = _load_file(Path(where)) if where.endswith(".py") else _import(where)
    if not hasattr(module, attribute):
        names = [name for name, value in vars(module).items() if isinstance(value, type)]
        raise InputError(f"{where}: has no {attribute!r}: {suggestion(attribute, names)}")
    return getattr(module, attribute)


def checked(controller: Any, text: str) -> Any:
    """The controller. InputError if it lacks a method that a controller has."""
    if lacking := _lacking(controller):
        raise InputError(f"{text}: is no controller, it has no method {lacking[0]!r}")
    return controller


def _lacking(controller: Any) -> list[str]:
    """Methods of a controller that an object or a class does not have."""
    return [name for name in ("reset", "act") if not callable(getattr(controller, name, None))]


def _import(where: str) -> ModuleType:
    try:
        return importlib.import_module(where)
    except (Exception, SystemExit) as problem:  # a module may fail in any way; not every text names one
        raise InputError(f"{where}: cannot be imported ({type(problem).__name__}: {problem})") from None


def _load_file(path: Path) -> ModuleType:
    check_file(path, "a Python file with a controller")
    try:
        return run_python(path)
    except (Exception, SystemExit) as problem:
        where = place_of(problem) or str(path)
        raise InputError(f"{where}: {type(problem).__name__}: {problem}") from problem
