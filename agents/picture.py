"""A start and a reversal under three controllers: `python -m agents.picture --out docs/images/agents_start_and_reversal.png`.

The first second and the first reversal of one pair of `val` that no controller has met before, driven by the tuned PID,
the same PID on servo valves, and a law: speeds, speed difference, commands. The picture also shows the dead-zone edges
that the law estimates, and the true ones.
"""

from __future__ import annotations

import argparse
import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.true_map import true_map
from hydro_env.controllers import make_controller
from hydro_env.controllers.mpc.flow_control import ProbingFlow
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.files import write_bytes
from hydro_env.limits import Limits
from hydro_env.plant import Plant

WINDOWS = ((0.0, 0.9), (1.95, 2.55))
PLANTS = {"servo_pid": "servo"}


def signals(name: str, case: int, seconds: float = 3.0) -> dict[str, NDArray[np.float64]]:
    """Signals of one controller on one pair of `val`, each with one row per control period."""
    servo = PLANTS.get(name)
    kwargs: dict[str, Any] = {"plant": servo, "mismatch": None} if servo else {"mismatch": "val"}
    env = HydraulicSyncVectorEnv(1, scenario="setpoint_steps", **kwargs)
    observation, info = env.reset(seed=[case])
    assert isinstance(env.plant, Plant)
    controller = make_controller(name)
    if getattr(controller, "needs", "measurements") != "measurements":
        controller.prepare(copy.deepcopy(env.plant))
    controller.reset(1, env.control_period)
    rows: dict[str, list[Any]] = {key: [] for key in ("time", "setpoint", "speed", "command", "edge")}
    truth = None if servo else true_map(env.plant).edge[0]
    for step in range(round(seconds / env.control_period)):
        rows["time"].append(step * env.control_period)
        rows["speed"].append(info["speed_rpm"][0].copy())
        action = controller.act(observation)
        edge = np.full((2, 2), np.nan)
        if isinstance(controller, ProbingFlow) and hasattr(controller, "law"):
            edge = controller.law.estimator.valves.state.edge[0].copy()
        rows["edge"].append(edge)
        rows["command"].append(np.array(action[0]))
        rows["setpoint"].append(float(info["setpoint_rpm"][0]))
        observation, _, _, _, info = env.step(action.astype(np.float32))
    made = {key: np.array(values) for key, values in rows.items()}
    made["true_edge"] = np.full((2, 2), np.nan) if truth is None else truth
    return made


def draw(out: Path, name: str = "probing_flow", case: int = 37) -> None:
    """Writes the picture (PNG)."""
    import io

    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = {"pid_tuned": "PID, tuned", "servo_pid": "PID on servo valves", name: name}
    traces = {name: signals(name, case) for name in names}
    widths = [each for _ in names for each in (WINDOWS[0][1] - WINDOWS[0][0], WINDOWS[1][1] - WINDOWS[1][0])]
    figure, axes = plt.subplots(
        3, 2 * len(names), figsize=(15, 7.5), sharey="row", gridspec_kw={"width_ratios": widths}
    )
    colours = ("#0072b2", "#d55e00")
    for column, (name, title) in enumerate(names.items()):
        data = traces[name]
        time = data["time"]
        for part, window in enumerate(WINDOWS):
            top, middle, low = axes[:, 2 * column + part]
            shown = (time >= window[0]) & (time <= window[1])
            top.step(time[shown], data["setpoint"][shown], where="post", color="0.6", lw=1, label="set-point")
            difference = data["speed"][:, 0] - data["speed"][:, 1]
            middle.axhline(0.0, color="0.8", lw=1)
            middle.plot(time[shown], difference[shown], color="k", lw=1.2)
            worst = np.abs(difference[shown]).max()
            middle.set_title(f"at most {worst:.0f} rpm", fontsize=9)
            for motor, colour in enumerate(colours):
                top.plot(
                    time[shown], data["speed"][shown, motor], color=colour, lw=1.4, label=f"motor {motor + 1}"
                )
                low.step(time[shown], data["command"][shown, motor], where="post", color=colour, lw=1.2)
                for side, sign in enumerate((1.0, -1.0)):
                    low.plot(
                        time[shown], sign * data["edge"][shown, motor, side], color=colour, lw=0.9, ls=":"
                    )
                    low.axhline(sign * data["true_edge"][motor, side], color=colour, lw=0.6, alpha=0.4)
            for axis in (top, middle, low):
                axis.set_xlim(window)
                axis.tick_params(labelsize=8)
            low.set_xlabel("time, s", fontsize=8)
        axes[0, 2 * column].set_title(title, loc="left", fontsize=11)
    axes[0, 0].legend(fontsize=8, loc="lower right")
    for axis, text in zip(axes[:, 0], ("speed, rpm", "difference, rpm", "command / rated"), strict=True):
        axis.set_ylabel(text, fontsize=9)
    figure.text(
        0.5, 0.005, "dotted: estimated dead-zone edges; faint: true ones",
        ha="center", fontsize=9,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0.02, 1, 1))
    memory = io.BytesIO()
    figure.savefig(memory, format="png", dpi=80)
    plt.close(figure)
    write_bytes(out, memory.getvalue())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.picture", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--controller", default="probing_flow", help="name of a controller, or a policy file")
    parser.add_argument(
        "--case", type=Limits(0, 999, whole=True), default=37, help="pair of val; 37 is a typical one"
    )
    chosen = parser.parse_args()
    draw(chosen.out, chosen.controller, chosen.case)


if __name__ == "__main__":
    main()
