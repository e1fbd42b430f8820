"""Sweeps over training seeds: the same policies on every engine, and nothing is lost when a process dies."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents.sweep import sweep
from hydro_env.controllers.learned.policy import read_policy
from hydro_env.errors import InputError
from hydro_env.training import checkpoint
from hydro_env.training.config import read_config

ROOT = Path(__file__).parents[2]
QUICK = ROOT / "configs" / "ppo_quick.yml"
SEEDS = (3, 5)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep") / "whole"
    sweep(read_config(QUICK), SEEDS, out, engine="serial", pairs=3, progress=False)
    return out


def check_same(one, other):
    assert (one / "sweep.json").read_bytes() == (other / "sweep.json").read_bytes()
    for seed in SEEDS:
        first, second = (read_policy(out / f"seed_{seed}" / "policy.npz")[0].layers for out in (one, other))
        for a, b in zip(first, second, strict=True):
            for array, same in zip(a, b, strict=True):
                np.testing.assert_array_equal(array, same)


def test_summary(whole):
    got = json.loads((whole / "sweep.json").read_text())
    assert got["schema"] == "hydro_env/sweep/1" and got["pairs"] == [2, 5] and not got["failed"]
    assert [each["seed"] for each in got["seeds"]] == list(SEEDS)
    assert got["seeds"][0]["scores"] != got["seeds"][1]["scores"]
    for row in got["rows"]:
        values = [each["scores"][row["scenario"]][row["metric"]] for each in got["seeds"]]
        assert row["iqm"] == pytest.approx(np.mean(values)) and row["n"] == 2
        assert row["ci95"] == pytest.approx(sorted(values))
    _, metadata = read_policy(whole / "seed_5" / "policy.npz")
    assert metadata["seed"] == 5


def test_killed_process_goes_on_from_its_checkpoint(whole, tmp_path):
    """Two processes, one of them killed in the middle, give what one after the other gives."""
    out = tmp_path / "parts"
    killed = []

    def kill():
        while checkpoint.latest(out / "seed_5" / "checkpoints") is None:
            time.sleep(0.02)
        for child in Path(f"/proc/{os.getpid()}/task").glob("*/children"):
            for pid in child.read_text().split():
                if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text() and not killed:
                    os.kill(int(pid), signal.SIGKILL)
                    killed.append(int(pid))

    thread = threading.Thread(target=kill)
    thread.start()
    sweep(read_config(QUICK), SEEDS, out, jobs=2, pairs=3, progress=False)
    thread.join()
    if sys.platform == "linux":
        assert killed
    check_same(whole, out)


def test_finished_seeds_are_not_trained_again(whole, monkeypatch):
    before = (whole / "sweep.json").read_bytes()
    written = {seed: (whole / f"seed_{seed}" / "policy.npz").stat().st_mtime_ns for seed in SEEDS}
    sweep(read_config(QUICK), SEEDS, whole, pairs=3, progress=False)
    assert (whole / "sweep.json").read_bytes() == before
    assert written == {seed: (whole / f"seed_{seed}" / "policy.npz").stat().st_mtime_ns for seed in SEEDS}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"seeds": [1, 1]}, "different numbers"),
        ({"seeds": [-1]}, "at least 0"),
        ({"engine": "rya"}, "serial, local, ray"),
        ({"jobs": 0}, "jobs"),
        ({"pairs": 0}, "pairs"),
    ],
)
def test_bad_input_is_named_in_one_line(tmp_path, changed, says):
    with pytest.raises(InputError, match=says) as caught:
        sweep(read_config(QUICK), **{"seeds": [0], "out": tmp_path / "out", "progress": False, **changed})
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()


def test_another_training_file_is_refused(whole, tmp_path):
    other = tmp_path / "other.yml"
    other.write_text(QUICK.read_text() + "# changed\n")
    with pytest.raises(InputError, match="name another folder"):
        sweep(read_config(other), SEEDS, whole, progress=False)


def test_mistake_in_the_file_ends_with_status_2(tmp_path):
    path = tmp_path / "bad.yml"
    path.write_text(QUICK.read_text().replace("mismatch: train", "mismatch: trian"))
    command = [
        sys.executable,
        "-m",
        "agents.sweep",
        "--config",
        str(path),
        "--seeds",
        "0",
        "--out",
        str(tmp_path / "o"),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2
    assert (
        done.stderr.startswith("error: ") and done.stderr.count("\n") == 1 and not (tmp_path / "o").exists()
    )


@pytest.mark.slow
def test_ray_gives_the_same(whole, tmp_path, monkeypatch):
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    small = {"num_cpus": 1, "object_store_memory": 80_000_000, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=small)
    try:
        cluster.add_node(num_cpus=1, object_store_memory=80_000_000)
        cluster.wait_for_nodes()
        monkeypatch.setenv("RAY_ADDRESS", cluster.address)
        sweep(read_config(QUICK), SEEDS, tmp_path / "ray", engine="ray", pairs=3, progress=False)
    finally:
        cluster.shutdown()
    check_same(whole, tmp_path / "ray")
