"""Practice rig logs: measurements of a rig in which effects are hidden, with the truth in a file beside them.

The rig is the reference simulator in the "different" forms, so the hidden effects do not have the equations that a
diagnosis fits. An engineer's two runs and a third one to be sealed are made:

    fit_1.csv   valve bench, open loop: slow and fast triangles, steps of many sizes both ways, steps under load,
                small loops about a bias, a sine of rising frequency
    fit_2.csv   operation, closed loop: set-point steps, staircase, reversing sine, load steps both ways
    sealed.csv  other values, order and mixture of both, for proof
    model.yaml  the model as an engineer has it, without the hidden effects
    truth.json  what was hidden

A user's own effect (`plant.load_effects`) has one set of equations, its laws. If one is hidden, the rig is the compiled
plant with the laws of the catalogue for all effects, and truth.json says `"forms": "catalogue"`: the diagnosis then meets
its own equations, so such a log shows that an effect can be found, not that it is told from real physics.

Commands change every 10 ms (the control period of the rig); the log is faster. Noise: see `NOISE`.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, suggestion
from ..files import write_text
from ..plant import BUILT_IN, CATALOGUE, PARAMETERS, Effect, Parameter, Plant, PlantModel, load_model
from ..units import BAR, LPM, MILLIMETRE, RPM
from ..waveforms import triangle
from .reference import ReferenceRig

__all__ = [
    "NOISE",
    "RECORDABLE",
    "SEVERITIES",
    "Hidden",
    "Practice",
    "make_practice",
    "parse_effects",
    "parse_values",
    "run",
]

Array = NDArray[np.float64]

SCHEMA = "hydro_env/truth/1"
#: Multiples of the typical distance of a parameter from its neutral value.
SEVERITIES = {"small": 0.5, "medium": 1.0, "large": 2.0}
#: Of a parameter that limits (neutral: infinite), multiples of its typical value.
_LIMIT_SEVERITIES = {"small": 1.4, "medium": 1.0, "large": 0.6}
#: Standard deviation and resolution of the recorded signals, in the unit of the log's column.
NOISE = {
    "current": (0.002, 0.0005),
    "pressure": (0.05, 0.01),
    "speed": (1.0, 0.1),
    "spool": (0.001, 0.0005),
    "flow": (0.05, 0.01),
}
#: What may be recorded besides time, command and speed.
RECORDABLE = ("setpoint", "current", "pressure", "load", "spool", "flow")
#: Base parameters that `base_error` makes wrong.
UNCERTAIN = ("D", "J", "B", "Km", "beta", "m", "R", "L", "alpha", "k", "Kq", "Fc", "Fs")
CONTROL_PERIOD = 0.01  # s
_CATALOGUE = "catalogue"  # forms of a rig with a user's effect
_COLUMNS = {  # signal of the simulator and its unit in the log
    "current": ("current", "A", 1.0),
    "pressure": ("pressure", "bar", BAR),
    "speed": ("measured_speed", "rpm", RPM),
    "spool": ("spool", "mm", MILLIMETRE),
    "flow": ("flow", "lpm", LPM),
}
_COLUMN_ORDER = ("command", "current", "pressure", "speed", "load", "spool", "flow")
_DECIMALS = {
    "time": 6,
    "setpoint": 1,
    "command": 3,
    "current": 4,
    "pressure": 2,
    "speed": 1,
    "load": 3,
    "spool": 4,
    "flow": 2,
}


@dataclass(frozen=True)
class Hidden:
    """An effect that acts on a channel: "1", "2", "both" or (effects of the whole rig) "rig"; parameters in SI."""

    name: str
    channel: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Practice:
    """Practice logs. `logs` maps "fit_1", "fit_2", "sealed" to columns by header name; `given` is the model an engineer
    has, `true` the one that made the logs; `hidden` and `truth` (the content of truth.json) say what the difference is.
    """

    logs: Mapping[str, Mapping[str, Array]]
    given: PlantModel
    true: PlantModel
    hidden: tuple[Hidden, ...]
    truth: Mapping[str, Any]

    def write(self, out: Path) -> None:
        """Writes the logs, model.yaml and truth.json into the folder `out`, which is made if need be."""
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{out}: cannot make this folder: {error.strerror}") from None
        texts = {f"{name}.csv": log_text(columns) for name, columns in self.logs.items()}
        truth = dict(self.truth)
        truth["log_sha256"] = {
            name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
        }
        for name, text in texts.items():
            write_text(out / name, text)
        self.given.to_yaml(out / "model.yaml")
        write_text(out / "truth.json", json.dumps(truth, indent=1) + "\n")


# --- what to hide -----------------------------------------------------------------------------------------------------
def parse_effects(words: Iterable[str]) -> dict[str, str]:
    """`["dead_zone:1", "supply_droop"]` -> `{"dead_zone": "1", "supply_droop": "rig"}`.

    Without a channel both have the effect. InputError for an unknown effect or channel, or one that is named twice.
    """
    chosen: dict[str, str] = {}
    for word in words:
        name, _, channel = word.partition(":")
        if name not in CATALOGUE:
            raise InputError(f"unknown effect {name!r}: {suggestion(name, CATALOGUE)}")
        of_rig = CATALOGUE[name].scope == "rig"
        channel = channel or ("rig" if of_rig else "both")
        if of_rig and channel != "rig":
            raise InputError(f"{word}: {name} acts on the whole rig; leave the channel out")
        if channel not in (("rig",) if of_rig else ("1", "2", "both")):
            raise InputError(f"{word}: unknown channel {channel!r}; a channel is 1, 2 or both")
        if name in chosen:
            raise InputError(f"{word}: {name} is named twice; name it once, with channel 1, 2 or both")
        chosen[name] = channel
    return chosen


def parse_values(words: Iterable[str]) -> dict[str, float]:
    """`["dead_zone.overlap_positive=7e-5"]` -> `{"dead_zone.overlap_positive": 7e-5}` (SI). InputError if malformed."""
    values: dict[str, float] = {}
    for word in words:
        name, equals, number = word.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not equals or not math.isfinite(value):
            raise InputError(
                f"{word}: expected EFFECT.PARAMETER=NUMBER in SI units, e.g. dead_zone.overlap_positive=7e-5"
            )
        values[name] = value
    return values


def _draw(parameter: Parameter, severity: str, duration: float, rng: np.random.Generator) -> float:
    """A value of an effect's parameter: size by severity, up to 15 % aside, and a random sign where both make sense."""
    typical = parameter.nominal if parameter.typical is None else parameter.typical
    aside = math.exp(rng.uniform(-0.15, 0.15))
    turned = rng.random() < 0.5
    neutral = parameter.nominal
    if typical == neutral:  # gives shape, not size
        if parameter.name == "phase":
            return float(rng.uniform(parameter.low, parameter.high))
        if parameter.name == "time_constant" and typical > duration:
            # Nobody sees a drift of minutes in seconds; slow effects are made as fast as the log is long.
            return max(0.4 * duration, parameter.low)
        return typical
    if math.isinf(neutral):
        value = typical * _LIMIT_SEVERITIES[severity] * aside
    elif parameter.log and neutral > 0.0:
        distance = math.log(typical / neutral) * SEVERITIES[severity] * aside
        value = neutral * math.exp(-distance if turned else distance)
    else:
        distance = (typical - neutral) * SEVERITIES[severity] * aside
        value = neutral + (-distance if turned and parameter.low < neutral < parameter.high else distance)
    return float(min(max(value, parameter.low), parameter.high))


