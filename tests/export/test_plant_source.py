"""The rig in C: what the kernel computes for one rig, to the last bit."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest

from hydro_env.export.fmu.build import FLAGS, build_library, find_compiler
from hydro_env.export.plant_source import PlantSource, plant_source
from hydro_env.plant import Plant, PlantModel, load_model

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

#: A face that needs no layout of the structure.
FACE = """
__attribute__((visibility("default"))) plant rig;
#define SEEN __attribute__((visibility("default")))
SEEN void start(void) { plant_start(&rig); }
SEEN void rest(void) { plant_rest(&rig); }
SEEN int set(unsigned place, double value) { return plant_set(&rig, place, value); }
SEEN void refresh(void) { plant_observe(&rig); }
SEEN int step(const double *given, double period) {
    rig.command[0] = given[0], rig.command[1] = given[1], rig.load[0] = given[2], rig.load[1] = given[3];
    return plant_step(&rig, period);
}
SEEN const double *cells(void) { return rig.memory; }
SEEN unsigned long size(void) { return sizeof(plant); }
"""


class InC:
    """A rig in C."""

    def __init__(self, model: PlantModel, folder: Path) -> None:
        self.source: PlantSource = plant_source(model, "0")
        (folder / "plant.h").write_text(self.source.header)
        (folder / "plant.c").write_text(self.source.body + FACE)
        compiler = find_compiler()
        assert compiler is not None
        build_library(
            compiler, [folder / "plant.c"], folder / "plant.so", [*FLAGS, "-Wall", "-Wextra", "-Werror"]
        )
        self.code = ctypes.CDLL(str(folder / "plant.so"))
        self.code.cells.restype = ctypes.POINTER(ctypes.c_double)
        self.code.step.argtypes = (ctypes.c_void_p, ctypes.c_double)
        self.code.set.argtypes = (ctypes.c_uint, ctypes.c_double)
        self.code.start()

    def step(self, command: np.ndarray, load: np.ndarray, period: float) -> bool:
        given = np.array([*command, *load])
        return bool(self.code.step(given.ctypes.data, period))

    def set(self, name: str, value: float) -> bool:
        places = [self.source.places[name] + c for c in (0, 1)]
        return [self.code.set(place, value) for place in places] == [1, 1]

    @property
    def signals(self) -> np.ndarray:
        kept = self.code.cells()
        return np.array(
            [[kept[self.source.places[name] + c] for c in (0, 1)] for name in self.source.outputs]
        )


def of_plant(plant: Plant, source: PlantSource) -> np.ndarray:
    return np.array([plant.get(name)[0] for name in source.outputs])


MODELS = {
    "paper": load_model("paper"),
    "rig": load_model("rig"),
    "servo": load_model("servo"),
    "delayed": load_model("rig")
    .with_values({"command_delay.delay": (0.0042, 0.013)}, name="delayed")
    .without("supply_droop"),
    "coupled": load_model("rig").with_values(
        {"supply_droop.relative_drop": 0.2, "command_delay.delay": (0.03, 0.0172)}, name="coupled"
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_equals_the_kernel_at_periods_of_all_kinds(name: str, tmp_path: Path) -> None:
    model, random = MODELS[name], np.random.default_rng(3)
    rig, plant = InC(model, tmp_path), Plant(model)
    limit = 1.2 * model.value("u_rated", 0)
    command = np.zeros(2)
    for n in range(150):
        command = random.uniform(-limit, limit, 2) if n % 3 == 0 else command
        load = random.uniform(-1.0, 1.0, 2) * (n % 2)
        period = (0.01, 1e-3, 0.0037, 4e-4, 0.05)[n // 30]
        period = period if n % 7 else 10.0 ** random.uniform(-4, -1.5)
        plant.step(command, load, period)
        assert rig.step(command, load, period)
        assert np.array_equal(rig.signals, of_plant(plant, rig.source)), n
    assert not plant.diverged.any() and np.ptp(rig.signals) > 0.0


def test_parameters_rest_and_divergence(tmp_path: Path) -> None:
    """A delay that is made longer brings back older commands; a channel that is lost is marked, and only until it rests."""
    model = MODELS["delayed"]
    rig, plant = InC(model, tmp_path), Plant(model)
    for n in range(40):
        command = np.array([20.0, -15.0]) * (-1) ** (n // 3)
        if n == 20:
            assert rig.set("command_delay.delay", 0.05) and not rig.set("command_delay.delay", 0.051)
            plant.set("command_delay.delay", 0.05)
        rig.step(command, np.zeros(2), 0.003)
        plant.step(command, 0.0, 0.003)
    assert np.array_equal(rig.signals, of_plant(plant, rig.source))
    for period in (0.0, -1.0, np.inf, np.nan):
        assert not rig.step(command, np.zeros(2), period)
    assert np.array_equal(rig.signals, of_plant(plant, rig.source))
    load = np.array([1e12, 0.0])
    rig.step(command, load, 0.01)
    plant.step(command, load, 0.01)
    assert (plant.get("diverged")[0] > 0.0).tolist() == [True, False]
    assert np.array_equal(rig.signals, of_plant(plant, rig.source))
    rig.code.rest()
    assert not rig.signals.any()


def test_a_delay_at_the_shortest_steps(tmp_path: Path) -> None:
    """Where the line is full, a command that stays as it was takes one place however long it is held; more are refused."""
    model = load_model("paper_dead_zone").with_values({"command_delay.delay": (0.0082, 0.05)})
    rig, plant, zero = InC(model, tmp_path), Plant(model), np.zeros(2)
    for period, same in ((1.1e-4, True), (2e-5, False)):
        for n in range(4000):
            given = np.array([60.0, -50.0]) if n // 700 % 2 else zero
            assert rig.step(given, zero, period)
            plant.step(given, 0.0, period)
        ours, theirs = rig.signals, of_plant(plant, rig.source)
        assert np.array_equal(ours, theirs) or (not same and np.allclose(ours, theirs, rtol=1e-4, atol=1e-6))
        assert abs(plant.speed).min() > 1.0
    taken = [rig.step(np.array([n * 1e-3, 0.0]), zero, period) for n in range(600)]
    assert taken == sorted(taken, reverse=True) and 480 < sum(taken) <= 500
    before = rig.signals
    assert not rig.step(zero, zero, period) and np.array_equal(rig.signals, before)
    for _ in range(2500):  # the last one may go on
        assert rig.step(np.array([(sum(taken) - 1) * 1e-3, 0.0]), zero, period)
    assert rig.step(zero, zero, period)
