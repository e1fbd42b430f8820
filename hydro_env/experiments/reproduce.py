"""`hydro-env reproduce`: the paper's experiments, what it publishes beside what its tables and the calibrated rig give.

Fig. 7: set-point steps under Table III's PID. Fig. 8: the load step. Fig. 2: flow over current of both valves, swept
slowly. The paper must have had a dead zone and a nominal torque that it does not print: its tables alone give a speed
difference of 13 rpm where it reports 175, its Fig. 2 shows a dead zone that they do not hold, and it loads the motors with
a "nominal torque" without a value. Both are calibrated to its results in every run.

The paper's Simulink controllers are continuous; here they are sampled every `PERIOD`, a tenth of the fastest time constant.
Speeds are the true ones: the paper's simulation has no sensors.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from tqdm import tqdm

from hydro_env.arrays import Floats
from hydro_env.controllers.classical.pid import TABLE_III, Pid
from hydro_env.files import write_json, write_text
from hydro_env.pages import COLOURS, beside_results, figure, legend, png
from hydro_env.plant import Plant, PlantModel, load_model
from hydro_env.tasks import Scenario, load_scenario
from hydro_env.units import LPM, RPM

#: Largest speed differences that the paper reports: Fig. 7 (set-point steps) and Fig. 8 (load step), rpm.
PUBLISHED_STEPS_RPM = 175.0
PUBLISHED_LOAD_RPM = 12.0
#: The speeds count as equal again while they differ by no more than 5 % of 600 rpm.
EQUAL_WITHIN_RPM = 30.0
#: Sampling of the controller, s.
PERIOD = 1e-4
#: Paper, 4.1: set-point steps without load (Fig. 7).
SETPOINT_STEPS = load_scenario({"duration": 6, "setpoint_rpm": [[0, 600], [2, -200], [4, 600]]})
#: Paper, 4.2: 600 rpm, 10 % of the nominal load torque, from 2 s on all of it (Fig. 8). Loads here are shares of that torque.
LOAD_STEP = load_scenario({"duration": 4, "setpoint_rpm": [[0, 600]], "load_Nm": [[0, 0.1, 0.1], [2, 1, 1]]})


# --- the paper's simulation ---------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Traces:
    """What happened: `time` (T,) s, `setpoint` (T,) rpm, `speed` (T, N, 2) rpm, `command` (T, N, 2) V, every millisecond.

    `peak` (N,) is the largest speed difference in rpm over all samples, from the instant on that was asked for.
    """

    time: Floats
    setpoint: Floats
    speed: Floats
    command: Floats
    peak: Floats

    @property
    def difference(self) -> Floats:
        """Speed of motor 1 less that of motor 2, rpm, (T, N)."""
        return self.speed[..., 0] - self.speed[..., 1]


def run_paper(
    model: PlantModel, scenario: Scenario, *, values: Mapping[str, ArrayLike] | None = None, num_rigs: int = 1,
    nominal_torque: ArrayLike = 0.0, peak_from: float = 0.0,
) -> Traces:  # fmt: skip
    """Runs the paper's closed loop for `num_rigs` variants of a model side by side.

    `values` maps parameters to arrays that broadcast to (num_rigs, 2); `nominal_torque` (N m) to (num_rigs,). The paper mentions
    no limit of the controllers' output, so there is none, and no end stop that a spool could reach. The largest difference
    counts from `peak_from` s on.
    """
    values = dict(values or {})
    plant = Plant(model, num_rigs, effects={n.split(".")[0] for n in values if "." in n})
    plant.set_values(values)
    plant.set("u_rated", 1e6)
    plant.set("x_max", 9e-3)
    plant.reset()
    pid = Pid(PERIOD, np.zeros((num_rigs, 2)), TABLE_III["Kp"], TABLE_III["Ti"], TABLE_III["Td"])
    limits = -inf, inf
    # The derivative acts on the first step too, as it does in a continuous controller.
    pid.step(np.zeros((num_rigs, 2)), limits=limits)

    steps = round(scenario.duration / PERIOD)
    every = round(1e-3 / PERIOD)
    time: Floats = np.arange(steps, dtype=float) * PERIOD
    setpoint, load = scenario.profile(time, None)
    torque = np.broadcast_to(np.asarray(nominal_torque, dtype=float), (num_rigs,))
    speeds, commands = (np.empty((-(-steps // every), num_rigs, 2)) for _ in range(2))
    peak = np.zeros(num_rigs)
    for n in range(steps):
        speed = plant.speed / RPM
        command = pid.step(setpoint[n] - speed, limits=limits)
        if n % every == 0:
            speeds[n // every], commands[n // every] = speed, command
        if time[n] >= peak_from:
            np.maximum(peak, np.abs(speed[:, 0] - speed[:, 1]), out=peak)
        plant.step(command, load[n] * torque[:, None], PERIOD)
    return Traces(time[::every], setpoint[::every], speeds, commands, peak)


def equal_again_after(traces: Traces, scenario: Scenario, within_rpm: float) -> Floats:
    """Time in s, (changes, N), from each change of the set-point until the difference stays within a band."""
    changes = [0.0, *traces.time[1:][np.diff(traces.setpoint) != 0.0], scenario.duration]
    times = []
    for start, end in itertools.pairwise(changes):
        rows = (traces.time >= start - 1e-9) & (traces.time < end - 1e-9)
        outside = np.abs(traces.difference[rows]) > within_rpm
        last = np.where(outside.any(axis=0), outside.shape[0] - np.argmax(outside[::-1], axis=0), 0)
        times.append(last * (traces.time[1] - traces.time[0]))
    return np.array(times)


# --- calibration ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Calibration:
    """The value that meets the target, and the curve it was read from (`tried` -> `reached` rpm)."""

    value: float
    tried: list[float]
    reached: list[float]


def _crossing(tried: Floats, reached: Floats, target: float) -> Calibration:
    order = np.argsort(reached)
    value = float(PchipInterpolator(reached[order], tried[order])(target))
    return Calibration(value, tried.tolist(), reached.tolist())


def _overlaps(values: Any) -> dict[str, Any]:
    """Dead zones of both valves, the same both ways."""
    return {"dead_zone.overlap_positive": values, "dead_zone.overlap_negative": values}


def calibrate_dead_zone() -> Calibration:
    """Overlap (m) of valve V1, the same both ways, with which the paper's set-point steps give its peak difference.

    V2 keeps none: only the difference of the two matters much, and Fig. 2 shows V1 as the odd one.
    """
    overlap = np.linspace(0.0, 150e-6, 16)
    pairs = np.column_stack([overlap, np.zeros_like(overlap)])
    traces = run_paper(load_model("paper"), SETPOINT_STEPS, values=_overlaps(pairs), num_rigs=overlap.size)
    return _crossing(overlap, traces.peak, PUBLISHED_STEPS_RPM)


def calibrate_torque(model: PlantModel) -> Calibration:
    """Nominal load torque (N m) with which the paper's load step gives its peak difference, without a command limit."""
    torque = np.concatenate([np.linspace(0.5, 2.5, 3), np.linspace(2.75, 4.0, 11), np.linspace(4.5, 6.0, 2)])
    traces = run_paper(model, LOAD_STEP, num_rigs=torque.size, nominal_torque=torque, peak_from=2.0)
    return _crossing(torque, traces.peak, PUBLISHED_LOAD_RPM)


