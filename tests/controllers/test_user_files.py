"""Controllers of the user's own: from files, with gains, tuned, from Stable-Baselines3, and what they are told."""

from __future__ import annotations

import json
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from hydro_env import cli
from hydro_env.controllers.registry import make_controller, split_gains
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError, InputWarning

MINE = """import numpy as np
from hydro_env.controllers.base import Controller, Gain


class Mine(Controller):
    GAINS = (Gain("Kp", "s/rad", 0.001, 0.1, default=0.02),)

    def command(self, measured):
        return self.gains["Kp"] * (measured.setpoint[:, None] - measured.speed)


class Volts:
    def reset(self, num_rigs, control_period):
        pass

    def act(self, observation):
        return 30.0 * np.sign(observation[:, :1] - observation[:, 1:3])


class Broken(Mine):
    def command(self, measured):
        return helper(measured)


def helper(measured):
    return measured.no_such_signal


class NotOne:
    pass
"""
LINE = MINE.splitlines().index("    return measured.no_such_signal") + 1
QUICK = ["--suite", "quick", "--scenario", "setpoint_steps", "--cases", "2"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scored(*words: str) -> dict:
    assert cli.run(["benchmark", *words, *QUICK, "--out", "out"]) == 0
    return json.loads(Path("out/scores.json").read_text())


def test_gains_stand_behind_any_name() -> None:
    assert split_gains("a/mine.py:Mine:Kp=0.2,Ki=1") == ("a/mine.py:Mine", {"Kp": 0.2, "Ki": 1.0})
    assert split_gains("mine.py:Mine") == ("mine.py:Mine", {})
    with pytest.raises(InputError, match="GAIN=NUMBER"):
        split_gains("mine.py:Mine:Kp=fast")


@pytest.mark.usefixtures("folder")
def test_gains_of_an_own_controller_are_changed() -> None:
    got = scored("mine.py:Mine:Kp=0.05", "mine.py:Mine")
    assert got["controllers"] == ["Mine:Kp=0.05", "Mine"]
    first, second = (
        [r["iqm"] for r in got["rows"] if r["controller"] == name] for name in got["controllers"]
    )
    assert first != second
    with pytest.raises(InputError, match="did you mean 'Kp'"):
        make_controller("mine.py:Mine:Kq=0.05")


@pytest.mark.usefixtures("folder")
def test_a_file_stands_for_all_controllers_in_it_and_volts_are_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    got = scored("mine.py")
    assert got["controllers"] == ["Mine", "Volts", "Broken"]
    assert [note["controller"] for note in got["notes"]] == ["Volts"]
    assert "not a voltage" in capsys.readouterr().out
    assert got["failed"][0]["reason"].endswith(f"(mine.py line {LINE})")
    with pytest.raises(InputError, match=r"mine\.py:Mine, mine\.py:Volts, mine\.py:Broken"):
        make_controller("mine.py")


@pytest.mark.parametrize("where", ["", "class Mine:\n    def __init__(self):\n        "])
def test_a_file_that_ends_the_program_is_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    (folder / "mine.py").write_text(f"import sys\n{where}sys.exit()\n")
    assert cli.run(["benchmark", "mine.py:Mine", *QUICK, "--out", "out"]) == 2
    error = capsys.readouterr().err.splitlines()
    assert "SystemExit" in error[-1] and "mine.py line" in error[-1] and not Path("out").exists()


def test_gains_of_an_own_law_that_cannot_be_made_are_one_line(folder: Path) -> None:
    (folder / "mine.py").write_text(
        MINE + "\n\nclass Own(Mine):\n    def __init__(self, name, **gains):\n        1 / 0\n"
    )
    (folder / "gains.json").write_text(
        '{"schema": "hydro_env/gains/1", "controller": "mine.py:Own", "gains": {"self": 1}}'
    )
    with pytest.raises(InputError, match=r"gains\.json: mine\.py:Own: cannot be made: TypeError"):
        make_controller("gains.json", trust=True)
    with pytest.raises(InputError, match=r"mine\.py:Own: cannot be made: TypeError"):
        make_controller("mine.py:Own:self=1")


@pytest.mark.usefixtures("folder")
def test_when_all_fail_the_command_fails(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["benchmark", "mine.py:Broken", *QUICK, "--out", "out"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert (
        error.startswith("error: every controller failed; Broken: AttributeError") and f"line {LINE}" in error
    )
    assert not Path("out").exists()


def test_files_of_one_name_in_two_folders_are_two(folder: Path) -> None:
    (folder / "other").mkdir()
    (folder / "other" / "mine.py").write_text(MINE.replace("default=0.02", "default=0.03"))
    got = scored("mine.py:Mine", "other/mine.py:Mine", "--jobs", "2")
    rows = [row["iqm"] for row in got["rows"]]
    assert got["controllers"] == ["Mine", "Mine_1"] and rows[: len(rows) // 2] != rows[len(rows) // 2 :]


@pytest.mark.usefixtures("folder")
def test_own_gains_are_tuned_and_the_file_drives(capsys: pytest.CaptureFixture[str]) -> None:
    budget = ["--cases", "1", "--episodes", "72", "--scenario", "setpoint_steps"]
    assert cli.run(["tune", "--controller", "mine.py:Mine", *budget, "--out", "gains"]) == 0
    kept = json.loads(Path("gains/gains.json").read_text())
    assert (
        kept["controller"] == "mine.py:Mine" and kept["name"] == "Mine" and kept["units"] == {"Kp": "s/rad"}
    )
    with pytest.raises(InputError, match="--trust"):
        make_controller("gains/gains.json")
    assert make_controller("gains/gains.json", trust=True).gains["Kp"] == kept["gains"]["Kp"]
    for law, words in {
        "mine.py:Volts": "lists them in GAINS",
        "mine.py:Broken": f"mine.py line {LINE}: AttributeError",
        "mine.py:Other": "has no 'Other'",
    }.items():
        assert cli.run(["tune", "--controller", law, *budget, "--out", "out"]) == 2
        assert words in capsys.readouterr().err.splitlines()[-1]
    Path("leaves.py").write_text(MINE.replace("return measured.no_such_signal", "raise SystemExit"))
    assert cli.run(["tune", "--controller", "leaves.py:Broken", *budget, "--out", "out"]) == 2
    assert f"leaves.py line {LINE}: sys.exit" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("kind", ["PPO", "SAC"])
def test_an_agent_of_stable_baselines3_drives_if_it_is_trusted(folder: Path, kind: str) -> None:
    library = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("hydro_env:HydraulicSync-v0", history=2)
    model = getattr(library, kind)("MlpPolicy", env, seed=0, device="cpu")
    model.save(folder / "agent")
    with pytest.raises(InputError, match="--trust"):
        make_controller("agent.zip")
    with pytest.warns(
        InputWarning, match="agent.zip: does not say whether its actions are commands or changes"
    ):
        make_controller("agent.zip", trust=True)
    driven = roll_out(make_controller("agent.zip:increment=0", trust=True), [5], mismatch="val")
    env = gymnasium.make("hydro_env:HydraulicSync-v0", history=2, mismatch="val", scenario="setpoint_steps")
    observation, _ = env.reset(seed=5)
    for row in range(20):
        action = model.predict(observation, deterministic=True)[0]
        np.testing.assert_allclose(driven.trace.command[row, 0], np.clip(action, -1, 1), atol=1e-6)
        observation = env.step(action)[0]


def test_an_agent_of_the_increments_is_not_taken_for_one_of_commands(folder: Path) -> None:
    library = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("hydro_env:HydraulicSyncTraining-v0")
    library.PPO("MlpPolicy", env, seed=0, device="cpu").save(folder / "agent")
    with pytest.raises(InputError, match=r"agent\.zip:increment=0\.3 for an agent of HydraulicSyncIncrement"):
        make_controller("agent.zip", trust=True)
    make_controller("agent.zip:increment=0.3", trust=True)


def test_other_archives_are_refused(folder: Path) -> None:
    (folder / "agent.zip").write_text("no archive")
    with pytest.raises(InputError, match="Stable-Baselines3 saves"):
        make_controller("agent.zip", trust=True)
    with pytest.raises(InputError, match="no such file; expected an agent"):
        make_controller("other.zip", trust=True)


def test_the_template_of_the_guide_drives(folder: Path) -> None:
    guide = Path(__file__).parents[2] / "docs" / "howto" / "write_a_controller.md"
    (template,) = re.findall(r"```python\n(# mine\.py.*?)```", guide.read_text(encoding="utf-8"), flags=re.S)
    (folder / "mine.py").write_text(template)
    got = scored("mine.py", "pid_paper")
    rows = {(r["controller"], r["metric"]): r["iqm"] for r in got["rows"]}
    assert not got["failed"] and not got["notes"]
    assert rows["MyController", "tracking_mae_rpm"] < rows["pid_paper", "tracking_mae_rpm"]
