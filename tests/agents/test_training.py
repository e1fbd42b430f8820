"""The training workshop: configuration, checkpoints that resume exactly, export that equals the original."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import json

import torch
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hydro_env.cli import run
from hydro_env.controllers.learned.policy import RECURRENT_SCHEMA, SCHEMA, NumpyPolicy, read_policy
from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.errors import InputError
from hydro_env.training import checkpoint
from hydro_env.training.config import read_config, with_changes
from hydro_env.training.lock import alone_in
from hydro_env.training.train import make_model, train
from tests.damage import damages

ROOT = Path(__file__).parents[2]
PPO, SAC = ROOT / "configs" / "ppo_quick.yml", ROOT / "configs" / "sac_quick.yml"
TIMES = ("seconds", "cpu_seconds")


def weights(path):
    network, metadata = read_policy(path)
    return network.layers, metadata


def curve(progress):
    return [{key: value for key, value in row.items() if key not in TIMES} for row in progress["curve"]]


@pytest.mark.parametrize("name", ["ppo", "ppo_short", "sac", "ppo_quick", "sac_quick"])
def test_the_training_files_are_valid(name):
    config = read_config(ROOT / "configs" / f"{name}.yml")
    assert config.training.algorithm == name.partition("_")[0]
    assert config.env_kwargs["mismatch"] == "train"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("n_epochs: 2", "n_epoch: 2", "HydraulicSync-v0: unknown key 'n_epoch': did you mean 'n_epochs'?"),
        ("evaluate_pairs", "evaluate_pair", "training: unknown key 'evaluate_pair'"),
        ("HydraulicSync-v0:", "Pendulum-v1:", "unknown key 'Pendulum-v1'"),
        ("algorithm: ppo", "algorithm: dqn", "algorithm is 'dqn'"),
        ("evaluate_pairs: 2", "evaluate_scenarios: [sin]", "unknown scenario 'sin': did you mean 'sine'?"),
        ("kind: frames", "kind: eyes", "interface.kind is 'eyes', should be 'frames'"),
        ("n_timesteps: 2048", "n_timesteps: 1e6", "n_timesteps is '1e6'"),
        (
            "learning_rate: lin_1e-3",
            "learning_rate: fast",
            "learning_rate is 'fast', should be a number from 0",
        ),
        ("dict(net_arch", "exec(net_arch", "policy_kwargs"),
        ("nn.Tanh", "nn.Softmax", "activation_fn nn.Softmax is unknown"),
        ("MlpPolicy", "CnnPolicy", "policy is 'CnnPolicy', should be 'MlpPolicy'"),
        ("training:", "training: [", "not YAML"),
        ("plant: paper_dead_zone", "plat: paper", "env_kwargs"),
        ("batch_size: 128", "batch_size: .nan", "batch_size is nan, should be"),
        ("learning_rate: lin_1e-3", "learning_rate: .inf", "learning_rate is inf, should be a number from 0"),
        (
            "learning_rate: lin_1e-3",
            "learning_rate: lin_nan",
            "learning_rate is 'lin_nan', should be a number from 0",
        ),
        ("gamma: 0.97", "gamma: .inf", "gamma is inf, should be a finite number"),
        ("log_std_init=-2.5", "log_std_init=1e999", "policy_kwargs: inf is no finite number"),
        ("evaluate_pairs: 2", "tracking_weight: .nan", "tracking_weight is nan"),
        ("mismatch: train", "mismatch: trian", "trian"),
    ],
)
def test_bad_configuration_is_named_in_one_line(tmp_path, old, new, says):
    path = tmp_path / "bad.yml"
    text = PPO.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        train(read_config(path), tmp_path / "run", bar=False)
    assert says in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_bad_configuration_ends_with_status_2(tmp_path, capsys):
    path = tmp_path / "bad.yml"
    path.write_text(PPO.read_text().replace("n_epochs", "n_epoch"))
    assert run(["train", "--config", str(path), "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1


def test_runs_of_different_seeds_share_no_episode():
    met = set()
    for seed in range(3):
        config = with_changes(read_config(PPO), seed=seed)
        model = make_model(config)
        model.env.reset()
        gains = model.env.unwrapped.batch.pairs["Kq"]
        met |= {pair.tobytes() for pair in gains}
    assert len(met) == 3 * config.num_envs > 3


@pytest.mark.parametrize("path", [PPO, SAC], ids=["ppo", "sac"])
def test_exported_policy_equals_the_original(tmp_path, path):
    config = read_config(path)
    train(config, tmp_path / "run", bar=False)
    model, _ = checkpoint.restore(checkpoint.latest(tmp_path / "run" / "checkpoints"), config.algorithm)
    from hydro_env.training.export import export_policy

    export_policy(model, tmp_path / "last.npz", make_interface(config.training.interface).table(), {})
    network = NumpyPolicy(tmp_path / "last.npz").network
    inputs = np.random.default_rng(0).normal(0.0, 2.0, (500, network.num_inputs)).astype(np.float32)
    expected, _ = model.predict(inputs, deterministic=True)
    np.testing.assert_allclose(network(inputs), expected, atol=1e-5)


@pytest.mark.parametrize("squash", ["clip", "tanh"])
@pytest.mark.parametrize("activation", ["tanh", "relu", "elu"])
def test_onnx_equals_the_policy_file(tmp_path, activation, squash):
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from hydro_env.export.onnx import export_onnx

    stream = np.random.default_rng(0)
    sizes = [(24, 9), (16, 24), (2, 16)]
    arrays = {f"w{n}": stream.normal(0.0, 0.5, size).astype(np.float32) for n, size in enumerate(sizes)}
    arrays |= {f"b{n}": stream.normal(0.0, 0.5, size[0]).astype(np.float32) for n, size in enumerate(sizes)}
    interface = {"kind": "frames", "frames": 1, "width": 9}
    metadata = {"schema": SCHEMA, "activation": activation, "squash": squash, "interface": interface}
    np.savez(tmp_path / "policy.npz", metadata=np.array(json.dumps(metadata)), **arrays)
    export_onnx(tmp_path / "policy.npz", tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    inputs = stream.normal(0.0, 2.0, (300, 9)).astype(np.float32)
    (outputs,) = session.run(None, {"inputs": inputs})
    network, _ = read_policy(tmp_path / "policy.npz")
    np.testing.assert_allclose(outputs, network(inputs), atol=1e-5)
    assert json.loads(session.get_modelmeta().custom_metadata_map["interface"]) == interface


def test_a_recurrent_network_is_the_same_in_torch_numpy_and_onnx(tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from agents.recurrent.network import RecurrentPolicy
    from hydro_env.export.onnx import export_onnx
    from hydro_env.training.export import write_policy

    torch.manual_seed(0)
    policy = RecurrentPolicy(sizes=(24, 16, 20), notes=5)
    path = tmp_path / "policy.npz"
    write_policy(path, policy.arrays(), policy.metadata())
    network, metadata = read_policy(path)
    assert metadata["schema"] == RECURRENT_SCHEMA
    export_onnx(path, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    inputs = np.random.default_rng(0).normal(0.0, 1.0, (80, 7, policy.num_inputs)).astype(np.float32)
    with torch.no_grad():
        expected, _ = policy(torch.from_numpy(inputs), torch.zeros(7, 16))
    states, state = network.start(7), np.zeros((7, 16), np.float32)
    for seen, wanted in zip(inputs, expected.clamp(-1.0, 1.0).numpy(), strict=True):
        np.testing.assert_allclose(network(seen, states), wanted, atol=1e-5)
        outputs, state = session.run(None, {"inputs": seen, "state1": state})
        np.testing.assert_allclose(outputs, wanted, atol=1e-5)


@pytest.mark.parametrize("path", [PPO, SAC], ids=["ppo", "sac"])
def test_a_run_in_two_parts_equals_a_run_in_one(tmp_path, path):
    config = replace(read_config(path))
    whole = train(config, tmp_path / "whole", bar=False)

    # The first part ends by an error right after a checkpoint, like a crash would.
    class Crash(Exception):
        pass

    saved = checkpoint.save
    count = 0

    def crashing(*arguments):
        nonlocal count
        saved(*arguments)
        count += 1
        if count == 2:
            raise Crash

    checkpoint.save = crashing
    try:
        with pytest.raises(Crash):
            train(config, tmp_path / "parts", bar=False)
    finally:
        checkpoint.save = saved
    with pytest.raises(InputError, match="--resume"):
        train(config, tmp_path / "parts", bar=False)
    parts = train(config, tmp_path / "parts", resume=True, bar=False)

    assert parts["steps"] == whole["steps"] == config.num_steps
    assert curve(parts) == curve(whole)
    one, _ = weights(tmp_path / "whole" / "policy.npz")
    other, _ = weights(tmp_path / "parts" / "policy.npz")
    for (w, b), (v, c) in zip(one, other, strict=True):
        np.testing.assert_array_equal(w, v)
        np.testing.assert_array_equal(b, c)


def test_killed_and_resumed(tmp_path):
    """kill -9 at a random moment loses no more than what came after the last checkpoint."""
    path = tmp_path / "long.yml"
    path.write_text(
        PPO.read_text()
        .replace("n_timesteps: 2048", "n_timesteps: 1000000")
        .replace("evaluate_every: 1024", "evaluate_every: 1000000")
    )
    run = tmp_path / "run"
    command = [sys.executable, "-m", "agents.train", "--config", str(path), "--out", str(run), "--quiet"]
    process = subprocess.Popen(
        command, cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, stderr=subprocess.PIPE
    )
    try:
        for _ in range(600):
            newest = checkpoint.latest(run / "checkpoints")
            if newest is not None and newest.name >= "step_000000001024":
                break
            assert process.poll() is None, process.stderr.read().decode()
            time.sleep(0.1)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    config = read_config(path)
    newest = checkpoint.latest(run / "checkpoints")
    _, before = checkpoint.restore(newest, config.algorithm)
    # The same file with an end: train only one rollout more. The run's own copy has to agree.
    text = path.read_text().replace("n_timesteps: 1000000", f"n_timesteps: {before['steps'] + 512}")
    path.write_text(text)
    (run / "config.yml").write_text(text)
    after = train(read_config(path), run, resume=True, bar=False)
    assert after["steps"] == before["steps"] + 512
    assert json.loads((run / "curve.json").read_text()) == after["curve"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A checkpoint of a run that has not learnt anything yet, and its configuration."""
    config = read_config(PPO)
    folder = tmp_path_factory.mktemp("run") / "checkpoints"
    return checkpoint.save(folder, make_model(config), {"steps": 0}), config


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_checkpoint_is_refused_in_one_line(saved, data):
    """Whatever bytes of whichever file are lost or changed; nothing of it is loaded."""
    place, config = saved
    path = data.draw(st.sampled_from(sorted(place.iterdir())))
    whole = path.read_bytes()
    damaged = data.draw(damages(whole))
    assume(damaged != whole)
    try:
        path.write_bytes(damaged)
        with pytest.raises(InputError) as caught:
            checkpoint.restore(place, config.algorithm)
    finally:
        path.write_bytes(whole)
    said = str(caught.value)
    assert said.startswith(str(place)) and "delete the folder `checkpoints`" in said and "\n" not in said
    if path.name != checkpoint.SUMS:
        assert said.startswith(f"{path}: is damaged")


