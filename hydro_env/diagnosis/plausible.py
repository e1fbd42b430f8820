"""Does the log fit the model's machine at all? Signs, units and exchanged sensors that only a model can tell.

The model as given is simulated anyway. A signal that is its mirror image, a tenth or a hundred of it, or the other channel's
is no missing effect but a mistake in the recording (or a model of another machine); what a diagnosis named then would be
wrong. The gate of `hydro_env.measured` has looked before at what needs no model.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from ..errors import InputError
from ..measured import Finding
from .fit import Problem
from .machine import Machine

__all__ = ["implausible", "stop_if_sure"]

#: Ratio of measured to simulated size, and what it would mean.
_RATIOS: dict[str, tuple[tuple[float, str], ...]] = {
    "speed": (
        (30.0 / math.pi, "are they rpm that are read as rad/s"), (math.pi / 30.0, "are they rad/s that are read as rpm"),
        (6.0, "are they deg/s that are read as rpm"), (1.0 / 6.0, "are they rpm that are read as deg/s"),
    ),
    "pressure": (
        (100.0, "is it kPa that is read as bar"), (0.01, "is it bar that is read as kPa"),
        (14.504, "is it psi that is read as bar"), (1.0 / 14.504, "is it bar that is read as psi"),
        (0.1, "is it MPa that is read as bar"), (10.0, "is it bar that is read as MPa"),
    ),
    "current": ((1000.0, "is it mA that is read as A"), (0.001, "is it A that is read as mA")),
    "spool": ((1000.0, "is it um that is read as mm"), (0.001, "is it mm that is read as um")),
    "flow": ((60.0, "is it l/min that is read as l/s"), (1.0 / 60.0, "is it l/s that is read as l/min")),
}  # fmt: skip
#: A ratio this near to one of a unit (factor) is no accident; within the wider factor it is worth a warning.
_SURE, _NEAR = 1.3, 1.7
_HINT = "give the right unit in a mapping, or a model of this machine"


def implausible(machine: Machine, given: dict[int, Problem]) -> list[Finding]:
    """Findings about the logs of `machine` beside the model as given."""
    if machine.quick:  # the steady-valve model takes its scale from the log
        return []
    found: list[Finding] = []
    for channel in machine.channels:
        for signal in dict.fromkeys(s.signal for s in machine.segments[channel]):
            measured, simulated = _pair(machine, given, channel, channel, signal)
            if measured.size < 100 or not (np.std(measured) > 0.0 and np.std(simulated) > 0.0):
                continue
            like = float(np.corrcoef(measured, simulated)[0, 1])
            place: dict[str, Any] = {"signal": signal, "channel": channel + 1}
            if like < -0.5:
                message = f"the {signal} of channel {channel + 1} is the mirror image of the model's (correlation {like:.2f})"
                found.append(
                    Finding(
                        "sign",
                        message,
                        f"give `sign: -1` for the {signal} in a mapping",
                        sure=like < -0.8,
                        **place,
                    )  # type: ignore[arg-type]
                )
            ratio = float(np.sqrt(np.mean(measured**2) / np.mean(simulated**2)))
            factor, meaning = min(_RATIOS[signal], key=lambda r: abs(math.log(ratio / r[0])))
            off = math.exp(abs(math.log(ratio / factor)))
            if off < _NEAR and abs(like) > 0.7:
                message = f"the values of {signal} of channel {channel + 1} are {ratio:.3g} times the model's: {meaning}?"
                found.append(Finding("unit", message, _HINT, sure=off < _SURE and abs(like) > 0.85, **place))
    if machine.channels == (0, 1):
        found += _exchanged(machine, given)
    return found


def _exchanged(machine: Machine, given: dict[int, Problem]) -> list[Finding]:
    """Signals that are like the other channel's model and not like their own."""
    found: list[Finding] = []
    for signal in dict.fromkeys(s.signal for s in machine.segments[0]):
        if not any(s.signal == signal for s in machine.segments[1]):
            continue
        likes = {}
        for own in (0, 1):
            for other in (0, 1):
                measured, simulated = _pair(machine, given, own, other, signal)
                if measured.size < 100 or not (np.std(measured) > 0.0 and np.std(simulated) > 0.0):
                    return found
                likes[own, other] = float(np.corrcoef(measured, simulated)[0, 1])
        if min(likes[0, 1], likes[1, 0]) > max(likes[0, 0], likes[1, 1]) + 0.2:
            sure = min(likes[0, 1], likes[1, 0]) > max(likes[0, 0], likes[1, 1]) + 0.4
            message = (
                f"the {signal} of each channel is like the model's of the other channel: are they swapped?"
            )
            found.append(
                Finding("swapped", message, f"exchange the {signal} columns in a mapping", signal, sure=sure)
            )
    return found


def _pair(
    machine: Machine, given: dict[int, Problem], own: int, other: int, signal: str
) -> tuple[np.ndarray, np.ndarray]:
    """Measured samples of channel `own` and the model's of channel `other`, over all logs."""
    measured, simulated = [], []
    by_log = {s.log: s for s in machine.segments[other] if s.signal == signal}
    for mine in machine.segments[own]:
        if mine.signal == signal and mine.log in by_log:
            values = given[other].simulated[other][by_log[mine.log].place]
            keep = mine.used & np.isfinite(values)
            measured.append(mine.measured[keep])
            simulated.append(values[keep])
    return np.concatenate(measured or [np.zeros(0)]), np.concatenate(simulated or [np.zeros(0)])


def stop_if_sure(findings: list[Finding], logs: str, accept: Collection[str]) -> None:
    """InputError for the first finding that is sure and not accepted."""
    for finding in findings:
        if finding.sure and finding.code not in accept:
            raise InputError(f"{logs}: {finding.text}; if it is right, --accept {finding.code}")
