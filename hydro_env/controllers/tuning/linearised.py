"""PID gains from the linearised plant, as a PID tuner finds them: `hydro-env tune --linear`.

Linearised are the base equations of one channel: coil, spool, oil and motor, five states. The spool slides (its
friction is constant then and drops out), the valve is open; effects, among them the dead zone, are not seen. That is
the plant that a tuner in a simulation program is shown.

The rule is the usual one for a plant with one slow pole: Ti cancels that pole, and Kp is as large as the largest
sensitivity Ms allows, max |1 / (1 + L(jw))|, the inverse of the least distance of the open loop L to -1. No derivative:
it would only raise the spool's mode. One number is left to choose, Ms. 1.2 to 2.0 are usual (Astrom and Hagglund); the
paper does not say what was chosen, and `MS` is the round number that comes nearest to its Table III.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hydro_env.controllers.base import RPM, Floats
from hydro_env.controllers.classical.pid import TABLE_III
from hydro_env.controllers.linear_channel import linear_rates
from hydro_env.controllers.tuning.gains import GainsFile, write_gains
from hydro_env.limits import Limits
from hydro_env.plant import PlantModel, load_model

MS, MAX_SENSITIVITY = 1.3, Limits(1.05, 4.0)
UNITS = {"Kp": "V/rpm", "Ti": "s", "Td": "s"}


def linear_plant(model: PlantModel, channel: int) -> tuple[Floats, Floats, Floats]:
    """State matrix (5, 5), input (5,) and output (5,) from volts to rpm of a channel (0 or 1).

    States: current, spool travel and speed, pressure, motor speed, in SI units.
    """
    a = linear_rates(lambda name: np.array(model.value(name, channel), float))
    b, c = np.zeros(5), np.zeros(5)
    b[0], c[4] = 1.0 / model.value("L", channel), 1.0 / RPM
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
    around = np.outer(poles, np.linspace(0.9, 1.1, 101))
    s = 1j * np.concatenate([np.geomspace(1e-2, 1e4, 400), around.ravel()])
    speed = np.linalg.solve(s[:, None, None] * np.eye(5) - a, b[None, :, None])[..., 0] @ c
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
) -> GainsFile:
    """Tunes a PI on each channel of a plant and writes `out/gains.json`, with how near it comes to Table III.

    Returns what gains.json says. InputError for a plant that is none, or an Ms beyond its limits.
    """
    MAX_SENSITIVITY.check(max_sensitivity, "--max-sensitivity")
    model = load_model(plant)
    found = [tune_channel(model, channel, max_sensitivity) for channel in (0, 1)]
    gains = {key: [each[key] for each in found] for key in UNITS}
    ours, paper = _with_integral(gains), _with_integral(TABLE_III)
    near = {key: (ours[key] / paper[key] - 1.0).round(3).tolist() for key in ours}
    tuning = {
        "command": f"hydro-env tune --linear --plant {plant} --max-sensitivity {max_sensitivity:g}",
        "method": "linearised plant, Ti cancels the slowest pole, Kp as large as the largest sensitivity allows",
        "plant": str(plant),
        "max_sensitivity": max_sensitivity,
        "table_iii": {key: list(value) for key, value in TABLE_III.items()},
        "relative_to_table_iii": near,
    }
    file = GainsFile(name=name or "pid_linear", controller="pid", gains=gains, units=UNITS, tuning=tuning)
    return write_gains(Path(out) / "gains.json", file)


def _with_integral(gains: Mapping[str, Sequence[float]]) -> dict[str, Floats]:
    """Kp, Ti and the gain of the integral, Kp/Ti, of both channels."""
    kp, ti = np.array(gains["Kp"]), np.array(gains["Ti"])
    return {"Kp": kp, "Ti": ti, "Kp/Ti": kp / ti}


def summary(found: GainsFile) -> str:
    """What a run says: the gains beside those of Table III."""
    tuning, off = found.tuning, found.tuning["relative_to_table_iii"]
    lines = [f"largest sensitivity {tuning['max_sensitivity']:g}; Table III in brackets, difference to it"]
    for c in (0, 1):
        parts = [
            f"{key} {found.gains[key][c]:.4g} {UNITS[key]} ({TABLE_III[key][c]:g}) {100 * off[key][c]:+.0f} %"
            for key in ("Kp", "Ti")
        ]
        parts += [f"Td 0 s ({TABLE_III['Td'][c]:g})", f"Kp/Ti {100 * off['Kp/Ti'][c]:+.0f} %"]
        lines.append(f"valve {c + 1}: " + ", ".join(parts))
    return "\n".join(lines)
