"""A plant file of one's own is scored, tuned and trained on with its own pair of valves, unless a split is asked for."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import gymnasium
import pytest

from hydro_env import cli
from hydro_env.benchmark import tuned as benchmark_gains
from hydro_env.benchmark.command import Selection
from hydro_env.controllers.tuning.gains import GainsFile, write_gains
from hydro_env.controllers.tuning.search import Search, Task, drive
from hydro_env.errors import InputError, InputWarning
from hydro_env.plant.model_files import values_set_by
from hydro_env.tasks import default_mismatch, load_mismatch

EVEN = "both: {Kq: 0.45}\neffects: {dead_zone: {both: {overlap_positive: 3.0e-5}}}"
UNEVEN = "channel_2: {Kq: 0.25}\neffects: {dead_zone: {channel_2: {overlap_positive: 2.0e-4}}}"


def write(folder: Path, name: str, content: str) -> str:
    path = folder / f"{name}.yaml"
    path.write_text(f"schema: hydro_env/model/1\nname: {name}\nbase: paper\n{content}\n")
    return str(path)


def scores(folder: Path, plant: str, *options: str) -> dict:
    arguments = ["pid_paper", "--suite", "quick", "--scenario", "setpoint_steps", "--cases", "2"]
    assert cli.run(["benchmark", *arguments, "--plant", plant, *options, "--out", str(folder)]) == 0
    return json.loads((folder / "scores.json").read_text())


def test_two_rigs_have_different_rows(tmp_path: Path) -> None:
    even = scores(tmp_path / "1", write(tmp_path, "even", EVEN))
    uneven = scores(tmp_path / "2", write(tmp_path, "uneven", UNEVEN))
    for found in (even, uneven):
        assert {row["split"] for row in found["rows"]} == {"own"} and found["splits"] == {"own": 2}
        assert "own pair of valves" in found["about"] and found["drawn_over"] == {}
    assert [row["iqm"] for row in even["rows"]] != [row["iqm"] for row in uneven["rows"]]


def test_a_split_that_is_asked_for_is_drawn_and_says_what_it_replaces(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = scores(tmp_path / "out", write(tmp_path, "uneven", UNEVEN), "--split", "test_interp")
    assert {row["split"] for row in found["rows"]} == {"test_interp"}
    assert {"Kq", "dead_zone"} <= {*found["drawn_over"]["test_interp"]}
    assert "in place of the plant's own" in found["about"] and found["about"] in capsys.readouterr().out


def test_what_counts_is_what_the_file_itself_sets(tmp_path: Path) -> None:
    for content in (EVEN, UNEVEN, "channel_1: {valve: valve_2}", "both: {R: 31.2}"):
        assert default_mismatch(write(tmp_path, "set", content)) == "own", content
    for content in ("both: {J: 0.003}", "effects: {sensor_lag: {both: {time_constant: 0.01}}}"):
        assert default_mismatch(write(tmp_path, "unset", content)) == "train", content
    assert default_mismatch("rig") == "train" and values_set_by("rig") == frozenset()
    with pytest.raises(InputError, match="papre"):
        default_mismatch("papre")


def test_a_suite_file_names_its_splits(tmp_path: Path) -> None:
    suite = tmp_path / "suite.yaml"
    suite.write_text("splits: {val: 3, own: 2}\nscenarios: [sine]\nmetrics: [tracking_mae_rpm]\n")
    assert Selection(suite).load(write(tmp_path, "even", EVEN)).splits == {"val": 3, "own": 2}


def test_the_environment_keeps_the_valves_of_a_plant_file(tmp_path: Path) -> None:
    plant, name = write(tmp_path, "uneven", UNEVEN), "hydro_env:HydraulicSync-v0"
    _, info = gymnasium.make(name, plant=plant).reset(seed=0)
    assert info["mismatch"]["Kq"][1] == 0.25 and info["mismatch"]["dead_zone.overlap_positive"][1] == 2.0e-4
    _, info = gymnasium.make(name, plant=plant, mismatch="train").reset(seed=0)
    assert info["mismatch"]["Kq"][1] != 0.25
    _, info = gymnasium.make(name, plant="paper_dead_zone", mismatch="own").reset(seed=0)
    assert info["mismatch"]["dead_zone.overlap_positive"][0] == 6.838e-05
    _, info = gymnasium.make(name).reset(seed=0)
    assert info["mismatch"]["Kq"][0] != 476106e-6
    assert load_mismatch("own") is None


def test_gains_are_tuned_on_the_own_pair(tmp_path: Path) -> None:
    plant = write(tmp_path, "uneven", UNEVEN)
    assert Task(plant=plant, mismatch="auto").mismatch is None and Task(mismatch="auto").mismatch == "train"
    assert Task(mismatch="own").mismatch is None and Task(plant=plant, mismatch="train").mismatch == "train"


def test_shipped_gains_are_tuned_for_a_plant_file_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant, searched = write(tmp_path, "uneven", UNEVEN), []

    def quick(out: Path, wanted: Search, name: str) -> None:
        searched.append(name)
        out.mkdir(parents=True)
        assert wanted.task.mismatch is None
        write_gains(
            out / "gains.json",
            GainsFile(name=name, controller="pid", gains={"Kp": 0.01, "Ti": 0.1, "Td": 0.001}),
        )

    def rows(*options: str) -> list[dict]:
        arguments = ["benchmark", "pid_tuned", "pid_paper", "--suite", "quick", "--cases", "1", *options]
        assert cli.run([*arguments, "--plant", plant, "--out", str(tmp_path / "out")]) == 0
        return json.loads((tmp_path / "out/scores.json").read_text())

    monkeypatch.setattr(benchmark_gains, "tune", quick)
    first, again, shipped = rows(), rows(), rows("--as-shipped")
    assert searched == ["pid_tuned"] and first["rows"] == again["rows"] != shipped["rows"]
    assert "Tuned for this plant: pid_tuned." in again["about"] and "Tuned" not in shipped["about"]
    assert "Tuning for" in capsys.readouterr().out and first["controllers"] == ["pid_tuned", "pid_paper"]
    Path(plant).write_text(Path(plant).read_text().replace("0.25", "0.28"))
    rows()
    assert searched == ["pid_tuned"] * 2


def test_gains_of_another_plant_are_pointed_out(tmp_path: Path) -> None:
    plant, gains = write(tmp_path, "uneven", UNEVEN), {"Kp": 0.01, "Ti": 0.1, "Td": 0.001}
    for of in ("rig", plant):
        tuning = {"plant": of, "plant_drive_rpm": list(drive(of))}
        write_gains(
            tmp_path / f"{Path(of).stem}.json", GainsFile(controller="pid", gains=gains, tuning=tuning)
        )
    with pytest.warns(InputWarning, match=r"rig\.json: tuned on rig, which drives otherwise"):
        benchmark_gains.warn_of_others([str(tmp_path / "rig.json"), "pid_tuned"], plant)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        benchmark_gains.warn_of_others([str(tmp_path / "uneven.json"), "pid_tuned"], plant)
