"""Whether everything works on anybody's rig: models drawn from 2 to 500 cm3/rev and 10 to 350 bar, and every command on each.

    python -m docs.evidence.any_rig --out DIR [--seed N] [--rigs N] [--stages STAGE ...]
    python -m docs.evidence.any_rig --out DIR --name [--plant paper] [--seed N] [--rigs N]

A rig is drawn like a data sheet: a motor, a valve whose rated flow fits it, a supply, lines and oil (`drawn`). Its model file
goes through the `STAGES`; those that take long see every tenth rig only. What is counted for each: tracebacks, refusals, numbers
of the paper's rig in what is said (`OF_THE_PAPER`), and wrong physics: no movement at the full command, or a speed that the flow
of the valve cannot give.

With `--name` each rig hides one effect of medium size, the effects in turn, and is diagnosed from short logs; `--plant` takes one
plant for all instead, for comparison. What DIR holds is not run again. Writes any_rig.json or names.json, and prints a table.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
import re
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import yaml

from agents.command import run_command
from hydro_env.cli.main import run as hydro_env
from hydro_env.diagnosis import diagnose
from hydro_env.errors import InputError
from hydro_env.experiments.coverage import by_channel
from hydro_env.files import write_json, write_text
from hydro_env.limits import SEEDS, Limits
from hydro_env.plant import load_model, simulate
from hydro_env.plant.scales import rated
from hydro_env.practice.generate import make_practice
from hydro_env.reading import read_json
from hydro_env.units import BAR, REVOLUTION, RPM

from .blind_trials.cases import Case, cases
from .blind_trials.judging import judge

#: What belongs to the paper's rig and is said of no other one.
OF_THE_PAPER = re.compile(r"8(\.47)? cm3|\b73(\.0)? V|\b600 rpm|0\.8 N ?m|24\.5 l|\b100 bar|paper")
#: Largest error of a base parameter where names are judged: displacements are known to 10 %.
BASE_ERROR = 0.1
#: Speeds that the valve's flow gives the motor, as shares, between which a rig moves as it should at the full command.
MOVES = (0.3, 1.05)


# --- rigs -----------------------------------------------------------------------------------------------------------------
def drawn(seed: int) -> dict[str, Any]:
    """The content of the model file of a rig (class values, assumed): of two valves of a type, the second is the weaker one."""
    rng = np.random.default_rng([seed, 53])
    between, factor = rng.uniform, lambda low, high: float(low * (high / low) ** rng.random())
    size, supply = factor(2.0, 500.0), factor(10.0, 350.0) * BAR  # cm3/rev, Pa
    D = 1e-6 * size / REVOLUTION
    speed = float(np.clip(5000.0 * (size / 2.0) ** -0.6 * factor(0.6, 1.6), 100.0, 5000.0)) * RPM
    volumetric, drag = between(0.85, 0.98), between(0.02, 0.08)
    flow = D * speed / volumetric
    volts, current = factor(5.0, 100.0), factor(0.01, 0.1) if rng.random() < 0.2 else factor(0.3, 3.0)
    travel, force, frequency = factor(3e-4, 4e-3), factor(10.0, 150.0), 2.0 * math.pi * factor(10.0, 100.0)
    spring, resistance = force / travel, volts / current
    mass, friction = spring / frequency**2, force * factor(0.005, 0.06)
    bristles = 1.3 * friction / (factor(1e-3, 4e-3) * travel)
    both = {
        "D": D, "J": (size / 500.0) ** (5.0 / 3.0) * factor(1.0, 20.0), "B": drag * D * supply / speed,
        "Km": (1.0 - volumetric) * flow / supply, "beta": factor(5e8, 1.6e9), "V": 1e-6 * size * factor(5.0, 50.0),
        "u_rated": volts, "R": resistance, "L": resistance * factor(1e-3, 1e-2), "alpha": force / current, "k": spring,
        "m": mass, "C": 2.0 * between(0.1, 0.9) * math.sqrt(spring * mass), "Fc": friction, "Fs": friction * between(1.0, 1.8),
        "vs": travel * factor(0.3, 8.0), "s0": bristles, "s1": 2.0 * between(0.5, 1.2) * math.sqrt(bristles * mass), "s2": 0.0,
        "x_max": travel * between(1.05, 1.3), "k_stop": force / (0.035 * travel), "v_stop": 50.0 * travel,
    }  # fmt: skip
    other, laps = between(0.7, 1.0), between(0.0, 0.3, 2) * travel * (rng.random() < 0.8)
    effects: dict[str, Any] = {"pressure_dependent_flow": {"both": {"supply_pressure": supply}}}
    if laps.any():
        sides = {
            f"channel_{c + 1}": dict.fromkeys(("overlap_positive", "overlap_negative"), float(laps[c]))
            for c in (0, 1)
        }
        effects["dead_zone"] = sides
    if rng.random() < 0.5:
        effects["entrained_air"] = {
            "both": {"fraction": factor(3e-4, 2e-3)}
        }  # 1 %, at half the supply pressure
    if rng.random() < 0.5:
        effects["line_loss"] = {"both": {"coefficient": between(0.0, 0.05) * supply / flow**2}}
    data = {
        "schema": "hydro_env/model/1", "name": f"rig_{seed}", "both": {n: float(v) for n, v in both.items()},
        "channel_1": {"Kq": flow / travel}, "channel_2": {"Kq": float(other * flow / travel)}, "effects": effects,
    }  # fmt: skip
    sources = dict.fromkeys((*both, "Kq", *effects), "data sheet")
    return data | ({"sources": sources} if rng.random() < 0.5 else {})


# --- what is done with each ----------------------------------------------------------------------------------------------
def _simulated(path: Path, out: Path) -> str:
    model = load_model(path)
    of = [rated(model, c) for c in (0, 1)]
    given = np.array([one["flow"] / one["displacement"] for one in of])
    start = max(
        one["inertia"] * w / (one["displacement"] * one["pressure"]) for one, w in zip(of, given, strict=True)
    )
    rows = round(100.0 * (1.0 + 10.0 * start))
    for way in (1.0, -1.0):
        volts = way * np.array([one["command"] for one in of])
        found = simulate(model, np.tile(volts, (rows, 1)), np.zeros((rows, 2)), 0.01, record=["speed"])
        speed = way * found["speed"][-1, 0]
        wrong = ~((MOVES[0] * given < speed) & (speed < MOVES[1] * given))
        if wrong.any():
            return f"speeds {speed / RPM} rpm where the valves give {given / RPM}"
    return ""


def _episode(path: Path, out: Path) -> str:
    env = gymnasium.make("hydro_env:HydraulicSync-v0", plant=str(path), scenario="setpoint_steps")
    env.reset(seed=0)
    done, largest = False, 0.0
    while not done:
        seen, reward, ended, late, _ = env.step(np.ones(2, np.float32))
        done, largest = ended or late, max(largest, float(np.abs(seen).max()))
        if not np.isfinite([*np.ravel(seen), float(reward)]).all():
            return "an observation or reward is not finite"
    return "" if largest > 0.05 else f"the largest observation is {largest:.2g}"


def _command(*words: str) -> Callable[[Path, Path], str]:
    """A stage that runs a command; `RIG` and `OUT` stand for the model file and a folder. What it says comes after its status."""

    def stage(path: Path, out: Path) -> str:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = hydro_env([{"RIG": str(path), "OUT": str(out)}.get(word, word) for word in words])
        text = said.getvalue().replace(str(path), "RIG").replace(str(out), "OUT")
        write_text(out / "said.txt", text)
        told = OF_THE_PAPER.search(text)
        last = text.strip().splitlines()[-1:]
        return f"status {status}: {last}" if status else f"says {told[0]!r}" if told else ""

    return stage


def _found(path: Path, out: Path) -> str:
    practice = make_practice(
        ["magnetic_hysteresis:1"], model=path, duration=6.0, rate=200.0, seed=1, base_error=0.1
    )
    practice.write(out)
    files = [str(out / f"{name}.csv") for name in ("fit_1", "fit_2", "sealed")]
    return _command("diagnose", *files[:2], "--sealed", files[2], "--model", "RIG", "--out", "OUT")(path, out)


#: Stages by name: what is done with a rig's model file, which returns what is wrong ("" if nothing is), and on every how many
#: rigs.
STAGES: dict[str, tuple[Callable[[Path, Path], str], int]] = {
    "simulate": (_simulated, 1),
    "environment": (_episode, 1),
    "valve-test": (
        _command("valve-test", "RIG", "--no-pictures", "--controllers", "pid_tuned", "--out", "OUT"),
        2,
    ),
    "hide": (
        _command(
            "hide", "spool_stiction:1", "supply_droop", "--duration", "3", "--model", "RIG", "--out", "OUT"
        ),
        2,
    ),
    "diagnose": (_found, 10),
    "export": (_command("export", "fmu", "--model", "RIG", "--out", "OUT"), 20),
    "benchmark": (
        _command("benchmark", "pid_tuned", "--suite", "quick", "--plant", "RIG", "--out", "OUT"),
        20,
    ),
}


def examined(seed: int, stages: Sequence[str], number: int) -> dict[str, str]:
    """What is wrong with each stage on a rig, the `number`-th; of stages that it does not see nothing."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "my_rig.yaml"
        path.write_text(yaml.safe_dump(drawn(seed)))
        for stage in stages:
            work, every = STAGES[stage]
            if number % every == 0:
                out = Path(name) / stage.replace(" ", "_")
                out.mkdir()
                try:
                    found[stage] = work(path, out)
                except InputError as problem:
                    found[stage] = f"refused: {problem}"
                except Exception:
                    found[stage] = traceback.format_exc(limit=-3)
    return found


