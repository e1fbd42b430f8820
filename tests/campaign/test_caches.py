"""Damaged files of ours, full disks and kills: nothing of it gives a traceback, a wrong result, or loses what was there.

All of it is slow: `pytest -m slow tests/campaign`.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from hydro_env.cli.main import run
from tests.command_outputs import IGNORED
from tests.full_disk import FullDisk

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
STEP = """
import gymnasium
env = gymnasium.make("hydro_env:HydraulicSync-v0", mismatch=None)
total = 0.0
for observation, *_ in [env.reset(seed=0), *(env.step(env.action_space.high) for _ in range(20))]:
    total += float(observation.sum())
print(total.hex())
"""


def snapshot(folder: Path) -> dict[str, str]:
    """Every file below a folder, hidden ones too, with the hash of its content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in folder.rglob("*")
    }


# --- damaged machine code -------------------------------------------------------------------------------------------


def _flip(data: bytes, stream: random.Random, bits: int) -> bytes:
    changed = bytearray(data)
    for _ in range(bits):
        changed[stream.randrange(len(changed))] ^= 1 << stream.randrange(8)
    return bytes(changed)


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "empty": lambda data, stream: b"",
    "half": lambda data, stream: data[: len(data) // 2],
    "cut": lambda data, stream: data[: stream.randrange(len(data))],
    "a byte short": lambda data, stream: data[:-1],
    "a byte more": lambda data, stream: data + b"\0",
    "zeros": lambda data, stream: bytes(len(data)),
    "noise": lambda data, stream: stream.randbytes(len(data)),
    "text": lambda data, stream: b"no machine code\n",
    "no checksum": lambda data, stream: data[32:],
    "of another file": lambda data, stream: b"\x80\x04K\x01.",
    "one bit": lambda data, stream: _flip(data, stream, 1),
    "another bit": lambda data, stream: _flip(data, stream, 1),
    "forty bits": lambda data, stream: _flip(data, stream, 40),
    "a block of zeros": lambda data, stream: data[:4096] + bytes(min(4096, len(data) - 4096)) + data[8192:],
}


def step(folder: Path) -> tuple[str, str]:
    """Makes a step with a folder for machine code; what that says on standard output and standard error."""
    own = {**os.environ, "HYDRO_ENV_CACHE": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", STEP], cwd=ROOT, env=own, capture_output=True, text=True, check=False
    )
    return done.stdout, done.stderr


