"""A diagnosis in a process of its own: started, watched, cancelled. One runs at a time."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError

__all__ = ["Job", "Jobs"]

#: Seconds that a process which was asked to end may take.
PATIENCE = 5.0


@dataclass(frozen=True)
class Job:
    """How a task stands. `state` is "running", "done", "failed" or "cancelled"."""

    what: str
    state: str = "running"
    stage: str = "starting"
    share: float = 0.0
    """Of the stages that are over, 0 to 1."""
    simulations: int = 0
    warnings: tuple[str, ...] = ()
    problem: str = ""
    result: Mapping[str, Any] | None = None
    folder: str = ""
    """Name of the folder of results, below the one of all."""


class Jobs:
    """Runs tasks of `diagnosis_process`, the results of each in a new folder below `out`: `diagnosis_1`, `diagnosis_2`, ..."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._process: subprocess.Popen[str] | None = None
        self._thread: threading.Thread | None = None
        self._cancelled = False
        self.latest: Job | None = None

    def start(self, what: str, fit: Sequence[Path], held_out: Sequence[Path] = (), model: str = "paper",
              mapping: Path | None = None) -> None:  # fmt: skip
        """Starts a task, "diagnose" or "inspect". InputError while another one runs, or if `out` cannot be written."""
        if self.running:
            raise InputError("a diagnosis is running; cancel it first")
        try:
            self._out.mkdir(parents=True, exist_ok=True)
            # In its place only when it is complete.
            work = Path(tempfile.mkdtemp(prefix=".diagnosis-", dir=self._out))
        except OSError as problem:
            raise InputError(f"--out {self._out}: cannot write there ({problem.strerror})") from None
        task = {"what": what, "fit": [*map(str, fit)], "held_out": [*map(str, held_out)], "model": model,
                "mapping": None if mapping is None else str(mapping), "out": str(work)}  # fmt: skip
        self._cancelled = False
        self.latest = Job(what)
        command = [sys.executable, "-m", "hydro_env.lab.diagnosis_process"]
        # A group of its own: Ctrl-C at the terminal is for the page, which then ends this one.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        self._thread = threading.Thread(target=self._follow, args=(task, work), name="diagnosis", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether a task is at work."""
        return self._thread is not None and self._thread.is_alive()

    def cancel(self) -> None:
        """Ends the task that runs; nothing is left of it."""
        self._cancelled = True
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(PATIENCE)
            self._process.kill()
        if self._thread is not None:
            self._thread.join()

    # --- in the thread that follows the process -------------------------------------------------------------------
    def _follow(self, task: dict[str, Any], work: Path) -> None:
        process, job = self._process, self.latest
        assert process is not None and job is not None
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        said: list[str] = []
        listener = threading.Thread(target=lambda: said.extend(process.stderr), daemon=True)  # type: ignore[arg-type]
        listener.start()
        with suppress(BrokenPipeError), process.stdin as pipe:
            pipe.write(json.dumps(task) + "\n")
        for line in process.stdout:
            job = self.latest = _after(job, json.loads(line))
        process.wait()
        listener.join()
        try:
            ended = self._ended(job, work, said)
        except OSError as problem:
            ended = replace(job, state="failed", problem=f"{self._out}: {problem.strerror}")
        # Nothing may be left of the work when the end is told.
        shutil.rmtree(work, ignore_errors=True)
        self.latest = ended

    def _ended(self, job: Job, work: Path, said: list[str]) -> Job:
        if self._cancelled:
            return replace(job, state="cancelled", stage="cancelled")
        if job.problem:
            return replace(job, state="failed")
        if job.result is None:
            last = said[-1].strip() if said else "it ended without a word"
            return replace(job, state="failed", problem=str(InputError(f"the diagnosis failed: {last}")))
        folder = ""
        if any(work.iterdir()):
            number = 1
            while (place := self._out / f"diagnosis_{number}").exists():
                number += 1
            work.chmod(0o755)
            work.rename(place)
            folder = place.name
        return replace(job, state="done", stage="done", share=1.0, folder=folder)


def _after(job: Job, answer: Mapping[str, Any]) -> Job:
    """The job after an answer of the process."""
    if "error" in answer:
        return replace(job, problem=str(answer["error"]))
    if "warning" in answer:
        return replace(job, warnings=(*job.warnings, str(answer["warning"])))
    if "stage" in answer:
        share = max(0, answer["number"] - 1) / answer["of"]
        return replace(job, stage=answer["stage"], share=share, simulations=answer["simulations"])
    return replace(job, result=answer)
