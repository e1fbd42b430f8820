"""The rig as an FMU: valid, and the same as the kernel to the last bits."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.errors import InputError
from hydro_env.export.fmu.build import export_fmu, find_compiler
from hydro_env.export.fmu.description import base_unit
from hydro_env.plant import PARAMETERS, Plant, load_model
from hydro_env.plant.catalogue import CATALOGUE

fmpy = pytest.importorskip("fmpy")

PERIOD, SIGNALS = 0.01, ("speed", "current", "spool", "pressure", "flow", "measured_speed", "angle")
LATE = "schema: hydro_env/model/1\nname: late\neffects:\n  command_delay:\n    both: {delay: 0.004}\n"
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def commands(rows: int, volts: float) -> np.ndarray:
    """Steps, reversals and a rest, (rows, 2)."""
    random = np.random.default_rng(5)
    return np.repeat(random.uniform(-volts, volts, (rows // 20, 2)), 20, axis=0)


class Unit:
    """An FMU of either version behind one face."""

    def __init__(self, path: Path) -> None:
        self.description = fmpy.read_model_description(str(path))
        folder = fmpy.extract(str(path))
        self.unit: Any = fmpy.instantiate_fmu(folder, self.description)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        old = self.description.fmiVersion == "2.0"
        if old:
            self.unit.setupExperiment(startTime=0.0)
        self.get_numbers = self.unit.getReal if old else self.unit.getFloat64
        self.set_numbers = self.unit.setReal if old else self.unit.setFloat64
        self.get_state = self.unit.getFMUstate if old else self.unit.getFMUState
        self.set_state = self.unit.setFMUstate if old else self.unit.setFMUState
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def set(self, **values: float) -> None:
        names = [name.replace("__", ".") for name in values]
        self.set_numbers([self.references[name] for name in names], list(values.values()))

    def get(self, *names: str) -> np.ndarray:
        return np.array(self.get_numbers([self.references[name] for name in names]))

    def step(
        self, time: float, command: np.ndarray, load: tuple[float, float], period: float = PERIOD
    ) -> None:
        self.set(command_1=command[0], command_2=command[1], load_1=load[0], load_2=load[1])
        self.unit.doStep(time, period)

    def signals(self) -> np.ndarray:
        return self.get(*(f"{name}_{c}" for name in SIGNALS for c in (1, 2)))


def of_plant(plant: Plant) -> np.ndarray:
    return np.concatenate([plant.get(name)[0] for name in SIGNALS])


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("fmu")
    return list(export_fmu(load_model("rig"), folder).files)


def test_description_is_valid(units: list[Path]) -> None:
    from fmpy.validation import validate_fmu

    assert [validate_fmu(str(path)) for path in units] == [[], []]


def test_every_parameter_is_tunable_with_unit_and_description(units: list[Path]) -> None:
    model = load_model("rig")
    for path in units:
        found = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
        expected = {f"channel_{c}.{name}": (p, c) for name, p in PARAMETERS.items() for c in (1, 2)}
        for effect in model.declared:
            for p in CATALOGUE[effect].parameters:
                for owner, c in (
                    [("rig", 1)] if CATALOGUE[effect].scope == "rig" else [("channel_1", 1), ("channel_2", 2)]
                ):
                    expected[f"{owner}.{effect}.{p.name}"] = (p, c)
        assert {name for name, v in found.items() if v.causality == "parameter"} == set(expected)
        for name, (p, c) in expected.items():
            assert (found[name].variability, found[name].unit) == ("tunable", p.unit)
            assert p.title in found[name].description
            own = name.split(".", 1)[1]
            assert float(found[name].start) == model.value(own, c - 1)


@needs_compiler
@pytest.mark.parametrize("version", [0, 1])
def test_equals_the_kernel(units: list[Path], version: int) -> None:
    unit, plant, load = Unit(units[version]), Plant("rig"), (0.4, -0.3)
    for n, command in enumerate(commands(60, 22.8)):
        unit.step(n * PERIOD, command, load)
        plant.step(command, load, PERIOD)
        assert np.array_equal(unit.signals(), of_plant(plant))


@needs_compiler
def test_state_is_taken_and_restored(units: list[Path]) -> None:
    unit = Unit(units[1])
    rows = commands(60, 22.8)
    for n in range(30):
        unit.step(n * PERIOD, rows[n], (0.0, 0.0))
    middle = unit.get_state()
    ends = []
    for _ in range(2):
        for n in range(30, 40):
            unit.step(n * PERIOD, rows[n], (0.0, 0.0))
        ends.append(unit.signals())
        unit.set_state(middle)
    assert np.array_equal(*ends)


@needs_compiler
def test_parameters_can_be_tuned(units: list[Path]) -> None:
    """A value set in the unit does what the same value does in the plant, also for one that both channels share."""
    unit, plant = Unit(units[0]), Plant("rig")
    unit.set(channel_2__Kq=0.2, rig__supply_droop__relative_drop=0.4)
    plant.set("Kq", [[plant.get("Kq")[0, 0], 0.2]])
    plant.set("supply_droop.relative_drop", 0.4)
    for n, command in enumerate(commands(20, 22.8)):
        unit.step(n * PERIOD, command, (0.0, 0.0))
        plant.step(command, 0.0, PERIOD)
    assert np.array_equal(unit.signals(), of_plant(plant))


@needs_compiler
@pytest.mark.parametrize("period", [1e-3, 0.0037, 4e-5])
def test_any_communication_step(units: list[Path], period: float) -> None:
    """A step is done like a period of the plant."""
    unit, plant = Unit(units[0]), Plant("rig")
    assert unit.description.coSimulation.canHandleVariableCommunicationStepSize
    for n, command in enumerate(commands(20, 22.8)):
        unit.step(n * period, command, (0.0, 0.0), period)
        plant.step(command, 0.0, period)
    assert np.array_equal(unit.signals(), of_plant(plant))


@needs_compiler
def test_a_state_that_effects_share(tmp_path: Path) -> None:
    """That of both line pressures, of an effect in no catalogue."""
    model = load_model("paper").with_values({"case_drain.conductance": 1e-12})
    unit, plant, rng = Unit(export_fmu(model, tmp_path).files[0]), Plant(model), np.random.default_rng(2)
    for n, command in enumerate(rng.uniform(-60.0, 60.0, (20, 2))):
        unit.step(n * PERIOD, command, (0.0, 0.0))
        plant.step(command, 0.0, PERIOD)
    assert np.array_equal(unit.signals(), of_plant(plant))
    assert unit.get("lines.mean_pressure_1").any()


@needs_compiler
def test_a_delayed_command(tmp_path: Path) -> None:
    (tmp_path / "late.yaml").write_text(LATE)
    path = export_fmu(load_model(tmp_path / "late.yaml"), tmp_path, (3,)).files[0]
    unit, plant, time = Unit(path), Plant(tmp_path / "late.yaml"), 0.0
    for n, command in enumerate(commands(60, 73.0)):
        period = (0.01, 0.0017, 0.0004)[n // 7 % 3]
        unit.step(time, command, (0.0, 0.0), period)
        plant.step(command, 0.0, period)
        time += period
    assert np.array_equal(unit.signals(), of_plant(plant))
    with pytest.raises(Exception, match="fmi3DoStep"):
        for n in range(600):
            unit.step(time, np.array([0.01 * n, 0.0]), (0.0, 0.0), 1e-6)  # more commands than the line holds
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        unit.set(channel_1__command_delay__delay=0.2)  # longer than the line
    assert unit.description.coSimulation.canHandleVariableCommunicationStepSize


@needs_compiler
@pytest.mark.parametrize("version", [0, 1])
def test_values_that_no_model_has_are_refused(units: list[Path], version: int) -> None:
    """As `PlantModel` refuses them; what was set before stays, and so do all signals."""
    unit, model = Unit(units[version]), load_model("rig")
    tried = refused = 0
    names = {v.name for v in unit.description.modelVariables if v.causality == "parameter"}
    for name in sorted(names):
        before = unit.get(name)
        for value in (np.inf, -np.inf, np.nan, 0.0, -1.0, -before[0], 1e30):
            try:
                model.with_values({name.split(".", 1)[1]: value})
                continue
            except InputError as problem:
                if "out of range" not in str(problem) and "not a number" not in str(problem):
                    continue  # what only the values together make impossible
            tried += 1
            with pytest.raises(fmpy.fmi1.FMICallException):
                unit.set(**{name.replace(".", "__"): value})
            refused += np.array_equal(unit.get(name), before)
    assert tried == refused > 2 * len(names)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.set(command_1=np.inf)
    unit.step(0.0, np.array([10.0, 10.0]), (0.0, 0.0))
    assert np.isfinite(unit.signals()).all()


@needs_compiler
@pytest.mark.parametrize("model", ["paper", "rig", "late"])
def test_the_source_compiles_without_a_warning(tmp_path: Path, model: str) -> None:
    (tmp_path / "late.yaml").write_text(LATE)
    for path in export_fmu(load_model(tmp_path / "late.yaml" if model == "late" else model), tmp_path).files:
        folder, compiler = fmpy.extract(str(path)), find_compiler()
        assert compiler is not None
        for source in sorted(Path(folder, "sources").glob("*.c")):
            command = [
                *compiler,
                "-std=c99",
                "-O2",
                "-Wall",
                "-Wextra",
                "-c",
                str(source),
                "-o",
                str(tmp_path / "o"),
            ]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0 and not done.stderr, done.stderr[:2000]


def test_names_in_any_writing(tmp_path: Path) -> None:
    """An identifier of C is made of what the user calls the rig; the name itself stays."""
    model = load_model("paper").with_values({}, name="Prüfstand 2 – links")
    for path in export_fmu(model, tmp_path).files:
        description = fmpy.read_model_description(str(path))
        assert description.coSimulation.modelIdentifier == "hydro_env_Prufstand_2_links"
        assert description.modelName == model.name


def test_source_needs_only_math(units: list[Path]) -> None:
    """The plant's own source compiles anywhere: no header but math.h and its own."""
    with zipfile.ZipFile(units[1]) as archive:
        text = archive.read("sources/plant.c").decode()
        listed = xml.fromstring(archive.read("sources/buildDescription.xml"))
        assert {f.get("name") for f in listed.iter("SourceFile")} <= {
            name.removeprefix("sources/") for name in archive.namelist()
        }
    assert {line for line in text.splitlines() if line.startswith("#include")} == {
        '#include "plant.h"', "#include <math.h>",
    }  # fmt: skip


