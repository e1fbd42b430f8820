"""The one error that users' input can cause, what it says of a name that nobody knows, and how signals stop a command."""

import signal
import sys
import threading
import traceback
import weakref
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path

#: Similarity (`difflib.SequenceMatcher.ratio`) from which on a name counts as a misspelling of another.
SIMILAR = 0.5
#: Letters of a message, and of a value shown in it.
MESSAGE, VALUE = 1200, 80
#: Time after which an interruption whose exception is gone counts as lost, s: what ends by it is done by then.
LOST = 1.0


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, row or key and says what would be right.

    The command line prints it as `error: ...` and exits with status 2. Whatever a message quotes, it stays one line that can
    be printed, of at most `MESSAGE` letters.
    """

    def __init__(self, message: object) -> None:
        super().__init__(_cut(_printable(" ".join(str(message).split())), MESSAGE))


def shown(value: object) -> str:
    """A value as an error quotes it: its `repr`, cut to `VALUE` letters."""
    try:
        text = repr(value[: 2 * VALUE] if isinstance(value, str | bytes) else value)
    except Exception:  # nested without end, a whole number of thousands of digits, a class of the user's
        text = f"a value of type {type(value).__name__}"
    return _cut(text, VALUE)


def _cut(text: str, most: int) -> str:
    """The text, or its beginning and its end where it is longer."""
    return text if len(text) <= most else f"{text[: most - most // 4]} ... {text[-(most // 4) :]}"


def _printable(text: str) -> str:
    """The text with what no terminal shows written as an escape."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputWarning(UserWarning):
    """Input that is used, although it looks wrong: one line like that of an `InputError`."""


def place_of(problem: BaseException) -> str:
    """`file.py line 12`, where code from outside of this package raised an error, "" where none did; of code that calls other
    code of its own file the innermost line. Installed libraries and Python's own do not count.
    """
    ours = str(Path(__file__).parent), str(Path(traceback.__file__).parent), "<"
    outside = [
        frame
        for frame in traceback.extract_tb(problem.__traceback__)
        if not frame.filename.startswith(ours) and "site-packages" not in frame.filename
    ]
    lines = [frame.lineno for frame in outside if frame.filename == outside[0].filename]
    return f"{outside[0].filename} line {lines[-1]}" if outside else ""


def described(problem: BaseException) -> str:
    """Any error in a line: its class, its text, cut to 300 letters, and where code from outside of this package raised it."""
    place = f" ({found})" if (found := place_of(problem)) else ""
    return f"{type(problem).__name__}: {' '.join(str(problem).split())}"[:300] + place


def nearest(word: object, known: Iterable[str]) -> str | None:
    """The known name that `word` is most like, upper and lower case alike; None where none is like it."""
    folded = {name.lower(): name for name in known}
    near = get_close_matches(
        (word if isinstance(word, str) else shown(word))[:VALUE].lower(), folded, n=1, cutoff=SIMILAR
    )
    return folded[near[0]] if near else None


def suggestion(word: object, known: Iterable[str]) -> str:
    """What an error says of an unknown name: "did you mean 'x'?", or "known are a, b" where no known one is like it."""
    names = list(known)
    near = nearest(word, names)
    return f"did you mean {near!r}?" if near else f"known are {', '.join(names)}"


def check_known(what: str, names: Iterable[object], known: Collection[str]) -> None:
    """InputError for the first of some names that is not known: "WHAT 'x': did you mean 'y'?"."""
    for name in names:
        if name not in known:
            raise InputError(f"{what} {shown(name)}: {suggestion(name, known)}")


@contextmanager
def located(where: object) -> Iterator[None]:
    """Puts a file, or a place in one, in front of every InputError: who finds what is wrong need not know where it stands."""
    try:
        yield
    except InputError as problem:
        raise InputError(f"{where}: {problem}") from None


def to_install(extra: str) -> str:
    """How to install an extra of this package, which is on no index: from its sources."""
    return f"in the folder of hydro_env's sources, pip install -c constraints.txt '.[{extra}]'"


class _Stop(KeyboardInterrupt):
    """What a signal raises; unlike a KeyboardInterrupt it tells when it is gone."""


@contextmanager
def stopped_by_signals() -> Iterator[list[int]]:
    """SIGTERM and SIGHUP stop what is done here as Ctrl-C does, so that it cleans up; the list then has the signal's number. A
    signal that is ignored (`nohup`) stays so, and so is all but Ctrl-C while it cleans up.

    Compiled code drops exceptions (numba's dispatcher, finalizers), and the work would go on. An interruption that is gone
    while it does is raised again.
    """
    came: list[int] = []
    defaults = {"SIGINT": signal.default_int_handler, "SIGTERM": signal.SIG_DFL, "SIGHUP": signal.SIG_DFL}
    before = {getattr(signal, name): action for name, action in defaults.items() if hasattr(signal, name)}
    if threading.current_thread() is not threading.main_thread():
        before = {}  # where Python lets no signal be handled
    ours = {number: action for number, action in before.items() if signal.getsignal(number) == action}
    raised: list[weakref.ref[_Stop]] = []
    again: list[threading.Timer] = []
    unraisable = sys.unraisablehook

    def stop(number: int, frame: object) -> None:
        if came and number != signal.SIGINT:
            return
        came.append(number)
        raise new()

    def new() -> _Stop:  # a function, since a variable of `stop` would keep it
        interruption = _Stop()
        raised[:] = [weakref.ref(interruption, gone)]
        return interruption

    def gone(_: object) -> None:
        again[:] = [threading.Timer(LOST, once_more)]
        again[0].daemon = True
        again[0].start()

    def once_more() -> None:
        number = came.pop()
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, number)  # wakes it, too
        else:
            signal.raise_signal(number)

    def tell(lost: "sys.UnraisableHookArgs") -> None:
        if not isinstance(lost.exc_value, _Stop):
            unraisable(lost)

    for number in ours:
        signal.signal(number, stop)
    sys.unraisablehook = tell
    try:
        yield came
    finally:
        raised.clear()  # and with it what would happen when the exception is gone
        for timer in again:
            timer.cancel()
        sys.unraisablehook = unraisable
        for number, action in ours.items():
            signal.signal(number, action)