def _choose(
    effects: Mapping[str, str],
    values: Mapping[str, float],
    severity: str,
    duration: float,
    rng: np.random.Generator,
) -> tuple[Hidden, ...]:
    hidden = []
    for name, channel in effects.items():
        effect: Effect = CATALOGUE[name]
        # Draws for every parameter, so that an explicit value changes no other one.
        drawn = {p.name: _draw(p, severity, duration, rng) for p in effect.parameters}
        explicit = {key.split(".", 1)[1]: v for key, v in values.items() if key.split(".", 1)[0] == name}
        chosen = {**drawn, **explicit}
        if effect.is_neutral(chosen):
            raise InputError(
                f"{name}: with these values nothing is hidden; a size away from the neutral one is needed"
            )
        hidden.append(Hidden(name, channel, chosen))
    return tuple(hidden)


def _check_values(values: Mapping[str, float], effects: Mapping[str, str]) -> None:
    for key, value in values.items():
        name, _, own = key.partition(".")
        if name not in effects:
            raise InputError(
                f"{key}: {name!r} is not among the effects to hide ({', '.join(effects) or 'none'})"
            )
        known = {p.name: p for p in CATALOGUE[name].parameters}
        if own not in known:
            raise InputError(f"{key}: effect {name!r} has no parameter {own!r}: {suggestion(own, known)}")
        p = known[own]
        if value != p.nominal and not p.low <= value <= p.high:
            raise InputError(
                f"{key}: {value:g} {p.unit} is out of range; right is {p.low:g} to {p.high:g} {p.unit}"
            )


