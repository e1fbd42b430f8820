"""`hydro-env speed`: how fast the plant and the environment run here, and how large the error is at that speed.

Speed without accuracy means nothing, so both are measured in one run: the error is the largest difference of the speed
to the reference simulator (SciPy's stiff solver on the plain equations) under the same kinds of command.
"""

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.arrays import Floats
from hydro_env.files import write_json
from hydro_env.plant import BUILT_IN, Plant, load_model
from hydro_env.units import RPM

NUM_ENVS = (1, 16, 64, 256, 1024)
#: Kinds of command, see `commands`.
KINDS = ("smooth", "uniform", "gaussian", "bang_bang")
#: Presets that are measured under every kind of command, with the mismatch of their valves. The first is the default plant.
PLANTS = {"paper_dead_zone": "auto", "rig": "auto", "servo": "own"}
DTYPES = ("float64", "float32")
PERIOD = 0.01
#: Control periods of each kind of command that are compared with the reference.
ERROR_ROWS = 100


def _rate(work: Callable[[], object], units: int, seconds: float) -> float:
    """Units of work a second of processor time, with `units` in a call: the best of five stretches, after one that warms up.

    All work here is done by one thread, so that on an idle machine this is time on the clock, and on a busy one it does
    not count what others take.
    """
    work()
    best = 0.0
    for _ in range(5):
        done, start = 0, time.process_time()
        while (passed := time.process_time() - start) < seconds / 5:
            work()
            done += units
        best = max(best, done / passed)
    return best


def commands(kind: str, rows: int, rigs: int, rng: np.random.Generator) -> Floats:
    """Commands of one of `KINDS`, (rows, rigs, 2), fractions of the rated one: what a controller does (slow motion with a little
    unrest), and what policies without training send, which drives spools into their end stops.
    """
    size = rows, rigs, 2
    if kind == "uniform":
        return rng.uniform(-1.0, 1.0, size)
    if kind == "gaussian":
        return np.clip(rng.normal(0.0, 1.0, size), -1.0, 1.0)
    if kind == "bang_bang":
        return rng.choice([-1.0, 1.0], size)
    time_s, phase = np.arange(rows)[:, None, None] * PERIOD, rng.uniform(0, 2 * np.pi, (rigs, 2))
    return 0.75 * np.sin(2 * np.pi * 0.4 * time_s + phase) + rng.normal(0.0, 0.014, size)


def measure_single(seconds: float = 1.0) -> dict[str, float]:
    """Steps a second of one environment (`gymnasium.make` without wrappers), and of its plant alone."""
    from hydro_env.envs.hydraulic_sync import HydraulicSyncEnv

    env, plant = HydraulicSyncEnv(), Plant("paper_dead_zone")
    actions = commands("smooth", 500, 1, np.random.default_rng(0))[:, 0].astype(np.float32)

    def steps() -> None:
        env.reset(seed=0)
        for action in actions:
            env.step(action)

    volts = plant.get("u_rated") * actions[:, None].astype(float)

    def plant_steps() -> None:
        for command in volts:
            plant.step(command, 0.0, PERIOD)

    works = {"env_steps_per_s": steps, "plant_steps_per_s": plant_steps}
    return {name: _rate(work, len(actions), seconds) for name, work in works.items()}


