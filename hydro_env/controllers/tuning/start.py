"""Where a search for gains begins: the gains a law ships with, and what the linearised plant makes of them.

By similarity gains of the paper's rig are the same numbers on a rig of another size. What similarity does not see is how stiff a
rig is: with little leakage or a short line the loop takes a tenth of the gain. The linearised plant sees that. Gains in V/rpm and
times in s are carried over a second time with the ratio of the gain and integral time that `tune_channel` finds on both plants.
"""

from __future__ import annotations

from math import isfinite, log

import numpy as np

from hydro_env.controllers.registry import CONTROLLERS, law_of
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.controllers.tuning.linearised import tune_channel
from hydro_env.plant import load_model, scales_of


def starts(name: str, plant: str, period: float) -> list[dict[str, float]]:
    """Gains in the units of the law, for a law by its name, a plant and a control period (s); none for a law without shipped
    gains or defaults.
    """
    law, shipped = law_of(name), _shipped(name, period)
    if not shipped:
        defaults = {gain.name: gain.default for gain in law.GAINS if gain.default is not None}
        return [defaults] if len(defaults) == len(law.GAINS) and all(map(isfinite, defaults.values())) else []
    gain, time = np.divide(_linear(plant), _linear("paper"))
    ratio = {"V/rpm": gain, "s": time}
    sizes = {each.name: float(ratio.get(each.unit, 1.0)) for each in law.GAINS}
    return [shipped, {key: value * sizes[key] for key, value in shipped.items()}]


def _shipped(name: str, period: float) -> dict[str, float]:
    """The gains of the first controller that ships with this law, for the nearest control period."""
    files = [entry.file for entry in CONTROLLERS.values() if entry.file and entry.file.suffix == ".json"]
    for found in map(read_gains, files):
        if found.controller == name:
            sets = found.by_period() or {period: found.gains}
            return dict(sets[min(sets, key=lambda known: abs(log(known / period)))])
    return {}


def _linear(plant: str) -> tuple[float, float]:
    """Kp in V/rpm as on the paper's rig, and Ti in s; geometric means of both channels."""
    model = load_model(plant)
    found = [tune_channel(model, channel) for channel in (0, 1)]
    kp, ti = ((found[0][key] * found[1][key]) ** 0.5 for key in ("Kp", "Ti"))
    scales = scales_of(model)
    return kp * scales.factor("rpm") / scales.factor("V"), ti
