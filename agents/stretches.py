"""Where in an episode two motors part most, and what knowing the valves would bring: `python -m agents.stretches [NAME ...]`.

The set-point steps of the paper's section 4.1, cut where the set-point moves and where the motors have arrived. For every
controller a line with the largest speed difference of each stretch (interquartile mean over pairs of `train`, 95th percentile
in brackets), of the whole episode, and the tracking error; then how often the largest of the episode lies in each stretch.
`--told` adds the same for `probing_flow` when it is told gains, edges of the dead zones or both at 0.2 s, which no controller can
measure.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.train import cleanly
from hydro_env.benchmark.statistics import iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.base import Floats
from hydro_env.controllers.estimation.valve_estimate import ValveEstimate
from hydro_env.controllers.mpc.flow_controller import RATED_TRAVEL
from hydro_env.controllers.mpc.flow_law import NOMINAL
from hydro_env.controllers.mpc.probing_flow import ProbingFlow
from hydro_env.controllers.rollout import roll_out
from hydro_env.plant import Plant

__all__ = ["STRETCHES", "TOLD", "Told", "lines", "parts"]

PERIOD, TOLD_AT = 0.01, 0.19
"""s; what is told at 0.19 s is used for the command at 0.2 s."""
STRETCHES = {
    "at rest, to 0.2 s": 0.0,
    "first start": 0.21,
    "600 rpm": 0.7,
    "first reversal": 2.01,
    "-200 rpm": 2.6,
    "second reversal": 4.01,
    "600 rpm again": 4.5,
}
"""Each begins at this time in s and ends where the next one begins."""
EDGES, GAINS = ("positive edges", "negative edges"), "gains"
TOLD = (("gains",), ("positive edges",), ("negative edges",), ("gains", *EDGES))
SURE = 0.004, 0.01
"""Standard deviations with which edges and gains are told."""


class Told(ProbingFlow):
    """`probing_flow`, which is told `what` of its valves at `TOLD_AT`; nothing if that is empty."""

    needs = "parameters"

    def __init__(self, what: Sequence[str] = ()) -> None:
        super().__init__()
        self.what = tuple(what)

    def reset(self, num_rigs: int, control_period: float) -> None:
        super().reset(num_rigs, control_period)
        self._steps = 0

    def prepare(self, plant: Plant) -> None:
        self._plant = plant

    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        sent = super().act(observation)
        if self._steps == round(TOLD_AT / PERIOD):
            tell(self.what, self._view.valves, self._plant)
        self._steps += 1
        return sent


def tell(what: Sequence[str], valves: ValveEstimate, plant: Plant) -> None:
    """Writes true `what` of a plant's valves into a law's estimate."""
    coil = plant.get("R") / NOMINAL["R"]
    if GAINS in what:
        valves.gain[:] = plant.get("Kq") / NOMINAL["Kq"] / coil
        valves.gain_variance[:], valves.shared[:] = SURE[1] ** 2, 0.0
    for side, (name, sign) in enumerate(zip(EDGES, (-1.0, 1.0), strict=True)):
        if name in what:
            overlap = plant.get(f"dead_zone.overlap_{name.split()[0]}") + sign * plant.get(
                "null_offset.offset"
            )
            valves.edge[..., side] = overlap / RATED_TRAVEL * coil
            valves.unknown[..., side], valves.edge_variance[..., side] = False, SURE[0] ** 2
            valves.shared[..., side], valves.between[:] = 0.0, 0.0


def parts(controller: Any, cases: Sequence[int]) -> tuple[Floats, Floats]:
    """Largest differences by stretch (stretches, cases) and tracking errors (cases,), rpm."""
    found = roll_out(controller, cases, mismatch="train", scenario="setpoint_steps", control_period=PERIOD)
    speed = found.trace.speed_rpm
    apart = np.abs(speed[..., 0] - speed[..., 1])
    begin = [round(time / PERIOD) for time in STRETCHES.values()]
    largest = [np.max(apart[a:b], axis=0) for a, b in zip(begin, [*begin[1:], len(apart)], strict=True)]
    return np.array(largest), found.metrics(["tracking_mae_rpm"])["tracking_mae_rpm"]


def lines(title: str, largest: Floats, tracking: Floats) -> list[str]:
    """Two lines of a table (Markdown) from what `parts` returns."""
    cells = [f"{iqm(row):.1f} ({np.percentile(row, 95):.0f})" for row in (*largest, largest.max(axis=0))]
    shares = np.bincount(largest.argmax(axis=0), minlength=len(largest)) / largest.shape[1]
    return [
        f"| {title} | " + " | ".join(cells) + f" at {iqm(tracking):.1f} |",
        f"| {title}: share of the largest | "
        + " | ".join(f"{100 * share:.0f} %" for share in shares)
        + " | |",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.stretches", description=__doc__)
    parser.add_argument("controllers", nargs="*", default=["probing_flow"], help="names or policy files")
    parser.add_argument("--pairs", type=int, default=320, help="pairs of valves")
    parser.add_argument("--told", action="store_true", help="also what knowing the valves would bring")
    chosen = parser.parse_args()

    def run() -> None:
        print(
            "| | "
            + " | ".join(STRETCHES)
            + " | all, at tracking error |\n"
            + "|---" * (len(STRETCHES) + 2)
            + "|"
        )
        for name in chosen.controllers:
            print(
                "\n".join(lines(f"`{name}`", *parts(make_controller(name), range(chosen.pairs)))), flush=True
            )
        for what in TOLD if chosen.told else ():
            found = parts(Told(what), range(chosen.pairs))
            print(lines(f"`probing_flow`, told {', '.join(what)}", *found)[0], flush=True)

    cleanly(run)


if __name__ == "__main__":
    main()