def measure_batch(
    num_envs: int, seconds: float = 1.0, dtype: str = "float64", kind: str = "smooth", model: str = "paper_dead_zone",
) -> dict[str, Any]:  # fmt: skip
    """Steps a second of a native batch under a kind of command, summed over its environments, with the kernel's share, and how
    many steps of the integrator a channel takes in a period, those that fail included."""
    from hydro_env.envs.batch import HydraulicSyncVectorEnv

    rows = max(5, min(500, 20_000 // num_envs))
    envs = HydraulicSyncVectorEnv(num_envs, model, mismatch=PLANTS[model], dtype=dtype)
    actions = commands(kind, rows, num_envs, np.random.default_rng(0)).astype(np.float32)
    envs.reset(seed=0)

    def steps() -> None:
        for action in actions:
            envs.step(action)

    plant = Plant(model, num_envs, dtype=dtype)
    rate = _rate(steps, rows * num_envs, seconds)
    kernel, taken = _plant_rate(plant, plant.get("u_rated") * actions.astype(float), seconds)
    return {
        "num_envs": num_envs, "dtype": dtype, "threads": 1, "env_steps_per_s": rate, "plant_steps_per_s": kernel,
        "channel_substeps_per_s": kernel * 2.0 * taken, "steps_a_period": taken, "times_real_time": rate * PERIOD,
    }  # fmt: skip


def _plant_rate(plant: Plant, volts: Floats, seconds: float) -> tuple[float, float]:
    """Steps a second of a plant under these commands (rows, rigs, 2), summed over its rigs, and how many steps of the integrator
    a channel attempts in each, the mean over all."""
    steps = partial(plant.run, volts, None, PERIOD, (), 1)
    rate, before = _rate(steps, len(volts) * plant.num_rigs, seconds), plant.get("attempts")
    steps()
    return rate, float((plant.get("attempts") - before).mean()) / len(volts)


def measure_commands(
    num_envs: int, seconds: float, errors: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Steps a second of every plant under every kind of command, with the error (rpm) that `errors` names for it by dtype, plant
    and kind."""
    rows = []
    for dtype, model, kind in tqdm(list(product(errors, PLANTS, KINDS)), desc="commands", leave=False):
        found = {"plant": model, "kind": kind, **measure_batch(num_envs, seconds, dtype, kind, model)}
        names = "plant", "kind", "dtype", "num_envs", "env_steps_per_s", "plant_steps_per_s", "steps_a_period"
        rows.append({**{name: found[name] for name in names}, "error_rpm": errors[dtype][model][kind]})
    return rows


def measure_errors(rows: int) -> dict[str, dict[str, Any]]:
    """Largest error of the speed in rpm against the reference, for every plant over `rows` control periods of each kind of
    command and twice as many of steps.

    One entry for each dtype: the worst error, and those by plant and kind.
    """
    from hydro_env.practice.reference import simulate_reference

    errors: dict[str, dict[str, Any]] = {dtype: {"worst_against_reference": 0.0} for dtype in DTYPES}
    for name in PLANTS:
        rng, model = np.random.default_rng(0), load_model(name)
        kinds = {kind: commands(kind, rows, 1, rng)[:, 0] for kind in KINDS}
        kinds["steps"] = np.repeat(rng.uniform(-0.75, 0.75, (8, 2)), rows // 4, axis=0)
        for kind, shares in kinds.items():
            volts = shares * np.array(model.pair("u_rated"))
            truth = simulate_reference(model, volts, None, PERIOD, tolerance=1e-8)["speed"]
            for dtype, found in errors.items():
                ours = Plant(model, dtype=dtype).run(volts, None, PERIOD)["speed"][:, 0]
                error = float(np.abs(ours - truth).max() / RPM)
                found.setdefault(name, {})[kind] = error
                found["worst_against_reference"] = max(found["worst_against_reference"], error)
    return errors


def measure_effects(seconds: float = 1.0) -> dict[str, float]:
    """Time of a step of a channel, ns: of the base plant, with the dead zone, and with every effect compiled in, all neutral.

    What a model does not name is not compiled in and costs nothing; the last figure is what naming all of them costs.
    """

    volts = Plant("paper").get("u_rated") * commands("smooth", 20, 1024, np.random.default_rng(0))

    def cost(plant: Plant) -> float:
        rate, taken = _plant_rate(plant, volts, seconds)
        return 1e9 / (rate * 2.0 * taken)

    return {
        "base_ns": cost(Plant("paper", 1024)),
        "dead_zone_ns": cost(Plant("paper_dead_zone", 1024)),
        "all_neutral_ns": cost(Plant("paper", 1024, effects=BUILT_IN)),
    }


def measure_start() -> dict[str, float]:
    """Seconds from the start of Python to the first step of an environment: nothing compiled yet, and from the cache."""
    code = (
        "import gymnasium; env = gymnasium.make('hydro_env:HydraulicSync-v0');"
        "env.reset(seed=0); env.step(env.action_space.sample()); import time; print(time.time())"
    )
    took = []
    with tempfile.TemporaryDirectory() as cache:
        for _ in ("cold", "warm"):
            begin = time.time()  # a clock that both processes read
            own = {**os.environ, "HYDRO_ENV_CACHE": cache}
            end = subprocess.check_output([sys.executable, "-c", code], env=own, text=True)
            took.append(float(end) - begin)
    return {"cold_s": took[0], "warm_s": took[1]}


def run(
    out: str | Path, *, num_envs: Sequence[int] = NUM_ENVS, seconds: float = 1.0, rows: int = ERROR_ROWS
) -> dict[str, Any]:
    """Measures and writes speed.json.

    Args:
        out: an existing folder.
        num_envs: sizes of batches.
        seconds: time to spend on each figure.
        rows: control periods of each kind of command that are compared with the reference.

    Returns the content of speed.json.
    """
    start = measure_start()
    sizes = [(n, "float64") for n in num_envs] + [(max(num_envs), "float32")]
    batch = [measure_batch(n, seconds, dtype) for n, dtype in tqdm(sizes, desc="batch", leave=False)]
    plant = Plant("paper_dead_zone", 1024)
    errors = measure_errors(rows)
    result = {
        "schema": "hydro_env/speed/1",
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "python": platform.python_version(),
        },
        "control_period_s": PERIOD,
        "tolerance_rpm": plant.tolerance / RPM,
        "start": start,
        "single": measure_single(seconds),
        "batch": batch,
        "commands": measure_commands(max(num_envs), seconds, errors),
        "error_rpm": errors["float64"],
        "error_float32_rpm": errors["float32"],
        "effects": measure_effects(seconds),
        "memory_bytes_per_env": plant.memory.nbytes / 1024,
    }
    write_json(Path(out) / "speed.json", result)
    return result


def summary(result: dict[str, Any]) -> str:
    """The result as a small table for the terminal."""
    single, effects, start = (result[key] for key in ("single", "effects", "start"))
    errors = {"float64": result["error_rpm"], "float32": result["error_float32_rpm"]}
    rigs = result["commands"][0]["num_envs"]
    return "\n".join([
        "environments           env steps/s   plant alone   steps a period   times real time",
        *(
            f"{row['num_envs']:12d} {row['dtype']}{row['env_steps_per_s']:14.0f}{row['plant_steps_per_s']:14.0f}"
            f"{row['steps_a_period']:17.1f}{row['times_real_time']:18.0f}"
            for row in result["batch"]
        ),
        f"{rigs} environments by kind of command, and largest error against the reference, rpm",
        *(
            f"{row['plant']:>16s} {row['kind']:>9s} {row['dtype']}{row['env_steps_per_s']:14.0f}"
            f"{row['plant_steps_per_s']:14.0f}{row['steps_a_period']:17.1f}{row['error_rpm']:10.3f}"
            for row in result["commands"]
        ),
        f"single environment: {1e6 / single['env_steps_per_s']:.0f} us a step,"
        f" plant alone {1e6 / single['plant_steps_per_s']:.0f} us",
        *(
            f"{dtype}: largest error against the reference {found['worst_against_reference']:.3f} rpm"
            for dtype, found in errors.items()
        ),
        f"a step of a channel of the base plant: {effects['base_ns']:.1f} ns, with a dead zone"
        f" {effects['dead_zone_ns']:.1f} ns, with all effects compiled in and neutral {effects['all_neutral_ns']:.0f} ns",
        f"from the start of Python to the first step of an environment: {start['cold_s']:.1f} s with nothing compiled,"
        f" {start['warm_s']:.1f} s from the cache",
        f"{result['memory_bytes_per_env']:.0f} bytes of plant per environment",
    ])  # fmt: skip