def _true_model(
    given: PlantModel, hidden: Sequence[Hidden], base_error: float, rng: np.random.Generator
) -> tuple[PlantModel, dict[str, Any]]:
    """The model that makes the logs, and what is wrong with the base parameters of the given one."""
    changed: dict[str, tuple[float, float]] = {}
    wrong: dict[str, Any] = {}
    for name in UNCERTAIN:
        factors = 1.0 + base_error * rng.uniform(-1.0, 1.0, 2)  # drawn always: a seed means the same rig
        if base_error == 0.0:
            continue
        p = PARAMETERS[name]
        old = given.pair(name)
        new = tuple(min(max(v * f, min(p.low, v)), max(p.high, v)) for v, f in zip(old, factors, strict=True))
        changed[name] = new
        for c in (0, 1):
            wrong[f"{name}_{c + 1}"] = {"nominal": old[c], "value": new[c], "unit": p.unit}
    if changed:
        # Static friction is never below sliding friction.
        changed["Fs"] = tuple(max(s, c) for s, c in zip(changed["Fs"], changed["Fc"], strict=True))  # type: ignore[assignment]
        for c in (0, 1):
            wrong[f"Fs_{c + 1}"]["value"] = changed["Fs"][c]
    true = given.with_values(changed, name="rig")
    for h in hidden:
        on = (h.channel in ("1", "both", "rig"), h.channel in ("2", "both", "rig"))
        for c in (0, 1):
            acts = given.effects.get(h.name)
            if on[c] and acts is not None and not CATALOGUE[h.name].is_neutral(acts[c]):
                raise InputError(
                    f"{h.name}: model {given.name!r} has this effect on channel {c + 1} already; "
                    "choose another base model (e.g. paper) or effect"
                )
        values = {}
        for own, value in h.parameters.items():
            old = true.pair(f"{h.name}.{own}")
            values[f"{h.name}.{own}"] = (value if on[0] else old[0], value if on[1] else old[1])
        true = true.with_values(values)
    return true, wrong


# --- manoeuvres on the grid of control periods -------------------------------------------------------------------------
def _hold(levels: Iterable[float], dwell: float, period: float) -> Array:
    return np.repeat(np.asarray(list(levels), dtype=float), max(1, round(dwell / period)))


def _triangle(middle: float, amplitude: float, cycle: float, cycles: float, period: float) -> Array:
    return middle - amplitude * triangle(np.arange(round(cycle * cycles / period)) * period / cycle)


def _sweep(middle: float, amplitude: float, low: float, high: float, duration: float, period: float) -> Array:
    """Sine of rising frequency (Hz)."""
    t = np.arange(round(duration / period)) * period
    phase = 2.0 * math.pi * low * duration / math.log(high / low) * (np.power(high / low, t / duration) - 1.0)
    return middle + amplitude * np.sin(phase)


@dataclass
class _Plan:
    """What one channel is asked to do: `value` is a set-point in rpm where `closed`, else a fraction of the rated command."""

    value: Array
    closed: NDArray[np.bool_]
    load: Array  # N m

    @staticmethod
    def of(*parts: tuple[str, Array, float | Array]) -> _Plan:
        lengths = [part[1].size for part in parts]
        return _Plan(
            np.concatenate([part[1] for part in parts]),
            np.concatenate([np.full(n, part[0] == "closed") for part, n in zip(parts, lengths, strict=True)]),
            np.concatenate([np.broadcast_to(part[2], n) for part, n in zip(parts, lengths, strict=True)]),
        )