def test_a_missing_file_of_a_checkpoint_is_named(saved):
    place, config = saved
    for path in place.iterdir():
        content = path.read_bytes()
        path.unlink()
        with pytest.raises(InputError, match=f"{path}: No such file"):
            checkpoint.restore(place, config.algorithm)
        path.write_bytes(content)
        path.chmod(0o600)
    checkpoint.restore(place, config.algorithm)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions of this kind")
def test_a_checkpoint_that_others_could_have_written_is_not_loaded(saved, monkeypatch):
    place, config = saved
    for path in (place, place / "model.zip"):
        before = path.stat().st_mode & 0o777
        path.chmod(before | 0o020)
        with pytest.raises(InputError, match=f"{path}: .*other users can write there"):
            checkpoint.restore(place, config.algorithm)
        path.chmod(before)
    own = place.stat().st_uid
    if own == 0:
        os.chown(place, 54321, -1)
    else:
        monkeypatch.setattr("hydro_env.pickles.os.geteuid", lambda: own + 1)
    with pytest.raises(InputError, match=f"{place}: .*belongs to another user"):
        checkpoint.restore(place, config.algorithm)
    os.chown(place, own, -1) if own == 0 else monkeypatch.undo()
    checkpoint.restore(place, config.algorithm)


def test_a_second_run_in_the_same_folder_is_refused(tmp_path):
    """Whoever comes first has the folder, until it ends: a killed process leaves nothing that stands in the way."""
    code = "import sys, time; from pathlib import Path; from hydro_env.training.lock import alone_in\n"
    code += f"with alone_in(Path({str(tmp_path / 'run')!r})): print('in', flush=True); time.sleep(600)"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert process.stdout.readline() == b"in\n"
        for resume in (False, True):
            with pytest.raises(InputError, match=f"run: process {process.pid} on .* trains here") as caught:
                train(read_config(PPO), tmp_path / "run", resume=resume, bar=False)
            assert "\n" not in str(caught.value)
    finally:
        process.kill()
        process.wait()
    with alone_in(tmp_path / "run"):
        pass


