"""Golden trajectories of the plant, base and every effect at its typical size: `python -m tests.golden` writes them anew."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydro_env.plant import BUILT_IN, CATALOGUE, Plant

PATH = Path(__file__).parent / "golden" / "trajectories.json"
SIGNALS = ("measured_speed", "pressure")
#: What lets an effect act here although its usual shape does not: a supply that the motor's inertia can exceed.
SHAPES = {"anti_cavitation.supply_pressure": 20e5}
PERIOD, ROWS, EVERY = 0.01, 31, 5  # s; commands of 10 ms, every fifth row is kept


def typical(name: str) -> dict[str, float]:
    """An effect at its typical size, by "effect.parameter"."""
    values = {f"{name}.{p.name}": p.typical for p in CATALOGUE[name].parameters}
    return values | {key: value for key, value in SHAPES.items() if key in values}


def trajectories() -> dict[str, NDArray[np.float64]]:
    """Signals of the base plant (row 0) and each effect, in one batch: (rows kept, 1 + effects, 2)."""
    plant = Plant("paper", 1 + len(BUILT_IN), effects=BUILT_IN)
    for row, name in enumerate(BUILT_IN, 1):
        plant.set_values(typical(name), rows=[row])
    plant.reset()
    t = np.arange(ROWS) * PERIOD
    command = np.stack([np.where(t < 0.15, 50.0, -30.0), 60.0 * np.sin(20.0 * t)], axis=1)
    load = np.where(t < 0.2, 0.0, 0.5)[:, None] * np.ones(2)
    return plant.run(command, load, PERIOD, SIGNALS, EVERY)


def main() -> None:
    found = trajectories()
    rows = {
        name: {s: [[float(f"{v:.7g}") for v in pair] for pair in found[s][:, n]] for s in SIGNALS}
        for n, name in enumerate(("base", *BUILT_IN))
    }
    lines = ",\n".join(f" {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items())
    PATH.parent.mkdir(exist_ok=True)
    PATH.write_text(f'{{"rows": {{\n{lines}\n}}}}\n', encoding="utf-8")


if __name__ == "__main__":
    main()
