"""How accurately models are simulated that lie far apart, within the ranges that are accepted.

    python -m docs.evidence.accuracy --out DIR [--models N] [--commands KIND ...] [--seconds S] [--sample N] [--seed N]

Models are drawn around every preset: a third of the base parameters and, in three of four, one to three effects are anywhere
within the accepted ranges. Each is driven for S seconds by smooth, stepped, uniform, Gaussian and bang-bang commands of full
range (or by some of these, `--commands`), every second one under loads that change ten times a second, and is compared with the
same plant at a thirtieth of the tolerance. One that differs there by more than 0.1 rpm (RMS) and 1e-4 of its speed is driven once
more at a thirtieth, by commands that are smaller by a millionth and by a load of a millionth of the torque at 100 bar: where that
moves the speed by more than a ten-thousandth, the motion separates neighbouring solutions, and no simulator foretells it.
`--sample` models, chosen by chance, are also compared with the reference simulator, each under one of the commands in turn.

`accuracy.csv` has a line for each model and command, the worst first: the RMS of the speed and of its errors in rpm, attempts at
steps for a period of 10 ms, and what the model is. `effects.md` counts by effect what is off.
"""

from __future__ import annotations

import argparse
import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agents.command import run_command
from hydro_env.errors import InputError
from hydro_env.files import write_text
from hydro_env.plant import (
    BUILT_IN,
    CATALOGUE,
    PARAMETERS,
    Parameter,
    Plant,
    PlantModel,
    load_model,
    preset_names,
    scales_of,
)
from hydro_env.practice.reference import simulate_reference
from hydro_env.units import RPM

from . import any_rig

Array = NDArray[np.float64]

COMMANDS = ("smooth", "steps", "uniform", "gaussian", "bang_bang")
PERIOD = 0.01
#: What is right: an error of the speed (RMS) in rpm, or as a share of the speed.
TOLERANCE_RPM, TOLERANCE_SHARE = 0.1, 1e-4
#: By which share commands are smaller, and how many times as much the speed changes where motions separate.
NUDGE, GROWTH = 1e-6, 100.0
#: By how much finer the tolerance is for what the speeds are compared with.
FINER = 30.0
#: What an infinite limit of the command, and of an effect, stands for.
_NO_LIMIT, _MOST = 200.0, 1e9


@dataclass
class Result:
    """A model under one command: RMS of the speed and of the errors in rpm, None where not compared; `growth`: by how much more
    than the command the speed changes; `attempts` at steps for a period, those of the channel that takes more."""

    model: PlantModel
    command: str
    speed: float
    error: float
    diverged: bool
    attempts: float = 0.0
    growth: float | None = None
    reference: float | None = None

    @property
    def off(self) -> bool:
        """Whether the error is beyond the bound, though the plant has not given up and the motion does not separate."""
        bound = max(TOLERANCE_RPM, TOLERANCE_SHARE * self.speed)
        separates = self.growth is not None and self.growth > GROWTH
        return not (self.diverged or separates or self.error <= bound)


