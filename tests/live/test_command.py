"""`hydro-env live` as a process: how it ends, and what is left after a kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from hydro_env.cli.main import run
from hydro_env.measured import read_log
from tests.live.rig import OWN_WATCHDOG, UdpRig

#: What a busy machine may add to a stated time, s.
BUSY = 0.4


@pytest.fixture
def rig() -> Iterator[UdpRig]:
    rig = UdpRig()
    rig.start()
    assert rig.ready.wait(60.0)
    yield rig
    rig.end()


def started(rig: UdpRig, folder: Path) -> subprocess.Popen[str]:
    """The command at work, with the valves open."""
    table = json.loads(rig.link().model_dump_json(exclude_unset=True))
    (folder / "link.yaml").write_text(yaml.safe_dump({"schema": "hydro_env/link/1", **table}))
    (folder / "own.py").write_text(
        "import numpy as np\nclass Own:\n    def reset(self, n, period): ...\n"
        "    def act(self, observation):\n        return np.full((1, 2), 0.15)\n"
    )
    command = ["live", "link.yaml", "own.py:Own", "--scenario", "setpoint_steps", "--out", "runs"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hydro_env", *command], cwd=folder, stderr=subprocess.PIPE, text=True
    )
    while not (rig.applied and any(rig.applied[-1][1:])):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    time.sleep(0.3)
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)])
@pytest.mark.skipif(sys.platform == "win32", reason="sends signals of POSIX")
def test_a_run_that_is_ended_leaves_closed_valves_and_a_whole_log(
    rig: UdpRig, tmp_path: Path, number: Any
) -> None:
    """After a kill the rig closes its valves by itself: nobody else is left who could."""
    process = started(rig, tmp_path)
    ended = time.monotonic()
    process.send_signal(number)
    told = process.communicate(timeout=60.0)[1]
    opened = len(rig.applied)
    while len(rig.applied) < opened + (OWN_WATCHDOG + 0.1) / rig.cycle:
        time.sleep(0.01)
    own = OWN_WATCHDOG + 2 * rig.cycle if number == signal.SIGKILL else 0.0
    assert rig.closed_after(ended) <= max(rig.link().stop_s, own) + BUSY
    log = (tmp_path / "runs" / "log_1.csv").read_text()
    assert log.endswith("\n") and len({line.count(",") for line in log.splitlines()}) == 1
    assert len(read_log(tmp_path / "runs" / "log_1.csv")) > 15
    if number != signal.SIGKILL:
        assert process.returncode == 0 and told.splitlines()[-1] == "stopped"


def test_bad_arguments_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "runs")]
    for words, said in (
        (["link.yaml"], "name a controller, or an --experiment to play"),
        (["link.yaml", "pid_tuned", "--experiment", "x.csv"], "one of them"),
        (["link.yaml", "--experiment", "x.csv", "--scenario", "sine"], "--scenario goes with a controller"),
        (["link.yaml", "pid_tuned", "--command-limit", "120"], "a number from 1 to 100 %"),
        (["link.yaml", "pid_tuned"], "link.yaml: no such file"),
    ):
        assert run(["live", *words, *out]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_rig_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    pytest.importorskip("asyncua", reason="needs the extra live")
    from hydro_env.errors import InputError
    from hydro_env.live.driver import Driver
    from hydro_env.live.run import Run
    from tests.live.rig import free_port
    from tests.live.test_supervisor import link

    nowhere = link(protocol="opcua", address=f"opc.tcp://127.0.0.1:{free_port()}")
    with pytest.raises(InputError, match="cannot be reached"):
        Run(nowhere, Driver(lambda *_: None, None), tmp_path / "runs", (10.0, 10.0))()
    assert not (tmp_path / "runs").exists()
