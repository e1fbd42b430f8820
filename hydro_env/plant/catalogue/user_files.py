"""Files of users' own effects: Python files that call `register`, loaded because the user named them."""

import os
from collections.abc import Iterable
from pathlib import Path

from ...errors import InputError, place_of
from ...reading import check_file, run_python
from ..kernel import compile_kernel
from .effect import CATALOGUE
from .law_checks import check_laws

_LOADED: dict[Path, tuple[str, ...]] = {}


def load_effects(paths: Iterable[str | Path]) -> tuple[str, ...]:
    """Runs Python files that register effects and returns the names of these; a file loaded before is not run again.

    InputError in one line if a file cannot be read or run, registers nothing, or has a law that is not neutral or cannot be
    compiled; nothing of that file stays in the catalogue then.
    """
    names: list[str] = []
    for path in paths:
        file = Path(os.path.realpath(path))
        if file not in _LOADED or any(name not in CATALOGUE for name in _LOADED[file]):
            _LOADED[file] = _run(file, str(path))
        names += _LOADED[file]
    return tuple(names)


def _run(file: Path, shown: str) -> tuple[str, ...]:
    what = "a Python file (.py) that calls hydro_env.plant.register"
    check_file(shown, what)
    if file.suffix != ".py":
        raise InputError(f"{shown}: not a Python file with effects; expected {what}")
    before = set(CATALOGUE)
    try:
        run_python(file)
        names = tuple(name for name in CATALOGUE if name not in before)
        if not names:
            raise InputError("registers no effect; it must call hydro_env.plant.register(Effect(...))")
        for name in names:
            check_laws(CATALOGUE[name])
        compile_kernel(names)
    except (Exception, SystemExit) as problem:  # a user's file may fail in any way
        for name in [name for name in CATALOGUE if name not in before]:
            del CATALOGUE[name]
        kind = "" if isinstance(problem, ValueError) else f"{type(problem).__name__}: "
        place = "" if isinstance(problem, InputError) else place_of(problem).rpartition(" line ")[2]
        line = f"line {place}: " if place else ""
        raise InputError(f"{shown}: {line}{kind}{problem}") from None
    return names
