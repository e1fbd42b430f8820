"""How accurately models are simulated that lie far apart, within the ranges that are accepted.

    python -m hydro_env.experiments.accuracy --out DIR [--ends] [--models N] [--effects NAME ...] [--commands KIND ...]
        [--seconds S] [--sample N] [--seed N]

`--ends` takes every base parameter over its accepted range, two of them at their ends, and every effect with each of its
parameters at either end. `--models` draws models: a preset, base parameters and effects within the accepted ranges. With
`--effects` it draws so many for each of these effects (`all`: for every one): the effect over its bounds, volume and bulk modulus
and up to three other base parameters of the paper's model over theirs; effects.md then counts what is off, by effect.

Each model is what a user gets from `load_model`, which gives it a shorter substep or refuses it where its own does not follow it.
It is driven for S seconds by smooth, uniform, Gaussian and bang-bang commands of full range, or by some of these
(`--commands`), and compared with the same at an eighth of the substep and of the parts in which a stiff channel takes it. One
that differs there by more than 0.1 rpm (RMS) and 1e-4 of its speed is driven once more at an eighth, by commands that are
smaller by a millionth: where that moves the speed by more than a ten-thousandth, the motion separates neighbouring solutions,
and no simulator foretells it (`substep_check`).
`--sample` models, chosen by chance, are also compared with the reference simulator, each under one of the commands in turn.

`accuracy.csv` has a line for each model and command: the RMS of the speed and of its errors in rpm, and what the model is.
"""

from __future__ import annotations

import argparse
import csv
import io
import itertools
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env.errors import InputError, run_command
from hydro_env.files import write_text
from hydro_env.plant import BUILT_IN, CATALOGUE, PARAMETERS, Parameter, Plant, PlantModel, load_model
from hydro_env.plant.substep_check import GROWTH, NUDGE, TOLERANCE_RPM, TOLERANCE_SHARE
from hydro_env.practice.reference import simulate_reference
from hydro_env.units import RPM

__all__ = [
    "COMMANDS", "Case", "Result", "commands", "compare", "drawn", "drawn_about", "ends_of_base",
    "ends_of_effects",
]  # fmt: skip

Array = NDArray[np.float64]

COMMANDS = ("smooth", "random", "gaussian", "bang_bang")
PRESETS = ("paper", "paper_dead_zone", "rig", "servo", "valve_1", "valve_2")
PERIOD = 0.01
#: What an infinite limit of the command stands for, V.
_NO_LIMIT = 200.0
#: In how many parts the substep is taken for what the speeds are compared with.
_FINE = 8
#: Most combinations of ends of the parameters of one effect.
_MOST_CORNERS = 16


@dataclass(frozen=True)
class Case:
    """What differs from a preset, the same on both channels."""

    values: dict[str, float]
    preset: str = "paper"

    @property
    def given(self) -> PlantModel:
        """The model as it is written down. InputError if it is refused by its parameters alone."""
        return load_model(self.preset).with_values(self.values, name="case")

    @cached_property
    def model(self) -> PlantModel:
        """The model as a user gets it, with a substep that follows it. InputError if none does."""
        return load_model(self.given)

    @property
    def plain(self) -> bool:
        """Whether no effect acts."""
        return not self.given.declared


@dataclass
class Result:
    """A case under one command: RMS of the speed and of the errors in rpm, None where not compared; `growth`: by how much more
    than the command the speed changes."""

    case: Case
    command: str
    speed: float
    error: float
    growth: float | None = None
    reference: float | None = None
    diverged: bool = False

    @property
    def bound(self) -> float:
        return max(TOLERANCE_RPM, TOLERANCE_SHARE * self.speed)

    @property
    def separates(self) -> bool:
        """Whether a change of the command becomes so much larger that no simulator foretells the motion."""
        return self.growth is not None and self.growth > GROWTH