def _bench(_: np.random.Generator, own: np.random.Generator, side: int, dt: float) -> _Plan:
    """Open loop. Channel 2 does the same kind of things in another order, so that the supply sees many pairs."""
    s = own.uniform(0.88, 1.1, 16)
    sign = 1.0 if side == 0 else -1.0
    lift = own.uniform(0.4, 0.8)
    slow = ("open", _triangle(0.0, sign * 0.62 * s[0], 3.2, 1.0, dt), 0.0)
    ladder = [0.12, -0.12, 0.25, 0.0, -0.25, 0.0, 0.5, -0.5, 0.75, 0.0, -0.75, 0.0]
    steps = ("open", _hold([sign * s[1 + n % 8] * v for n, v in enumerate(ladder)], 0.24, dt), 0.0)
    fast = ("open", _triangle(0.0, -sign * 0.55 * s[9], 0.7, 1.0, dt), 0.0)
    full = ("open", _hold([sign, -sign, 0.0], 0.3, dt), 0.0)
    loaded = _hold([0.45, 0.45, 0.7, 0.3, -0.45, -0.45, -0.7, -0.3], 0.25, dt) * sign * s[10]
    weight = _hold([0.0, lift, lift, lift, 0.0, -lift, -lift, -lift], 0.25, dt) * sign
    under_load = ("open", loaded, weight)
    loops = ("open", _triangle(-sign * 0.4, 0.12 * s[11], 0.5, 2.0, dt), 0.0)
    sweep = ("open", _sweep(sign * 0.35, 0.15 * s[12], 1.0, 14.0, 1.4, dt), 0.0)
    rest = ("open", _hold([0.0], 0.2, dt), 0.0)
    if side == 0:
        return _Plan.of(rest, slow, steps, under_load, full, loops, sweep, fast)
    return _Plan.of(rest, steps, slow, fast, sweep, under_load, loops, full)


def _operation(common: np.random.Generator, own: np.random.Generator, side: int, dt: float) -> _Plan:
    """Closed loop: set-points as in the paper's experiments, slow reversals, load steps both ways.

    Both channels follow the same set-point, as on the rig; their loads differ.
    """
    s = common.uniform(0.85, 1.15, 12)
    lift = own.uniform(0.4, 0.7)
    jumps = ("closed", _hold([600.0 * s[0], -250.0 * s[1], 500.0 * s[2]], 1.0, dt), 0.0)
    pushes = _hold(
        [0.0, lift, 0.2, -0.5 * lift, 0.0] if side == 0 else [0.5 * lift, 0.0, -0.2, lift, 0.0], 0.4, dt
    )
    held = ("closed", np.full(pushes.size, 450.0 * s[4]), pushes)
    back = ("closed", np.full(pushes.size, -400.0 * s[5]), -pushes)
    stairs = (
        "closed",
        _hold([60.0 * s[6], 150.0 * s[7], 300.0 * s[8], -60.0 * s[6], -150.0 * s[7], 0.0], 0.4, dt),
        0.0,
    )
    wave = ("closed", _sweep(0.0, 250.0 * s[9], 0.5, 1.5, 2.6, dt), 0.0)
    rest = ("closed", _hold([0.0], 0.2, dt), 0.0)
    return _Plan.of(rest, jumps, held, wave, stairs, back)


def _proof(common: np.random.Generator, own: np.random.Generator, side: int, dt: float) -> _Plan:
    """Other values and another mixture of both, with levels at random."""
    signs = [1.0, -1.0, 1.0, 1.0, -1.0]
    jumps = _hold(common.uniform(120.0, 650.0, 5) * np.array(signs), 0.9, dt)
    lift = own.uniform(0.3, 0.7)
    late = np.arange(jumps.size) * dt % 0.9 > (0.55 if side == 0 else 0.35)
    closed = ("closed", jumps, np.where(late, lift, 0.0) * np.sign(jumps))
    random = ("open", _hold(own.uniform(-0.8, 0.8, 10), 0.27, dt), 0.0)
    ramp = ("open", _triangle(0.05, 0.5 * own.uniform(0.9, 1.1), 2.1, 1.0, dt), 0.0)
    loaded = ("open", _hold(own.uniform(0.25, 0.6, 4), 0.3, dt), lift)
    wave = ("open", _sweep(-0.3, 0.2, 0.8, 6.0, 1.6, dt), 0.0)
    rest = ("open", _hold([0.0], 0.2, dt), 0.0)
    if side == 0:
        return _Plan.of(rest, random, closed, ramp, wave, loaded)
    return _Plan.of(rest, random, closed, loaded, ramp, wave)


#: Makes the plan of a channel from draws that both channels share and draws of its own.
_Maker = Callable[[np.random.Generator, np.random.Generator, int, float], _Plan]
_RUNS: dict[str, _Maker] = {
    "fit_1": _bench,
    "fit_2": _operation,
    "sealed": _proof,
}


