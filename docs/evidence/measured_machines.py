"""A loader crane and a servo valve that others measured: verdicts on held-out logs, and figures of the valve.

    python -m docs.evidence.measured_machines DATA --out DIR

DATA holds the recordings, which are not part of this package (no licence is stated for them), in the folders

    crane_two_axes  main_sine.csv.gz, dual_sine_1.csv.gz; github.com/emilah-png/Bachelor at ac8c08df
    servovalve      flow_gain.txt.gz, leakage_period_20.txt.gz (100, 500); github.com/senerphd/servoValveModelling at c459838a

A folder that is absent is left out, and said so. Writes measured_machines.json, crane.md, servo_valve.md and
measured_machines.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.command import run_command
from hydro_env.diagnosis import Diagnosis, diagnose
from hydro_env.errors import InputError
from hydro_env.experiments import valve_test
from hydro_env.files import write_json, write_text
from hydro_env.pages import COLOURS, RC, png
from hydro_env.valve_bench import Columns
from hydro_env.valve_bench.bench import Sweeps

from .blind_trials.tables import markdown

SCHEMA = "hydro_env/measured_machines/1"
MAPPINGS = Path(__file__).parents[2] / "configs" / "mappings"
#: The models on a held-out log, as keys of `gap` and in words.
MODELS = {
    "before": "as given",
    "calibrated": "calibrated",
    "after": "with what was named",
    "placebo": "placebo",
    "noise": "noise",
}
COLUMNS = Columns(signal="1", flow="2", signal_unit="A", flow_unit="GPM")
SWEEP_PERIODS = (20.0, 100.0, 500.0)


@dataclass(frozen=True)
class Run:
    """An axis of the crane: the log, its windows to fit and to hold out (s), and the mapping of its columns."""

    name: str
    log: str
    fit: str
    held_out: str
    mapping: str


RUNS = (
    Run("Main, sine", "main_sine", "0:13,23:34", "13:23,34:47", "crane_main"),
    Run("Main, both axes moving", "dual_sine_1", "0:15,30:45", "15:30,45:", "crane_main"),
    Run("Jib, both axes moving", "dual_sine_1", "0:15,30:45", "15:30,45:", "crane_jib"),
)


# --- the crane --------------------------------------------------------------------------------------------------------
def crane(folder: Path) -> list[dict[str, Any]]:
    """A row for each run: verdict, overlaps as a share of full command, errors on the held-out windows in mm/s."""
    rows = []
    for each in RUNS:
        log = folder / f"{each.log}.csv.gz"
        found = diagnose(
            [f"{log}@{each.fit}"], [f"{log}@{each.held_out}"], mapping=MAPPINGS / f"{each.mapping}.yaml"
        )
        errors = next(iter(found.as_dict()["gap"]["sealed"].values()))
        rows.append({
            "run": each.name, "verdict": found.verdict, "names": [[e.name, e.probability] for e in found.effects],
            "overlap": _overlap(found), "errors_mm_per_s": {key: errors[key] for key in MODELS},
        })  # fmt: skip
    return rows


def _overlap(found: Diagnosis) -> dict[str, list[float]]:
    """Value and interval of the overlap in both directions, per cent of full command."""
    values = next((e.parameters for e in found.effects if e.name == "dead_zone"), {})
    model, channel = found.model, found.rig.channels[0]
    full = model.value("alpha", channel) * model.value("u_rated", channel)
    share = 100.0 * model.value("k", channel) * model.value("R", channel) / full
    return {name: [share * x for x in (v.value, v.low, v.high)] for name, v in values.items()}


def crane_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows in Markdown."""
    head = [
        "run", "verdict", "overlap, positive direction", "overlap, negative direction",
        "speed error on the held-out part, mm/s: as given, calibrated, after, placebo (noise)",
    ]  # fmt: skip
    cells = []
    for row in rows:
        *errors, noise = row["errors_mm_per_s"].values()
        overlaps = [row["overlap"].get(f"overlap_{way}") for way in ("positive", "negative")]
        names = ", ".join(f"`{name}` {p:.2f}" for name, p in row["names"])
        cells.append([
            row["run"], f"`{row['verdict']}`: {names}" if names else f"`{row['verdict']}`",
            *("{:.1f} % ({:.1f} to {:.1f})".format(*v) if v else "-" for v in overlaps),
            f"{', '.join(f'{e:.2f}' for e in errors)} ({noise:.2f})",
        ])  # fmt: skip
    return "\n".join(markdown(head, cells)) + "\n"