# --- naming -----------------------------------------------------------------------------------------------------------------
def named(case: Case, plant: str | None) -> dict[str, Any]:
    """Hides the effect of a trial on the rig of its seed, or on `plant`, and judges what the diagnosis names."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = load_model(plant or drawn(case.seed))
        for word in case.hidden:  # what is hidden is not in the given model
            model = model.without(word.partition(":")[0])
        practice = make_practice(case.hidden, model=model, base_error=BASE_ERROR, seed=case.seed, rate=500.0)
        practice.write(folder)
        files = [folder / f"{log}.csv" for log in ("fit_1", "fit_2", "sealed")]
        begin = time.process_time()
        data = diagnose(files[:2], files[2:], model=folder / "model.yaml").as_dict()
    found = judge(data, by_channel(practice.truth["effects"]), practice.truth["verdict"])
    kept = {key: found[key] for key in ("verdict", "named", "right", "set", "worst")}
    return {"seed": case.seed, "hidden": case.hidden, **kept, "cpu_s": round(time.process_time() - begin, 1)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("--out", type=Path, required=True)
    add("--seed", type=SEEDS, default=0)
    add("--first", type=Limits(0, 10_000, whole=True), default=0, help="number of the first of these rigs")
    add("--rigs", type=Limits(1, 10_000, whole=True), default=100)
    add("--stages", nargs="+", choices=STAGES, default=list(STAGES))
    add("--name", action="store_true", help="hide and diagnose one effect on each")
    add("--plant", help="one plant for all names")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / ("names.json" if given.name else "any_rig.json")
    rows: dict[str, Any] = read_json(path, "rigs that were examined") if path.exists() else {}
    for number in range(given.first, given.first + given.rigs):
        seed = given.seed + number
        if str(seed) in rows:
            continue
        if given.name:
            trials = cases(["medium"], given.seed)
            rows[str(seed)] = named(replace(trials[number % len(trials)], seed=seed), given.plant)
            print({**rows[str(seed)]}, flush=True)
        else:
            rows[str(seed)] = examined(seed, given.stages, number)
            print(seed, {stage: text for stage, text in rows[str(seed)].items() if text}, flush=True)
        write_json(path, rows)
    print(names_summary(rows) if given.name else stages_table(rows))


def names_summary(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """How many are right."""
    right, among = (sum(row[key] for row in rows.values()) for key in ("right", "set"))
    return (
        f"{len(rows)} effects: {right} named, {among} named or listed as indistinguishable from the named one"
    )


def stages_table(rows: Mapping[str, Mapping[str, str]]) -> str:
    """Rigs by stage, and those of which something is wrong, in Markdown."""
    lines = ["| stage | rigs | wrong |", "|---|---|---|"]
    for stage in STAGES:
        seen = [row[stage] for row in rows.values() if stage in row]
        lines.append(f"| {stage} | {len(seen)} | {sum(map(bool, seen))} |")
    return "\n".join(lines)


if __name__ == "__main__":
    run_command(main)
