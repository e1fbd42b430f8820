"""The proof: how far the models are from manoeuvres that took no part in the fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..estimation.least_squares import Problem, channels_of
from ..estimation.noise import noise_floor
from ..models.base import UNITS, Machine

__all__ = ["MODELS", "NAMED", "Proof", "prove", "shown_unit"]

#: The models that are always compared, in this order. Where the form of an effect was corrected there is `NAMED` besides: the
#: named effects without that correction.
MODELS = ("before", "calibrated", "after", "placebo")
NAMED = "named"


@dataclass(frozen=True)
class Proof:
    """`gap[key][model]` are RMS errors in the unit of `key` (speed_1_rpm, ...), beside "noise"; `traces[model][channel]` the
    simulated samples (n,) in the order of `machine.segments[channel]`."""

    machine: Machine
    gap: dict[str, dict[str, float]]
    traces: dict[str, dict[int, np.ndarray]]


def shown_unit(machine: Machine, signal: str, channel: int) -> tuple[str, float]:
    """Unit in which a signal is reported, and its size in SI; a cylinder's speed is in mm/s."""
    if signal == "speed" and machine.parts[0].log.kinds[channel] == "cylinder":
        return "mm_per_s", 1e-3
    return UNITS[signal]


def prove(machine: Machine, models: Mapping[str, Mapping[int, Problem]]) -> Proof:
    """Simulates every model freely from the logged commands and compares with all logs of `machine`."""
    traces: dict[str, dict[int, np.ndarray]] = {}
    for name in models:
        problems = list({id(p): p for p in models[name].values()}.values())
        found: dict[int, np.ndarray] = {}
        for problem, result in zip(problems, machine.predict([p.request() for p in problems]), strict=True):
            for channel in channels_of(problem, machine):
                if models[name][channel] is problem:
                    found[channel] = result[channel]
        traces[name] = found
    gap: dict[str, dict[str, float]] = {}
    for channel in machine.channels:
        signals = list(dict.fromkeys(s.signal for s in machine.segments[channel]))
        for signal in signals:
            unit, size = shown_unit(machine, signal, channel)
            entry = {"noise": _noise(machine, traces, channel, signal) / size}
            for name in models:
                errors = [
                    (s.measured - traces[name][channel][s.place])[s.used]
                    for s in machine.segments[channel]
                    if s.signal == signal
                ]
                entry[name] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) / size
            gap[f"{signal}_{channel + 1}_{unit}"] = entry
    return Proof(machine, gap, traces)


def _noise(machine: Machine, traces: dict[str, dict[int, np.ndarray]], channel: int, signal: str) -> float:
    """The floor by the residual that is smoothest of all models'."""
    found = []
    for s in machine.segments[channel]:
        if s.signal == signal:
            each = [
                noise_floor(s.measured - traces[name][channel][s.place], s.used, s.period)
                for name in ("calibrated", "after")
            ]
            found.append(min(each))
    return float(np.median(found))
