"""Which experiment would separate what the logs cannot: from the catalogue for known pairs, and by simulating both models.

`simulated` drives the model with the named effect and the one with a competing one, both as refitted to the logs, through a few
manoeuvres of a bench, and says in which of them, and in which signal, they differ most in units of that signal's noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...plant import simulate
from ...plant.catalogue import separating_experiment
from ...plant.sensors import NOISE
from ...waveforms import triangle
from ..estimation import Estimate
from ..models.base import UNITS, RigModel
from ..models.dynamic_rig import DynamicRig
from ..state import State
from .candidates import ACCEPTED, Candidate
from .naming import NamedEffect

__all__ = ["MANOEUVRES", "Separation", "next_experiment", "run", "simulated"]

#: Rows of the simulated manoeuvres, s, and the difference (RMS in noise units) from which two models count as separated.
PERIOD, SEPARATED = 1e-3, 2.0


def _triangle(seconds: float, cycle: float, size: float) -> np.ndarray:
    return np.asarray(-size * triangle(np.arange(round(seconds / PERIOD)) * PERIOD / cycle))


def _sweep(seconds: float, middle: float, size: float, high: float) -> np.ndarray:
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    return np.asarray(middle + size * np.sin(np.pi * high * t * t / seconds))


def _steps(levels: Sequence[float], dwell: float) -> np.ndarray:
    return np.repeat(np.asarray(levels), round(dwell / PERIOD))


#: name: (command as a share of the rated one, load torque in N m)
MANOEUVRES: dict[str, tuple[np.ndarray, float]] = {
    "a slow triangle of 60 % of the rated command, 10 s a cycle": (_triangle(10.0, 10.0, 0.6), 0.0),
    "fast triangles of 40 %, 1 s a cycle": (_triangle(6.0, 1.0, 0.4), 0.0),
    "triangles of 15 %, 4 s a cycle": (_triangle(8.0, 4.0, 0.15), 0.0),
    "a sine about 35 % with rising frequency, up to 20 Hz": (_sweep(6.0, 0.35, 0.15, 20.0), 0.0),
    "steps of 20 to 100 % both ways": (_steps([0.2, -0.2, 0.5, -0.5, 0.8, -0.8, 1.0, -1.0, 0.0], 0.6), 0.0),
    "steps of 40 % both ways under a load of 0.6 N m": (_steps([0.4, -0.4, 0.0, 0.4, -0.4, 0.0], 0.8), 0.6),
    "a constant 80 % for 20 s": (_steps([0.8], 20.0), 0.0),
}


@dataclass(frozen=True)
class Separation:
    """How far two models are apart: RMS difference of a signal in a manoeuvre, in units of that signal's noise."""

    manoeuvre: str
    signal: str
    distance: float


def simulated(rig: DynamicRig, channel: int, first: Estimate, second: Estimate) -> list[Separation]:
    """All manoeuvres and signals, those that separate the two models best first."""
    names = {u.name for p in (first, second) for u in p.unknowns}
    pairs = [rig.model.pair(name) for name in sorted(names)]
    values = {name: np.array([pair, pair]) for name, pair in zip(sorted(names), pairs, strict=True)}
    for lane, estimate in enumerate((first, second)):
        for name, value in estimate.values(channel).items():
            values[name][lane, channel] = value
    effects = rig.kernel(first.request().effects | second.request().effects)
    rated = rig.model.value("u_rated", channel)
    found = []
    for manoeuvre, (share, torque) in MANOEUVRES.items():
        command = np.zeros((share.size, 2))
        command[:, channel] = share * rated
        load = np.zeros_like(command)
        load[:, channel] = torque * np.sign(share)
        recorded = {
            "speed": "measured_speed",
            "current": "current",
            "pressure": "pressure",
            "spool": "spool",
            "mean_line_pressure": "mean_line_pressure",
        }
        out = simulate(
            rig.model, command, load, PERIOD, values=values, num_rigs=2, effects=effects,
            record=list(recorded.values()), substep=rig.substep,
        )  # fmt: skip
        for signal, name in recorded.items():
            unit, size = UNITS[signal]
            noise = (NOISE["pressure_bar"] if unit == "bar" else NOISE[f"{signal}_{unit}"]) * size
            apart = out[name][:, 0, channel] - out[name][:, 1, channel]
            found.append(Separation(manoeuvre, signal, float(np.sqrt(np.mean(apart**2))) / noise))
    return sorted(found, key=lambda s: -s.distance)


def _by_simulation(
    rig: RigModel, candidates: Sequence[Candidate], effect: NamedEffect, competing: str
) -> dict[str, Any] | None:
    """The manoeuvre that separates an effect from a competing one, from the models that were refitted with each of them."""
    if not isinstance(rig, DynamicRig) or len(effect.channels) != 1:
        return None
    (channel,) = effect.channels
    tried = [t for t in reversed(candidates) if t.channel == channel and t.estimate is not None]
    own = next((t for t in tried if t.effect == effect.name and t.outcome == ACCEPTED), None)
    other = next((t for t in tried if t.effect == competing and (own is None or t.round == own.round)), None)
    if own is None or other is None or own.estimate is None or other.estimate is None:
        return None
    found = simulated(rig, channel, own.estimate, other.estimate)
    logged = {s for s in UNITS if any(p.log.has(s, channel) for p in rig.parts)}
    best = next((s for s in found if s.signal in logged), None)
    if best is None or best.distance < SEPARATED:
        best = found[0]
    more = "" if best.signal in logged else f" with the {best.signal} recorded"
    if best.distance < SEPARATED:
        text = f"none of {len(MANOEUVRES)} bench manoeuvres would separate them: at most {best.distance:.1f} times the noise"
        return {
            "description": text,
            "separates": sorted((effect.name, competing)),
            "distance": round(best.distance, 2),
        }
    text = f"{best.manoeuvre}{more}: there the two differ by {best.distance:.1f} times the noise of the {best.signal}"
    return {
        "description": text,
        "separates": sorted((effect.name, competing)),
        "distance": round(best.distance, 1),
    }


def run(state: State) -> State:
    """Proposes what to record next."""
    found = next_experiment(state.effects, state.rig, state.selection.candidates)
    return replace(state, next_experiment=found)


def next_experiment(
    named: Sequence[NamedEffect], rig: RigModel, candidates: Sequence[Candidate]
) -> dict[str, Any] | None:
    """The experiment that separates the names that stayed tied, or None."""
    for effect in named:
        for other in effect.indistinguishable_from:
            found = _by_simulation(rig, candidates, effect, other)
            if found is not None:
                known = separating_experiment(effect.name, other)
                return {**found, "description": "; or ".join(filter(None, (found["description"], known)))}
    for effect in named:
        for other in effect.indistinguishable_from:
            if text := separating_experiment(effect.name, other):
                return {"description": text, "separates": sorted({effect.name, other})}
    for effect in named:
        if effect.indistinguishable_from:
            missing = [s for s in ("current", "pressure", "load") if not any(p.log.has(s) for p in rig.parts)]
            text = (
                f"record {', '.join(missing)} as well"
                if missing
                else "slow triangles of three amplitudes, then steps under load"
            )
            return {"description": text, "separates": [effect.name, *effect.indistinguishable_from]}
    return None
