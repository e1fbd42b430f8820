"""What is written to the valves: a state machine of samples and time, which knows neither clock nor network.

    waiting   zero, until `START` good samples have come at the cycle's pace
    running   what the driver wants, within the limits of command and rate
    fault     zero, for good: only a new start of the program leaves it
    stopped   zero, for good: the run is over

Zero is written at once, not along the rate limit.
"""

import math
from enum import StrEnum
from typing import Any

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.errors import InputError, shown
from hydro_env.live.link import Link, Sample

#: Good samples before anything but zero is written, and how far their pace may be from the cycle's.
START, PACE = 10, 0.3
#: How long the first sample may take, s.
PATIENCE = 10.0
#: From how many cycles on a sample is late.
LATE = 2.0
#: By what share two clocks may run apart: more is a delay that grows.
DRIFT = 1e-3


class State(StrEnum):
    WAITING = "waiting"
    RUNNING = "running"
    FAULT = "fault"
    STOPPED = "stopped"


class Supervisor:
    """Watches samples and limits commands. Times `now` are of any clock that never goes back, in s.

    `command` (2,): shares of the rated commands in force. `limit`: the largest; that of the link unless given.
    """

    def __init__(self, link: Link, now: float, limit: float | None = None) -> None:
        self.link, self.limit = link, link.command_limit_percent / 100.0 if limit is None else limit
        self.state, self.cause = State.WAITING, ""
        self.command: Floats = np.zeros(2)
        self.deadline = now + PATIENCE
        self.ended = math.inf  # when the run ended
        self._good, self._begun = 0, now
        self._arrived = self._moved = now
        self._count: float | None = None
        self._refused = 0
        self._delay = math.inf
        self._repeated: dict[str, tuple[float, float]] = {}

    @property
    def over(self) -> bool:
        """Whether zero is all that will be written."""
        return self.state in (State.FAULT, State.STOPPED)

    def fail(self, now: float, cause: object) -> None:
        """A fault."""
        self._end(now, State.FAULT, str(InputError(cause)))  # one line

    def stop(self, now: float) -> None:
        """The end of a run without a fault."""
        self._end(now, State.STOPPED)

    def _end(self, now: float, state: State, cause: str = "") -> None:
        """The first end of a run is kept, with its cause."""
        if not self.over:
            self.state, self.cause, self.command, self.ended = state, cause, np.zeros(2), now

    # --- samples --------------------------------------------------------------------------------------------------
    def see(self, now: float, sample: Sample | None) -> bool:
        """Takes in what came until `now`, None where nothing did. Whether it is a new sample."""
        if sample is None or not self._new(now, sample):
            self._refused += sample is not None
            self._missed(now)
            return False
        self._refused = 0
        if not self.over:
            self._check(now, sample)
            self.deadline, self._arrived = now + self.link.watchdog_s, now
            if self.state is State.WAITING:
                self._wait(now, sample)
        return True

    def _new(self, now: float, sample: Sample) -> bool:
        """Whether a sample is neither an old one nor one that was long under way."""
        if sample.number is not None:
            if not math.isfinite(sample.number):
                self.fail(now, f"{self.link.count!r} is no number")
            elif self._count is not None and sample.number <= self._count:
                return False
            self._count = sample.number
        if sample.time is None:
            return True
        if not math.isfinite(sample.time):
            self.fail(now, "the rig's clock shows no number")
        # The least delay so far is taken for none. It may grow as clocks run apart.
        delay = now - sample.time
        self._delay = min(self._delay + DRIFT * (now - self._arrived), delay)
        return not delay - self._delay > self.link.watchdog_s

    def _missed(self, now: float) -> None:
        if now >= self.deadline:
            others = f"; {self._refused} old or late ones came" if self._refused else ""
            self.fail(now, f"no new sample for {now - self._arrived:.2f} s{others}")
        elif self.link.when_late == "zero" and now - self._arrived > LATE * self.link.cycle_s:
            self.command = np.zeros(2)

    def _check(self, now: float, sample: Sample) -> None:
        """A fault for what no sensor that works shows."""
        for key, source in self.link.inputs.items():
            value = sample.values.get(key, math.nan)
            low, high = source.ends
            if not math.isfinite(value):
                self.fail(now, f"{key} ({source.name!r}) is absent or not finite")
            elif not low <= value <= high:
                self.fail(now, f"{key} is {source.shown(value)}, its range is {source.said}")
            last, since = self._repeated.get(key, (math.nan, now))
            driven = key[-1] in "12" and self.command[int(key[-1]) - 1] != 0.0  # its channel has a command
            if value != last or not driven:
                since = now
            elif now - since > (most := self.link.frozen_after(key)):
                self.fail(now, f"{key} is frozen: {source.shown(value)} for {most:g} s under command")
            self._repeated[key] = value, since

    def _wait(self, now: float, sample: Sample) -> None:
        clock = now if sample.time is None else sample.time
        if self._good == 0:
            self._begun = clock
        self._good += 1
        if self._good > START:
            pace, cycle = (clock - self._begun) / START, self.link.cycle_s
            if abs(pace / cycle - 1.0) > PACE:
                self.fail(now, f"samples come every {pace:.3g} s, cycle_s of the link is {cycle:g}")
            else:
                self.state, self._moved = State.RUNNING, now

    # --- commands -------------------------------------------------------------------------------------------------
    def take(self, now: float, wanted: Any) -> None:
        """Commands (2,) that the driver wants, as shares of the rated ones, within the limits. A fault for what is none."""
        if self.state is not State.RUNNING:
            return
        try:
            shares = np.asarray_chkfinite(wanted, dtype=float).reshape(2)
        except (TypeError, ValueError):
            self.fail(now, f"the controller gave {shown(wanted)}, expected two commands that are finite")
            return
        step = self.link.rate_limit * min(now - self._moved, LATE * self.link.cycle_s)
        bounded = np.clip(shares, -self.limit, self.limit)
        self.command, self._moved = self.command + np.clip(bounded - self.command, -step, step), now