def commands(kind: str, seconds: float, rng: np.random.Generator) -> Array:
    """Shares of the rated command, (T, 2)."""
    rows = round(seconds / PERIOD)
    at = np.arange(rows)[:, None] * PERIOD
    if kind == "smooth":
        phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        slow, fast = (np.sin(2.0 * math.pi * f * at + n * phase) for n, f in ((1, 0.8), (2, 3.0)))
        return 0.6 * slow + 0.15 * fast
    if kind == "steps":
        return np.repeat(rng.uniform(-1.0, 1.0, (rows // 20 + 1, 2)), 20, axis=0)[:rows]
    if kind == "uniform":
        return rng.uniform(-1.0, 1.0, (rows, 2))
    if kind == "gaussian":
        return np.clip(rng.normal(0.0, 0.5, (rows, 2)), -1.0, 1.0)
    return np.where(np.cumsum(rng.random((rows, 2)) < 0.4, axis=0) % 2 == 0, 1.0, -1.0)


def loads(model: PlantModel, seconds: float, rng: np.random.Generator) -> Array:
    """Torques of up to a fifth of what the motors, or a motor as large as the paper's, give at 100 bar, N m, (T, 2)."""
    rows = round(seconds / PERIOD)
    share = np.repeat(rng.uniform(-0.2, 0.2, (rows // 10 + 1, 2)), 10, axis=0)[:rows]
    return share * 1e7 * np.minimum(model.pair("D"), PARAMETERS["D"].nominal)


def drawn(count: int, rng: np.random.Generator, rigs: bool = False) -> tuple[list[PlantModel], int]:
    """Random models around all presets in turn, or around `rigs` of every size, and how many draws were refused."""
    models: list[PlantModel] = []
    refused, presets = 0, preset_names()
    while len(models) < count:
        base = load_model(
            any_rig.drawn(int(rng.integers(2**31))) if rigs else presets[len(models) % len(presets)]
        )
        scales, values = scales_of(base), {}
        for name, p in PARAMETERS.items():
            if rng.random() < 1.0 / 3.0 and not (rigs and p.absolute):
                values[name] = _value(p, *scales.parameter(p).possible, rng)
        for name in rng.choice(BUILT_IN, rng.integers(4), replace=False):
            for p in scales.effect(CATALOGUE[name]).parameters:
                values[f"{name}.{p.name}"] = _value(p, p.low, p.high, rng)
        try:
            models.append(base.with_values(values))
        except InputError:
            refused += 1
    return models, refused


def _value(p: Parameter, low: float, high: float, rng: np.random.Generator) -> float:
    """An end of the range, or a value between, by factors where these are natural."""
    high = max(_NO_LIMIT, 2.0 * low) if p.name == "u_rated" else min(high, _MOST)
    if rng.random() < 0.3:
        return (low, high)[rng.integers(2)]
    if p.log:
        return float(np.exp(rng.uniform(math.log(max(low, 1e-3 * high)), math.log(high))))
    return float(rng.uniform(low, high))


# --- comparison -------------------------------------------------------------------------------------------------------
def _run(
    models: Sequence[PlantModel], volts: Array, load: Array, finer: float = 1.0
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Speeds (T, models, 2) in rpm under `volts` and `load` (T, models, 2), which diverged, and attempts for a period."""
    plant = Plant(models[0], len(models), effects=BUILT_IN, tolerance=models[0].tolerance / finer)
    names = (*PARAMETERS, *(f"{name}.{p.name}" for name in BUILT_IN for p in CATALOGUE[name].parameters))
    for row, model in enumerate(models):
        plant.set_values({name: model.pair(name) for name in names}, rows=[row])
    plant.reset()
    speed = plant.run(volts, load, PERIOD)["speed"] / RPM
    return speed, plant.diverged, plant.get("attempts").max(axis=1) / len(volts)


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=(0, 2))))


def compare(models: Sequence[PlantModel], volts: Array, load: Array, command: str) -> list[Result]:
    """The results under commands and loads (T, models, 2) of one kind."""
    speed, diverged, attempts = _run(models, volts, load)
    fine, broken, _ = _run(models, volts, load, FINER)
    columns = (_rms(fine), _rms(speed - fine), diverged | broken, attempts)
    found = [
        Result(model, command, *numbers)
        for model, *numbers in zip(models, *(column.tolist() for column in columns), strict=True)
    ]
    doubtful = [n for n, result in enumerate(found) if result.off]
    if doubtful:
        own = [models[n] for n in doubtful]
        more = NUDGE * np.array([model.pair("D") for model in own]) * 1e7
        nudged, _, _ = _run(own, (1.0 - NUDGE) * volts[:, doubtful], load[:, doubtful] + more, FINER)
        for n, moved in zip(doubtful, _rms(fine[:, doubtful] - nudged), strict=True):
            found[n].growth = float(moved) / (NUDGE * max(found[n].speed, 1e-9))
    return found


def against_reference(model: PlantModel, volts: Array, load: Array) -> float:
    """RMS error of the speeds against the reference simulator under commands and loads (T, 2), rpm."""
    truth = simulate_reference(model, volts, load, PERIOD, tolerance=1e-8)["speed"] / RPM
    speed, _, _ = _run([model], volts[:, None], load[:, None])
    return float(_rms(speed - truth[:, None])[0])


# --- the command ------------------------------------------------------------------------------------------------------
def summary(results: Sequence[Result], refused: int) -> str:
    """What was found, in lines."""
    errors = np.array([r.error for r in results])
    off = [r for r in results if r.off]
    compared = [r.reference for r in results if r.reference is not None]
    lines = [
        f"{len(results)} runs of {len({id(r.model) for r in results})} models; {refused} models drawn were refused",
        f"diverged: {sum(r.diverged for r in results)}",
        f"error in rpm: median {np.median(errors):.2g}, 99 % below {np.quantile(errors, 0.99):.2g}",
        f"separating: {sum(r.growth is not None and not r.off for r in results)}; others off: {len(off)}, the worst by"
        f" {max((r.error for r in off), default=0.0):.2g} rpm",
    ]
    if compared:
        right = sum(e <= TOLERANCE_RPM for e in compared)
        lines.append(
            f"against the reference: {right} of {len(compared)} within, median {np.median(compared):.2g} rpm"
        )
    return "\n".join(lines)


def effects_table(results: Sequence[Result]) -> str:
    """By effect how many runs separate or are off, in Markdown, and the worst of these."""
    lines = ["| effect | runs | separating | off | worst error, rpm |", "|---|---|---|---|---|"]
    for name in ("none", *BUILT_IN):
        own = [r for r in results if (name in r.model.declared if name != "none" else not r.model.declared)]
        off = [r for r in own if r.off]
        separating = sum(r.growth is not None and not r.off for r in own)
        worst = f"{max(r.error for r in off):.2g}" if off else ""
        lines.append(f"| `{name}` | {len(own)} | {separating} | {len(off)} | {worst} |")
    return "\n".join(lines) + "\n"


def table(results: Sequence[Result]) -> str:
    """The results as CSV, those that are off and the worst first."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        ["command", "speed_rpm", "error_rpm", "growth", "reference_rpm", "diverged", "attempts", "model"]
    )
    for r in sorted(results, key=lambda r: (not r.off, -r.error)):
        numbers = ["" if v is None else f"{v:.3g}" for v in (r.speed, r.error, r.growth, r.reference)]
        base = load_model(r.model.name).values if r.model.name in preset_names() else {}
        own = {n: v[0] for n, v in r.model.values.items() if v != base.get(n)}
        said = " ".join([r.model.name, *(f"{name}={value:.6g}" for name, value in own.items())])
        writer.writerow([r.command, *numbers, int(r.diverged), f"{r.attempts:.4g}", said])
    return out.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument(
        "--rigs", action="store_true", help="around rigs of every size instead of the presets"
    )
    parser.add_argument("--models", type=int, default=2000)
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(options.seed)
    models, refused = drawn(options.models, rng, options.rigs)
    sampled = {
        int(n): options.commands[n % len(options.commands)]
        for n in rng.permutation(len(models))[: options.sample]
    }
    results: list[Result] = []
    for kind in options.commands:
        for start in range(0, len(models), 16):
            group = models[start : start + 16]
            rated = np.array([np.minimum(model.pair("u_rated"), _NO_LIMIT) for model in group])
            volts = np.stack([commands(kind, options.seconds, rng) for _ in group], axis=1) * rated
            load = np.stack(
                [loads(model, options.seconds, rng) * (n % 2) for n, model in enumerate(group)], axis=1
            )
            found = compare(group, volts, load, kind)
            for n, result in enumerate(found):
                if sampled.get(start + n) == kind:
                    result.reference = against_reference(result.model, volts[:, n], load[:, n])
            results += found
        write_text(options.out / "accuracy.csv", table(results))
        write_text(options.out / "effects.md", effects_table(results))
        print(f"{kind}:\n{summary(results, refused)}", flush=True)


if __name__ == "__main__":
    run_command(main)
