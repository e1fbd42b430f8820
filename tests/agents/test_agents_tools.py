"""What surrounds training: robustness study, search, pictures, scores of the law alone."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from pathlib import Path

from agents import robustness
from agents.robustness import CONDITIONS, as_table, drive, study
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError

ROOT = Path(__file__).parents[2]


def test_the_study_drives_as_the_benchmark_does():
    """Under no special condition the study's own loop gives the scores of `roll_out`."""
    cases = [3, 4, 5]
    ours = drive(make_controller("probing_flow"), cases, CONDITIONS[0])
    theirs = roll_out(make_controller("probing_flow"), cases, mismatch="test_interp").metrics(
        robustness.METRICS
    )
    for name in robustness.METRICS:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9)


@pytest.mark.parametrize("condition", CONDITIONS[1:3] + CONDITIONS[5:], ids=lambda condition: condition.name)
def test_every_condition_changes_the_scores(condition):
    usual = drive(make_controller("probing_flow"), [3, 4], CONDITIONS[0])
    other = drive(make_controller("probing_flow"), [3, 4], condition)
    assert not np.allclose(usual["max_speed_difference_rpm"], other["max_speed_difference_rpm"])


def test_the_study_writes_a_table():
    rows = study(["pid_tuned"], [0, 1], CONDITIONS[:1])
    assert json.loads(json.dumps(rows)) == rows
    assert as_table(rows).splitlines()[-1].startswith("| as trained | ")


def test_the_search_tries_values_and_goes_on(tmp_path):
    pytest.importorskip("optuna")
    from agents.search import search
    from hydro_env.training.config import read_config

    text = (ROOT / "configs" / "ppo_quick.yml").read_text()
    config = tmp_path / "quick.yml"
    config.write_text(text)
    study = search(config, tmp_path / "out", trials=1, steps=512)
    assert len(study.trials) == 1 and np.isfinite(study.best_value)
    study = search(config, tmp_path / "out", trials=1, steps=512)
    assert len(study.trials) == 2
    tried = read_config(tmp_path / "out" / "trial_0001" / "config.yml")
    assert tried.hyper["gamma"] != read_config(config).hyper["gamma"] and tried.num_steps == 512


def test_the_search_says_what_it_needs(tmp_path):
    from agents.search import search

    with pytest.raises(InputError, match=r"absent\.yml"):
        search(tmp_path / "absent.yml", tmp_path / "out", trials=1, steps=512)


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_rl_zoo_trains_from_the_same_file(tmp_path, algorithm):
    pytest.importorskip("rl_zoo3")
    zoo = [str(Path(sys.executable).with_name("rl_zoo3")), "train", "--gym-packages", "hydro_env"]
    what = ["--algo", algorithm, "--env", "HydraulicSync-v0", "-conf", f"configs/{algorithm}_quick.yml"]
    how = ["-n", "256", "-f", str(tmp_path), "--eval-freq", "-1"]
    done = subprocess.run([*zoo, *what, *how], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(tmp_path.rglob("HydraulicSync-v0.zip"))


def test_curves_give_a_table_of_powers_of_ten():
    from agents.curves import table

    point = {"max_speed_difference_rpm": 20.0, "tracking_mae_rpm": 30.0, "seconds": 90.0}
    runs = [
        {
            "algorithm": "ppo",
            "points": [{**point, "steps": 1e5 * k, "max_speed_difference_rpm": d} for k in (0.2, 1.2, 13.0)],
        }
        for d in (20.0, 22.0, 30.0)
    ]
    assert table(runs).splitlines()[0] == "| periods | 10^5 | 10^6 |"
    assert table(runs).splitlines()[2] == "| `ppo` | 22.0 / 30.0 (1.5 min) | 22.0 / 30.0 (1.5 min) |"
