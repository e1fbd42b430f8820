"""What a campaign of hostile input shares: one case under limits of time and memory, and what came of it."""

from __future__ import annotations

import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from hydro_env.errors import InputError

#: Of one case: s, bytes beyond what the process has, letters of a message.
SECONDS, BYTES, LETTERS = 30, 3 * 2**30, 2000
#: What code in a file would leave behind if it were run.
MARK = "code_was_run"


class Case(NamedTuple):
    """`call(folder)` returns if it worked, raises InputError or returns the status and the text of a command. `refused`: it
    must not work."""

    call: Callable[[Path], Any]
    refused: bool = False


class TooLong(BaseException):
    """Beyond the time of a case; no handler of the code under test may take it for an error of its own."""


@contextmanager
def limited(seconds: int = SECONDS) -> Iterator[None]:
    """A block that gets `TooLong` after some seconds and MemoryError beyond the memory it may take."""

    def late(number: int, frame: FrameType | None) -> None:
        raise TooLong

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = signal.signal(signal.SIGALRM, late)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + BYTES, hard))
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def wrong_with(case: Case, folder: Path) -> str:
    """What is wrong with how a case ended, "" if it worked or was refused in one clear line."""
    status: Any = 0
    text = ""
    try:
        with limited():
            done = case.call(folder)
        if isinstance(done, tuple):
            status, text = done
    except InputError as problem:
        status, text = 2, str(problem)
    except TooLong:
        return f"took more than {SECONDS} s"
    except BaseException as problem:
        return f"{type(problem).__name__}: {str(problem)[:300]}"
    if (folder / MARK).exists():
        return "code of the file was run"
    if status == 0:
        return "accepted" if case.refused else ""
    if status != 2 or not text.strip() or "Traceback" in text:
        return f"status {status}: {text[:300]}"
    return f"message: {text[:300]!r}" if "\n" in text.strip() or len(text) > LETTERS else ""
