"""`hydro-env reproduce`: the paper's experiments, what it publishes beside what its tables and the calibrated rig give.

Fig. 7: set-point steps under Table III's PID. Fig. 8: the load step. Fig. 2: flow over current of both valves, swept
slowly. The dead zone and the nominal torque are calibrated anew in every run (`calibrate.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from hydro_env.experiments.paper_calibration import (
    PUBLISHED_LOAD_RPM,
    PUBLISHED_STEPS_RPM,
    Calibration,
    calibrate_dead_zone,
    calibrate_torque,
)
from hydro_env.experiments.paper_rig import LOAD_STEP, SETPOINT_STEPS, Traces, equal_again_after, run_paper
from hydro_env.files import write_json, write_text
from hydro_env.pages import beside_results, png
from hydro_env.plant import Plant, PlantModel, load_model
from hydro_env.units import LPM

__all__ = ["EQUAL_WITHIN_RPM", "Reproduction", "dead_zone_model", "draw_load", "draw_steps", "draw_valves", "reproduce",
           "run", "summary", "sweep"]  # fmt: skip

Floats = NDArray[np.float64]

#: The speeds count as equal again while they differ by no more than 5 % of 600 rpm.
EQUAL_WITHIN_RPM = 30.0


@dataclass(frozen=True)
class Reproduction:
    """All that was simulated. Traces of the steps hold two rigs: the tables alone, and with the calibrated dead zone."""

    model: PlantModel
    dead_zone: Calibration
    torque: Calibration
    steps: Traces
    load: Traces
    equal_again_s: Floats

    @property
    def numbers(self) -> dict[str, Any]:
        """The content of reproduce.json."""
        return {
            "schema": "hydro_env/reproduce/1",
            "setpoint_steps": {
                "published_rpm": PUBLISHED_STEPS_RPM,
                "tables_only_rpm": self.steps.peak[0],
                "with_dead_zone_rpm": self.steps.peak[1],
                "published_equal_again_after_s": 1.0,
                "equal_again_after_s": self.equal_again_s[:, 1].max(),
                "equal_again_after_each_step_s": self.equal_again_s[:, 1].tolist(),
                "equal_again_within_rpm": EQUAL_WITHIN_RPM,
                "overlap_V1_m": self.dead_zone.value,
            },
            "load_step": {
                "published_rpm": PUBLISHED_LOAD_RPM,
                "simulated_rpm": self.load.peak[0],
                "nominal_torque_Nm": self.torque.value,
                "largest_command_V": float(np.abs(self.load.command).max()),
            },
            "calibration": {
                "dead_zone": {"overlap_V1_m": self.dead_zone.tried, "peak_rpm": self.dead_zone.reached},
                "nominal_torque": {"torque_Nm": self.torque.tried, "peak_rpm": self.torque.reached},
            },
        }


def dead_zone_model(overlap: float) -> PlantModel:
    """The paper's rig with this overlap (m) on V1, both ways, and none on V2; rounded to 10 nm."""
    overlap = round(overlap, 8)
    return load_model("paper").with_values(
        {"dead_zone.overlap_positive": (overlap, 0.0), "dead_zone.overlap_negative": (overlap, 0.0)},
        name="paper_dead_zone",
    )


def reproduce(progress: bool = True) -> Reproduction:
    """Calibrates and runs both experiments."""
    with tqdm(total=4, desc="reproduce", disable=not progress, leave=False) as bar:
        dead_zone = calibrate_dead_zone()
        model = dead_zone_model(dead_zone.value)
        bar.update()
        overlap = model.value("dead_zone.overlap_positive", 0)
        both = np.array([[0.0, 0.0], [overlap, 0.0]])
        values = {"dead_zone.overlap_positive": both, "dead_zone.overlap_negative": both}
        steps = run_paper(load_model("paper"), SETPOINT_STEPS, values=values, num_rigs=2)
        bar.update()
        torque = calibrate_torque(model)
        bar.update()
        load = run_paper(model, LOAD_STEP, nominal_torque=torque.value, peak_from=2.0)
        bar.update()
    equal = equal_again_after(steps, SETPOINT_STEPS, EQUAL_WITHIN_RPM)
    return Reproduction(model, dead_zone, torque, steps, load, equal)


