"""The reduced model for an axis of which only command, speed and perhaps pressure are known: a valve that is always steady.

    spool = alpha u / (R k)          opening = effects of the port opening (spool)
    flow = Kq opening sqrt(drive)    drive = 1, or what effects of the port flow make of the measured pressure
    speed = flow / D, seen through a lag of first order that stands for spool, line and inertia together

Parameters, effects, laws and their names are those of the plant, so that selection, proof and report are the same. A
cylinder axis is a motor axis whose displacement is its piston area; what can be estimated from command and speed is Kq / D
only, so Kq is estimated and D is the mapping's or the model's.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from scipy.signal import lfilter

from ...plant import CATALOGUE, PARAMETERS, Effect, Parameter, PlantModel
from ...plant.catalogue.effect import arguments, called_by
from ..input.parts import Part, filled
from .base import Progress, Request, RigModel, Samples, given_parameters

#: Effects of the catalogue that this model can show. Force thresholds look like overlap, speed scale like flow gain.
SUPPORTED = (
    "command_delay", "driver_saturation", "magnetic_hysteresis", "null_offset", "dead_zone", "flow_saturation",
    "directional_gain", "flow_gain_nonlinearity", "pressure_dependent_flow", "sensor_offset",
)  # fmt: skip
#: Plausible flow gains, as multiples of the smallest and the largest one by least squares: what an effect takes of the flow.
WIDEST = (0.2, 5.0)
#: From a servo valve on a light axis, in milliseconds, to a proportional valve on a crane.
LAG = Parameter(
    "lag", "s", 0.02, 0.001, 0.6, "valve, line and inertia of a large axis together", "lag of the speed behind the command",
    log=True,
)  # fmt: skip


class SteadyValve(RigModel):
    """See `base.RigModel`. The flow gain of the model as given is set by least squares on the fit logs, because no
    preset knows the axis."""

    simulation_is_cheap, has_hidden_states = True, False
    notes = (
        "steady-valve model: the flow gain as given is set by least squares on the fit logs, the lag stands for all dynamics",
    )

    def __init__(
        self, model: PlantModel, parts: list[Part], *, every_row: bool = False, progress: Progress = None,
        flow_gain: dict[int, float] | None = None, without: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        super().__init__(model, parts, ("speed",), every_row, progress, without)
        self.displacement = {c: parts[0].log.displacement[c] or model.value("D", c) for c in self.channels}
        self.flow_gain = flow_gain or {c: self._flow_gain(c) for c in self.channels}
        low, high = WIDEST[0] * min(self.flow_gain.values()), WIDEST[1] * max(self.flow_gain.values())
        kq = PARAMETERS["Kq"]
        wide = Parameter("Kq", kq.unit, kq.nominal, low, high, "least squares", kq.note, log=True)
        self.own = {"lag": LAG, "Kq": wide}

    def with_parts(self, parts: list[Part], every_row: bool) -> "SteadyValve":
        return SteadyValve(
            self.model, parts, every_row=every_row, progress=self.progress, flow_gain=self.flow_gain, without=self.without,
        )  # fmt: skip

    def written(self, values: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """The values as those of a rig with the model's own displacement: its flow gain gives the axis' speeds, in rad/s for m/s.

        The area of a piston would make a shaft that rings against its line far too fast."""
        gains = values.get("Kq", self.model.pair("Kq"))
        shares = (self.model.value("D", c) / d if (d := self.displacement.get(c)) else 1.0 for c in (0, 1))
        one, two = (gain * share for gain, share in zip(gains, shares, strict=True))
        return {**values, "Kq": (one, two)}

    def base(self, channel: int) -> list[str]:
        return ["Kq", "lag", *given_parameters(self, channel)]

    def supported(self) -> list[str]:
        pressure = all(part.log.has("pressure", c) for part in self.parts for c in self.channels)
        return [n for n in SUPPORTED if n in CATALOGUE and (pressure or not CATALOGUE[n].reads("pressure"))]

    def has(self, effect: str, channel: int | None) -> bool:
        return effect in self.supported() and super().has(effect, channel)

    def given(self, name: str, channel: int) -> float:
        if name == "Kq":
            return self.flow_gain[channel]
        return LAG.nominal if name == "lag" else super().given(name, channel)

    def _flow_gain(self, channel: int) -> float:
        """The flow gain that explains the speeds best with nothing else in the model."""
        over = under = 0.0
        for s in self.segments[channel]:
            opening = self._spool(self.parts[s.log], channel)[s.rows][s.used]
            over += float(opening @ s.measured[s.used])
            under += float(opening @ opening)
        return abs(over) / max(under, 1e-30) * self.displacement[channel]

    def _spool(self, part: Part, channel: int) -> np.ndarray:
        alpha, resistance, spring = (self.model.value(n, channel) for n in ("alpha", "R", "k"))
        return alpha * np.nan_to_num(part.log.command_V[:, channel]) / (resistance * spring)

    # --- simulation -----------------------------------------------------------------------------------------------------
    def predict(self, requests: Sequence[Request]) -> list[Samples]:
        results: list[Samples] = [{} for _ in requests]
        groups: dict[tuple[int, frozenset[str]], list[int]] = {}
        for number, request in enumerate(requests):
            for channel in self.channels if request.channel is None else (request.channel,):
                effects = request.effects.union(e for e in self.model.declared if self.has(e, channel))
                groups.setdefault((channel, effects), []).append(number)
        for (channel, effects), numbers in groups.items():
            own = (f"{e}.{p.name}" for e in effects for p in CATALOGUE[e].parameters)
            wanted = [requests[n].on(channel) for n in numbers]
            names = dict.fromkeys(("Kq", "lag", *own, *(name for each in wanted for name in each)))
            given = {name: self.given(name, channel) for name in names}
            values = {n: np.array([[each.get(n, usual)] for each in wanted]) for n, usual in given.items()}
            ordered = [n for n in CATALOGUE if n in effects]
            speeds = [self._speed(part, channel, values, ordered) for part in self.parts]
            for lane, n in enumerate(numbers):
                own_rows = [speeds[s.log][lane, s.rows] for s in self.segments[channel]]
                results[n][channel] = np.concatenate(own_rows)
        if self.progress is not None:
            self.progress(len(requests))
        return results

    def _speed(
        self, part: Part, channel: int, values: dict[str, np.ndarray], effects: list[str]
    ) -> np.ndarray:
        """Speeds (lanes, T) for values (lanes, 1)."""
        log, period = part.log, part.log.period
        known: dict[str, Any] = {n: self.model.value(n, channel) for n in PARAMETERS} | values
        command = np.nan_to_num(log.command_V[:, channel])[None, :]
        delays = [values[f"{e}.{own}"] for e in effects if (own := CATALOGUE[e].delays_command)]
        if delays:
            # Interpolated, so that the result is smooth in the delay.
            rows, late = np.arange(len(log)), np.sum(delays, axis=0)[:, 0] / period
            command = np.stack([np.interp(rows - each, rows, command[0]) for each in late])
        voltage = apply_laws("voltage", command, effects, known)
        known["current"] = voltage / known["R"]
        force = known["alpha"] * known["current"]
        for name in effects:
            if CATALOGUE[name].states and "force" in CATALOGUE[name].laws:
                known[f"{name}.{CATALOGUE[name].states[0].name}"] = _state(name, known, period)
        known["spool"] = apply_laws("force", force, effects, known) / known["k"]
        known["opening"] = apply_laws("opening", known["spool"], effects, known)
        pressure = log.get("pressure")
        known["pressure"] = 0.0 if pressure is None else filled(pressure[:, channel])[None, :]
        drive = apply_laws("drive", np.ones_like(known["opening"]), effects, known)
        speed = known["Kq"] * known["opening"] * np.sqrt(np.maximum(drive, 0.0)) / self.displacement[channel]
        speed = _lagged(np.broadcast_to(speed, (values["Kq"].shape[0], len(log))), values["lag"], period)
        return apply_laws("measured_speed", speed, effects, known)


def _lagged(value: np.ndarray, lag: np.ndarray, period: float) -> np.ndarray:
    """First-order lag of a value that is held from row to row; the output at a row is before that row's command acts."""
    keeps = [float(np.exp(-period / each)) for each in lag[:, 0]]
    lanes = zip(keeps, value, strict=True)
    return np.stack([lfilter([0.0, 1.0 - keep], [1.0, -keep], own) for keep, own in lanes])


