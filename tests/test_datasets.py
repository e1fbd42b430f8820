"""Data sets for offline learning: what Minari reads from them, replay in the environment, refusals."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest

from hydro_env import __version__
from hydro_env.cli import run
from hydro_env.datasets import Task
from tests.full_disk import FullDisk

PAGE = Path(__file__).parents[1] / "docs" / "howto" / "learn_from_recorded_data.md"


def record(out: Path, *words: str) -> int:
    return run(["dataset", "--out", str(out), *words])


def metadata(dataset: minari.MinariDataset) -> list[dict]:
    return list(dataset.storage.get_episode_metadata(range(len(dataset))))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data") / "data"
    words = ["--controller", "random", "--controller", "gru", "--split", "train", "--split", "faulted"]
    assert record(out, *words, "--episodes", "3", "--seed", "7", "--scenario", "setpoint_steps") == 0
    return out


def test_minari_finds_and_loads_them(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    names = [f"hydro_env/setpoint_steps/{c}-{s}-v0" for c in ("gru", "random") for s in ("faulted", "train")]
    assert list(minari.list_local_datasets()) == names
    for name in names:
        dataset = minari.load_dataset(name)
        assert dataset.total_episodes == 3 and dataset.total_steps == sum(len(each) for each in dataset)
        for evaluation, split in ((False, dataset.id.split("-")[1]), (True, "test_interp")):
            env = dataset.recover_environment(eval_env=evaluation)
            assert env.observation_space == dataset.observation_space
            assert env.action_space == dataset.action_space
            assert env.unwrapped.batch.mismatch.name == split
            assert env.unwrapped.batch.scenario.name == "setpoint_steps"


@pytest.mark.parametrize("name", ["random-train", "gru-faulted"])
def test_recorded_actions_give_the_same_episode_again(folder: Path, name: str) -> None:
    dataset = minari.MinariDataset(folder / f"hydro_env/setpoint_steps/{name}-v0/data")
    env = dataset.recover_environment()
    for episode, about in zip(dataset, metadata(dataset), strict=True):
        observation, info = env.reset(seed=about["seed"])
        assert (info["case"], info["fault"]) == (about["case"], about["fault"])
        for key, pair in info["mismatch"].items():
            np.testing.assert_array_equal(about["mismatch"][key], pair)
        for t, action in enumerate(episode.actions):
            assert env.action_space.contains(action)
            np.testing.assert_array_equal(observation, episode.observations[t])
            for key in ("setpoint_rpm", "speed_rpm", "angle_difference_deg"):
                np.testing.assert_array_equal(info[key], episode.infos[key][t])
            observation, reward, terminated, truncated, info = env.step(action)
            assert reward == episode.rewards[t]
            assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
            assert info["cost_travel"] == episode.infos["cost_travel"][t + 1]
        np.testing.assert_array_equal(observation, episode.observations[-1])
        assert truncated and about["return"] == pytest.approx(episode.rewards.sum())


def test_the_command_inside_writes_it_again(folder: Path, tmp_path: Path) -> None:
    first = minari.MinariDataset(folder / "hydro_env/setpoint_steps/gru-faulted-v0/data")
    made = first.storage.metadata["hydro_env"]
    assert (made["version"], made["seed"], made["needs"]) == (__version__, 7, "measurements")
    assert made["cases"] == [7, 8, 9] == [about["case"] for about in metadata(first)]
    program, command, *words = shlex.split(made["command"])
    assert (program, command) == ("hydro-env", "dataset")
    assert record(tmp_path / "again", *words) == 0
    second = minari.MinariDataset(tmp_path / "again" / first.id / "data")
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.observations, two.observations)
        np.testing.assert_array_equal(one.actions, two.actions)


def test_a_part_is_the_same_as_all_at_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hydro_env.datasets.AT_ONCE", 2)
    words = ["--controller", "random", "--split", "train", "--scenario", "setpoint_steps"]
    assert record(tmp_path / "parts", *words, "--episodes", "3", "--seed", "7") == 0
    name = "hydro_env/setpoint_steps/random-train-v0/data"
    parts, whole = minari.MinariDataset(tmp_path / "parts" / name), minari.MinariDataset(folder / name)
    assert metadata(parts)[2]["seed"] == 9
    for one, two in zip(parts, whole, strict=True):
        np.testing.assert_array_equal(one.observations, two.observations)


def test_a_rig_of_ones_own_needs_no_other_file(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text("schema: hydro_env/model/1\nname: mine\nbase: paper\nboth: {J: 0.003}\n")
    words = ["--controller", "random", "--split", "own", "--plant", str(rig), "--episodes", "1"]
    assert record(tmp_path / "data", *words) == 0
    rig.unlink()
    dataset = minari.MinariDataset(tmp_path / "data/hydro_env/random-own-v0/data")
    for evaluation in (False, True):
        env = dataset.recover_environment(eval_env=evaluation)
        assert env.unwrapped.plant.model.value("J", 0) == 0.003
        assert env.unwrapped.batch.mismatch is None
    assert isinstance(env, gymnasium.Env)


def test_what_is_there_stays(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    words = [
        "--controller",
        "pid_tuned",
        "--controller",
        "gru",
        "--split",
        "train",
        "--scenario",
        "setpoint_steps",
    ]
    assert record(folder, *words, "--episodes", "1") == 2
    assert "gru-train-v0: is there already" in capsys.readouterr().err
    assert before == {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--controller", "rando"], "unknown controller 'rando'"),
        (["--split", "tran"], "did you mean 'train'?"),
        (["--scenario", "sin"], "did you mean 'sine'?"),
        (["--plant", "rg"], "rg"),
        (["--controller", "gru", "--controller", "gru"], "hydro_env/gru-train-v0"),
        (["--controller", "broken.py:Broken"], "broken.py line 6"),
        (["--controller", "broken.py:Nothing"], "act returned None"),
    ],
)
def test_refusals(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.py").write_text(
        "class Broken:\n def reset(self, num_rigs, control_period):\n  pass\n\n def act(self, observation):\n"
        "  return 1 / 0\n\nclass Nothing(Broken):\n def act(self, observation):\n  pass\n"
    )
    assert record(tmp_path / "data", *words, "--episodes", "1") == 2
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("error: "))
    assert said in line
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["broken.py"]


def test_a_full_disk_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "disk"
    root.mkdir()
    words = ["--controller", "random", "--split", "train", "--episodes", "2"]
    disk = FullDisk(monkeypatch, root)
    assert record(root / "data", *words) == 0
    writes = disk.count
    for full_at in np.linspace(1, writes, 12, dtype=int):
        disk.begin(None)
        shutil.rmtree(root / "data", ignore_errors=True)
        capsys.readouterr()
        disk.begin(int(full_at))
        assert record(root / "data", *words) == 2 and not list(root.iterdir()), full_at
        said = capsys.readouterr().err
        assert "error: " in said and "No space left" in said and str(root) in said
        assert "/." not in said.partition(str(root))[2], said


def test_an_interruption_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hydro_env import datasets

    real, done = datasets.roll_out, []

    def interrupted(*args, **kwargs):
        if done:
            raise KeyboardInterrupt
        done.append(real(*args, **kwargs))

    monkeypatch.setattr(datasets, "roll_out", interrupted)
    assert record(tmp_path / "data", "--controller", "random", "--episodes", "1") == 130
    assert done and not list(tmp_path.iterdir())


def test_names_of_data_sets() -> None:
    assert Task("random", "train").id == "hydro_env/random-train-v0"
    assert (
        Task("a/my file.py:Mine:Kp=0.2", "val", "sine").id == "hydro_env/sine/my_file_py_Mine_Kp_0_2-val-v0"
    )


def test_the_example_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    assert len(example.splitlines()) <= 40
    monkeypatch.chdir(tmp_path)
    assert record(Path("data"), "--controller", "gru", "--split", "train", "--episodes", "2") == 0
    said: list[float] = []
    exec(compile(example, PAGE.name, "exec"), {"__name__": "page", "print": said.append})
    assert -20_000 < said[0] < 0