def test_resume_wants_a_run(tmp_path):
    config = read_config(PPO)
    with pytest.raises(InputError, match="no checkpoint"):
        train(config, tmp_path / "empty", resume=True, bar=False)


def test_a_recipe_with_other_steps_and_seed_is_trained_by_its_name(tmp_path, capsys):
    out = tmp_path / "run"
    assert (
        run(["train", "--algo", "ppo_quick", "--steps", "512", "--seed", "7", "--quiet", "--out", str(out)])
        == 0
    )
    begun = read_config(out / "config.yml")
    assert (begun.num_steps, begun.training.seed) == (512, 7)
    assert begun.hyper.keys() == read_config(PPO).hyper.keys()
    assert json.loads((out / "curve.json").read_text())[-1]["steps"] == 512
    assert run(["train", "--resume", "--quiet", "--out", str(out)]) == 0
    capsys.readouterr()
    for words, says in (
        (["--algo", "ppoo"], "did you mean 'ppo'"),
        (["--algo", "ppo", "--config", str(PPO)], "give one of them"),
        (["--algo", "ppo_quick", "--resume", "--seed", "8"], "differs from"),
    ):
        assert run(["train", *words, "--quiet", "--out", str(out)]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ") and said.count("\n") == 1 and says in said


def test_the_network_of_increments_drives_as_in_the_environment_of_increments(tmp_path):
    """A policy file trained with the interface's increments, and the same weights in HydraulicSyncIncrement-v0."""
    import gymnasium

    interface = {"kind": "frames", "frames": 2, "increment": 0.3, "errors": True}
    text = PPO.read_text().replace(
        PPO.read_text().split("interface: ")[1].split("\n")[0], json.dumps(interface)
    )
    (tmp_path / "plain.yml").write_text(text)
    config = read_config(tmp_path / "plain.yml")
    train(config, tmp_path / "run", bar=False)
    policy = NumpyPolicy(tmp_path / "run" / "policy.npz")
    assert policy.interface.table() == {**interface, "width": 9}
    plain = gymnasium.make("hydro_env:HydraulicSync-v0", mismatch="val", scenario="setpoint_steps")
    changing = gymnasium.make(
        "hydro_env:HydraulicSyncIncrement-v0", mismatch="val", scenario="setpoint_steps"
    )
    one, two = plain.reset(seed=1)[0], changing.reset(seed=1)[0]
    policy.reset(1, 0.01)
    for _ in range(100):
        one = plain.step(policy.act(one[None])[0])[0]
        two = changing.step(np.clip(policy.network(two[None].astype(np.float64))[0], -1.0, 1.0))[0]
        np.testing.assert_allclose(one, two[-9:], atol=1e-5)
