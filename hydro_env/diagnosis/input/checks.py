"""Logs that go together: the same channels and signals in all, every channel driven, and nothing fitted that is held out."""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...measured import Mapping, RigLog, read_log
from ...measured.log import HELD
from ...measured.mapping import CHANNEL_SIGNALS
from ..estimation.uncertainty import SHORTEST_S
from .parts import Part, overlap, read_parts

#: A channel stands still if its speed (RMS) is below this share of the other channel's peak: what noise and a shared base move.
STANDS_STILL = 0.02


def read_logs(
    fit: Sequence[str | Path | RigLog], held_out: Sequence[str | Path | RigLog] | None, mapping: Mapping | str | Path | None,
    accept: Collection[str] = (),
) -> tuple[list[Part], list[Part]]:  # fmt: skip
    """The logs to fit and those held out, None where none are wanted. InputError for anything that cannot be used, for rows that
    are in both, and for logs that are too short."""
    if not fit:
        raise InputError("no fit log; name at least one log to fit")
    if held_out is not None and not held_out:
        raise InputError("no held-out log; name at least one with --sealed (or a part of a run, LOG@FROM:TO)")
    read = cache(partial(read_log, mapping=mapping))  # an hour of log whose parts are in both is read once
    parts, proofs = (read_parts(words, mapping, accept, read) for words in (fit, held_out or ()))
    overlap(parts, proofs)
    parts, proofs = _known_signals(*_without_idle(parts, proofs))
    _check_channels(parts, proofs)
    for what, own in (("fit", parts), ("held-out", proofs)):
        lasts = sum(part.seconds for part in own)
        if own and lasts < (1.0 - 1e-6) * SHORTEST_S:
            logs = ", ".join(part.label for part in own)
            raise InputError(
                f"{logs}: the {what} logs last {lasts:.2g} s in all, at least {SHORTEST_S:g} s are needed for 95 % intervals; "
                "record longer, 10 s or more is good"
            )
    return parts, proofs


def _without_idle(parts: list[Part], proofs: list[Part]) -> tuple[list[Part], list[Part]]:
    """The logs without a channel that was never driven and never moved, while the other one was."""
    first = parts[0].log.channels
    if len(first) < 2 or any(p.log.channels != first for p in parts):
        return parts, proofs
    peak = [max(float(np.nanmax(np.abs(p.log.speed[:, c]), initial=0.0)) for p in parts) for c in first]
    undriven = [c for c in first if not any(p.log.command_V[:, c].any() for p in parts)]
    rms = {c: [np.sqrt(np.nanmean(p.log.speed[:, c] ** 2)) for p in parts] for c in undriven}
    idle = [c for c, speeds in rms.items() if all(v < STANDS_STILL * peak[1 - c] for v in speeds)]
    if len(idle) != 1:
        return parts, proofs
    text = f"channel {idle[0] + 1} was neither driven nor did it move: only the other one is diagnosed"
    return _left_out(parts, proofs, ("command_V", "speed"), idle[0], text)


def _known_signals(parts: list[Part], proofs: list[Part]) -> tuple[list[Part], list[Part]]:
    """The logs without signals of held-out ones that no fit log has: nothing says how large their noise is."""
    for signal, c in itertools.product((s for s in CHANNEL_SIGNALS if s not in HELD), parts[0].log.channels):
        having, shown = (any(p.log.has(signal, c) for p in each) for each in (parts, proofs))
        if shown and not having:
            text = f"{signal} of channel {c + 1} is in no fit log: left out of the held-out ones"
            parts, proofs = _left_out(parts, proofs, (signal,), c, text)
    return parts, proofs


def _left_out(
    parts: list[Part], proofs: list[Part], signals: Sequence[str], channel: int, why: str
) -> tuple[list[Part], list[Part]]:
    """The logs with these fields empty on a channel, and a note that says so."""
    parts, proofs = ([_without(p, signals, channel) for p in each] for each in (parts, proofs))
    return [replace(parts[0], note="; ".join(filter(None, (parts[0].note, why)))), *parts[1:]], proofs


def _without(part: Part, signals: Sequence[str], channel: int) -> Part:
    """The part with these fields of its log empty (NaN) on a channel."""
    own = {signal: getattr(part.log, signal) for signal in signals if part.log.has(signal)}
    here = np.arange(2) == channel
    changes: dict[str, Any] = {signal: np.where(here, np.nan, values) for signal, values in own.items()}
    return replace(part, log=replace(part.log, **changes))


def _check_channels(parts: list[Part], proofs: list[Part]) -> None:
    for part in (*parts, *proofs):
        if part.log.channels != parts[0].log.channels:
            own, first = (" and ".join(str(c + 1) for c in p.log.channels) for p in (part, parts[0]))
            raise InputError(
                f"{part.label}: has channels {own}, {parts[0].label} has {first}; all need the same"
            )
    for c in parts[0].log.channels:
        if not any(abs(part.log.command_V[:, c]).max() > 0.0 for part in parts):
            peak = max(float(np.nanmax(np.abs(p.log.speed[p.inside, c]), initial=0.0)) for p in parts)
            moves = " though the axis moves: something else drove it" if peak >= 0.01 else ""
            what = f"the command of channel {c + 1} is zero throughout{moves}"
            raise InputError(f"{parts[0].label}: {what}; record the signal that drives the valve")