@pytest.fixture(scope="module")
def machine_code(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder with the machine code of a step, and what a run prints."""
    folder = tmp_path_factory.mktemp("cache") / "clean"
    out, err = step(folder)
    assert err == "" and len(kernels(folder)) == 2
    return folder, out


def kernels(folder: Path) -> list[Path]:
    """The files of kernels; the others are Numba's."""
    return sorted(path for path in (folder / "machine_code").iterdir() if path.suffix in (".json", ".o"))


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("files", [(0,), (1,), (0, 1)], ids=str)
def test_damaged_machine_code(machine_code, tmp_path: Path, damage: str, files: tuple[int, ...]) -> None:
    """The same result, one line, and whole files afterwards."""
    clean, expected = machine_code
    shutil.copytree(clean, tmp_path / "cache")
    stream = random.Random(f"{damage} {files}")
    paths = kernels(tmp_path / "cache")
    for number in files:
        paths[number].write_bytes(DAMAGES[damage](paths[number].read_bytes(), stream))
    out, err = step(tmp_path / "cache")
    assert out == expected, err
    assert err.count("\n") == 1 and "damaged machine code was removed" in err
    assert step(tmp_path / "cache") == (expected, "")


@pytest.mark.parametrize("thing", ["folder", "link to nothing", "no permission"])
def test_something_else_in_the_place_of_machine_code(machine_code, tmp_path: Path, thing: str) -> None:
    clean, expected = machine_code
    shutil.copytree(clean, tmp_path / "cache")
    for path in kernels(tmp_path / "cache"):
        if thing == "no permission":
            path.chmod(0)
            continue
        path.unlink()
        if thing == "folder":
            (path / "inside").mkdir(parents=True)
        else:
            path.symlink_to(tmp_path / "nothing")
    out, err = step(tmp_path / "cache")
    assert out == expected and err.count("\n") <= 2, err


def test_processes_that_compile_at_the_same_time(tmp_path: Path, machine_code) -> None:
    own = {**os.environ, "HYDRO_ENV_CACHE": str(tmp_path)}
    command = [sys.executable, "-c", STEP]
    together = [
        subprocess.Popen(
            command, cwd=ROOT, env=own, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(4)
    ]
    assert [process.communicate() for process in together] == [(machine_code[1], "")] * 4
    assert sorted(path.suffix for path in tmp_path.rglob("*")) == sorted(
        path.suffix for path in machine_code[0].rglob("*")
    )


@pytest.mark.parametrize("number", range(12))
def test_killed_while_it_compiles(tmp_path: Path, machine_code, number: int) -> None:
    """At a random time; the next run is as if nothing had happened."""
    own = {**os.environ, "HYDRO_ENV_CACHE": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-c", STEP], cwd=ROOT, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(0.5 + 0.5 * number)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert step(tmp_path) == (machine_code[1], "")


# --- full disks -----------------------------------------------------------------------------------------------------
LOGS = "{logs}/fit_1.csv {logs}/fit_2.csv --sealed {logs}/sealed.csv --model {logs}/model.yaml"
COMMANDS = {
    "reproduce": "reproduce --out {out}",
    "valve-test": "valve-test paper:1 paper:2 --seconds 3 --out {out}",
    "tune": "tune --episodes 288 --cases 4 --scenario setpoint_steps --out {out}",
    "tune --linear": "tune --linear --out {out}",
    "benchmark": "benchmark pid_paper pid_tuned --suite quick --cases 1 --cells {out}-cells --out {out}",
    "hide": "hide dead_zone:1 --duration 3 --out {out}",
    "diagnose": f"diagnose {LOGS} --out {{out}}",
    "diagnose --inspect": "diagnose --inspect {logs}/fit_1.csv --out {out}",
    "speed": "speed --num-envs 1 --seconds 0.05 --out {out}",
    "demo": "demo --out {out}",
    "close-loop": "close-loop --case dead_zone --seeds 1 --out {out}",
}
#: What takes long and writes nothing: its results are recorded in the first run and given back in all later ones.
RECORDED = (
    ("hydro_env.experiments.reproduce", "reproduce"), ("hydro_env.experiments.reproduce", "sweep"),
    ("hydro_env.case.command", "diagnose"), ("hydro_env.controllers.tuning.tune", "search"),
    ("hydro_env.experiments.close_loop", "run_tasks"), ("hydro_env.experiments.valve_test", "bench"),
    ("hydro_env.practice.generate", "make_practice"),  # after the modules that import it by name
    *(("hydro_env.experiments.speed", f"measure_{n}") for n in ("start", "batch", "commands", "errors", "single", "effects")),
)  # fmt: skip


class Recorder:
    """Functions that give back, call by call, what they returned in the first run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, more: Sequence[tuple[str, str]]) -> None:
        self.results: dict[str, list[Any]] = {}
        self.calls: dict[str, int] = {}
        for module, name in (*RECORDED, *more):
            place = importlib.import_module(module)
            monkeypatch.setattr(place, name, partial(self._call, f"{module}.{name}", getattr(place, name)))

    def _call(self, name: str, real: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        number, known = self.calls.get(name, 0), self.results.setdefault(name, [])
        self.calls[name] = number + 1
        if number == len(known):
            known.append(real(*args, **kwargs))
        return known[number]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("practice") / "logs"
    assert run(["hide", "dead_zone:1", "--duration", "4", "--seed", "2", "--out", str(folder)]) == 0
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_full_disk(name: str, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """From every write on in turn, into a new folder and over earlier results."""
    from hydro_env.experiments import close_loop

    monkeypatch.setattr(close_loop, "Settings", partial(close_loop.Settings, generations=2))
    monkeypatch.setattr(close_loop, "DURATION", 4.0)
    root, kept = tmp_path / "disk", tmp_path / "kept"
    root.mkdir()
    out = root / "out"
    words = [word.format(out=out, logs=logs) for word in COMMANDS[name].split()]
    recorder = Recorder(monkeypatch, [("hydro_env.benchmark.command", "run_tasks")] if name == "demo" else [])
    assert run(words) == 0
    capsys.readouterr()
    shutil.copytree(root, kept)
    disk = FullDisk(monkeypatch, root)

    def begin(fresh: bool) -> dict[str, str]:
        disk.begin(None)
        shutil.rmtree(root)
        root.mkdir() if fresh else shutil.copytree(kept, root)
        recorder.calls.clear()
        return snapshot(root)

    tried = 0
    for fresh in (True, False):
        full_at = 0
        while True:
            full_at += 1
            before = begin(fresh)
            disk.begin(full_at)
            status = run(words)
            reached, said = disk.count, capsys.readouterr().err.replace("\r", "\n")
            disk.begin(None)
            if reached < full_at:
                break
            tried += 1
            where = f"{name}, fresh {fresh}, write {full_at}: {said}"
            assert status == 2, where
            lines = [line for line in said.splitlines() if line.startswith("error: ")]
            assert len(lines) == 1 and str(root) in lines[0] and "No space left" in lines[0], where
            assert "/." not in lines[0].partition(str(out))[2], where
            after = {path: text for path, text in snapshot(root).items() if not path.startswith("out-cells")}
            assert after == {
                path: text for path, text in before.items() if not path.startswith("out-cells")
            }, where
        assert status == 0
    print(f"{name}: {tried} full disks")
    assert tried >= 8


@pytest.mark.parametrize("size", [0, 1, 100, 5_000, 20_000, 100_000])
@pytest.mark.parametrize("name", ["hide", "tune --linear", "benchmark", "diagnose --inspect"])
def test_files_that_the_system_does_not_let_grow(name: str, size: int, logs: Path, tmp_path: Path) -> None:
    """A real process and a real limit (`ulimit -f`), which stops C libraries, too."""
    out = tmp_path / "out"
    words = [word.format(out=out, logs=logs) for word in COMMANDS[name].split()]
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
    done = subprocess.run(
        [sys.executable, "-m", "hydro_env", *words],
        cwd=ROOT,
        preexec_fn=limit,
        capture_output=True,
        text=True,
        check=False,
    )
    said = done.stderr.replace("\r", "\n")
    assert "Traceback" not in said
    if done.returncode:
        (line,) = [line for line in said.splitlines() if line.startswith("error: ")]
        assert done.returncode == 2 and str(tmp_path) in line and "File too large" in line
        assert not out.exists()
    else:
        assert size > 1 and out.is_dir()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("name", ["hide", "tune --linear", "benchmark", "diagnose --inspect"])
def test_full_standard_output(name: str, logs: Path, tmp_path: Path) -> None:
    words = [word.format(out=tmp_path / "out", logs=logs) for word in COMMANDS[name].split()]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "hydro_env", *words],
            cwd=ROOT,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    said = done.stderr.replace("\r", "\n")
    assert done.returncode == 2 and "Traceback" not in said and "Exception" not in said
    assert "error: standard output: No space left on device" in said


# --- kills ----------------------------------------------------------------------------------------------------------


def _killed(command: list[str], after: float) -> None:
    """Runs a command and kills it, with `kill -9`, after so many seconds."""
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()


KILLED = {
    "benchmark": "benchmark pid_paper pid_tuned cross_coupled --suite quick --cases 2 --cells {folder}/cells --out {folder}/out",
    "tune": "tune --episodes 288 --cases 4 --scenario setpoint_steps --out {folder}/out",
    "diagnose": f"diagnose {LOGS} --out {{folder}}/out",
}


@pytest.mark.parametrize("name", KILLED)
def test_killed_and_run_again(name: str, logs: Path, tmp_path: Path) -> None:
    """Earlier results stay as they were through every kill; the same command then gives what it gives without kills."""
    words = [
        sys.executable,
        "-m",
        "hydro_env",
        *(w.format(folder=tmp_path, logs=logs) for w in KILLED[name].split()),
    ]
    begin = time.monotonic()
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    took = time.monotonic() - begin
    before = snapshot(tmp_path / "out")
    result = _results(tmp_path / "out")
    shutil.rmtree(tmp_path / "cells", ignore_errors=True)
    stream = random.Random(name)
    for _ in range(6):
        _killed(words, took * stream.uniform(0.1, 0.9))
        now = snapshot(tmp_path / "out")
        if {path: now.get(path) for path in before} == before:
            continue
        assert _results(tmp_path / "out") == result  # it was faster than the kill
        before = now
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    assert _results(tmp_path / "out") == result


def _results(out: Path) -> list[Any]:
    """What the JSON files of a command say, without times and hashes of code."""
    return [_less(json.loads(path.read_text(encoding="utf-8"))) for path in sorted(out.glob("*.json"))]


def _less(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _less(value) for key, value in data.items() if key not in IGNORED}
    return [_less(value) for value in data] if isinstance(data, list) else data


@pytest.mark.parametrize("name", ["ppo_quick", "sac_quick"])
def test_training_killed_and_resumed(name: str, tmp_path: Path) -> None:
    """Killed at random times, resumed each time, and at the end the same policy as without kills."""
    pytest.importorskip("stable_baselines3")
    import numpy as np

    config = ROOT / "configs" / f"{name}.yml"
    train = [sys.executable, "-m", "agents.train", "--config", str(config), "--quiet", "--out"]
    begin = time.monotonic()
    subprocess.run([*train, str(tmp_path / "whole")], cwd=ROOT, check=True, capture_output=True)
    took = time.monotonic() - begin
    run = tmp_path / "killed"
    stream = random.Random(name)
    _killed([*train, str(run)], took * 0.7)
    for _ in range(8):
        resume = ["--resume"] if (run / "config.yml").exists() else []
        _killed([*train, str(run), *resume], took * stream.uniform(0.3, 0.9))
    done = subprocess.run(
        [*train, str(run), "--resume"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "whole" / "policy.npz") as one, np.load(run / "policy.npz") as other:
        assert one.files == other.files
        for key in one.files:
            if key != "metadata":
                np.testing.assert_array_equal(one[key], other[key])


def test_training_whose_files_cannot_grow(tmp_path: Path) -> None:
    """A real limit of the system on the size of a file: one line that names a file of the run; resumed, the same policy."""
    pytest.importorskip("stable_baselines3")
    import numpy as np

    train = [
        sys.executable, "-m", "agents.train", "--config", str(ROOT / "configs" / "ppo_quick.yml"), "--quiet", "--out"
    ]  # fmt: skip
    subprocess.run([*train, str(tmp_path / "whole")], cwd=ROOT, check=True, capture_output=True)
    sizes = sorted({path.stat().st_size for path in (tmp_path / "whole").rglob("*") if path.is_file()})
    with np.load(tmp_path / "whole" / "policy.npz") as policy:
        expected = {key: policy[key] for key in policy.files if key != "metadata"}
    # Python itself tries out its folder for temporary files with four bytes.
    for size in sorted({8, *(size // 2 for size in sizes), *(size - 1 for size in sizes)}):
        run = tmp_path / f"run_{size}"
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
        done = subprocess.run(
            [*train, str(run)], cwd=ROOT, preexec_fn=limit, capture_output=True, text=True, check=False
        )
        lines = done.stderr.splitlines()
        assert done.returncode == 2 and len(lines) == 1, (size, done.stderr)
        assert lines[0].startswith("error: ") and str(run) in lines[0] and "File too large" in lines[0], (
            size,
            lines,
        )
        resume = ["--resume"] if (run / "config.yml").exists() else []
        subprocess.run([*train, str(run), *resume], cwd=ROOT, check=True, capture_output=True)
        with np.load(run / "policy.npz") as policy:
            assert all(np.array_equal(policy[key], value) for key, value in expected.items()), size