def commands(kind: str, seconds: float, rng: np.random.Generator) -> Array:
    """Shares of the rated command, (T, 2)."""
    rows = round(seconds / PERIOD)
    time = np.arange(rows)[:, None] * PERIOD
    if kind == "smooth":
        phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        slow, fast = (np.sin(2.0 * math.pi * f * time + n * phase) for n, f in ((1, 0.8), (2, 3.0)))
        return 0.6 * slow + 0.15 * fast
    if kind == "random":
        return rng.uniform(-1.0, 1.0, (rows, 2))
    if kind == "gaussian":
        return np.clip(rng.normal(0.0, 0.5, (rows, 2)), -1.0, 1.0)
    return np.where(np.cumsum(rng.random((rows, 2)) < 0.4, axis=0) % 2 == 0, 1.0, -1.0)


# --- cases ------------------------------------------------------------------------------------------------------------
def _ends(p: Parameter) -> tuple[float, float]:
    low, high = p.possible
    return low, high if math.isfinite(high) and p.name != "u_rated" else max(_NO_LIMIT, 2.0 * low)


def ends_of_base(steps: int = 7) -> list[Case]:
    """Each base parameter over its accepted range, any two of them at their ends, and no dry friction."""
    cases = [Case({"Fc": 0.0, "Fs": 0.0})]
    for name, p in PARAMETERS.items():
        low, high = _ends(p)
        over = np.geomspace(low or 1e-3 * high, high, steps)
        cases += [Case({name: float(value)}) for value in (over if low else np.r_[0.0, over])]
    for one, other in itertools.combinations(PARAMETERS, 2):
        corners = itertools.product(_ends(PARAMETERS[one]), _ends(PARAMETERS[other]))
        cases += [Case({one: a, other: b}) for a, b in corners]
    return cases


def ends_of_effects(names: Iterable[str] = BUILT_IN, seed: int = 0) -> list[Case]:
    """Each effect with its parameters at either end: all combinations, or as many by chance where they are many."""
    rng = np.random.default_rng(seed)
    cases = []
    for effect in map(CATALOGUE.__getitem__, names):
        keys = [f"{effect.name}.{p.name}" for p in effect.parameters]
        corners = list(itertools.product(*((p.low, min(p.high, 1e9)) for p in effect.parameters)))
        if len(corners) > _MOST_CORNERS:
            corners = [corners[n] for n in rng.choice(len(corners), _MOST_CORNERS, replace=False)]
        cases += [Case(dict(zip(keys, corner, strict=True))) for corner in corners]
    return cases


def drawn(count: int, rng: np.random.Generator, move: float = 0.35) -> tuple[list[Case], int]:
    """Random models, and how many draws were refused: of a preset a third of the base parameters is moved, and every second one
    gets effects."""
    cases: list[Case] = []
    refused = 0
    while len(cases) < count:
        values: dict[str, float] = {}
        for name, p in PARAMETERS.items():
            if rng.random() < move:
                values[name] = _value(p, *_ends(p), rng)
        for name in rng.choice(BUILT_IN, rng.choice([0, 0, 1, 2]), replace=False):
            for p in CATALOGUE[name].parameters:
                values[f"{name}.{p.name}"] = _value(p, p.low, min(p.high, 1e9), rng)
        case = Case(values, str(rng.choice(PRESETS)))
        try:
            _ = case.given
        except InputError:
            refused += 1
        else:
            cases.append(case)
    return cases, refused


def drawn_about(effect: str, count: int, rng: np.random.Generator) -> tuple[list[Case], int]:
    """Random models that have one effect, and how many draws were refused.

    The effect, volume and bulk modulus and up to three other base parameters are within their accepted ranges."""
    cases: list[Case] = []
    others = [name for name in PARAMETERS if name not in ("V", "beta")]
    refused = 0
    while len(cases) < count:
        moved = ("V", "beta", *rng.choice(others, rng.integers(4), replace=False))
        values = {name: _value(PARAMETERS[name], *_ends(PARAMETERS[name]), rng) for name in moved}
        for p in CATALOGUE[effect].parameters:
            values[f"{effect}.{p.name}"] = _value(p, p.low, min(p.high, 1e9), rng)
        case = Case(values)
        try:
            _ = case.given
        except InputError:
            refused += 1
        else:
            cases.append(case)
    return cases, refused


def _value(p: Parameter, low: float, high: float, rng: np.random.Generator) -> float:
    """An end of the range, or a value between, by factors where these are natural."""
    if rng.random() < 0.3:
        return (low, high)[rng.integers(2)]
    if p.log:
        return float(np.exp(rng.uniform(math.log(max(low, 1e-3 * high)), math.log(high))))
    return float(rng.uniform(low, high))