# --- the servo valve --------------------------------------------------------------------------------------------------
def servo_valve(folder: Path, out: Path) -> dict[str, Any]:
    """Entries of valve_test.json: of the flow over the signal, and of the leakage at three rates."""
    (out / "flow_gain").mkdir(parents=True, exist_ok=True)
    (out / "leakage").mkdir(parents=True, exist_ok=True)
    leakage = [str(folder / f"leakage_period_{s:g}.txt.gz") for s in SWEEP_PERIODS]
    rates = Sweeps(columns=COLUMNS, periods=SWEEP_PERIODS, one_valve=True)
    quiet: dict[str, Any] = {"pictures": False, "progress": False}
    flow = valve_test.run(
        out / "flow_gain", [str(folder / "flow_gain.txt.gz")], Sweeps(columns=COLUMNS), **quiet
    )
    leak = valve_test.run(out / "leakage", leakage, rates, **quiet)
    return {"flow_gain": flow["valves"][0], "leakage": leak["valves"][0]}


def servo_valve_table(found: Mapping[str, Any]) -> str:
    """The figures in Markdown."""
    flow, check = found["flow_gain"], found["leakage"]["rate_check"]
    sides = [flow[way] for way in ("positive", "negative")]

    def both(key: str, digits: int) -> str:
        return " and ".join(f"{side[key]:.{digits}f}" for side in sides)

    loops = ", ".join(f"{s['loop_percent']:.1f}" for s in check["sweeps"])
    rows = [
        ["gain, l/min per A", both("gain_lpm_per_unit", 0)],
        ["overlap, % of the rated current", both("dead_zone_percent", 1)],
        ["linearity, %", both("linearity_percent", 1)],
        ["largest flow, l/min", both("maximum_flow_lpm", 1)],
        ["null, % of the rated current", f"{flow['null']['percent']:.1f}"],
        ["loop of the flow, %", f"{flow['hysteresis']['percent']:.1f}"],
        ["loop of the leakage, slowest sweep first, %", loops],
        ["the leakage's loop is", f"{check['verdict']}: {check['reason']}"],
    ]
    return "\n".join(markdown(["figure, positive and negative direction", "value"], rows)) + "\n"


# --- both -------------------------------------------------------------------------------------------------------------
def run(data: Path, out: Path) -> dict[str, Any]:
    """Measures what DATA holds and writes tables and picture; InputError if neither folder is there."""
    folders = {name: data / name for name in ("crane_two_axes", "servovalve")}
    there = {name for name, folder in folders.items() if folder.is_dir()}
    if not there:
        raise InputError(
            f"{data}: neither {' nor '.join(folders)} is there; see --help for the sources of the recordings"
        )
    for name in sorted(set(folders) - there):
        print(f"{folders[name]} is absent: left out")
    out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {"schema": SCHEMA}
    if "crane_two_axes" in there:
        found["crane"] = crane(folders["crane_two_axes"])
        write_text(out / "crane.md", crane_table(found["crane"]))
    if "servovalve" in there:
        found["servo_valve"] = servo_valve(folders["servovalve"], out)
        write_text(out / "servo_valve.md", servo_valve_table(found["servo_valve"]))
    write_json(out / "measured_machines.json", found)
    _draw(found, out / "measured_machines.png")
    return found


def _draw(found: Mapping[str, Any], path: Path) -> None:
    """Held-out errors of the crane's runs, and the loop of the servo valve's leakage over the rate."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(RC):
        made = Figure(figsize=(11.0, 3.6), layout="constrained")
        axes = made.subplots(1, 2, width_ratios=[1.7, 1.0])
        runs = found.get("crane", [])
        for n, (key, name) in enumerate(MODELS.items()):
            places = [row + 0.16 * (n - 2) for row in range(len(runs))]
            axes[0].bar(places, [r["errors_mm_per_s"][key] for r in runs], 0.15, label=name, color=COLOURS[n])
        axes[0].set_xticks(range(len(runs)), [r["run"] for r in runs])
        axes[0].set_ylabel("RMS error of the speed, mm/s")
        axes[0].set_title("Loader crane: held-out windows", loc="left")
        axes[0].legend(frameon=False, fontsize=8, ncols=3)
        sweeps = found.get("servo_valve", {}).get("leakage", {}).get("rate_check", {}).get("sweeps", [])
        rates, loops = ([s[key] for s in sweeps] for key in ("rate_percent_per_s", "loop_percent"))
        axes[1].loglog(rates, loops, "o-", color=COLOURS[0])
        axes[1].set_xlabel("rate of the sweep, % of 5 mA a second")
        axes[1].set_ylabel("loop, % of 5 mA")
        axes[1].set_title("Servo valve: loop of the leakage", loc="left")
        for axis in (axes[1].xaxis, axes[1].yaxis):
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(lambda value, _: "")
        png(made, path)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="measured_machines", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    found = run(given.data, given.out)
    print(crane_table(found.get("crane", [])), end="")
    if "servo_valve" in found:
        print(servo_valve_table(found["servo_valve"]), end="")


if __name__ == "__main__":
    run_command(main)
