"""The commands in the order in which `--help` lists them; runs one of them and turns whatever happens into an exit status and
one line.

Exit status: 0 done; 2 bad input or a folder that cannot be written, with one line on stderr; 130 interrupted, 143 by SIGTERM.
"""

import gc
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any, NoReturn, TextIO

import typer

from hydro_env import __version__
from hydro_env.cli.components import describe, valve_test
from hydro_env.cli.controllers import benchmark, dataset, train, tune
from hydro_env.cli.diagnosis import diagnose, hide
from hydro_env.cli.experiments import close_loop, demo, naming_benchmark, pdf, reproduce, speed
from hydro_env.cli.export import export
from hydro_env.cli.help import HelpfulCommand, HelpfulGroup
from hydro_env.cli.listing import list_names
from hydro_env.cli.live import lab, live
from hydro_env.errors import InputError, InputWarning, place_of, shown, stopped_by_signals, to_install

#: Objects that are made before Python looks for cyclic garbage, 700 by default. Imports, Numba and fits make many that stay, and
#: to search them again and again takes longer than what there is to find is worth.
GARBAGE = 1_000_000
#: Which optional libraries an extra of the package holds.
EXTRAS = {
    "report": "plotly jinja2 matplotlib",
    "measured": "pandas asammdf nptdms",
    "render": "pygame",
    "agents": "torch filelock tensorboard stable_baselines3 sb3_contrib onnx onnxruntime",
    "ray": "ray",
    "fmu": "fmpy",
    "lab": "nicegui fastapi uvicorn",
    "live": "asyncua",
}

app = typer.Typer(
    cls=HelpfulGroup,
    add_completion=False,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Synchronise two hydraulic motors, each driven by its own proportional valve.",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"hydro_env {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


for _command in (
    demo, describe, reproduce, valve_test, speed, tune, train, benchmark, dataset, hide, diagnose, lab, live, close_loop,
    pdf,
):  # fmt: skip
    app.command(_command.__name__.replace("_", "-"), cls=HelpfulCommand)(_command)
app.add_typer(export, name="export")
app.add_typer(naming_benchmark, name="naming-benchmark")
app.command("list", cls=HelpfulCommand)(list_names)


class _PatientOutput:
    """Standard output or error that nobody needs to read to the end (`hydro-env ... | head`): what a command is for is the files
    in `--out`, so it goes on. A full disk behind standard output is an OSError that says so."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Writes, or does nothing once the reader has gone."""
        self._as_far_as_read(partial(self._stream.write, text))
        return len(text)

    def flush(self) -> None:
        """The same for what is still in the buffer."""
        self._as_far_as_read(self._stream.flush)

    def _as_far_as_read(self, work: Callable[[], object]) -> None:
        try:
            work()
        except OSError as problem:
            # What the buffer holds is written again when the process ends, so the pipe itself is replaced.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if self._stream.fileno() == 1 and not isinstance(problem, BrokenPipeError):
                raise OSError(problem.errno, problem.strerror, "standard output") from None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


INTERRUPTED = "interrupted; nothing half-written is left in --out"


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs one command and ends the process with its exit status."""
    gc.set_threshold(GARBAGE)
    _open_what_is_closed()
    sys.stdout, sys.stderr = _PatientOutput(sys.stdout), _PatientOutput(sys.stderr)  # type: ignore[assignment]
    with stopped_by_signals() as signals:
        try:
            status = run(arguments)
        except Exception:  # what an interruption became in somebody's C code
            if not signals:
                raise
            status = _fail(INTERRUPTED)
    if signals:
        status = 128 + signals[0]
        # CPython ends by SIGINT, whatever the status, if the last code that was run from text was interrupted.
        exec("")
    try:
        sys.stdout.flush()
    except OSError as problem:
        status = _fail(f"{problem.filename}: {problem.strerror}")
    gc.freeze()  # the end of the process would go through everything for garbage once more
    sys.exit(status)


def _open_what_is_closed() -> None:
    """Leads nowhere what was closed before the process began (`>&-`): else the next file that is opened would take its place, and
    get what libraries and other processes write there."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the least free number is this one
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


def run(arguments: Sequence[str] | None) -> int:
    """Runs one command (`sys.argv` for None); its exit status."""
    with warnings.catch_warnings():
        warnings.simplefilter("once", InputWarning)
        others = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                print(f"warning: {message}", file=sys.stderr)
            else:
                others(message, category, *where, **more)

        warnings.showwarning = show
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    try:
        given = sys.argv[1:] if arguments is None else list(arguments)
        for word in given:
            if not word.isprintable() and any(c == "\0" or "\ud800" <= c <= "\udfff" for c in word):
                raise InputError(f"the argument {shown(word)} is no UTF-8 text; rename what it names")
        many = ("--controllers",) if given[:1] == ["benchmark"] else ("--sealed", "--held-out")
        status = app(args=spread(given, many), prog_name="hydro-env", standalone_mode=False)
    except InputError as problem:
        return _fail(problem)
    except (KeyboardInterrupt, typer.Abort):
        return _fail(INTERRUPTED, status=130)
    except ModuleNotFoundError as problem:
        library = (problem.name or "").partition(".")[0]
        for extra, libraries in EXTRAS.items():
            if library in libraries.split():
                return _fail(f"this needs {problem.name}: {to_install(extra)}")
        raise
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        return _fail(f"{where}{problem.strerror or problem}")
    except SystemExit as problem:  # nothing of ours: code of the user's
        return _fail(f"{place_of(problem)}: sys.exit({problem.code!r}) where it should only return")
    except Exception as problem:
        usage = getattr(problem, "format_message", None)  # typer's own errors: an unknown option, ...
        if usage is None:
            from hydro_env.jit import removed_if_damaged  # which loads Numba

            if folder := removed_if_damaged(problem):
                return _fail(
                    f"{folder}: damaged machine code was removed; the same command compiles it again"
                )
            raise
        context = getattr(problem, "ctx", None)
        return _fail(f"{usage()} Try `{context.command_path if context else 'hydro-env'} --help`.")
    if status == 130:  # typer turns an interruption into this
        return _fail(INTERRUPTED, status=130)
    return status if isinstance(status, int) else 0


def spread(arguments: list[str], options: Sequence[str]) -> list[str]:
    """`--sealed A B` as `--sealed A --sealed B`: options of typer take one value each."""
    spread: list[str] = []
    option = ""
    for word in arguments:
        if word in options:
            option = word
        elif word.startswith("-"):
            option = ""
        elif option and spread[-1] != option:
            spread.append(option)
        spread.append(word)
    return spread


def _fail(problem: object, status: int = 2) -> int:
    print(f"error: {InputError(problem)}", file=sys.stderr)  # whatever it was, one line that can be printed
    return status
