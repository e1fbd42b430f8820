"""Whole rigs of every size, in the units of the paper's.

Rigs whose ratios are alike turn alike: how long the supply takes to bring a motor to its rated speed, the valve's flow to bring
the oil in the line to the supply pressure, what share of the flow leaks, how fast the spool is (Ivantysyn and Ivantysynova 2001,
similarity of displacement machines; Merritt 1967, ch. 5 and 8). So a rig is drawn like a data sheet (`QUANTITIES`), and what is
simulated has its ratios with the paper's displacement, rated flow, supply pressure, rated current and travel of the spool. Its
observations are those of the rig itself, which are scaled by its size anyway; 600 rpm stand for its own largest set-point.

`pace` makes everything on the rig slower by this factor. A controller counts in its own periods: at a pace of 2 a period of 10 ms
is to it what one of 5 ms is on the rig as drawn. The little that the coil's back-EMF damps the spool stays as it is.
"""

from collections.abc import Mapping
from math import pi

import numpy as np

from ..arrays import Floats
from ..plant import CATALOGUE, PARAMETERS, PlantModel, parameter_of
from ..plant.scales import rated
from ..reading import shipped_yaml
from ..units import BAR, REVOLUTION, RPM

PACE = "pace"
#: What a rig is drawn by, and what it is.
QUANTITIES: Mapping[str, str] = shipped_yaml(__package__, "rig_quantities.yaml")
#: Parameters that follow from these.
DERIVED = ("J", "B", "Km", "V", "L", "m", "C", "s0", "s1")
#: Of quantities with these units, at the same speeds, flows and forces, the power to which they grow with the pace.
_POWERS = {"s": 1, "kg m2": 1, "m3": 1, "H": 1, "N s/m": 1, "kg": 2, "m/s": -1}


def rig_values(drawn: Mapping[str, Floats], Fs: Floats, model: PlantModel) -> dict[str, Floats]:
    """The parameters `DERIVED` (n, 2) of rigs with these quantities (n, 2) and static friction of the spool (n, 2), in the units
    of a model of the paper's size."""
    q, own = drawn, rated(model, 0)
    D, rate = own["displacement"], own["flow"] / own["displacement"]
    size = 1e-6 * q["size"] / REVOLUTION
    speed = np.clip(5000.0 * (q["size"] / 2.0) ** -0.6 * q["speed"], 100.0, 5000.0) * RPM
    inertia = (q["size"] / 500.0) ** (5.0 / 3.0) * q["load"]  # kg m2; 1 of a motor of 500 cm3/rev
    starts = inertia * speed / (size * q["supply"] * BAR)  # s to the rated speed
    # Seconds of rated flow to the supply pressure.
    fills = q["line"] * REVOLUTION * q["supply"] * BAR / (q["modulus"] * speed)
    travel, k, beta = own["travel"], model.value("k", 0), model.value("beta", 0)
    m = k / (2.0 * pi * q["frequency"]) ** 2
    s0 = Fs / (q["bristle"] * travel)
    found = {
        "J": starts * D * own["pressure"] / rate,
        "B": q["drag"] * D * own["pressure"] / rate,
        "Km": q["leakage"] * own["flow"] / own["pressure"],
        "V": fills * beta * own["flow"] / own["pressure"],
        "L": q["coil"] * model.value("R", 0),
        "m": m,
        "C": 2.0 * q["damping"] * np.sqrt(k * m),
        "s0": s0,
        "s1": 2.0 * q["bristle_damping"] * np.sqrt(s0 * m),
    }
    return {name: np.broadcast_to(value, Fs.shape).copy() for name, value in found.items()}


def power_of_pace(name: str) -> int:
    """The power to which a parameter grows with the pace. A delay of the command is one of the controller, not of the rig."""
    of_rig = name != "command_delay.delay" and not name.startswith("speed_sensor.")
    return _POWERS.get(parameter_of(name).unit, 0) if of_rig else 0


def paced(pace: Floats, values: Mapping[str, Floats], model: PlantModel) -> dict[str, Floats]:
    """What changes at a pace (n, 2): of parameters (n, 2), and of those of the model and its effects that are not among them."""
    effects = {name.partition(".")[0] for name in (*values, *model.values)} & CATALOGUE.keys()
    of_effects = [f"{effect}.{p.name}" for effect in effects for p in CATALOGUE[effect].parameters]
    found = {}
    for name in (*PARAMETERS, *sorted(of_effects)):
        if power := power_of_pace(name):
            found[name] = values.get(name, np.tile(model.pair(name), (len(pace), 1))) * pace**power
    return found