# --- comparison -------------------------------------------------------------------------------------------------------
def _run(cases: Sequence[Case], share: Array, parts: int) -> tuple[Array, NDArray[np.bool_], float]:
    """Speeds (T, cases, 2) in rpm at the substep, one and the same, in so many parts; which diverged; and channel substeps."""
    models = [case.model for case in cases]
    declared = {model.declared for model in models}
    effects = declared.pop() if len(declared) == 1 else BUILT_IN
    # A rig to a block: in a common one all take the parts that any of them asks for.
    finer = replace(load_model("paper"), substep=models[0].substep, finer=models[0].finer * parts)
    plant = Plant(finer, len(cases), effects=effects, block=1)
    named = [f"{name}.{p.name}" for name in effects for p in CATALOGUE[name].parameters]
    for row, model in enumerate(models):
        plant.set_values({name: model.pair(name) for name in (*PARAMETERS, *named)}, rows=[row])
    plant.reset()
    volts = share[:, None] * np.minimum(plant.get("u_rated"), _NO_LIMIT)
    speed = plant.run(volts, None, PERIOD, ("speed",))["speed"]
    return speed / RPM, plant.diverged, float(2 * len(cases) * len(share) * plant.substeps(PERIOD))


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=(0, 2))))


def compare(cases: Sequence[Case], share: Array, command: str) -> tuple[list[Result], float]:
    """The results under one command, and the number of channel substeps that were made at the model's own substep."""
    groups: dict[tuple[bool, float, int], list[Case]] = {}
    for case in cases:
        groups.setdefault((case.plain, case.model.substep, case.model.finer), []).append(case)
    results: list[Result] = []
    made = 0.0
    for group in groups.values():
        speed, diverged, substeps = _run(group, share, 1)
        fine, broken, _ = _run(group, share, _FINE)
        made += substeps
        found = [
            Result(case, command, *numbers)
            for case, *numbers in zip(group, _rms(fine).tolist(), _rms(speed - fine).tolist(), strict=True)
        ]
        for result, bad in zip(found, (diverged | broken).tolist(), strict=True):
            result.diverged = bad
        doubtful = [n for n, result in enumerate(found) if result.error > result.bound]
        if doubtful:
            nudged, _, _ = _run([group[n] for n in doubtful], (1.0 - NUDGE) * share, _FINE)
            for n, moved in zip(doubtful, _rms(fine[:, doubtful] - nudged).tolist(), strict=True):
                found[n].growth = moved / (NUDGE * max(found[n].speed, 1e-9))
        results += found
    return results, made


def against_reference(case: Case, share: Array) -> float:
    """RMS error of the speeds against the reference simulator, rpm."""
    model = case.model
    volts = share * np.minimum(model.pair("u_rated"), _NO_LIMIT)
    truth = simulate_reference(model, volts, None, PERIOD, tolerance=1e-8)["speed"]
    speed, _, _ = _run([case], share, 1)
    return float(_rms(speed - truth[:, None] / RPM)[0])


# --- the command ------------------------------------------------------------------------------------------------------
def summary(results: Sequence[Result], made: float, refused: int) -> str:
    """What was found, in lines."""
    errors = np.array([result.error for result in results])
    over = [r for r in results if r.error > r.bound and not r.separates]
    references = [r for r in results if r.reference is not None]
    lines = [
        f"{len(results)} runs of {len({id(r.case) for r in results})} models, {made:.3g} channel substeps; {refused} models"
        " drawn were refused",
        f"diverged: {sum(r.diverged for r in results)}",
        f"error in rpm: median {np.median(errors):.2g}, 99 % below {np.quantile(errors, 0.99):.2g}",
        f"separating: {sum(r.separates for r in results)}; others above the bound: {len(over)}",
    ]
    if references:
        worst = [r.reference for r in references if r.reference is not None]
        within = sum(r.reference <= r.bound for r in references if r.reference is not None)
        lines.append(
            f"against the reference: {within} of {len(references)} within, median {np.median(worst):.2g} rpm"
        )
    return "\n".join(lines)


