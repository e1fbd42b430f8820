"""Wheel and source archive install into an empty environment, from the package index, and run the demo there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from hydro_env import __version__

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


@pytest.mark.parametrize("archive", ["*.whl", "*.tar.gz"])
def test_it_installs_and_runs_the_demo(archive: str, built: Path, tmp_path: Path) -> None:
    (package,) = built.glob(archive)
    venv.create(tmp_path / "venv", with_pip=True)
    scripts = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    work = tmp_path / "work"
    work.mkdir()
    # Machine code is compiled once for both archives.
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    clean["HYDRO_ENV_CACHE"] = str(built / "machine_code")

    def run(*command: str) -> str:
        done = subprocess.run(
            [str(scripts / command[0]), *command[1:]],
            cwd=work,
            env=clean,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    run("python", "-m", "pip", "install", "-q", "-c", str(ROOT / "constraints.txt"), f"{package}[report]")
    assert run("hydro-env", "--version").strip() == f"hydro_env {__version__}"
    where = run("python", "-c", "import hydro_env; print(hydro_env.__file__)")
    assert Path(where.strip()).is_relative_to(tmp_path / "venv")
    run("hydro-env", "demo", "--out", "demo")
    assert "<svg" in (work / "demo" / "index.html").read_text(encoding="utf-8")
    assert json.loads((work / "demo" / "demo.json").read_text(encoding="utf-8"))["diagnosis"]