def _plans(make: _Maker, seeds: np.random.SeedSequence, dt: float, steps: int) -> list[_Plan]:
    """Rounds of the manoeuvre, each with other values, cut to the log's length; one plan for each channel."""
    shared, *own = seeds.spawn(3)
    plans = []
    for side in (0, 1):
        # The shared stream starts afresh for each channel: both draw the same from it.
        common, alone = np.random.default_rng(shared), np.random.default_rng(own[side])
        plan = make(common, alone, side, dt)
        while plan.value.size < steps:
            more = make(common, alone, side, dt)
            plan = _Plan(
                *(np.concatenate([getattr(plan, n), getattr(more, n)]) for n in ("value", "closed", "load"))
            )
        plans.append(_Plan(plan.value[:steps], plan.closed[:steps], plan.load[:steps]))
    return plans


class _CatalogueRig:
    """The compiled plant in the place of a `ReferenceRig`."""

    def __init__(self, model: PlantModel) -> None:
        self.plant = Plant(model)
        self.names = [signal for signal, _, _ in _COLUMNS.values()]

    def signals(self) -> dict[str, Array]:
        return {name: self.plant.get(name)[0] for name in self.names}

    def advance(self, command_V: Array, load_Nm: Array, duration: float, samples: int) -> dict[str, Array]:
        command, load = np.tile(command_V, (samples, 1)), np.tile(load_Nm, (samples, 1))
        rows = self.plant.run(command, load, duration / samples, self.names)
        if self.plant.diverged[0]:
            raise InputError("the rig diverges with these effects; smaller values are right")
        end = self.signals()
        return {name: np.vstack([rows[name][1:, 0], end[name]]) for name in self.names}


class _SpeedLoop:
    """The PI controllers of the rig: the paper's V1 gains, scaled to the flow gain of the given model."""

    def __init__(self, given: PlantModel, period: float) -> None:
        self.gain = 0.016 * 476106e-6 / np.array(given.pair("Kq"))  # V/rpm
        self.reset_time, self.period = 0.156, period  # s
        self.limit = np.array(given.pair("u_rated"))
        self.sum = np.zeros(2)  # rpm s

    def __call__(self, setpoint: Array, speed: Array) -> Array:
        error = setpoint - speed
        wanted = self.gain * (error + self.sum / self.reset_time)
        given = np.clip(wanted, -self.limit, self.limit)
        self.sum = np.where(
            (wanted != given) & (error * wanted > 0.0), self.sum, self.sum + error * self.period
        )
        return given


def _record(
    name: str, given: PlantModel, true: PlantModel, record: Sequence[str], rate: float, duration: float, noise: float,
    forms: str, seeds: np.random.SeedSequence,
) -> dict[str, Array]:  # fmt: skip
    """Runs one manoeuvre on the true rig and returns the log's columns by header name."""
    plan_seed, noise_seed = seeds.spawn(2)
    period = max(CONTROL_PERIOD, 1.0 / rate)
    samples = round(period * rate)
    steps = max(1, round(duration / period))
    rows = steps * samples
    plans = _plans(_RUNS[name], plan_seed, period, steps)
    if "load" not in record:
        for plan in plans:  # a load that nobody logs would be a second hidden effect
            plan.load = np.zeros(steps)
    # Every signal has a stream of its own: recording more of them changes none.
    streams = dict(zip(_COLUMNS, noise_seed.spawn(len(_COLUMNS)), strict=True))
    errors = {
        n: noise * NOISE[n][0] * np.random.default_rng(s).standard_normal((rows, 2))
        for n, s in streams.items()
    }

    loop = _SpeedLoop(given, period)
    rated = np.array(given.pair("u_rated"))
    rig: ReferenceRig | _CatalogueRig
    rig = _CatalogueRig(true) if forms == _CATALOGUE else ReferenceRig(true, forms=forms, tolerance=1e-6)
    now = rig.signals()
    command, load, setpoint = np.empty((rows, 2)), np.empty((rows, 2)), np.empty((rows, 2))
    shown = {n: np.empty((rows, 2)) for n in _COLUMNS}
    for n in range(steps):
        first = n * samples
        closed = np.array([plan.closed[n] for plan in plans])
        value = np.array([plan.value[n] for plan in plans])
        speed = now["measured_speed"] / RPM + errors["speed"][first]
        by_loop = loop(np.where(closed, value, 0.0), speed)
        loop.sum = np.where(closed, loop.sum, 0.0)
        volts = np.round(np.where(closed, by_loop, value * rated), 3)
        torque = np.round([plan.load[n] for plan in plans], 3)
        here = slice(first, first + samples)
        command[here], load[here] = np.clip(volts, -rated, rated), torque
        setpoint[here] = np.where(closed, value, 0.0)
        part = rig.advance(command[first], torque, period, samples)
        for column, (signal, _, _) in _COLUMNS.items():
            shown[column][first] = now[signal]
            shown[column][first + 1 : first + samples] = part[signal][:-1]
        now = {signal: values[-1] for signal, values in part.items()}

    columns: dict[str, Array] = {"time_s": np.arange(rows) / rate}
    if "setpoint" in record:
        columns["setpoint_rpm"] = np.round(setpoint[:, 0], 1)
    for c in (0, 1):
        for column in _COLUMN_ORDER:
            if column == "command":
                columns[f"command_{c + 1}_V"] = command[:, c]
            elif column == "load":
                if "load" in record:
                    columns[f"load_{c + 1}_Nm"] = load[:, c]
            elif column == "speed" or column in record:
                _, unit, scale = _COLUMNS[column]
                resolution = NOISE[column][1]
                raw = shown[column][:, c] / scale + errors[column][:, c]
                columns[f"{column}_{c + 1}_{unit}"] = (
                    np.round(raw / resolution) * resolution if noise > 0.0 else raw
                )
    return columns