def test_without_a_compiler_the_source_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    made = export_fmu(load_model("paper"), tmp_path, (2,))
    assert "no C compiler" in made.note
    with zipfile.ZipFile(made.files[0]) as archive:
        names = archive.namelist()
    assert "sources/plant.c" in names and not [name for name in names if name.startswith("binaries/")]


@pytest.mark.parametrize(
    ("arguments", "environment", "says"),
    [
        (["--model", "nothing"], {}, "unknown plant 'nothing'"),
        (["--model", "paper", "--fmi", "1"], {}, "2, 3 or both"),
        (["--model", "paper"], {"CC": "no-such-compiler"}, "no-such-compiler"),
        (["--model", "paper"], {"CC": "false"}, "does not compile"),
    ],
)
def test_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str],
    environment: dict[str, str], says: str,
) -> None:  # fmt: skip
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit) as ended:
        main(["export", "fmu", *arguments, "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and says in said
    assert not (tmp_path / "out").exists()


def test_units_of_the_catalogue() -> None:
    assert base_unit("m3/(s Pa2)") == ({"m": 5, "s": 3, "kg": -2}, 1.0)
    assert base_unit("1/MPa") == ({"kg": -1, "m": 1, "s": 2}, 1e-6)
    for p in [*PARAMETERS.values(), *(p for e in CATALOGUE.values() for p in e.parameters)]:
        base_unit(p.unit)
