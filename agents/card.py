"""Scores of a finished policy on test pairs, as the table of its card: `python -m agents.card ppo`.

While an agent is developed its makers look at some test pairs, and what they see there steers what they try next. So the
card is filled from cases that nobody looks at before: by default 700 to 899 of each split. `python -m agents.card law`
scores the control law beneath the network alone.
"""

from __future__ import annotations

import argparse

import numpy as np

from hydro_env.benchmark.statistics import bootstrap_interval, cvar, iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out

from .evaluate import METRICS, LawAlone

__all__ = ["ROWS", "card_rows"]

ROWS = (
    *(("test_interp", name) for name in ("setpoint_steps", "load_step", "staircase", "sine", "unequal_load")),
    ("test_extrap", "setpoint_steps"),
    ("paper_pair", "setpoint_steps"),
)


def card_rows(policy: str, first: int = 700, cases: int = 200) -> list[str]:
    """Lines of the card's table (Markdown) for a shipped policy's name or the path of one."""
    rows = [
        "| split | scenario | largest difference [95 % interval] | its 95th percentile | mean of the worst 5 %"
        " | RMS difference | tracking error | command variation, 1/s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for split, scenario in ROWS:
        count = min(cases, 20) if split == "paper_pair" else cases  # one pair, 20 times other noise
        controller = LawAlone() if policy == "law" else make_controller(policy)
        episodes = roll_out(controller, range(first, first + count), mismatch=split, scenario=scenario)
        scores = episodes.metrics(METRICS)
        largest = scores[METRICS[0]]
        low, high = bootstrap_interval(largest)
        means = [float(iqm(scores[name])) for name in METRICS]
        rows.append(
            f"| {split} | {scenario} | {means[0]:.1f} [{low:.1f}, {high:.1f}] | {np.percentile(largest, 95):.1f}"
            f" | {cvar(largest):.1f}"
            f" | {means[1]:.1f} | {means[2]:.1f} | {means[3]:.2f} |"
        )
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="name of a shipped controller, or the path of a policy (.npz)")
    parser.add_argument("--first", type=int, default=700, help="first case of each split")
    parser.add_argument("--cases", type=int, default=200, help="pairs of valves in each split")
    chosen = parser.parse_args()
    print("\n".join(card_rows(chosen.policy, chosen.first, chosen.cases)))