def log_text(columns: Mapping[str, Array]) -> str:
    """A rig log as CSV text."""
    decimals = [_DECIMALS[name.split("_")[0]] for name in columns]
    buffer = io.StringIO()
    np.savetxt(
        buffer, np.column_stack(list(columns.values())), fmt=[f"%.{d}f" for d in decimals], delimiter=",",
        header=",".join(columns), comments="",
    )  # fmt: skip
    return buffer.getvalue()


# --- all of it ---------------------------------------------------------------------------------------------------------
def make_practice(
    effects: Iterable[str] | Mapping[str, str] = (), *, model: str | Path | PlantModel = "paper", severity: str = "medium",
    values: Mapping[str, float] | None = None, noise: float = 1.0, base_error: float = 0.0,
    record: Iterable[str] = ("setpoint", "current", "pressure", "load"), rate: float = 1000.0, duration: float = 12.0,
    seed: int = 0, forms: str = "different", runs: Iterable[str] = ("fit_1", "fit_2", "sealed"),
    progress: Callable[[str], None] | None = None,
) -> Practice:  # fmt: skip
    """Makes practice logs of a rig with hidden effects.

    effects     "NAME" or "NAME:CHANNEL" (channel 1, 2 or both), or {name: channel}; none: nothing is hidden
    model       the model an engineer has: preset, YAML file or model
    severity    "small", "medium" or "large": half, one or two times the catalogue's typical size, each up to 15 % aside;
                signs are drawn where both make sense; drifts slower than the log are made as fast as it
    values      {"effect.parameter": value in SI}, instead of the drawn ones
    noise       factor on `NOISE`; 0: no noise and no quantisation
    base_error  the rig's base parameters differ from the model's by up to this fraction (0.1: 10 %), each channel alone
    record      signals besides time, command and speed, of `RECORDABLE`; without "load" none is applied
    rate        rows per second, a multiple of 100 Hz or a rate below
    duration    of each log, s, at least 3
    seed        the same seed gives the same logs; plan, rig and noise have streams of their own
    forms       of the effects in the simulator, see `plant.reference.FORMS`; "catalogue" wherever a user's effect is
    runs        which logs to make, of "fit_1", "fit_2", "sealed"
    progress    called with the name of each log as it is begun

    InputError in one line for anything unknown or out of range.
    """
    chosen = parse_effects(
        effects
        if not isinstance(effects, Mapping)
        else [f"{n}:{c}" if c != "rig" else n for n, c in effects.items()]
    )
    explicit = dict(values or {})
    record = tuple(record)
    runs = tuple(runs)
    if severity not in SEVERITIES:
        raise InputError(
            f"severity is {severity!r}; right is {', '.join(SEVERITIES)} or EFFECT.PARAMETER=NUMBER"
        )
    _check_values(explicit, chosen)
    for name in record:
        if name not in RECORDABLE:
            raise InputError(f"record: unknown signal {name!r}: {suggestion(name, RECORDABLE)}")
    for name in runs:
        if name not in _RUNS:
            raise InputError(f"runs: unknown log {name!r}: {suggestion(name, _RUNS)}")
    if not 0.0 <= noise <= 100.0:
        raise InputError(
            f"noise is {noise:g}; a factor from 0 to 100 is right (1: as in the contract of the rig)"
        )
    if not 0.0 <= base_error <= 0.5:
        raise InputError(f"base error is {base_error:g}; a fraction from 0 to 0.5 is right (0.1: 10 %)")
    if not 3.0 <= duration <= 3600.0:
        raise InputError(f"duration is {duration:g} s; 3 to 3600 s are right")
    multiple = rate * CONTROL_PERIOD
    if not 10.0 <= rate <= 20000.0 or (multiple > 1.0 and abs(multiple - round(multiple)) > 1e-9):
        raise InputError(f"rate is {rate:g} Hz; a multiple of 100 Hz up to 20000, or 10 to 100 Hz, is right")
    if seed < 0:
        raise InputError(f"seed is {seed}; a whole number from 0 is right")

    given = load_model(model)
    size_seed, base_seed, *run_seeds = np.random.SeedSequence(seed).spawn(2 + len(_RUNS))
    hidden = _choose(chosen, explicit, severity, duration, np.random.default_rng(size_seed))
    if any(name not in BUILT_IN for name in (*chosen, *given.declared)):
        forms = _CATALOGUE
    true, wrong = _true_model(given, hidden, base_error, np.random.default_rng(base_seed))
    logs: dict[str, dict[str, Array]] = {}
    for name, seeds in zip(_RUNS, run_seeds, strict=True):
        if name in runs:
            if progress is not None:
                progress(name)
            logs[name] = _record(name, given, true, record, rate, duration, noise, forms, seeds)
    truth = {
        "schema": SCHEMA,
        "verdict": "effects" if hidden else ("calibration" if wrong else "none"),
        "effects": [
            {
                "name": h.name,
                "channel": h.channel,
                "parameters": {
                    n: {"value": v if math.isfinite(v) else None, "unit": CATALOGUE[h.name].parameter(n).unit}
                    for n, v in h.parameters.items()
                },
            }
            for h in hidden
        ],
        "base_parameters": wrong,
        "model": given.name,
        "severity": severity,
        "noise": noise,
        "base_error": base_error,
        "record": list(record),
        "rate_Hz": rate,
        "duration_s": duration,
        "seed": seed,
        "forms": forms,
        "logs": {
            "fit": [f"{n}.csv" for n in logs if n.startswith("fit")],
            "sealed": [f"{n}.csv" for n in logs if n.startswith("sealed")],
        },
    }
    return Practice(logs, given, true, hidden, truth)