# --- experiments ------------------------------------------------------------------------------------------------------
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


def reproduce(progress: bool = True) -> Reproduction:
    """Calibrates and runs both experiments."""
    with tqdm(total=4, desc="reproduce", disable=not progress, leave=False) as bar:
        dead_zone = calibrate_dead_zone()
        overlap = round(dead_zone.value, 8)  # to 10 nm
        model = load_model("paper").with_values(_overlaps((overlap, 0.0)), name="paper_dead_zone")
        bar.update()
        values = _overlaps([[0.0, 0.0], [overlap, 0.0]])
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
    command = share[:, None] * np.array(model.pair("u_rated"))
    out = Plant(model).run(command, None, period, ("current", "flow"))
    return out["current"][:, 0], out["flow"][:, 0]


def run(out: str | Path, *, pictures: bool = True) -> Reproduction:
    """Runs the experiments and writes reproduce.json, traces.csv, paper_dead_zone.yaml and, if asked, the pictures.

    Args:
        out: an existing folder.
        pictures: figure_2.png, figure_7.png, figure_8.png (needs the extra `report`).

    Returns all that was simulated; its `numbers` are the content of reproduce.json.
    """
    out = Path(out)
    result = reproduce()
    result.model.to_yaml(out / "paper_dead_zone.yaml")
    write_text(out / "traces.csv", _table(result))
    write_json(out / "reproduce.json", result.numbers)
    if pictures:
        for name, draw in (("figure_2", draw_valves), ("figure_7", draw_steps), ("figure_8", draw_load)):
            with beside_results(path := out / f"{name}.png"):
                png(draw(result), path)
    return result


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
    steps = result.steps
    rows = np.column_stack([steps.time, steps.setpoint, steps.speed.reshape(len(steps.time), 4)])
    return head + "\n" + "\n".join(",".join(f"{value:.6g}" for value in row) for row in rows) + "\n"


