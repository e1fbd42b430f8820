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
from hydro_env.controllers.base import Floats
from hydro_env.controllers.mpc.probing_flow import ProbingFlow
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.observation import decode

__all__ = ["differences"]

PERIOD, JUMP, SHOWN = 0.01, 3.5, 4
"""s; the load's jump; control instants that are shown after it."""
SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)


class Harder(ProbingFlow):
    """`probing_flow`, whose command at the first sample that shows the jump is mixed with `share` of the strongest one against
    the difference."""

    def __init__(self, share: float) -> None:
        super().__init__()
        self.share = share

    def reset(self, num_rigs: int, control_period: float) -> None:
        super().reset(num_rigs, control_period)
        self._steps = 0

    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        sent = super().act(observation)
        if self._steps == round(JUMP / PERIOD) + 1:
            speed = decode(np.asarray(observation)).speed
            against = np.sign(speed[:, 1:] - speed[:, :1]) * np.array([1.0, -1.0])
            sent = (1.0 - self.share) * sent + self.share * against
            self._view.sent, self._view._last = sent.copy(), sent.copy()
        self._steps += 1
        return sent


def differences(share: float, pairs: int) -> Floats:
    """Speed differences at all control instants, (instants, pairs), rpm."""
    found = roll_out(
        Harder(share), range(pairs), mismatch="train", scenario="unequal_load", control_period=PERIOD
    )
    return found.trace.speed_rpm[..., 0] - found.trace.speed_rpm[..., 1]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.sudden_load", description=__doc__)
    parser.add_argument("--pairs", type=int, default=100, help="pairs of valves")
    pairs = parser.parse_args().pairs

    def run() -> None:
        first = round(JUMP / PERIOD) + 1
        instants = " | ".join(f"{JUMP + PERIOD * (k + 1):.2f} s" for k in range(SHOWN))
        print(f"| share | largest | {instants} |\n|---|---|" + "---|" * SHOWN)
        for share in SHARES:
            apart = np.abs(differences(share, pairs))
            cells = " | ".join(f"{iqm(row):.1f}" for row in apart[first : first + SHOWN])
            print(f"| {share:g} | {iqm(apart.max(axis=0)):.1f} | {cells} |", flush=True)

    cleanly(run)


if __name__ == "__main__":
    main()
