"""How fast the recurrent recipe trains here: `python -m agents.speed [--config configs/gru.yml] [--jobs 2]`.

Each of `jobs` processes, one thread each, as seeds that are trained side by side, drives windows of both stages and learns
from them, for `--seconds` a stage. Printed are control periods of single rigs, of all processes together: a second on the clock,
and a second of processor time, which on a busy machine does not count what others take. `whole recipe` weighs the stages by
their periods; scoring between them is left out.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as in agents.recurrent

import argparse
import time
from functools import partial
from pathlib import Path

import torch

from agents.command import run_command
from agents.recurrent.__main__ import STAGES, Run
from agents.recurrent.settings import Settings, read_settings
from hydro_env.errors import InputError
from hydro_env.limits import CORES, Limits
from hydro_env.parallel import Failure, as_done

Rates = dict[str, tuple[float, float]]
"""Control periods a second on the clock and of processor time, by stage."""


def measure(settings: Settings, seconds: float, seed: int) -> Rates:
    """The rates of one process; a window that warms up is not counted."""
    torch.set_num_threads(1)
    rates = {}
    policy = Run(settings, Path(), "").policy
    for name, make in STAGES.items():
        stage = make(settings, policy, seed)
        stage.window()
        begun, clock, cpu = stage.done, time.monotonic(), time.process_time()
        passed = 0.0
        while passed < seconds or stage.done == begun:
            stage.window()
            passed = time.monotonic() - clock
        done = stage.done - begun
        rates[name] = (done / passed, done / (time.process_time() - cpu))
    return rates


def summary(settings: Settings, found: list[Rates]) -> str:
    """One line for each stage, and one for the whole recipe."""
    periods = {"imitation": settings.imitation.periods, "gradient": settings.gradient.periods}
    rates = {name: [sum(each[name][kind] for each in found) for kind in (0, 1)] for name in periods}
    total = sum(periods.values())
    rates["whole recipe"] = [
        total / sum(periods[name] / rates[name][kind] for name in periods) for kind in (0, 1)
    ]
    lines = [f"control periods a second of {len(found)} processes    on the clock  of processor time"]
    return "\n".join(lines + [f"{name:47}{clock:12,.0f}{cpu:19,.0f}" for name, (clock, cpu) in rates.items()])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.speed", description=__doc__)
    parser.add_argument("--config", type=Path, default=Path("configs/gru.yml"), help="training file")
    parser.add_argument("--jobs", type=CORES, default=2, help="processes side by side")
    parser.add_argument("--seconds", type=Limits(0.1, 3600), default=10.0, help="for each stage")
    given = parser.parse_args()

    def work() -> None:
        settings = read_settings(given.config)
        found = []
        for _, rates in as_done(
            range(given.jobs), partial(measure, settings, given.seconds), jobs=given.jobs
        ):
            if isinstance(rates, Failure):
                raise InputError(rates.reason)
            found.append(rates)
        print(summary(settings, found))

    run_command(work)


if __name__ == "__main__":
    # As the module that other processes import, not as the nameless one that was started.
    from agents import speed as module

    module.main()