# --- pictures ---------------------------------------------------------------------------------------------------------
def draw_steps(result: Reproduction) -> Any:
    """Fig. 7: speeds of both motors by the tables alone and with the dead zone, below them both differences."""
    drawing, axes = figure(3, height=1.9)
    time, last = result.steps.time, axes[-1]
    rigs = (("the tables alone", COLOURS[4]), ("with the dead zone", COLOURS[3]))
    for rig, (axis, (label, colour)) in enumerate(zip(axes, rigs, strict=False)):
        axis.plot(time, result.steps.setpoint, color=COLOURS[4], linewidth=0.9, label="set-point")
        draw_speeds(axis, time, result.steps.speed[:, rig])
        axis.set_title(f"Speeds, {label}", loc="left", fontsize=9.5)
        axis.set_ylabel("rpm")
        last.plot(time, result.steps.difference[:, rig], color=colour, label=label)
    for side in (-1, 1):
        last.axhline(side * PUBLISHED_STEPS_RPM, color=COLOURS[2], linestyle="--", linewidth=1.1)
    title = f"Speed difference; dashed: the {PUBLISHED_STEPS_RPM:g} rpm of the paper"
    last.set_title(title, loc="left", fontsize=9.5)
    last.set(xlabel="time, s", ylabel="rpm", xlim=(0, time[-1]))
    legend(axes[0])
    legend(last)
    return drawing


def draw_load(result: Reproduction) -> Any:
    """Fig. 8: speeds around the load step and their difference."""
    drawing, (speeds, gap) = figure(2, height=2.3)
    time, late = result.load.time, result.load.time >= 1.9
    draw_speeds(speeds, time, result.load.speed[:, 0])
    speeds.set(ylabel="speed, rpm")
    label = f"simulated: {result.load.peak[0]:.0f} rpm"
    gap.plot(time[late], np.abs(result.load.difference[late, 0]), color=COLOURS[3], label=label)
    label = f"paper: {PUBLISHED_LOAD_RPM:.0f} rpm"
    gap.axhline(PUBLISHED_LOAD_RPM, color=COLOURS[2], linestyle="--", linewidth=1.1, label=label)
    gap.set(xlabel="time, s", ylabel="speed difference\nfrom 1.9 s on, rpm", ylim=(0, None))
    legend(speeds)
    legend(gap)
    return drawing


def draw_speeds(axis: Any, time: Any, speed: Floats, **style: Any) -> None:
    """Lines of both motors; `speed` is (T, 2) in rpm."""
    for motor in (0, 1):
        axis.plot(time, speed[:, motor], color=COLOURS[motor], label=f"motor {motor + 1}", **style)


def draw_valves(result: Reproduction) -> Any:
    """Fig. 2: flow over current of both valves of the calibrated rig, swept slowly both ways."""
    drawing, (axis,) = figure(1, height=3.2)
    current, flow = sweep(result.model)
    for valve in (0, 1):
        axis.plot(current[:, valve] * 1e3, flow[:, valve] / LPM, color=COLOURS[valve], label=f"V{valve + 1}")
    axis.axvspan(-300, 300, color="grey", alpha=0.15, linewidth=0, label="no flow in the paper's Fig. 2")
    axis.set(xlabel="current, mA", ylabel="flow, l/min")
    axis.legend(loc="upper left")
    return drawing