def sweep(model: PlantModel, seconds: float = 20.0, period: float = 1e-3) -> tuple[Floats, Floats]:
    """Fig. 2's test: current (T, 2) in A and flow (T, 2) in m3/s while the command goes slowly 0, +, -, 0."""
    time = np.arange(round(seconds / period)) * period / seconds
    share = np.interp(time, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    plant = Plant(model)
    command = share[:, None] * np.array(model.pair("u_rated"))
    out = plant.run(command, None, period, ("current", "flow"))
    return out["current"][:, 0], out["flow"][:, 0]


def run(out: str | Path, *, pictures: bool = True) -> dict[str, Any]:
    """Runs the experiments and writes reproduce.json, traces.csv, paper_dead_zone.yaml and, if asked, the pictures.

    Args:
        out: an existing folder.
        pictures: figure_2.png, figure_7.png, figure_8.png (needs the extra `report`).

    Returns the content of reproduce.json.
    """
    out = Path(out)
    result = reproduce()
    result.model.to_yaml(out / "paper_dead_zone.yaml")
    write_text(out / "traces.csv", _table(result))
    numbers = result.numbers
    write_json(out / "reproduce.json", numbers)
    if pictures:
        for name, draw in (("figure_2", draw_valves), ("figure_7", draw_steps), ("figure_8", draw_load)):
            with beside_results(path := out / f"{name}.png"):
                png(draw(result), path)
    return numbers


def summary(numbers: dict[str, Any]) -> str:
    """The result in a few lines for the terminal."""
    steps, load = numbers["setpoint_steps"], numbers["load_step"]
    return "\n".join([
        "largest speed difference, rpm       paper   tables alone   with calibrated dead zone",
        f"  set-point steps 600/-200/600     {steps['published_rpm']:7.0f}{steps['tables_only_rpm']:15.1f}"
        f"{steps['with_dead_zone_rpm']:28.1f}",
        f"  load step                        {load['published_rpm']:7.0f}{'':15}{load['simulated_rpm']:28.1f}",
        f"dead zone of V1: {steps['overlap_V1_m'] * 1e6:.1f} um; within {steps['equal_again_within_rpm']:.0f} rpm again after"
        f" {steps['equal_again_after_s']:.2f} s (paper: up to 1 s)",
        f"nominal torque: {load['nominal_torque_Nm']:.2f} N m, which takes up to {load['largest_command_V']:.0f} V"
        " where the valve is rated for 73 V",
    ])  # fmt: skip


def _table(result: Reproduction) -> str:
    head = "time_s,setpoint_rpm,tables_speed_1_rpm,tables_speed_2_rpm,dead_zone_speed_1_rpm,dead_zone_speed_2_rpm"
    rows = np.column_stack(
        [result.steps.time, result.steps.setpoint, result.steps.speed.reshape(len(result.steps.time), 4)]
    )
    return head + "\n" + "\n".join(",".join(f"{value:.6g}" for value in row) for row in rows) + "\n"


# --- pictures ---------------------------------------------------------------------------------------------------------
def draw_steps(result: Reproduction) -> Any:
    """Fig. 7: speeds with the calibrated dead zone, and the difference of both rigs."""
    from hydro_env.pages import COLOURS, figure

    drawing, (speeds, gap) = figure(2, height=2.6)
    time = result.steps.time
    speeds.plot(time, result.steps.setpoint, color="grey", linewidth=0.8, label="set-point")
    for motor in (0, 1):
        speeds.plot(time, result.steps.speed[:, 1, motor], color=COLOURS[motor], label=f"motor {motor + 1}")
    speeds.set(ylabel="speed, rpm")
    speeds.legend(loc="upper right", ncols=3)
    for rig, (label, colour) in enumerate((("tables alone", COLOURS[2]), ("with dead zone", COLOURS[3]))):
        peak = result.steps.peak[rig]
        gap.plot(
            time, np.abs(result.steps.difference[:, rig]), color=colour, label=f"{label}: {peak:.0f} rpm"
        )
    gap.axhline(
        PUBLISHED_STEPS_RPM,
        color="grey",
        linestyle="--",
        linewidth=0.8,
        label=f"paper: {PUBLISHED_STEPS_RPM:.0f} rpm",
    )
    gap.set(xlabel="time, s", ylabel="speed difference, rpm", ylim=(0, None))
    gap.legend(loc="upper right", ncols=3)
    return drawing


def draw_load(result: Reproduction) -> Any:
    """Fig. 8: speeds around the load step and their difference."""
    from hydro_env.pages import COLOURS, figure

    drawing, (speeds, gap) = figure(2, height=2.3)
    time = result.load.time
    for motor in (0, 1):
        speeds.plot(time, result.load.speed[:, 0, motor], color=COLOURS[motor], label=f"motor {motor + 1}")
    speeds.set(ylabel="speed, rpm")
    speeds.legend(loc="lower right", ncols=2)
    late = time >= 1.9
    gap.plot(
        time[late],
        np.abs(result.load.difference[late, 0]),
        color=COLOURS[3],
        label=f"simulated: {result.load.peak[0]:.0f} rpm",
    )
    gap.axhline(
        PUBLISHED_LOAD_RPM,
        color="grey",
        linestyle="--",
        linewidth=0.8,
        label=f"paper: {PUBLISHED_LOAD_RPM:.0f} rpm",
    )
    gap.set(xlabel="time, s", ylabel="speed difference\nfrom 1.9 s on, rpm", ylim=(0, None))
    gap.legend(loc="upper right", ncols=2)
    return drawing


def draw_valves(result: Reproduction) -> Any:
    """Fig. 2: flow over current of both valves of the calibrated rig, swept slowly both ways."""
    from hydro_env.pages import COLOURS, figure

    drawing, (axis,) = figure(1, height=3.2)
    current, flow = sweep(result.model)
    for valve in (0, 1):
        axis.plot(current[:, valve] * 1e3, flow[:, valve] / LPM, color=COLOURS[valve], label=f"V{valve + 1}")
    axis.axvspan(-300, 300, color="grey", alpha=0.15, linewidth=0, label="no flow in the paper's Fig. 2")
    axis.set(xlabel="current, mA", ylabel="flow, l/min")
    axis.legend(loc="upper left")
    return drawing
