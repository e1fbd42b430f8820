"""The loop: a sample comes, the driver wants commands, the supervisor limits them, they are written and logged.

The driver works in a thread of its own, so that one that hangs cannot keep zero from being written.
"""

import asyncio
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from hydro_env.errors import InputError, place_of
from hydro_env.live.driver import Driver
from hydro_env.live.link import Link, Sample
from hydro_env.live.log import Log
from hydro_env.live.supervisor import PATIENCE, State, Supervisor
from hydro_env.live.transports import OpcUa, Transport, Udp

#: Seconds after a fault that are still logged, and between two tries to reach a rig that is lost.
LOGGED_AFTER, AGAIN = 5.0, 1.0
#: How often zero is written in the end: a datagram may be lost.
ZEROS = 3


class Run:
    """A rig under a driver, from the connection to the last zero. `told(text)` gets a line for every change of the state.

    link, driver  what is driven, and by what
    rated_V       commands of 1 in V, for the log
    limit         largest command as a share of the rated one; that of the link unless given
    duration      s; None for no end but the driver's
    """

    def __init__(
        self, link: Link, driver: Driver, out: Path, rated_V: tuple[float, float], *, limit: float | None = None,
        duration: float | None = None, told: Callable[[str], None] = print,
    ) -> None:  # fmt: skip
        self.link, self.driver, self.told, self.limit = link, driver, told, limit
        self.duration = np.inf if duration is None else duration
        played = ["setpoint"] if driver.setpoint else []
        self._log_of = lambda: Log(out, {*link.inputs, *played}, rated_V)
        self.stop = threading.Event()  # ends the run, from any thread
        self._beat, self._cycle, self._behind = 0, 0, 0.0
        self._began: float | None = None  # by the rig's clock, if it has one, as the next
        self._first: float | None = None
        self._logged, self._shown = np.zeros(2), ""

    def __call__(self) -> str:
        """Runs until the driver's end, a signal (Ctrl-C, SIGTERM, SIGHUP) or `stop`, also after a fault, whose cause it returns;
        "" without one. InputError if the rig cannot be reached."""
        return asyncio.run(self._run())

    async def _run(self) -> str:
        self._listen()
        transport = Udp(self.link) if self.link.protocol == "udp" else OpcUa(self.link)
        try:
            await transport.open(PATIENCE)
        except OSError as problem:
            with suppress(OSError):
                await transport.close()
            raise InputError(f"{self.link.address}: cannot be reached: {_said(problem)}") from None
        self.log = self._log_of()
        self.told(f"log: {self.log.path}")
        self._born = time.monotonic()
        self.supervisor = Supervisor(self.link, self._born, self.limit)
        try:
            await self._drive(transport)
        finally:  # whatever happened, interruptions and a full disk included
            self.supervisor.stop(time.monotonic())
            for _ in range(ZEROS):
                with suppress(OSError):
                    await self._send(transport)
                await asyncio.sleep(self.link.cycle_s)
            self._tell()
            await transport.close()
            self.log.close()
        return self.supervisor.cause

    def _listen(self) -> None:
        """Takes Ctrl-C and the like for `stop`, where the system lets an event loop do that."""
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            with suppress(NotImplementedError, RuntimeError, ValueError, AttributeError):
                asyncio.get_running_loop().add_signal_handler(getattr(signal, name), self.stop.set)

    async def _drive(self, transport: Transport) -> None:
        supervisor, worker = self.supervisor, _Worker(self.driver.act)
        while not self.stop.is_set():
            self._tell()
            sample, new = None, False
            try:
                sample = await self._receive(transport)
                new = supervisor.see(time.monotonic(), sample)
                if new and sample is not None and supervisor.state is State.RUNNING:
                    if self._at_end(sample):
                        return
                    await self._take(worker, sample)
                await self._send(transport)
            except OSError as problem:
                await self._lost(transport, problem)
            self._write(sample if new else None)

    async def _receive(self, transport: Transport) -> Sample | None:
        supervisor, link = self.supervisor, self.link
        left = link.watchdog_s if supervisor.over else supervisor.deadline - time.monotonic()
        try:
            raw = await transport.receive(max(left, link.cycle_s))
        except InputError as problem:
            supervisor.fail(time.monotonic(), problem)
            raw = None
        return None if raw is None else link.sample(raw)

    def _at_end(self, sample: Sample) -> bool:
        """Numbers the cycle of a sample. Whether the run is over."""
        clock = time.monotonic() if sample.time is None else sample.time
        if self._began is None:
            self._began = clock
        self._cycle = max(0, round((clock - self._began) / self.link.cycle_s))
        cycles = np.inf if self.driver.cycles is None else self.driver.cycles
        return clock - self._began >= self.duration or self._cycle >= cycles

    async def _take(self, worker: "_Worker", sample: Sample) -> None:
        """Asks the driver, for as long as the watchdog allows."""
        supervisor, most = self.supervisor, self.link.watchdog_s
        try:
            wanted = await asyncio.wait_for(worker.ask(self._cycle, sample, supervisor.command), most)
        except TimeoutError:
            supervisor.fail(time.monotonic(), f"the controller gave no command within {most:g} s")
        except Exception as problem:
            place = place_of(problem)
            supervisor.fail(time.monotonic(), f"the controller failed: {problem!r}{place and f' ({place})'}")
        else:
            supervisor.take(time.monotonic(), wanted)

    async def _send(self, transport: Transport) -> None:
        self._beat = (self._beat + 1) % 2**15
        await transport.send(self.link.outputs(self.supervisor.command, self._beat), self.link.watchdog_s)

    async def _lost(self, transport: Transport, problem: OSError) -> None:
        """A fault; and the rig is called again, so that it gets its zero."""
        self.supervisor.fail(time.monotonic(), f"connection lost: {_said(problem)}")
        self._tell()
        await transport.close()
        with suppress(OSError, InputError):
            await transport.open(AGAIN)
            return
        await asyncio.sleep(AGAIN)

    # --- what is told -------------------------------------------------------------------------------------------------
    def _write(self, sample: Sample | None) -> None:
        """A row for a new sample, and where a command has changed without one."""
        supervisor, now = self.supervisor, time.monotonic()
        command, running = supervisor.command, supervisor.state is State.RUNNING
        if now > supervisor.ended + LOGGED_AFTER or (sample is None and (command == self._logged).all()):
            return
        clock = now - self._behind if sample is None or sample.time is None else sample.time
        values = {} if sample is None else dict(sample.values)
        if self._first is None:
            self._first, self._behind = clock, now - clock
        if self.driver.setpoint is not None and sample is not None:
            values["setpoint"] = self.driver.setpoint(self._cycle) if running else 0.0
        self.log.row(clock - self._first, command, values)
        self._logged = command

    def _tell(self) -> None:
        supervisor, now = self.supervisor, time.monotonic()
        if supervisor.state is not self._shown:
            self._shown = supervisor.state
            self.log.event(state=supervisor.state, cause=supervisor.cause, after_s=round(now - self._born, 3))
            end = f": {supervisor.cause}; zero is written until Ctrl-C" if supervisor.cause else ""
            self.told(f"{supervisor.state}{end}")


def _said(problem: OSError) -> str:
    return problem.strerror or str(problem) or "no answer in time"


class _Worker:
    """Calls a function in a thread of its own, one call after the other."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._calls: SimpleQueue[tuple[Future[Any], tuple[Any, ...]]] = SimpleQueue()
        threading.Thread(target=self._work, name="driver", daemon=True).start()

    def ask(self, *arguments: Any) -> asyncio.Future[Any]:
        """What the function returns, or raises."""
        answer: Future[Any] = Future()
        self._calls.put((answer, arguments))
        return asyncio.wrap_future(answer)

    def _work(self) -> None:
        while True:
            answer, arguments = self._calls.get()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(self._function(*arguments))
            except BaseException as problem:  # a controller of the user's may raise anything
                answer.set_exception(
                    problem if isinstance(problem, Exception) else RuntimeError(repr(problem))
                )