def run(
    effects: Sequence[str], out: Path, *, none: bool = False, model: str = "paper", severity: str = "medium",
    values: Sequence[str] = (), noise: float = 1.0, base_error_percent: float = 0.0,
    record: Sequence[str] = ("setpoint", "current", "pressure", "load"), rate: float = 1000.0, duration: float = 12.0,
    seed: int = 0,
) -> Practice:  # fmt: skip
    """The command `hydro-env hide EFFECT[:CHANNEL] ... --out DIR`; options as in `make_practice`.

    `values` are words "effect.parameter=value"; `none` (--none) hides nothing and must be said when no effect is named.
    Writes fit_1.csv, fit_2.csv, sealed.csv, model.yaml and truth.json to `out`.
    """
    from tqdm import tqdm

    if none and effects:
        raise InputError(f"--none hides nothing, yet {effects[0]!r} is named; leave one of them out")
    if not none and not effects:
        raise InputError(f"name an effect to hide, or --none; effects are {', '.join(CATALOGUE)}")
    with tqdm(total=len(_RUNS), unit="log", leave=False, delay=0.5) as bar:

        def begin(name: str) -> None:
            bar.update(1 if bar.desc else 0)  # the one before is done
            bar.set_description(name)

        practice = make_practice(
            effects, model=model, severity=severity, values=parse_values(values), noise=noise,
            base_error=base_error_percent / 100.0, record=record, rate=rate, duration=duration, seed=seed, progress=begin,
        )  # fmt: skip
    practice.write(Path(out))
    return practice
