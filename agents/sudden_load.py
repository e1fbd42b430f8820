"""What one other command would bring when a load jumps from one motor to the other: `python -m agents.sudden_load`.

In `unequal_load` the nominal torque leaves one shaft and falls on the other at 3.5 s. The first sample that shows it comes a
period later, whatever the controller. Here the command that `probing_flow` then gives is mixed with the strongest one against
the difference (both valves at their limits), by several shares; from the next period on the law goes on by itself, knowing
what was sent. The share is the same for all pairs and chosen afterwards, so this is no controller: it shows what is left to
be gained. A line for each share: the largest difference of the whole episode and the differences at the next control instants,
rpm, interquartile means over pairs of `train`.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.train import cleanly
from hydro_env.benchmark.statistics import iqm
from hydro_env.controllers.probing import ProbingFlow
from hydro_env.envs.batch import HydraulicSyncVectorEnv

__all__ = ["differences"]

Floats = NDArray[np.floating[Any]]

PERIOD, JUMP, SHOWN = 0.01, 3.5, 4
"""s; the load's jump; control instants that are shown after it."""
SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)


def differences(share: float, pairs: int) -> Floats:
    """Speed differences at all control instants but the first, (instants, pairs), rpm."""
    env = HydraulicSyncVectorEnv(pairs, plant="paper_dead_zone", mismatch="train", scenario="unequal_load")
    observation, _ = env.reset(seed=list(range(pairs)))
    law = ProbingFlow()
    law.reset(pairs, PERIOD)
    seen = round(JUMP / PERIOD) + 1
    apart: list[Floats] = []
    done = False
    while not done:
        command = np.clip(law.act(observation), -1.0, 1.0)
        if len(apart) == seen and share > 0.0:
            against = -np.sign(apart[-1])[:, None] * np.array([1.0, -1.0])
            command = (1.0 - share) * command + share * against
            law._view.sent, law._view._last = command.copy(), command.copy()
        observation, _, _, truncated, info = env.step(command.astype(np.float32))
        apart.append(info["speed_rpm"][:, 0] - info["speed_rpm"][:, 1])
        done = bool(np.all(truncated))
    return np.array(apart)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.sudden_load", description=__doc__)
    parser.add_argument("--pairs", type=int, default=100, help="pairs of valves")
    pairs = parser.parse_args().pairs

    def run() -> None:
        first = round(JUMP / PERIOD)
        instants = " | ".join(f"{JUMP + PERIOD * (k + 1):.2f} s" for k in range(SHOWN))
        print(f"| share | largest | {instants} |\n|---|---|" + "---|" * SHOWN)
        for share in SHARES:
            apart = np.abs(differences(share, pairs))
            cells = " | ".join(f"{iqm(row):.1f}" for row in apart[first : first + SHOWN])
            print(f"| {share:g} | {iqm(apart.max(axis=0)):.1f} | {cells} |", flush=True)

    cleanly(run)


if __name__ == "__main__":
    main()
