"""Logs and parts of logs: which rows a diagnosis may fit to, and which are held out.

A log is named by its path; `PATH@FROM:TO` (seconds of the log's own clock, either may be left out) names a part of
it. `PATH@0:13,23:34` names two windows of one run. A run is simulated from its beginning with all logged
commands, so that the state at a window's beginning is the simulated one; only the measurements inside the windows count.
A log of more than two minutes is taken in windows instead, chosen where none are named (`windows`), each a run of its own.
"""

import hashlib
import itertools
import os
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...measured import Mapping, RigLog, read_log
from ...measured.gate import jump_size
from .windows import LONG_S, WARM_S, choose, rest_starts

#: The windows of a log of which no part is named.
ALL = [(-np.inf, np.inf)]
#: Commands of uneven logs are held on a grid of about this step, s, a quarter of the time constant L / R of the paper's coil:
#: within it the mean of a command does what the command does.
FINE_S = 2.5e-4


@dataclass(frozen=True)
class Part:
    """A run on an even grid, cut at the end of the last window; `inside` (T,) marks the rows that count; `note` says what was
    chosen for the user. If the rows of the log were unevenly spaced, `uneven` is the log as it was recorded, and `held`
    (2, n T, 2) commands and loads on a grid that is n times finer, so that they act from their own times on."""

    label: str
    log: RigLog
    inside: np.ndarray
    note: str = ""
    uneven: RigLog | None = None
    held: np.ndarray | None = None

    @property
    def finer(self) -> int:
        return 1 if self.held is None else self.held.shape[1] // len(self.log)

    @property
    def driving(self) -> tuple[np.ndarray, np.ndarray]:
        """Commands and loads (n, 2) as they were recorded, zero where no load was."""
        log = self.log if self.uneven is None else self.uneven
        return log.command_V, np.zeros(log.command_V.shape) if log.load is None else log.load

    def first(self, rows: int) -> "Part":
        """The part with its first `rows` rows only."""
        held = None if self.held is None else self.held[:, : rows * self.finer]
        return replace(self, log=self.log.first(rows), inside=self.inside[:rows], held=held)

    @property
    def seconds(self) -> float:
        return float(self.inside.sum()) * self.log.period


def read_parts(
    words: Iterable[str | Path | RigLog], mapping: Mapping | str | Path | None, accept: Collection[str] = (),
    read: Callable[[str], RigLog] | None = None,
) -> list[Part]:  # fmt: skip
    """Reads `PATH[@FROM:TO[,FROM:TO...]]` words, or takes logs that are loaded. InputError for a bad log, window or clock,
    and for a log that is surely wrong unless the code of that finding is in `accept`. `read` reads a path, with the same
    mapping, and keeps what it has read."""
    read, parts = read or cache(partial(read_log, mapping=mapping)), []
    for word in words:
        if isinstance(word, RigLog):
            log, windows = _named(word), ALL
            path = name = log.name
        else:
            name = str(word)
            path, windows = split(name)
            log = read(path)
        log = _usable(path, log, windows, accept)
        own = _runs(name, log if log.uniform else log.resample(), windows)
        parts += own if log.uniform else [timed(replace(part, uneven=log)) for part in own]
    return parts


def _named(log: RigLog) -> RigLog:
    """A loaded log with a name and a hash, by which rows that are fitted and held out are distinguished."""
    if log.sha256:
        return log
    content = b"".join(values.tobytes() for values in (log.time_s, log.command_V, log.speed))
    sha256 = hashlib.sha256(content).hexdigest()
    return replace(log, name=log.name or f"log {sha256[:8]}", sha256=sha256)


def timed(part: Part, lead: float | np.ndarray = 0.0, even: bool = False) -> Part:
    """A part of an uneven log with its rows and commands at other times, see `RigLog.resample`."""
    recorded = part.uneven
    assert recorded is not None
    again, finer = recorded.resample(lead, even), max(1, round(part.log.period / FINE_S))
    first = round((part.log.time_s[0] - again.time_s[0]) / part.log.period)
    rows, fine = slice(first, first + len(part.log)), slice(first * finer, (first + len(part.log)) * finer)
    held = [recorded.held(np.nan_to_num(values), lead, even, finer)[fine] for values in part.driving]
    load, late = (None if values is None else values[rows] for values in (again.load, again.late))
    log = replace(part.log, command_V=again.command_V[rows], load=load, late=late)
    return replace(part, held=np.array(held), log=log)


