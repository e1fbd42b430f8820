"""Baselines: PPO in one file, algorithms of Stable-Baselines3 on a recipe's rigs, clones, and the line to beat."""

import json
import sys

import gymnasium
import numpy as np
import pytest
import torch

pytest.importorskip("sb3_contrib")

from stable_baselines3 import PPO, SAC

from agents import baselines, cloning, line_to_beat, ppo_single
from agents.baselines import AGENTS, make
from hydro_env.controllers.learned.policy import NumpyPolicy


def test_ppo_in_one_file_learns_and_exports_what_it_learnt(tmp_path):
    policy = ppo_single.train(65_536, 3, tmp_path / "a", points=2, pairs=4)
    curve = json.loads((tmp_path / "a" / "curve.json").read_text())
    assert [point["steps"] for point in curve] == [32_768, 65_536]
    assert curve[0]["mean_return"] < curve[1]["mean_return"] - 100.0  # zero commands have about -2400
    driver = NumpyPolicy(tmp_path / "a" / "policy.npz")
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, (5, driver.network.num_inputs)).astype(np.float32)
    with torch.no_grad():
        wanted = policy(torch.from_numpy(inputs)).clamp(-1.0, 1.0).numpy()
    np.testing.assert_allclose(driver.network(inputs), wanted, atol=1e-5)
    ppo_single.train(16_384, 3, tmp_path / "b", points=1, pairs=4)
    ppo_single.train(16_384, 3, tmp_path / "c", points=1, pairs=4)
    ppo_single.train(16_384, 4, tmp_path / "d", points=1, pairs=4)
    b, c, d = (NumpyPolicy(tmp_path / name / "policy.npz").network.layers[0].weight for name in "bcd")
    assert np.array_equal(b, c) and not np.array_equal(b, d)


@pytest.mark.parametrize(("name", "kind", "rigs"), [("ppo", PPO, 128), ("sac", SAC, 512)])
def test_default_settings_are_those_of_the_library_on_the_rigs_of_the_recipe(name, kind, rigs):
    model, interface = make(AGENTS[name], 1000, 0)
    env = gymnasium.make("hydro_env:HydraulicSync-v0", **interface.env_kwargs())
    plain = kind("MlpPolicy", env, device="cpu")
    assert str(model.policy) == str(plain.policy) and model.n_envs == rigs
    settings = "gamma batch_size learning_rate n_steps n_epochs gradient_steps buffer_size tau ent_coef learning_starts"
    for setting in settings.split():
        assert getattr(model, setting, None) == getattr(plain, setting, None), setting


def test_seeds_share_no_episode_and_settings_of_the_recipe_are_taken_over():
    first, second = (make(AGENTS["tqc"], 600_000, seed)[0] for seed in (0, 1))
    assert min(second.env.venv._seeds) > max(first.env.venv._seeds) + 2**30
    assert (first.batch_size, first.gradient_steps, first.gamma, first.n_envs) == (1024, 4, 0.9, 512)


@pytest.fixture
def few_controllers(monkeypatch):
    classes = dict.fromkeys(line_to_beat.CLASSES, ())
    monkeypatch.setattr(
        line_to_beat,
        "CLASSES",
        classes | {"classical": ("pid_tuned", "cross_coupled"), "recurrent": ("gru",)},
    )


def test_baselines_train_and_stand_beside_the_line_to_beat(tmp_path, monkeypatch, few_controllers, capsys):
    monkeypatch.setattr(cloning, "RIGS", 8)
    names = ["recurrent_ppo", "sac", "clone_cross_coupled"]
    command = ["agents.baselines", "--agents", *names, "--seeds", "1", "--steps", "2000", "--pairs", "2"]
    monkeypatch.setattr(sys, "argv", [*command, "--out", str(tmp_path)])
    baselines.main()
    assert "sac, seed 0" in capsys.readouterr().out
    baselines.main()
    assert "sac, seed 0" not in capsys.readouterr().out  # nothing is left to train
    rows = (tmp_path / "baselines.md").read_text().splitlines()[2:]
    assert [row.split(" | ")[0] for row in rows][-1] == "| clone of `cross_coupled`"
    best = {row.split(" | ")[0]: row for row in (tmp_path / "line_to_beat.md").read_text().splitlines()[2:]}
    assert best["| classical"].startswith("| classical | `cross_coupled` |") and len(best) == 4
    curves = json.loads((tmp_path / "baselines.json").read_text())["curves"]
    assert [curve["points"][-1]["steps"] for curve in curves] == [4800, 8192, 2048]
    assert (tmp_path / "baselines.png").stat().st_size > 10_000


def test_zero_commands_are_the_worst_on_the_ladder(tmp_path, monkeypatch):
    monkeypatch.setattr(
        line_to_beat, "LADDER", {rung: line_to_beat.LADDER[rung] for rung in ("pair", "train")}
    )
    line_to_beat.ladder(tmp_path, 2)
    for row in (tmp_path / "ladder.md").read_text().splitlines()[2:]:
        returns = [float(cell) for cell in row.strip("| ").split(" | ")[2:]]
        assert returns[0] == min(returns) and returns[-1] == max(returns)