def _state(effect: str, known: dict[str, Any], period: float) -> np.ndarray:
    """The memory of an effect that is driven by the current, by implicit steps from row to row; (lanes, T)."""
    described = CATALOGUE[effect]
    state, current = described.states[0], known["current"]
    rate_of, further = elementwise(state.rate), 0.01 * state.scale
    names = list(inspect.signature(state.rate).parameters)
    own = {n: argument(described, n, known) for n in names if n not in (state.name, "current_rate")}
    changes = np.diff(current, axis=1, prepend=current[:, :1]) / period
    lanes = np.broadcast_shapes(changes[:, :1].shape, *map(np.shape, own.values()))[0]
    loop, out = np.zeros((lanes, 1)), np.empty((lanes, current.shape[1]))
    for row in range(current.shape[1]):
        inputs = {**own, "current_rate": changes[:, row : row + 1]}
        both = ({**inputs, state.name: at} for at in (loop, loop + further))
        rate, beside = (rate_of(*(each[n] for n in names)) for each in both)
        decay = (rate - beside) / further
        loop = (loop + period * (rate + decay * loop)) / (1.0 + period * decay)
        out[:, row] = loop[:, 0]
    return out


# --- the catalogue's laws on whole arrays: samples are evaluated rather than integrated --------------------------------------
@cache
def elementwise(law: Callable[..., float]) -> Callable[..., Any]:
    """A law of the catalogue, which is written for numbers, as a compiled function of arrays."""
    from numba import vectorize

    for helper in called_by(law):
        _callable_when_compiled(helper)
    return vectorize(law)


@cache
def _callable_when_compiled(helper: Callable[..., float]) -> None:
    """Has compiled functions call a plain one."""
    from numba.extending import register_jitable

    register_jitable(helper)


def apply_laws(quantity: str, value: np.ndarray, effects: list[str], known: Mapping[str, Any]) -> np.ndarray:
    """`value` passed through the laws that these effects have for `quantity`.

    `known` holds signals, base parameters and "effect.parameter" values that broadcast against `value`.
    """
    for name in effects:
        effect = CATALOGUE[name]
        law = effect.laws.get(quantity)
        if law is not None:
            value = elementwise(law)(value, *(argument(effect, a, known) for a in arguments(law)[1:]))
    return value


def argument(effect: Effect, name: str, known: Mapping[str, Any]) -> Any:
    """What an argument of a law stands for: the effect's own parameter or state, a signal, or a base parameter."""
    own = f"{effect.name}.{name}"
    return known[own] if own in known else known[name]
