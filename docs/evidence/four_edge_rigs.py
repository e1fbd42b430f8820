"""How often the diagnosis is right on rigs of a simulator with other equations: four edges, two lines (`four_edges`).

    python -m docs.evidence.four_edge_rigs --out DIR [--seed N] [--only CASE ...] [--logs DIR] [--jobs N]

Each case hides what such a machine has (`CASES`) on a rig of its own: spool, orifices, lines and motors up to 10 % off the data
sheet, sizes of what is hidden drawn from 0.8 to 1.25 times the given ones. The model that is to be improved is what an engineer
writes from the data sheet: two servo valves with a spool loop of 80 Hz and a damping ratio of 0.8, rated flows 10 % off, 120 bar.
Commands, loads, load pressures and speeds are logged at 1 kHz, for two logs to fit and one to be held out, 12 s each.

What is right is stated for each case: one name or more, or verdicts. Elastic walls of hoses make a line softer, which is a bulk
modulus. A vessel behind an orifice on one line alone, and a soft shaft without play, have no law in the catalogue, so `unknown`
is right.

Cases that DIR holds already are not run again. Writes four_edge_rigs.json and four_edge_rigs.md.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.command import run_command
from hydro_env.diagnosis import diagnose
from hydro_env.experiments.coverage import by_channel
from hydro_env.files import write_json, write_text
from hydro_env.limits import CORES, SEEDS
from hydro_env.plant import PlantModel, load_model
from hydro_env.practice.recorder import log_text
from hydro_env.reading import read_json
from hydro_env.units import BAR, RPM

from .blind_trials.running import method
from .blind_trials.tables import markdown
from .four_edges import Axis, simulate

SCHEMA = "hydro_env/four_edge_rigs/1"
Array = NDArray[np.float64]
Stream = np.random.Generator

#: Length of a log and its period, s.
SECONDS, PERIOD = 12.0, 1e-3
#: Standard deviations of the sensors: speed, rpm, and load pressure, bar.
SPEED_NOISE, PRESSURE_NOISE = 1.0, 0.05
#: How far base parameters are off the data sheet, and the factors on what is hidden.
OFF, SIZES = 0.1, (0.8, 1.25)
#: The data sheet: supply over tank, bar; rated flows of the valves, m3/s by m of opening at half the supply over an edge; the
#: spool's frequency, Hz, and damping; each line's volume, m3.
NET_SUPPLY, RATED, SPOOL, LINE = 120.0, (0.33, 0.245), (80.0, 0.8), 2e-4
#: Motors and oil of the data sheet, SI.
MOTOR = {
    "displacement": 1.348e-6,
    "leakage": 1.5e-11,
    "inertia": 2.8e-3,
    "friction": 4.3e-3,
    "modulus": 1.267e9,
}


@dataclass(frozen=True)
class Case:
    """What is hidden, by channel as fields of `Axis` (`resistance`: of the supply both valves share), and what is then right:
    these names together, as "effect:channel", or one of these verdicts."""

    hidden: Mapping[int, Mapping[str, float]]
    names: tuple[str, ...] = ()
    verdicts: tuple[str, ...] = ()
    resistance: float = 0.0


def _lap(*edges: float) -> dict[str, float]:
    pa, pb, at, bt = edges if len(edges) > 1 else edges * 4
    return {"overlap_pa": pa, "overlap_pb": pb, "overlap_at": at, "overlap_bt": bt}


_DRY = {"coulomb": 0.5, "static": 0.8}
_LAGGING_RELIEF = {
    "relief_pressure": 22e5,
    "relief_slope": 2e-10,
    "relief_lag": 0.01,
    "relief_hysteresis": 4e5,
}
_FINE = ("none", "calibration")
CASES: dict[str, Case] = {
    "nothing": Case({}, (), _FINE),
    "overlap": Case({0: _lap(40e-6)}, ("dead_zone:1",)),
    "uneven overlap": Case({1: _lap(25e-6, 60e-6, 60e-6, 25e-6)}, ("dead_zone:2",)),
    "underlap": Case({1: _lap(-30e-6)}, ("underlap:2",)),
    "uneven underlap": Case({0: _lap(-20e-6, -45e-6, -45e-6, -20e-6)}, ("underlap:1",)),
    "spool off centre": Case({1: {"zero": 15e-6}}, ("null_offset:2",)),
    "narrow edges one way": Case({0: {"negative_gain": 0.8}}, ("directional_gain:1",)),
    "play at the input": Case({1: {"play": 2.0}}, ("input_hysteresis:2",)),
    "late command": Case({0: {"delay": 0.012}}, ("command_delay:1",)),
    "limited driver": Case({1: {"voltage_limit": 17.5}}, ("driver_saturation:2",)),
    "dry friction of a motor": Case({0: _DRY}, ("motor_coulomb_friction:1",)),
    "leak of line A": Case({0: {"leak_a": 1.2e-12}}, ("external_leakage:1",)),
    "leak of line B": Case({1: {"leak_b": 1.5e-12}}, ("external_leakage:2",)),
    "relief valve": Case({0: {"relief_pressure": 20e5, "relief_slope": 2e-10}}, ("crossport_relief:1",)),
    "slow relief valve": Case({1: _LAGGING_RELIEF}, ("crossport_relief:2",)),
    "weak supply": Case({}, ("supply_droop:rig",), resistance=6e9),
    "air in the oil": Case({1: {"air": 0.004}}, ("entrained_air:2",), ("calibration",)),
    "hoses": Case({1: {"hose": 1.5e-9}}, (), ("calibration", "unknown")),
    "vessel at a line": Case({0: {"vessel_volume": 1.5e-3, "vessel_orifice": 2.4e-8}}, (), ("unknown",)),
    "soft shaft": Case(
        {0: {"inertia": 0.5, "far_inertia": 1.4e-3, "stiffness": 12.0, "shaft_damping": 4e-3}},
        (),
        ("unknown",),
    ),
    "slow speed sensor": Case({1: {"sensor_lag": 0.02}}, ("sensor_lag:2",)),
    "offset of a speed sensor": Case({0: {"sensor_offset": 0.8 * RPM}}, ("sensor_offset:1",)),
    "overlap, slow sensor": Case({0: _lap(40e-6), 1: {"sensor_lag": 0.015}}, ("dead_zone:1", "sensor_lag:2")),
    "dry friction, underlap": Case({0: _DRY, 1: _lap(-30e-6)}, ("motor_coulomb_friction:1", "underlap:2")),
    "overlap and play": Case({0: {**_lap(30e-6), "play": 2.0}}, ("dead_zone:1", "input_hysteresis:1")),
}
#: Fields that are factors on the data sheet's value, and those whose size is not drawn.
_FACTORS, _GIVEN = ("inertia",), ("inertia", "far_inertia")


def engineers_model() -> PlantModel:
    """The model before any log, from the data sheet."""
    servo = load_model("servo")
    k = servo.value("k", 0)
    omega = 2.0 * math.pi * SPOOL[0]
    mass = k / omega**2
    values = {
        "m": mass, "C": 2.0 * SPOOL[1] * omega * mass, "L": 1e-3, "Fc": 2e-3, "Fs": 2e-3, "D": MOTOR["displacement"],
        "J": MOTOR["inertia"], "B": MOTOR["friction"], "Km": MOTOR["leakage"], "V": 0.5 * LINE, "beta": MOTOR["modulus"],
        "Kq": RATED, "pressure_dependent_flow.supply_pressure": NET_SUPPLY * BAR,
    }  # fmt: skip
    return servo.with_values(values, "data sheet")


def _axes(rng: Stream, case: Case) -> tuple[tuple[Axis, Axis], float]:
    """The rig of a case: its axes, and the resistance of its supply."""
    model = engineers_model()
    gain = model.value("alpha", 0) / model.value("R", 0) / model.value("k", 0)

    def off(value: float, by: float = OFF) -> float:
        return float(value * (1.0 + rng.uniform(-by, by)))

    found = []
    for c, rated in enumerate(RATED):
        volume = off(LINE)
        own = {name: off(value) for name, value in MOTOR.items() if name != "displacement"}
        axis = Axis(
            gain=gain, frequency=off(SPOOL[0], 0.05), damping=off(SPOOL[1]), volume_a=volume, volume_b=volume,
            orifice=0.95 * off(rated) / math.sqrt(0.5 * NET_SUPPLY * BAR), displacement=MOTOR["displacement"], **own,
        )  # fmt: skip
        sizes = {
            n: v * (1.0 if n in _GIVEN else rng.uniform(*SIZES)) for n, v in case.hidden.get(c, {}).items()
        }
        sizes |= {n: getattr(axis, n) * v for n, v in sizes.items() if n in _FACTORS}
        found.append(axis._replace(**sizes))
    return (found[0], found[1]), case.resistance * float(rng.uniform(*SIZES))


# --- manoeuvres -----------------------------------------------------------------------------------------------------------
def _steps(rng: Stream, rows: int, size: float) -> Array:
    found, at = np.zeros(rows), min(300, rows // 4)
    while at < rows:
        length = int(rng.uniform(0.4, 1.2) / PERIOD)
        found[at : at + length] = rng.uniform(-size, size)
        at += length
    return found


def _sines(rng: Stream, rows: int, size: float) -> Array:
    t, found = np.arange(rows) * PERIOD, np.zeros(rows)
    for _ in range(3):
        phase = 2.0 * math.pi * rng.uniform(0.3, 2.5) * t + rng.uniform(0.0, 2.0 * math.pi)
        found += rng.uniform(0.3, 1.0) * np.sin(phase)
    return found * size / np.abs(found).max() * np.minimum(1.0, t / 0.2)


def _ramps(rng: Stream, rows: int, size: float) -> Array:
    at, to = [0], [0.0]
    while at[-1] < rows:
        at.append(at[-1] + int(rng.uniform(0.3, 1.5) / PERIOD))
        to.append(rng.uniform(-size, size))
    return np.interp(np.arange(rows), at, to)


def _manoeuvre(rng: Stream, log: str, rows: int) -> tuple[Array, Array]:
    """Command, V, and load, N m, of one channel in a log."""
    third, half = rows // 3, int(0.55 * rows)
    if log == "fit_1":
        command = _steps(rng, rows, 26.0)
    elif log == "fit_2":
        command = np.concatenate([_sines(rng, half, 23.0), _ramps(rng, rows - half, 24.0)])
    else:
        command = np.concatenate(
            [_ramps(rng, third, 12.0), _steps(rng, third, 24.0), _sines(rng, rows - 2 * third, 25.0)]
        )
    t = np.arange(rows) * PERIOD
    swell = 0.5 + 0.5 * np.sin(rng.uniform(0.3, 2.0) * t)
    load = _ramps(rng, rows, 2.5) * swell * (t > 0.2 * SECONDS)
    return np.round(command, 3), np.round(load, 3)


def logs(name: str, seed: int, seconds: float = SECONDS) -> dict[str, dict[str, Array]]:
    """The three logs of a case, by columns: "fit_1", "fit_2" and "sealed"."""
    streams = np.random.default_rng([seed, list(CASES).index(name)]).spawn(2)
    axes, resistance = _axes(streams[0], CASES[name])
    rows, rng = round(seconds / PERIOD) + 1, streams[1]
    found: dict[str, dict[str, Array]] = {}
    for log in ("fit_1", "fit_2", "sealed"):
        both = [_manoeuvre(rng, log, rows) for _ in (0, 1)]
        command, load = (np.stack(parts, axis=1) for parts in zip(*both, strict=True))
        seen = simulate(axes, command, load, PERIOD, supply=(NET_SUPPLY + 1.0) * BAR, resistance=resistance)
        columns: dict[str, Array] = {"time_s": np.arange(rows, dtype=float) * PERIOD}
        for c in (0, 1):
            pressure = (seen["pressure_a"][:, c] - seen["pressure_b"][:, c]) / BAR
            columns |= {
                f"command_{c + 1}_V": command[:, c],
                f"pressure_{c + 1}_bar": pressure + rng.normal(0.0, PRESSURE_NOISE, rows),
                f"speed_{c + 1}_rpm": seen["measured_speed"][:, c] / RPM + rng.normal(0.0, SPEED_NOISE, rows),
                f"load_{c + 1}_Nm": load[:, c],
            }
        found[log] = columns
    return found


# --- running --------------------------------------------------------------------------------------------------------------
def judged(case: Case, data: Mapping[str, Any]) -> dict[str, Any]:
    """What a diagnosis (the content of diagnosis.json) says of a case.

    `right` if it names what is there and nothing else, on its channel, or ends as stated; `set` if what is there is listed beside
    the name; `false_name` if a name is given as proven of something that is not there.
    """
    each = [
        {f"{n}:{c}" for n in (e["name"], *e["indistinguishable_from"])}
        for e in data["effects"]
        for _, c in by_channel([e])
    ]
    named = {f"{n}:{c}" for n, c in by_channel(data["effects"])}
    effects, expected = data["verdict"] == "effects", {*case.names}
    fits = effects and bool(expected) and expected <= set().union(*each) and len(named) == len(expected)
    ends = data["verdict"] in case.verdicts and (data["verdict"] == "unknown" or not named)
    worst = max(v["after"] / v["noise"] for k, v in data["gap"]["sealed"].items() if k.startswith("speed"))
    return {
        "verdict": data["verdict"],
        "best_guess": bool(data.get("best_guess")),
        "named": sorted(named),
        "right": (fits and named == expected) or ends,
        "set": fits or ends,
        "false_name": effects and not data.get("best_guess") and any(not own & expected for own in each),
        "worst": round(worst, 3),
    }


def run(
    out: Path, seed: int, only: Sequence[str] = (), kept: Path | None = None, jobs: int = 1
) -> list[dict[str, Any]]:
    """Runs the cases that the folder does not hold; returns all of its rows."""
    from tqdm import tqdm

    out.mkdir(parents=True, exist_ok=True)
    path = out / "four_edge_rigs.json"
    rows = read_json(path, "the rigs of a run")["rows"] if path.exists() else []
    done = {(r["seed"], r["case"]) for r in rows}
    todo = [name for name in only or CASES if (seed, name) not in done]
    for name in tqdm(todo, unit="rig"):
        with tempfile.TemporaryDirectory() as temporary:
            folder = (kept / f"{seed}_{name.replace(' ', '_').replace(',', '')}") if kept else Path(temporary)
            folder.mkdir(parents=True, exist_ok=True)
            for log, columns in logs(name, seed).items():
                write_text(folder / f"{log}.csv", log_text(columns))
            begin = time.process_time()
            fit = [folder / "fit_1.csv", folder / "fit_2.csv"]
            found = diagnose(fit, [folder / "sealed.csv"], model=engineers_model(), jobs=jobs)
        row = {"case": name, "seed": seed, **judged(CASES[name], found.as_dict())}
        rows.append(row | {"cpu_s": round(time.process_time() - begin, 1), "method": method()})
        write_json(path, {"schema": SCHEMA, "rows": rows})
        tqdm.write(_line(row), file=sys.stdout)
        sys.stdout.flush()
    write_text(out / "four_edge_rigs.md", table(rows))
    return rows


def _expected(name: str) -> str:
    case = CASES[name]
    return " or ".join([*([", ".join(case.names)] if case.names else []), *case.verdicts])


def _line(row: Mapping[str, Any]) -> str:
    mark = (
        "right" if row["right"] else "set" if row["set"] else "FALSE NAME" if row["false_name"] else "missed"
    )
    said = row["verdict"] + (" (best guess)" if row["best_guess"] else "")
    named = ", ".join(row["named"]) or "-"
    return f"{row['case']:26s} {mark:10s} {said:12s} {named}  {row['worst']:.2f} x noise"


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Counts and all rows in Markdown."""
    counts = [
        ["right", sum(r["right"] for r in rows)],
        ["right, or listed with the named one", sum(r["set"] for r in rows)],
        ["a false name given as proven", sum(r["false_name"] for r in rows)],
        ["held-out speeds within 1.3 times the noise", sum(r["worst"] <= 1.3 for r in rows)],
    ]
    head = markdown(["rigs", str(len(rows))], counts)
    cells = [
        [
            r["case"], r["seed"], _expected(r["case"]), r["verdict"] + (", best guess" if r["best_guess"] else ""),
            ", ".join(r["named"]) or "-", "yes" if r["right"] else "listed" if r["set"] else "no", f"{r['worst']:.2f}",
        ]
        for r in sorted(rows, key=lambda r: (list(CASES).index(r["case"]), r["seed"]))
    ]  # fmt: skip
    columns = ["hidden", "seed", "right is", "verdict", "named", "right", "held-out speed, times the noise"]
    return "\n".join([*head, "", *markdown(columns, cells)]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="four_edge_rigs", description="The diagnosis on rigs of another simulator."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--seed", type=SEEDS, default=1)
    parser.add_argument("--only", nargs="*", default=[], choices=list(CASES), metavar="CASE")
    parser.add_argument("--logs", type=Path, help="folder in which the logs are kept")
    parser.add_argument("--jobs", type=CORES, default=1, help="threads of a diagnosis")
    given = parser.parse_args()
    print(table(run(given.out, given.seed, given.only, given.logs, given.jobs)), end="")


if __name__ == "__main__":
    run_command(main)
