"""How the batch environment scales: steps a second over the number of environments and over threads, time of a reset, memory.

    python -m docs.evidence.scaling --out DIR [--most 1000000] [--threads 1 2] [--seconds 2]

writes scaling.md (a table), scaling.json and scaling.png. Each size is measured in a process of its own, by the clock, in
float64 under slow motion, so that the figures hold for an idle machine with as many cores as threads.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.command import run_command
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.experiments.speed import commands
from hydro_env.files import write_json, write_text
from hydro_env.pages import COLOURS, RC, png

#: Commands that are drawn beforehand and sent again and again.
ROWS = 8


def measure(num_envs: int, threads: int, seconds: float) -> dict[str, float]:
    """Environment steps a second and processor time of a step (s), the best of a few stretches; seconds of a reset; resident
    memory of this process, bytes, at its highest, and before the batch was made."""
    import resource

    kib = 1 if sys.platform == "darwin" else 1024
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * kib
    envs = HydraulicSyncVectorEnv(num_envs, threads=threads)
    actions = commands("smooth", ROWS, num_envs, np.random.default_rng(0)).astype(np.float32)
    start = time.perf_counter()
    envs.reset(seed=0)
    reset = time.perf_counter() - start
    envs.step(actions[0])
    best, processor, begun = np.inf, np.inf, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        start, used = time.perf_counter(), time.process_time()
        for action in actions:
            envs.step(action)
        best = min(best, (time.perf_counter() - start) / ROWS)
        processor = min(processor, (time.process_time() - used) / ROWS)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * kib
    return {
        "num_envs": num_envs,
        "threads": threads,
        "env_steps_per_s": num_envs / best,
        "step_s": best,
        "step_processor_s": processor,
        "reset_s": reset,
        "memory_bytes": float(most),
        "memory_bytes_per_env": (most - before) / num_envs,
    }


def _digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.2g}"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The figures as a table in Markdown."""
    lines = [
        "| environments | threads | steps per s | a step, ms | processor time, ms | a reset, s | bytes an environment |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        cells = [
            f"{row['num_envs']:,}", f"{row['threads']}", f"{row['env_steps_per_s']:,.0f}", _digits(1e3 * row["step_s"]),
            _digits(1e3 * row["step_processor_s"]), _digits(row["reset_s"]),
            f"{row['memory_bytes_per_env']:,.0f}" if row["num_envs"] >= 10_000 else "",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Writes steps a second over the number of environments, a line for each number of threads, as a PNG."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(RC):
        made = Figure(figsize=(6.4, 3.6), layout="constrained")
        axes = made.subplots()
        for threads, colour in zip(sorted({row["threads"] for row in rows}), COLOURS, strict=False):
            shown = [row for row in rows if row["threads"] == threads]
            label = "one thread" if threads == 1 else f"{threads} threads"
            sizes, rates = ([row[key] for row in shown] for key in ("num_envs", "env_steps_per_s"))
            axes.plot(sizes, rates, "o-", ms=4, color=colour, label=label)
        axes.set_xscale("log")
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value / 1e6:g}")
        axes.set_xlabel("environments in a batch")
        axes.set_ylabel("million environment steps per s")
        axes.legend(frameon=False)
        png(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--most", type=int, default=1_000_000)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--only", type=int, help="prints the figures of this one size, as JSON")
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options.only, options.threads[0], options.seconds)))
        return
    if options.out is None:
        parser.error("--out: a folder is needed")
    options.out.mkdir(parents=True, exist_ok=True)
    sizes = [10**k for k in range(7) if 10**k <= options.most]
    rows = []
    for threads, size in tqdm(
        [(threads, size) for threads in options.threads for size in sizes], desc="sizes"
    ):
        command = [sys.executable, "-m", "docs.evidence.scaling", "--only", str(size)]
        command += ["--threads", str(threads), "--seconds", str(options.seconds)]
        rows.append(json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout))
    write_json(options.out / "scaling.json", {"schema": "hydro_env/scaling/1", "rows": rows})
    write_text(options.out / "scaling.md", table(rows))
    draw(rows, options.out / "scaling.png")
    print(table(rows), end="")


if __name__ == "__main__":
    run_command(main)
