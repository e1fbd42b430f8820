"""A diagnosis in a process of its own: started, watched, cancelled. One runs at a time."""

import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError, InputWarning, to_install

#: Spawned: neither the threads of the server nor those of Numba survive a fork.
_CONTEXT = multiprocessing.get_context("spawn")
#: Logs, each a file or with `@FROM:TO` a part of one.
Logs = Sequence[str | Path]


@dataclass(frozen=True)
class Job:
    """How a task stands. `state` is "running", "done", "failed" or "cancelled"."""

    state: str = "running"
    stage: str = "starting"
    #: Of the stages that are over, 0 to 1.
    share: float = 0.0
    simulations: int = 0
    warnings: tuple[str, ...] = ()
    problem: str = ""
    #: The words "verdict" and "summary" of a diagnosis, "text" and "mapping" of an inspection.
    result: Mapping[str, Any] | None = None
    #: Name of the folder of results, below the one of all.
    folder: str = ""


class Jobs:
    """Runs tasks, the results of each in a new folder below `out`: `diagnosis_1`, `diagnosis_2`, ..."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._process: Any = None
        self._thread: threading.Thread | None = None
        self._cancelled = False
        self.latest: Job | None = None

    def start(self, what: str, fit: Sequence[Path], held_out: Sequence[Path] = (), model: str = "paper",
              mapping: Path | None = None) -> None:  # fmt: skip
        """Starts to "diagnose" or "inspect" logs. InputError while another one runs, or if `out` cannot be written."""
        if self.running:
            raise InputError("a diagnosis is running; cancel it first")
        try:
            self._out.mkdir(parents=True, exist_ok=True)
            # In its place only when it is complete.
            work = Path(tempfile.mkdtemp(prefix=".diagnosis-", dir=self._out))
        except OSError as problem:
            raise InputError(f"--out {self._out}: cannot write there ({problem.strerror})") from None
        self._cancelled, self.latest = False, Job()
        messages, writer = _CONTEXT.Pipe(duplex=False)
        task = {"diagnose": _diagnose, "inspect": _inspect}[what]
        given = {"fit": fit, "held_out": held_out, "model": model, "mapping": mapping, "out": work}
        self._process = _CONTEXT.Process(target=_do, args=(task, given, writer), daemon=True)
        self._process.start()
        writer.close()  # so that the pipe ends with the process
        self._thread = threading.Thread(
            target=self._follow, args=(messages, work), name="diagnosis", daemon=True
        )
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether a task is at work."""
        return self._thread is not None and self._thread.is_alive()

    def cancel(self) -> None:
        """Ends the task that runs; nothing is left of it."""
        self._cancelled = True
        if self._thread is not None:
            self._process.kill()
            self._thread.join()

    # --- in the thread that follows the process -------------------------------------------------------------------
    def _follow(self, messages: Connection, work: Path) -> None:
        job = Job()
        with suppress(EOFError, OSError):  # the process has ended
            while True:
                changes = messages.recv()
                for counted in changes.keys() & {"warnings", "simulations"}:
                    changes[counted] = getattr(job, counted) + changes[counted]
                job = self.latest = replace(job, **changes)
        self._process.join()
        try:
            ended = self._ended(job, work)
        except OSError as problem:
            ended = replace(job, state="failed", problem=f"{self._out}: {problem.strerror}")
        # Nothing may be left of the work when the end is told.
        shutil.rmtree(work, ignore_errors=True)
        self.latest = ended

    def _ended(self, job: Job, work: Path) -> Job:
        if self._cancelled:
            return replace(job, state="cancelled", stage="cancelled")
        if job.problem or job.result is None:
            died = f"the diagnosis failed: its process ended with status {self._process.exitcode}"
            return replace(job, state="failed", problem=job.problem or died)
        folder = ""
        if any(work.iterdir()):
            place = next(place for n in count(1) if not (place := self._out / f"diagnosis_{n}").exists())
            work.chmod(0o755)
            work.rename(place)
            folder = place.name
        return replace(job, state="done", stage="done", share=1.0, folder=folder)


# --- in the process -----------------------------------------------------------------------------------------------
def _do(task: Callable[..., dict[str, str]], given: dict[str, Any], messages: Connection) -> None:
    """Does a task; each message has the words of `Job` that change, of warnings and simulations those that are new."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which then ends this process
    speaking = threading.Lock()

    def say(**changes: Any) -> None:
        with speaking:  # threads that simulate report as well
            try:
                messages.send(changes)
            except BrokenPipeError:  # nobody waits for the results any more
                os._exit(1)

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, InputWarning):
            say(warnings=(str(message),))

    warnings.simplefilter("once", InputWarning)
    warnings.showwarning = show
    try:
        say(result=task(say, **given))
    except InputError as problem:
        say(problem=str(problem))
    except Exception as problem:
        hint = f"; {to_install('measured,report')}" if isinstance(problem, ModuleNotFoundError) else ""
        say(problem=str(InputError(f"the diagnosis failed: {problem!r}{hint}")))


def _diagnose(
    say: Callable[..., None], fit: Logs, held_out: Logs, model: str, mapping: Path | None, out: Path
) -> dict[str, str]:
    from loky import cpu_count

    from hydro_env.case import command
    from hydro_env.diagnosis import STAGES, workflow

    numbers = {text: number for number, text in enumerate(STAGES.values())}

    def progress(text: str, more: int) -> None:
        say(stage=text, share=numbers.get(text, 0) / len(STAGES), simulations=more)

    if not held_out:
        fit, held_out = _in_two(fit, mapping)
    found = workflow.diagnose(fit, held_out, model, mapping, jobs=cpu_count(), progress=progress)
    say(stage="writing the report", share=1.0 - 1.0 / len(STAGES))
    command.write(found, out)
    return {"verdict": found.verdict, "summary": found.summary()}


def _in_two(fit: Logs, mapping: Path | None) -> tuple[Logs, Logs]:
    """With no log held out: the last third of the last log, and the others with the rest of it."""
    from hydro_env.measured import load_mapping, read_log

    log = read_log(fit[-1], None if mapping is None else load_mapping(mapping))
    start, end = float(log.time_s[0]), float(log.time_s[-1])
    cut = start + 2.0 * (end - start) / 3.0
    return [*fit[:-1], f"{fit[-1]}@{start:.6f}:{cut:.6f}"], [f"{fit[-1]}@{cut:.6f}:"]


def _inspect(say: Callable[..., None], fit: Logs, mapping: Path | None, **others: Any) -> dict[str, str]:
    from hydro_env.measured.inspect import shown

    return dict(zip(("text", "mapping"), shown(fit[0], mapping), strict=True))
