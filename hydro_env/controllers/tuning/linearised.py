"""PID gains from the linearised plant, as a PID tuner finds them: `hydro-env tune --linear`.

Linearised are the base equations of one channel: coil, spool, oil and motor, five states. The spool slides (its
friction is constant then and drops out), the valve is open; effects, among them the dead zone, are not seen. That is
the plant that a tuner in a simulation program is shown.

The rule is the usual one for a plant with one slow pole: Ti cancels that pole, and Kp is as large as the largest
sensitivity Ms allows, max |1 / (1 + L(jw))|, the inverse of the least distance of the open loop L to -1. No derivative:
it would only raise the spool's mode. One number is left to choose, Ms. 1.2 to 2.0 are usual (Astrom and Hagglund); the
paper does not say what was chosen, and `MS` is the round number that comes nearest to its Table III.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.controllers.base import RPM, Floats
from hydro_env.controllers.classical.pid import TABLE_III
from hydro_env.controllers.tuning.gains import GainsFile, write_gains
from hydro_env.errors import InputError
from hydro_env.plant import PlantModel, load_model

__all__ = ["MS", "largest_sensitivity", "linear_plant", "run", "summary", "tune_channel"]

MS = 1.3
UNITS = {"Kp": "V/rpm", "Ti": "s", "Td": "s"}


def linear_plant(model: PlantModel, channel: int) -> tuple[Floats, Floats, Floats]:
    """State matrix (5, 5), input (5,) and output (5,) from volts to rpm of a channel (0 or 1).

    States: current, spool travel and speed, pressure, motor speed, in SI units.
    """
    p = {name: float(model.value(name, channel)) for name in
         ("R", "L", "alpha", "k", "C", "s2", "m", "Kq", "D", "Km", "V", "beta", "J", "B")}  # fmt: skip
    stiffness = p["beta"] / p["V"]
    a = np.zeros((5, 5))
    a[0, 0], a[0, 2] = -p["R"] / p["L"], -p["alpha"] / p["L"]
    a[1, 2] = 1.0
    a[2, 0], a[2, 1], a[2, 2] = p["alpha"] / p["m"], -p["k"] / p["m"], -(p["C"] + p["s2"]) / p["m"]
    a[3, 1], a[3, 3], a[3, 4] = stiffness * p["Kq"], -stiffness * p["Km"], -stiffness * p["D"]
    a[4, 3], a[4, 4] = p["D"] / p["J"], -p["B"] / p["J"]
    b, c = np.zeros(5), np.zeros(5)
    b[0], c[4] = 1.0 / p["L"], 1.0 / RPM
    return a, b, c


def largest_sensitivity(plant: tuple[Floats, Floats, Floats], kp: float, ti: float) -> float:
    """Ms of the loop that a PI closes around a plant; infinite if it is not stable."""
    a, b, c = plant
    closed = np.zeros((6, 6))
    closed[:5, :5], closed[:5, 5], closed[5, :5] = a - kp * np.outer(b, c), kp / ti * b, -c
    if np.max(np.linalg.eigvals(closed).real) >= 0.0:
        return np.inf
    # The mode of the spool is sharp: a grid that is fine around every pole of the closed loop and of the plant.
    poles = np.abs(np.concatenate([np.linalg.eigvals(closed), np.linalg.eigvals(a)]))
    grid = np.concatenate(
        [np.geomspace(1e-2, 1e4, 400), *(pole * np.linspace(0.9, 1.1, 101) for pole in poles)]
    )
    s = 1j * grid
    speed = (
        np.linalg.solve(s[:, None, None] * np.eye(5) - a, np.broadcast_to(b[:, None], (len(s), 5, 1)))[..., 0]
        @ c
    )
    return float(np.max(1.0 / np.abs(1.0 + kp * (1.0 + 1.0 / (ti * s)) * speed)))


def tune_channel(model: PlantModel, channel: int, max_sensitivity: float = MS) -> dict[str, float]:
    """Kp (V/rpm), Ti and Td (s) of a channel."""
    plant = linear_plant(model, channel)
    ti = 1.0 / np.min(np.abs(np.linalg.eigvals(plant[0])))
    low, high = 0.0, 1.0
    for _ in range(40):
        kp = 0.5 * (low + high)
        low, high = (kp, high) if largest_sensitivity(plant, kp, ti) <= max_sensitivity else (low, kp)
    return {"Kp": float(f"{low:.4g}"), "Ti": float(f"{ti:.4g}"), "Td": 0.0}


def run(
    out: str | Path, *, plant: str = "paper", max_sensitivity: float = MS, name: str | None = None
) -> dict[str, Any]:
    """Tunes a PI on each channel of a plant and writes `out/gains.json`, with how near it comes to Table III.

    Returns what gains.json says. InputError for a plant that is none, or an Ms outside 1.05 to 4.
    """
    if not 1.05 <= max_sensitivity <= 4.0:
        raise InputError(
            f"--max-sensitivity {max_sensitivity:g}: the largest sensitivity must be between 1.05 and 4"
        )
    model = load_model(plant)
    found = [tune_channel(model, channel, max_sensitivity) for channel in (0, 1)]
    gains: dict[str, float | list[float]] = {key: [each[key] for each in found] for key in UNITS}
    integral = [(each["Kp"] / each["Ti"]) / (kp / ti) for each, kp, ti in
                zip(found, TABLE_III["Kp"], TABLE_III["Ti"], strict=True)]  # fmt: skip
    near = {
        key: [round(each[key] / paper - 1.0, 3) for each, paper in zip(found, TABLE_III[key], strict=True)]
        for key in ("Kp", "Ti")
    }
    tuning = {
        "command": f"hydro-env tune --linear --plant {plant} --max-sensitivity {max_sensitivity:g}",
        "method": "linearised plant, Ti cancels the slowest pole, Kp as large as the largest sensitivity allows",
        "plant": str(plant),
        "max_sensitivity": max_sensitivity,
        "table_iii": {key: list(value) for key, value in TABLE_III.items()},
        "relative_to_table_iii": near | {"Kp/Ti": [round(each - 1.0, 3) for each in integral]},
    }
    Path(out).mkdir(parents=True, exist_ok=True)
    file = GainsFile(name=name or "pid_linear", controller="pid", gains=gains, units=UNITS, tuning=tuning)
    write_gains(Path(out) / "gains.json", file)
    return {"controller": "pid", "gains": gains, "units": UNITS, "tuning": tuning}


def summary(found: dict[str, Any]) -> str:
    """What a run says: the gains beside those of Table III."""
    lines = [
        f"largest sensitivity {found['tuning']['max_sensitivity']:g}; Table III in brackets, difference to it"
    ]
    for channel in (0, 1):
        parts = []
        for key in ("Kp", "Ti"):
            paper, off = TABLE_III[key][channel], found["tuning"]["relative_to_table_iii"][key][channel]
            parts.append(
                f"{key} {found['gains'][key][channel]:.4g} {UNITS[key]} ({paper:g}) {100 * off:+.0f} %"
            )
        parts.append(f"Td 0 s ({TABLE_III['Td'][channel]:g})")
        parts.append(f"Kp/Ti {100 * found['tuning']['relative_to_table_iii']['Kp/Ti'][channel]:+.0f} %")
        lines.append(f"valve {channel + 1}: " + ", ".join(parts))
    return "\n".join(lines)
