"""A foreign FMU as the plant of the benchmark."""

from __future__ import annotations

import copy
import json
import pickle
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.controllers.registry import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.envs.hydraulic_sync import HydraulicSyncEnv
from hydro_env.envs.privileged import privileged_names
from hydro_env.errors import InputError
from hydro_env.export.fmu.build import export_fmu, find_compiler
from hydro_env.fmu_plant import load_fmu
from hydro_env.plant import PAPER, load_model, scales_of

pytest.importorskip("fmpy")
pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

MAPPING = """\
schema: hydro_env/fmu_mapping/1
rated: 73
start: {channel_2.Kq: 0.3}
channel_1:
  command: {variable: valve.one}
  speed: {variable: motor.one, unit: rpm, sign: -1}
  pressure: pressure_1
  load: load_1
channel_2:
  command: {variable: command_2}
  speed: {variable: speed_2}
  load: load_2
"""


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return list(export_fmu(load_model("paper_dead_zone"), tmp_path_factory.mktemp("fmu")).files)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Whose rated command is not that of the paper's valves."""
    return export_fmu(load_model("rig"), tmp_path_factory.mktemp("rig"), (3,)).files[0]


def renamed(unit: Path, to: Path, *own: bytes) -> Path:
    """The same FMU with other names and speeds in rpm, and so somebody else's."""
    others = [(b'"command_1"', b'"valve.one"'), (b'"speed_1"', b'"motor.one"'), (b'"rad/s"', b'"rpm"')]
    changes = [own] if own else others
    with zipfile.ZipFile(unit) as old, zipfile.ZipFile(to, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                for old_name, new_name in changes:
                    data = data.replace(old_name, new_name)
            new.writestr(name, data)
    return to


@pytest.mark.parametrize("preset", ["paper_dead_zone", "rig"])
def test_driven_like_the_rig_that_it_is(units: list[Path], rig: Path, preset: str) -> None:
    """The whole roll-out is the same bit for bit, of two cases at once, with loads, where the FMU ends no step of its own at a
    point of the grid of the peak."""
    drive = {"duration": 0.4, "setpoint_rpm": [[0.0, 300.0], [0.2, -200.0]], "load_Nm": [[0.1, 0.5, 0.1]]}
    traces = []
    for plant in (preset, load_fmu(rig if preset == "rig" else units[0], trust=True)):
        controller = make_controller("cross_coupled")
        done = roll_out(controller, [4, 5], plant=plant, mismatch="own", scenario=drive, control_period=1e-3)
        traces.append(
            (done.trace.speed_rpm, done.trace.command, done.trace.peak_difference_rpm, done.returns)
        )
    for ours, theirs in zip(*traces, strict=True):
        assert np.array_equal(ours, theirs)


def test_the_peak_between_the_ends_of_periods(units: list[Path]) -> None:
    envs = [
        HydraulicSyncVectorEnv(1, plant, "setpoint_steps", None, noise=0.0, privileged=True)
        for plant in ("paper_dead_zone", load_fmu(units[0], trust=True))
    ]
    names = [privileged_names(env) for env in envs]
    assert {*names[0]} - {*names[1]} == {"spool_1", "spool_2"}
    shown = [names[0].index(name) for name in names[1]]
    for env in envs:
        env.reset(seed=0)
    beyond = []
    for n in range(30):
        command = np.full((1, 2), 0.5 * np.cos(0.5 * n))
        ours, theirs = (env.step(command)[4] for env in envs)
        assert theirs["peak_difference_rpm"] == pytest.approx(ours["peak_difference_rpm"], abs=0.2)
        np.testing.assert_allclose(theirs["privileged"], ours["privileged"][:, shown], atol=1e-3)
        beyond.append(ours["peak_difference_rpm"] - np.abs(ours["speed_difference_rpm"]))
    assert np.max(beyond) > 1.0


def test_a_mapping_has_names_units_signs_and_start_values(units: list[Path], tmp_path: Path) -> None:
    unit = renamed(units[0], tmp_path / "theirs.fmu")
    (tmp_path / "mapping.yaml").write_text(MAPPING)
    rigs = load_fmu(unit, tmp_path / "mapping.yaml", trust=True).make_plant(1)
    plain = load_fmu(units[0], trust=True).make_plant(1)
    speeds = [0.0]
    for each in (plain, rigs):
        each.reset()
        for _ in range(500):
            each.hold(np.array([[30.0, 40.0]]), np.array([[0.2, 0.1]]), 1e-3)
            speeds.append(each.get("speed")[0, 1])
    rpm = 2.0 * np.pi / 60.0
    assert rigs.get("speed")[0, 0] == pytest.approx(-rpm * plain.get("speed")[0, 0], rel=1e-12)
    assert rigs.get("pressure")[0].tolist() == [plain.get("pressure")[0, 0], 0.0]
    assert (
        0.9 < rigs.get("speed")[0, 1] / (rpm * plain.get("speed")[0, 1]) < 0.98
    )  # a smaller gain on channel 2: 0.3 against 0.315; in the unit that the FMU states
    assert rigs.get("angle")[0, 1] == pytest.approx(
        np.trapezoid([0.0, *speeds[501:]], dx=1e-3)
    )  # no angle is mapped


def test_the_rated_command(units: list[Path], rig: Path, tmp_path: Path) -> None:
    """The FMU's own, unless the mapping has another; without either there is none."""
    assert load_fmu(rig, trust=True).value("u_rated", 1) == 22.8
    mapping = tmp_path / "mapping.yaml"
    plain = MAPPING.replace("valve.one", "command_1").replace("motor.one, unit: rpm", "speed_1")
    for change, rated in (("rated: 12", 12.0), ("", 22.8), ("start: {channel_1.u_rated: 15}", 15.0)):
        mapping.write_text(plain.replace("rated: 73\nstart: {channel_2.Kq: 0.3}", change))
        assert load_fmu(rig, mapping, trust=True).value("u_rated", 0) == rated
    mapping.write_text(plain.replace("rated: 73", "rated: -73"))
    with pytest.raises(InputError, match=r"mapping\.yaml: rated is -73, should be greater than 0"):
        load_fmu(rig, mapping, trust=True)
    theirs = renamed(units[0], tmp_path / "theirs.fmu", b".u_rated", b".something")
    mapping.write_text(plain.replace("rated: 73\n", ""))
    with pytest.raises(InputError, match="rated is missing"):
        load_fmu(theirs, mapping, trust=True)


def test_how_large_it_is(units: list[Path], rig: Path, tmp_path: Path) -> None:
    """By the values of a rig of our own, by the model that a mapping names, or else as the paper's."""
    ours = load_model("rig")
    large = ours.with_values({"D": 6.0 * ours.value("D", 0), "Kq": 12.0 * ours.value("Kq", 0)})
    large.to_yaml(tmp_path / "large.yaml", source="this test")
    theirs = renamed(units[0], tmp_path / "theirs.fmu", b'"channel_1.', b'"motor.'), tmp_path / "mapping.yaml"
    plain = MAPPING.replace("valve.one", "command_1").replace("motor.one, unit: rpm", "speed_1")
    for model, expected in (("", PAPER), ("model: large.yaml", scales_of(large))):
        theirs[1].write_text(plain.replace("start: {channel_2.Kq: 0.3}", model))
        found = load_fmu(theirs[0], theirs[1], trust=True)
        assert replace(scales_of(found), command=1.0) == replace(expected, command=1.0)
    assert scales_of(load_fmu(rig, trust=True)) == scales_of(load_model("rig"))
    assert scales_of(large).speed > 1.5


def test_what_an_fmu_cannot_do_is_refused(units: list[Path]) -> None:
    model = load_fmu(units[0], trust=True)
    rigs = model.make_plant(2)
    for copied in (
        rigs.copy,
        lambda: copy.copy(rigs),
        lambda: copy.deepcopy(rigs),
        lambda: pickle.dumps(rigs),
    ):
        with pytest.raises(InputError, match="cannot be put on the valve bench or copied"):
            copied()
    with pytest.raises(InputError, match="is simulated by its own code; leave it out"):
        HydraulicSyncEnv(model, mismatch="own", tolerance_rpm=0.5)
    with pytest.raises(InputError, match="float32 is not possible"):
        roll_out(make_controller("pid_tuned"), [1], plant=model, mismatch="own", dtype="float32")


def test_the_command(units: list[Path], tmp_path: Path) -> None:
    arguments = [
        "benchmark",
        "pid_tuned",
        "bench_flow",
        "--suite",
        "quick",
        "--scenario",
        "setpoint_steps",
        "--cases",
        "1",
    ]
    with pytest.raises(SystemExit) as ended:
        main([*arguments, "--plant", str(units[1]), "--trust", "--out", str(tmp_path / "scores")])
    assert ended.value.code == 0
    text = (tmp_path / "scores" / "scores.json").read_text()
    assert '"split": "own"' in text and json.loads(text)["dtype"] == "float64"
    assert "cannot be put on the valve bench" in text  # bench_flow


@pytest.mark.parametrize(
    ("mapping", "says"),
    [
        (MAPPING.replace("valve.one", "valve.two"), "has no variable 'valve.two'"),
        (MAPPING.replace("{variable: valve.one}", "{variable: motor.one}"), "expected an input"),
        (MAPPING.replace("unit: rpm", "unit: bar"), "is no unit of angular speed"),
        (MAPPING.replace("unit: rpm", "unit: rad/s"), "channel_1.speed: unit rad/s: the FMU states rpm"),
        (
            MAPPING.replace("speed: {variable: speed_2}", "current: current_2"),
            "speed of channel 2 is missing",
        ),
        (MAPPING.replace("rated: 73", "rated: much"), "rated is 'much'"),
        (MAPPING.replace("sign:", "sing:"), "unknown key 'sing'"),
        (MAPPING.replace("start: {channel_2.Kq", "start: {channel_3.Kq"), "has no variable 'channel_3.Kq'"),
        ("model: other.yaml\n" + MAPPING, "other.yaml"),
        ("- 1\n", "expected a table"),
    ],
)
def test_bad_mapping(units: list[Path], tmp_path: Path, mapping: str, says: str) -> None:
    unit = renamed(units[0], tmp_path / "theirs.fmu")
    (tmp_path / "mapping.yaml").write_text(mapping)
    with pytest.raises(InputError, match=says):
        load_fmu(unit, tmp_path / "mapping.yaml", trust=True)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--plant", "there.fmu"], "runs code from the file; with --trust"),
        (["--plant", "gone.fmu", "--trust"], "no such file; expected an FMU"),
        (["--plant", "text.fmu", "--trust"], "no FMU that FMPy can read"),
        (["--plant", "there.fmu", "--trust", "--split", "train"], "only own is right"),
        (["--plant", "paper", "--mapping", "mapping.yaml"], "goes with an FMU"),
    ],
)
def test_bad_input(
    units: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    arguments: list[str], says: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    shutil.copy(units[0], "there.fmu")
    Path("text.fmu").write_text("no archive")
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "pid_tuned", "--suite", "quick", "--cases", "1", *arguments, "--out", "out"])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and says in said
    assert not Path("out").exists()
