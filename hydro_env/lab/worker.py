"""The session in a thread of its own, in step with the clock. Whoever asks for a change never waits for it."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from hydro_env.errors import InputError
from hydro_env.lab.rig import PERIOD
from hydro_env.lab.session import Session, Snapshot

#: Pause between two looks at the clock, s.
_PAUSE = 0.01
#: What is further behind the clock, in s of the clock, is not caught up with.
_MAX_BEHIND = 0.1
#: Time over which the speed that is reached is measured, s.
_MEASURED_OVER = 1.0


@dataclass(frozen=True)
class Seen:
    """What a page shows: the session, whether it runs, how many seconds of the rig there are to be in one of the
    clock (`tempo`), and how many there are (`reached`)."""

    session: Snapshot
    running: bool
    tempo: float
    reached: float
    #: Why the last change was refused, "" if it was made.
    refused: str


class Worker:
    """Runs a session. `ask` hands it a change, `seen` is the newest state, `logs` receives finished logs as text."""

    def __init__(self, session: Session, logs: Callable[[str], None] = lambda text: None) -> None:
        self._session, self._logs = session, logs
        self._changes: queue.SimpleQueue[Callable[[Session], None]] = queue.SimpleQueue()
        self._running, self._tempo, self._reached = True, 1.0, 1.0
        self._refused = ""
        self._over = threading.Event()
        self.seen = self._look()
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)

    def start(self) -> None:
        """Begins to run."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread, after the period that it is in."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def ask(self, change: Callable[[Session], None]) -> None:
        """Has a change made between two periods. What is wrong with it stands in `seen.refused` then."""
        self._changes.put(change)

    def pause(self, paused: bool) -> None:
        """Holds the rig's time, or lets it go on."""
        self._running = not paused

    def set_tempo(self, tempo: float) -> None:
        """How many seconds of the rig there are in a second of the clock."""
        self._tempo = tempo

    def _look(self) -> Seen:
        return Seen(self._session.snapshot(), self._running, self._tempo, self._reached, self._refused)

    def _run(self) -> None:
        clock = measured = time.perf_counter()
        owed, done = 0.0, 0
        while not self._over.is_set():
            self._make_changes()
            now = time.perf_counter()
            if self._running:
                owed += (now - clock) * self._tempo
            clock = now
            owed = min(owed, _MAX_BEHIND * self._tempo + PERIOD)
            while owed >= PERIOD and not self._over.is_set() and self._changes.empty():
                self._step()
                owed, done = owed - PERIOD, done + 1
                if time.perf_counter() - clock > _PAUSE:
                    break
            if now - measured >= _MEASURED_OVER:
                self._reached = done * PERIOD / (now - measured)
                measured, done = now, 0
            if self._session.finished_log:
                self._hand_over()
            self.seen = self._look()
            self._over.wait(_PAUSE)

    def _step(self) -> None:
        try:
            self._session.step()
        except Exception as problem:  # none is known; the page would stand still without a word
            self._running, self._refused = False, str(InputError(f"paused: {problem!r}"))

    def _hand_over(self) -> None:
        text, self._session.finished_log = self._session.finished_log, ""
        try:
            self._logs(text)
        except OSError as problem:
            self._refused = f"{problem.filename}: the log was not written ({problem.strerror})"

    def _make_changes(self) -> None:
        while not self._changes.empty():
            self._refused = ""
            try:
                self._changes.get()(self._session)
            except Exception as problem:  # the page has to say it, and the rig runs on
                self._refused = str(InputError(problem))
