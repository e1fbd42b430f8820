"""Logs and parts of logs: which rows a diagnosis may fit to, and which stay sealed.

A log is named by its path; `PATH@FROM:TO` (seconds of the log's own clock, either may be left out) names a part of
it. `PATH@0:13,23:34` names two windows of one run. A run is always simulated from its beginning with all logged
commands, so that the state at a window's beginning is the simulated one; only the measurements inside the windows count.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..measured import Mapping, RigLog, load_mapping, read_log

__all__ = ["Part", "overlap", "read_parts"]


@dataclass(frozen=True)
class Part:
    """A run on an even grid, cut at the end of the last window; `inside` (T,) marks the rows that count."""

    label: str
    log: RigLog
    inside: np.ndarray
    windows: tuple[tuple[float, float], ...]

    @property
    def seconds(self) -> float:
        return float(self.inside.sum()) * self.log.period


def read_parts(words: Iterable[str | Path], mapping: Mapping | str | Path | None) -> list[Part]:
    """Reads `PATH[@FROM:TO[,FROM:TO...]]` words. InputError for a bad log, window or clock."""
    if mapping is not None and not isinstance(mapping, Mapping):
        mapping = load_mapping(mapping)
    read: dict[str, RigLog] = {}
    parts = []
    for word in words:
        path, windows = _split(str(word))
        if path not in read:
            read[path] = _even(_whole(path, read_log(path, mapping)))
        parts.append(_cut(str(word), read[path], windows))
    return parts


def _split(word: str) -> tuple[str, list[tuple[float, float]]]:
    path, at, text = word.rpartition("@")
    if not at or Path(word).exists():
        return word, [(-np.inf, np.inf)]
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


def _whole(path: str, log: RigLog) -> RigLog:
    """The log, if its clock does not jump: nobody knows what the rig did meanwhile, so nothing after it can be simulated."""
    for finding in log.findings:
        if finding.code == "clock_jump":
            row = "" if finding.row is None else f"row {finding.row}, "
            raise InputError(
                f"{path}: {row}column {finding.column!r}: {finding.message}; {finding.suggestion}"
            )
    return log


def _even(log: RigLog) -> RigLog:
    return log if log.uniform else log.resample(log.period)


def _cut(word: str, log: RigLog, windows: list[tuple[float, float]]) -> Part:
    time = log.time_s
    inside = np.zeros(len(log), bool)
    for start, end in windows:
        rows = (time >= start) & (time < end)
        if rows.sum() < 20:
            raise InputError(
                f"{word}: only {int(rows.sum())} rows between {start:g} and {end:g} s; "
                f"the log runs from {time[0]:g} to {time[-1]:g} s"
            )
        inside |= rows
    last = int(np.flatnonzero(inside)[-1]) + 1
    if last < len(log):
        log = log.window(time[0], time[last])
    shown = tuple((max(a, float(time[0])), min(b, float(time[-1]))) for a, b in windows)
    return Part(word, log, inside[: len(log)], shown)


def overlap(fit: Iterable[Part], sealed: Iterable[Part]) -> None:
    """InputError if a row counts both for the fit and for the proof."""
    for a in fit:
        for b in sealed:
            if a.log.sha256 == b.log.sha256:
                n = min(len(a.inside), len(b.inside))
                if (a.inside[:n] & b.inside[:n]).any():
                    raise InputError(
                        f"{b.label} is sealed but shares rows with {a.label}, which is fitted; name parts that are apart"
                    )