def effects_table(results: Sequence[Result]) -> str:
    """By effect how many models are off under any command, in Markdown: all, those that separate, and the worst other one."""
    lines = [
        "| effect | models | off | of these separating | worst other error, rpm |",
        "|---|---|---|---|---|",
    ]
    by_effect: dict[str, list[Result]] = {}
    for r in results:
        by_effect.setdefault(" ".join(r.case.given.declared), []).append(r)
    for name, own in sorted(by_effect.items()):
        off = [r for r in own if r.error > r.bound]
        others = [r for r in off if not r.separates]
        off_models, other_models = ({id(r.case) for r in rows} for rows in (off, others))
        worst = f"{max(r.error for r in others):.2g}" if others else ""
        models = len({id(r.case) for r in own})
        lines.append(
            f"| `{name}` | {models} | {len(off_models)} | {len(off_models - other_models)} | {worst} |"
        )
    return "\n".join(lines) + "\n"


def table(results: Sequence[Result]) -> str:
    """The results as CSV, the worst first."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["command", "speed_rpm", "error_rpm", "growth", "reference_rpm", "diverged", "model"])
    for r in sorted(results, key=lambda r: -r.error):
        numbers = ["" if v is None else f"{v:.3g}" for v in (r.speed, r.error, r.growth, r.reference)]
        said = " ".join([r.case.preset, *(f"{name}={value:.4g}" for name, value in r.case.values.items())])
        writer.writerow([r.command, *numbers, int(r.diverged), said])
    return out.getvalue()


def _wanted(options: argparse.Namespace, rng: np.random.Generator) -> tuple[list[Case], int]:
    """The models that are asked for, and how many were refused."""
    names = BUILT_IN if "all" in options.effects else options.effects
    found = [drawn_about(name, options.models, rng) for name in names] or [drawn(options.models, rng)]
    cases, refused = [case for own, _ in found for case in own], sum(count for _, count in found)
    for case in (*ends_of_base(), *ends_of_effects()) if options.ends else ():
        try:
            _ = case.given
        except InputError:
            refused += 1
        else:
            cases.append(case)
    return cases, refused


def _checked(cases: Iterable[Case]) -> set[int]:
    """The cases, by `id`, that are not refused when their substep is checked; prints what came of it and what it took."""
    parts: dict[int, int] = {}
    took, refused = [], []
    for case in cases:
        begun = time.process_time()
        try:
            parts[id(case)] = case.model.finer
        except InputError as problem:
            refused.append(str(problem))
        took.append(time.process_time() - begun)
    shares = list(parts.values())
    print(
        f"substep checked: {sum(share > 1 for share in shares)} models get a shorter one, so that they take"
        f" {np.mean(shares):.3g} times as many in the mean, {len(refused)} are refused; {np.median(took):.2g} processor"
        f" seconds in the median, {np.quantile(took, 0.9):.2g} for nine of ten",
        *refused,
        sep="\n  ",
    )
    return set(parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--ends", action="store_true")
    parser.add_argument("--models", type=int, default=0)
    parser.add_argument("--effects", nargs="+", choices=("all", *BUILT_IN), metavar="NAME", default=[])
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(options.seed)
    cases, refused = _wanted(options, rng)
    if not cases:
        parser.error("--ends or --models: nothing to simulate")
    followed = _checked(cases)
    sampled = set(rng.permutation(len(cases))[: options.sample].tolist())
    results: list[Result] = []
    made = 0.0
    for turn, kind in enumerate(options.commands):
        share = commands(kind, options.seconds, rng)
        for start in range(0, len(cases), 64):
            group = [case for case in cases[start : start + 64] if id(case) in followed]
            found, substeps = compare(group, share, kind)
            results += found
            made += substeps
        own: dict[int, Any] = {id(cases[n]): n for n in sampled if n % len(options.commands) == turn}
        for result in results:
            if result.command == kind and id(result.case) in own:
                result.reference = against_reference(result.case, share)
        write_text(options.out / "accuracy.csv", table(results))
        print(f"{kind}:\n{summary(results, made, refused)}", flush=True)
    if options.effects:
        write_text(options.out / "effects.md", effects_table(results))
        print(effects_table(results), end="")


if __name__ == "__main__":
    run_command(main)