def _runs(word: str, log: RigLog, windows: list[tuple[float, float]]) -> list[Part]:
    ends = [min(end, float(log.time_s[-1]) + log.period) for _, end in windows]
    if max(ends) - log.time_s[0] <= LONG_S:
        return [_cut(word, log, windows)]
    resting = log.time_s[rest_starts(log)]
    parts = []
    for (start, _), end in zip(windows, ends, strict=True):
        start = max(start, float(log.time_s[0]))
        chosen, notes = [(start, end, False)], []
        if end - start > LONG_S:
            chosen = choose(log, start, end)
            shown = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b, _ in chosen)
            seconds = f"{end - start:.6g} s are too long to simulate"
            notes.append(f"{seconds}; looked at {shown}, where the commands move most")
        for a, b, at_rest in chosen:
            before = resting[(resting <= a) & (resting >= a - LONG_S)]
            begin = a if at_rest or not before.size else float(before[-1])
            known = at_rest or bool(before.size) or a <= log.time_s[0]
            if not known:
                notes.append(f"nothing rests before {a:.6g} s, so the first {WARM_S:g} s there do not count")
            part = _cut(word, log.window(begin, b), [(a if known else a + WARM_S, b)])
            parts.append(replace(part, note=f"{word}: {'; '.join(notes)}" if notes else ""))
            notes = []
    return parts


def split(word: str) -> tuple[str, list[tuple[float, float]]]:
    """`PATH@FROM:TO,...` as the path and its windows, s; InputError for a window that is none."""
    path, at, text = word.rpartition("@")
    if not at or os.path.exists(word):  # also False of a name that is too long
        return word, ALL
    windows = []
    for piece in text.split(","):
        start, colon, end = piece.partition(":")
        try:
            window = (float(start) if start else -np.inf, float(end) if end else np.inf)
        except ValueError:
            colon = ""
        if not colon or not window[0] < window[1]:
            raise InputError(f"{word}: window {piece!r} is not FROM:TO in seconds, e.g. {path}@0:25")
        windows.append(window)
    return path, windows


def _usable(path: str, log: RigLog, windows: list[tuple[float, float]], accept: Collection[str]) -> RigLog:
    """The log, if nothing is surely wrong with it: what a diagnosis finds would be that mistake.

    Nobody knows what the rig did while the clock jumped: only the stretch without a jump that holds all windows is given.
    """
    wrong = [finding for finding in log.findings if finding.sure and finding.code not in accept]
    for finding in wrong:
        if finding.code == "clock_jump":
            steps = np.diff(log.time_s)
            jumps = np.flatnonzero(steps > jump_size(log.time_s))
            edges = [-np.inf, *(0.5 * (log.time_s[jumps] + log.time_s[jumps + 1])), np.inf]
            first, last = min(w[0] for w in windows), max(w[1] for w in windows)
            for start, end in itertools.pairwise(edges):
                if start <= first and last <= end:
                    return log.window(start, end)
        row = "" if finding.row is None else f"row {finding.row}: "
        named = finding.column is None or repr(finding.column) in finding.message
        place = row + ("" if named else f"column {finding.column!r}: ")
        way_out = "" if finding.code == "clock_jump" else f"; if it is right, --accept {finding.code}"
        raise InputError(f"{path}: {place}{finding.text}{way_out}")
    return log


def _cut(word: str, log: RigLog, windows: list[tuple[float, float]]) -> Part:
    time = log.time_s
    inside = np.zeros(len(log), bool)
    for start, end in windows:
        rows = (time >= start) & (time < end)
        if rows.sum() < 20:
            only = f"only {int(rows.sum())} rows between {start:g} and {end:g} s"
            raise InputError(f"{word}: {only}; the log runs from {time[0]:g} to {time[-1]:g} s")
        inside |= rows
    last = int(np.flatnonzero(inside)[-1]) + 1
    if last < len(log):
        log = log.window(time[0], time[last])
    return Part(word, log, inside[: len(log)])


def overlap(fit: Iterable[Part], sealed: Iterable[Part]) -> None:
    """InputError if a row counts both for the fit and for the proof."""
    for a, b in itertools.product(fit, sealed):
        mine, other = (np.round(p.log.time_s[p.inside] / p.log.period) for p in (a, b))
        if a.log.sha256 == b.log.sha256 and np.intersect1d(mine, other).size:
            raise InputError(
                f"{b.label} is sealed but shares rows with {a.label}, which is fitted; name parts apart"
            )


def filled(values: np.ndarray) -> np.ndarray:
    """Samples (n,) with holes filled along straight lines, so that a simulation or a filter runs through them."""
    known = np.isfinite(values)
    if known.all():
        return values
    rows = np.arange(values.size)
    return np.interp(rows, rows[known], values[known]) if known.any() else np.zeros(values.size)
