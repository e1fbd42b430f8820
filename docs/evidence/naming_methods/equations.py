"""Errors of the equations of coil, line and shaft beside a calibrated model, and the same of every candidate effect.

An equation's left-hand side is linear in the signals, so its error is that of measured minus simulated signals:

    coil   R i + L di/dt, V
    line   D w + Km p + V/beta dp/dt, m3/s (D w alone where no pressure is logged)
    shaft  J dw/dt + B w - D p, N m

A *term* is the same of a simulation with a candidate at its typical size minus the calibrated one: effects with memory have
terms like all others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from hydro_env.diagnosis.estimation.noise import noise_floor
from hydro_env.diagnosis.input.parts import filled
from hydro_env.diagnosis.models.base import Request, effect_in
from hydro_env.experiments.naming_benchmark.methods import Start

Array = NDArray[np.float64]

#: Width of the filter that smooths and differentiates, s.
WIDTH = 0.03


@dataclass(frozen=True)
class Equation:
    """The error of an equation of a channel in one log, over its noise (n,), terms (n,) by (effect, parameter) likewise, and
    the command as a fraction of the rated one (n,)."""

    name: str
    log: int
    error: Array
    command: Array
    terms: dict[tuple[str, str], Array] = field(default_factory=dict)


def equations(start: Start, channel: int) -> list[Equation]:
    """The errors of all equations of a channel in the logs to fit, with the terms of all candidates."""
    rig = start.rig
    requests, keys = [start.estimates[channel].request()], [("", "")]
    for name in rig.candidates():
        for key, request in _requests(start, channel, name):
            keys.append(key)
            requests.append(request)
    simulated = rig.predict(requests)
    found = []
    for log, part in enumerate(rig.parts):
        segments = {s.signal: s for s in rig.segments[channel] if s.log == log}
        speed = segments["speed"]
        measured = {n: filled(s.measured) for n, s in segments.items()}
        simulations = [{n: r[channel][s.place] for n, s in segments.items()} for r in simulated]
        command = part.log.command_V[speed.rows, channel] / rig.model.value("u_rated", channel)
        base = simulations[0]
        errors = _sides(start, channel, {n: measured[n] - base[n] for n in base}, speed.period)
        beside = [{n: s[n] - base[n] for n in base} for s in simulations[1:]]
        terms = [_sides(start, channel, signals, speed.period) for signals in beside]
        for name, error in errors.items():
            noise = max(noise_floor(error, np.ones(error.size, bool), speed.period), 1e-30)
            own = {key: t[name] / noise for key, t in zip(keys[1:], terms, strict=True)}
            good = {k: v for k, v in own.items() if np.isfinite(v).all()}
            found.append(Equation(name, log, error / noise, command, good))
    return found


def _requests(start: Start, channel: int, name: str) -> list[tuple[tuple[str, str], Request]]:
    """Simulations with an effect at its typical size, one for each parameter that carries it."""
    effect = effect_in(start.rig, name, channel)
    shapes = {f"{name}.{p.name}": p.typical for p in effect.parameters if not p.carries_size}
    neutral = {f"{name}.{p.name}": p.nominal for p in effect.parameters if p.carries_size}
    own = {c: estimate.request().values for c, estimate in start.estimates.items()}
    found = []
    for p in (p for p in effect.parameters if p.carries_size):
        values = {**shapes, **neutral, f"{name}.{p.name}": p.typical}
        if effect.scope == "rig" or effect.couples_channels:
            pairs = {n: tuple(float(own[c][n]) for c in sorted(own)) for n in own[channel]}  # type: ignore[arg-type]
            request = Request(None, {**pairs, **{n: (v, v) for n, v in values.items()}})  # type: ignore[dict-item]
        else:
            request = Request(channel, {**own[channel], **values})
        found.append(((name, p.name), request))
    return found


def _sides(start: Start, channel: int, signals: Mapping[str, Array], period: float) -> dict[str, Array]:
    """The left-hand sides of the equations that these signals allow."""
    value = start.estimates[channel].values(channel)

    def number(name: str) -> float:
        return float(value.get(name, start.rig.model.value(name, channel)))

    width = max(5, 2 * round(0.5 * WIDTH / period) + 1)

    def smooth(x: Array, deriv: int = 0) -> Array:
        return np.asarray(savgol_filter(x, width, 2, deriv=deriv, delta=period))

    found = {}
    if "current" in signals:
        i = signals["current"]
        found["coil"] = number("R") * smooth(i) + number("L") * smooth(i, 1)
    w, displacement = signals["speed"], number("D")
    if "pressure" not in signals:
        return {**found, "line": displacement * smooth(w)}
    p = signals["pressure"]
    found["line"] = (
        displacement * smooth(w) + number("Km") * smooth(p) + number("V") / number("beta") * smooth(p, 1)
    )
    found["shaft"] = number("J") * smooth(w, 1) + number("B") * smooth(w) - displacement * smooth(p)
    return found
