"""Whole rigs: they move like rigs of their own size, and at another pace like themselves."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_env.envs import HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.plant import PlantModel, load_model, parameter_of, simulate
from hydro_env.plant.scales import rated
from hydro_env.tasks import SPLITS, draw_pairs, load_mismatch
from hydro_env.tasks.rigs import QUANTITIES, paced, rig_values
from hydro_env.units import BAR, REVOLUTION, RPM

PAPER = load_model("paper")
COMMAND = np.repeat([0.3, -0.2, 0.5, 0.1], 20)[:, None] * np.array([1.0, 0.8])
ORBITAL = {
    "size": 160.0, "supply": 180.0, "speed": 0.8, "leakage": 0.06, "drag": 0.04, "load": 4.0, "modulus": 9e8, "line": 8.0,
    "coil": 4e-3, "frequency": 25.0, "damping": 0.6, "bristle": 2e-3, "bristle_damping": 0.8,
}  # fmt: skip


def speeds(values: dict[str, object], period: float = 0.01) -> np.ndarray:
    model = PAPER.with_values(values)
    return simulate(model, COMMAND * model.pair("u_rated"), None, period, record=["speed"])["speed"][:, 0]


def as_drawn() -> dict[str, np.ndarray]:
    quantities = {name: np.full((1, 2), value) for name, value in ORBITAL.items()}
    return {name: value[0] for name, value in rig_values(quantities, np.full((1, 2), 0.3), PAPER).items()}


def test_a_rig_turns_as_in_its_own_units() -> None:
    own = rated(PAPER, 0)
    size, supply, speed = 160e-6 / REVOLUTION, 180 * BAR, 5000.0 * 80.0**-0.6 * 0.8 * RPM
    flow, drawn = size * speed, as_drawn()
    common = {"Fs": 0.3, "Fc": 0.2, "vs": 1e-3} | {n: drawn[n] for n in ("L", "m", "C", "s0", "s1")}
    real = {
        "D": size, "J": (160 / 500) ** (5 / 3) * 4.0, "B": 0.04 * size * supply / speed, "Km": 0.06 * flow / supply,
        "V": 8.0 * 160e-6, "beta": 9e8, "Kq": flow / own["travel"], "pressure_dependent_flow.supply_pressure": supply,
    }  # fmt: skip
    alike = {n: drawn[n] for n in ("J", "B", "Km", "V")} | {
        "Kq": own["flow"] / own["travel"], "pressure_dependent_flow.supply_pressure": own["pressure"]
    }  # fmt: skip
    found, expected = speeds({**common, **alike}), speeds({**common, **real})
    scale = own["flow"] / own["displacement"] / speed
    assert np.abs(expected).max() > 0.1 * speed
    assert np.abs(found - scale * expected).max() < 0.5 * RPM


@pytest.mark.parametrize("pace", [0.5, 2.0])
def test_at_another_pace_a_rig_turns_alike_in_its_own_periods(pace: float) -> None:
    values = {
        "sensor_lag.time_constant": 0.01, "supply_droop.relative_drop": 0.2, "coil_heating.rise": 0.2,
        "coil_heating.time_constant": 5.0, "pressure_dependent_flow.supply_pressure": 1e7,
        "R": 1e4, "u_rated": 7.3e3, "L": 10.0, "C": 40.0,  # hardly any back-EMF
    }  # fmt: skip
    model = PAPER.with_values(values)
    changed = paced(np.full((1, 2), pace), {}, model)
    other = {name: value[0] for name, value in changed.items()}
    assert np.abs(speeds(values | other, 0.01 * pace) - speeds(values)).max() < 0.2 * RPM
    assert np.abs(speeds(values, 0.01 * pace) - speeds(values)).max() > 5.0 * RPM


@pytest.mark.parametrize("split", ["train_any", "train_robust"])
def test_rigs_are_ones_that_the_plant_accepts(split: str) -> None:
    pairs = draw_pairs(split, 500, seed=7)
    for name, values in pairs.values.items():
        if not name.startswith("speed_sensor."):
            low, high = parameter_of(name).possible
            inside = (values >= low) & (values <= high) | (values == parameter_of(name).neutral)
            assert inside.mean() > 0.95, name
    healthy = pairs.fault.count("") / 500
    assert abs(healthy - SPLITS[split].healthy) < 0.06
    assert set(pairs.fault) == {"", *SPLITS["faulted"].faults}


def test_faults_are_relative_to_the_rig() -> None:
    """A motor that leaks leaks a multiple of what it leaks when healthy."""
    split = SPLITS["train_any"]
    pairs = draw_pairs(split, 400, seed=3)
    ratio = [pairs.values["Km"][i] for i, fault in enumerate(pairs.fault) if fault == "leaking_motor"]
    found = np.array([max(pair) / min(pair) for pair in ratio])
    assert len(found) > 5 and found.min() >= 1.99 and found.max() <= 4.01


def test_refused_where_it_means_nothing() -> None:
    with pytest.raises(InputError, match="draws whole rigs: take the plant paper_dead_zone"):
        HydraulicSyncVectorEnv(1, "rig", mismatch="train_any").reset(seed=0)
    ranges = {"parameters": {"Fs": 0.2}, "rig": {"size": 8.0}}
    with pytest.raises(InputError, match=r"mismatch: rig: supply is missing \(supply pressure, bar\)"):
        load_mismatch(ranges)
    with pytest.raises(InputError, match="rig: unknown quantity 'paec'"):
        load_mismatch({"parameters": {"Fs": 0.2}, "rig": {"paec": 1.0}})
    with pytest.raises(InputError, match="rig: pace should be above zero"):
        load_mismatch({"parameters": {"Fs": 0.2}, "rig": {"pace": 0.0}})
    with pytest.raises(InputError, match="need a range of Fs"):
        load_mismatch({"parameters": {"Fc": 0.2}, "rig": dict.fromkeys(QUANTITIES, 1.0)})


def test_plant_model_of_a_case() -> None:
    """The values of a case make a model, which is then scored or tuned for by itself."""
    values = draw_pairs("test_any", [5]).values
    model = PlantModel(
        values={n: tuple(v[0]) for n, v in values.items() if not n.startswith("speed_sensor.")}
    )
    assert model.pair("J") == tuple(values["J"][0])
