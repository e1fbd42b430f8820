"""What is installed: the wheel holds hydro_env and its data only, and the core needs none of the extras."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

from hydro_env import __version__
from hydro_env.training.recipes import RECIPES

ROOT = Path(__file__).parents[2]

OPTIONAL = (
    "torch", "stable_baselines3", "sb3_contrib", "onnx", "onnxruntime", "tensorboard", "plotly", "jinja2", "matplotlib",
    "pandas", "pyarrow", "asammdf", "nptdms", "h5py", "pygame", "PIL", "moviepy", "ray", "minari", "pettingzoo",
    "fmpy", "nicegui", "fastapi", "asyncua", "agents",
)  # fmt: skip
"""No module of the core may import these when it is imported."""

NEEDS_EXTRA = (
    "hydro_env.sb3",
    "hydro_env.multi_agent",
    "hydro_env.training.",
    "hydro_env.lab.elements",
    "hydro_env.lab.guard",
    "hydro_env.lab.live_page",
    "hydro_env.lab.page",
    "hydro_env.lab.diagnosis_page",
    "hydro_env.lab.server",
    "hydro_env.__main__",
)
"""Modules that exist to be imported with an extra, or that run when imported."""


def run(code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=cwd, capture_output=True, text=True, check=False)


def test_the_workflow_tries_the_lowest_and_the_newest_versions() -> None:
    job = yaml.safe_load((ROOT / ".github" / "workflows" / "test.yml").read_text())["jobs"]["versions"]
    tried = {(each["python"], each["versions"]) for each in job["strategy"]["matrix"]["include"]}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (project["requires-python"].removeprefix(">="), "lowest-direct") in tried
    assert ("3.13", "highest") in tried
    assert job["steps"][-1]["run"] == ".ci/versions ${{ matrix.versions }}"
    assert (ROOT / ".ci" / "versions").stat().st_mode & 0o111
    # Without a bound the lowest version is the first ever published.
    assert all(">=" in each for each in project["dependencies"])


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = folder.glob("*.whl")
    assert path.name == f"hydro_env-{__version__}-py3-none-any.whl"
    with zipfile.ZipFile(path) as archive:
        return archive.namelist()


def test_wheel_holds_hydro_env_only(wheel: list[str]) -> None:
    others = [
        name for name in wheel if not name.startswith(("hydro_env/", f"hydro_env-{__version__}.dist-info/"))
    ]
    assert not others
    assert not [name for name in wheel if "__pycache__" in name or name.endswith((".nbi", ".nbc", ".pyc"))]


def test_wheel_holds_every_data_file(wheel: list[str]) -> None:
    source = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "hydro_env").rglob("*")
        if path.is_file()
        and path.suffix in {".py", ".typed", ".yaml", ".json", ".npz", ".html", ".css", ".c", ".js"}
    }
    assert "hydro_env/py.typed" in source and "hydro_env/plant/presets/paper.yaml" in source
    source |= {f"hydro_env/training/recipes/{name}.yml" for name in RECIPES}
    assert source <= set(wheel)
    assert any(name.endswith("licenses/LICENSE") for name in wheel)


def test_readme_on_the_package_index_has_addresses(tmp_path: Path) -> None:
    """With an address in `project.urls` every link of the README leads to a file of the repository; without one it stays."""
    for name in ("README.md", "hatch_build.py", "LICENSE", "hydro_env/__init__.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    source = "https://example.org/hydro_env"

    def links(extra: str) -> list[str]:
        (tmp_path / "pyproject.toml").write_text(f"{project}\n{extra}", encoding="utf-8")
        command = [sys.executable, "-m", "hatchling", "metadata"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        return re.findall(r"\]\(([^)]+)\)", json.loads(done.stdout)["readme"]["text"])

    plain, absolute = links(""), links(f'[project.urls]\nSource = "{source}"')
    assert plain == re.findall(r"\]\(([^)]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(absolute) == len(plain) > 5
    for link in absolute:
        place, _, path = link.removeprefix(f"{source}/").partition("/main/")
        assert place in ("raw", "blob") and (ROOT / path.partition("#")[0]).is_file(), link


def test_core_imports_without_the_extras(tmp_path: Path) -> None:
    code = f"""
import importlib, importlib.abc, pkgutil, sys

class Block(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OPTIONAL!r}:
            raise ModuleNotFoundError(f"{{name}} is blocked", name=name)

sys.meta_path.insert(0, Block())
import hydro_env
for module in pkgutil.walk_packages(hydro_env.__path__, "hydro_env."):
    if not module.name.startswith({NEEDS_EXTRA!r}):
        importlib.import_module(module.name)
import gymnasium
env = gymnasium.make("hydro_env:HydraulicSync-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
"""
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_import_is_light(tmp_path: Path) -> None:
    code = "import sys, hydro_env; print([name for name in ('numba', 'scipy', 'pydantic') if name in sys.modules])"
    done = run(code, tmp_path)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_command_line_answers_without_loading_the_simulator(tmp_path: Path) -> None:
    code = "import sys, hydro_env.cli; print([name for name in ('numba', 'scipy', 'pydantic') if name in sys.modules])"
    done = run(code, tmp_path)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_every_constraint_is_a_plain_pin() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert "torch==2.13.0" in lines
    pinned = set()
    for line in lines:
        name, equals, version = line.partition("==")
        assert equals and name.replace("-", "").isalnum() and version.replace(".", "").isalnum(), line
        pinned.add(name)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [
        *project["dependencies"],
        *(each for extra in project["optional-dependencies"].values() for each in extra),
    ]
    names = {re.split(r"[^A-Za-z0-9_-]", each)[0].lower().replace("_", "-") for each in wanted}
    assert names - {"hydro-env"} <= pinned


def test_the_licence_of_every_pinned_package_is_listed() -> None:
    rows = json.loads((ROOT / "docs" / "licences.json").read_text(encoding="utf-8"))
    listed = [f"{name}=={version}" for name, version, licence in rows if licence]
    assert listed == (ROOT / "constraints.txt").read_text().splitlines()


def test_the_citation_has_the_version_of_the_package() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert f"version = {{{__version__}}}" in (ROOT / "docs" / "reference" / "protocol.md").read_text(
        encoding="utf-8"
    )
