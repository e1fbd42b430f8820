"""The one error that users' input can cause, and what it says of a name that nobody knows."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

__all__ = ["InputError", "InputWarning", "nearest", "place_of", "suggestion"]

#: Similarity (`difflib.SequenceMatcher.ratio`) from which on a name counts as a misspelling of another.
SIMILAR = 0.5


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, row or key and says what would be right.

    The command line prints it as `error: ...` and exits with status 2.
    """


class InputWarning(UserWarning):
    """Input that is used, although it looks wrong: one line like that of an `InputError`."""


def place_of(problem: BaseException) -> str:
    """`file.py line 12`, where code from outside of this package raised an error, "" where none did; of code that calls other
    code of its own file the innermost line. Installed libraries do not count.
    """
    package = str(Path(__file__).parent)
    outside = [
        frame
        for frame in traceback.extract_tb(problem.__traceback__)
        if not frame.filename.startswith((package, "<")) and "site-packages" not in frame.filename
    ]
    lines = [frame.lineno for frame in outside if frame.filename == outside[0].filename]
    return f"{outside[0].filename} line {lines[-1]}" if outside else ""


def nearest(word: object, known: Iterable[str]) -> str | None:
    """The known name that `word` is most like, upper and lower case alike; None where none is like it."""
    folded = {name.lower(): name for name in known}
    near = get_close_matches(str(word).lower(), folded, n=1, cutoff=SIMILAR)
    return folded[near[0]] if near else None


def suggestion(word: object, known: Iterable[str]) -> str:
    """What an error says of an unknown name: "did you mean 'x'?", or "known are a, b" where no known one is like it."""
    names = list(known)
    near = nearest(word, names)
    return f"did you mean {near!r}?" if near else f"known are {', '.join(names)}"
