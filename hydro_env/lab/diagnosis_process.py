"""What a process of `jobs` does: reads a task from stdin, says on stdout what it is doing, writes the results to a folder.

The task is a line of JSON, the words of `Task`. Each line of the answer is JSON too: {"stage", "number", "of", "simulations"}
while it works, {"warning"}, and at last {"verdict", "summary"}, {"text", "mapping"} or {"error"}.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError, InputWarning, to_install

__all__ = ["main"]

Say = Callable[..., None]


def diagnose(task: Mapping[str, Any], say: Say) -> None:
    """Diagnoses the logs `task["fit"]` and `task["held_out"]` with `task["model"]` and `task["mapping"]` (or None)."""
    from hydro_env.diagnosis import STAGES, command, workflow

    numbers = {text: number for number, (text, _) in enumerate(STAGES, 1)}
    simulations, counting = 0, threading.Lock()

    def progress(text: str, more: int) -> None:
        nonlocal simulations
        with counting:
            simulations += more
        say(stage=text, number=numbers.get(text, 0), of=len(STAGES), simulations=simulations)

    fit, held_out = task["fit"], task["held_out"]
    if not held_out:
        fit, held_out = _in_two(fit, task["mapping"])
    found = workflow.diagnose(fit, held_out, task["model"], task["mapping"], jobs=_cores(), progress=progress)
    say(stage="writing the report", number=len(STAGES), of=len(STAGES), simulations=simulations)
    command.write(found, Path(task["out"]))
    say(verdict=found.verdict, summary=found.summary())


def _in_two(fit: list[str], mapping: str | None) -> tuple[list[str], list[str]]:
    """With no log held out: the last third of the last log, and the others with the rest of it."""
    from hydro_env.measured import load_mapping, read_log

    if not fit:
        raise InputError("no log; add one to fit")
    log = read_log(fit[-1], None if mapping is None else load_mapping(mapping))
    start, end = float(log.time_s[0]), float(log.time_s[-1])
    cut = start + 2.0 * (end - start) / 3.0
    return [*fit[:-1], f"{fit[-1]}@{start:.6f}:{cut:.6f}"], [f"{fit[-1]}@{cut:.6f}:"]


def inspect(task: Mapping[str, Any], say: Say) -> None:
    """Says how the first log would be read, and proposes a mapping."""
    from hydro_env.measured.inspect import shown

    text, mapping = shown(task["fit"][0], task["mapping"])
    say(text=text, mapping=mapping)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def main() -> None:
    """Does the task that stdin holds."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # what a library prints is no answer

    speaking = threading.Lock()  # threads that simulate report as well

    def say(**answer: Any) -> None:
        with speaking:
            try:
                print(json.dumps(answer), file=answers, flush=True)
            except BrokenPipeError:  # nobody waits for the results any more
                os._exit(1)

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, InputWarning):
            say(warning=str(message))

    warnings.simplefilter("once", InputWarning)
    warnings.showwarning = show
    task = json.loads(sys.stdin.readline())
    try:
        {"diagnose": diagnose, "inspect": inspect}[task["what"]](task, say)
    except InputError as problem:
        say(error=str(problem))
    except ModuleNotFoundError as problem:
        say(error=f"this needs {problem.name}: {to_install('measured,report')}")
    except OSError as problem:
        say(error=str(InputError(f"{problem.filename or 'a file'}: {problem.strerror or problem}")))


if __name__ == "__main__":
    main()
