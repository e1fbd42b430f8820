"""The documents: generated parts are up to date; what a page names exists; what it claims and no command prints is true."""

from __future__ import annotations

import importlib
import inspect
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from hydro_env.envs.batch import OPTIONS, HydraulicSyncVectorEnv
from hydro_env.experiments.reproduce import SETPOINT_STEPS, run_paper
from hydro_env.plant import load_model

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GENERATE = runpy.run_path(str(DOCS / "generate.py"))
PAGES: list[Path] = [
    *GENERATE["pages"](),
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "hydro_env").rglob("*.md")),
]
COMMANDS: dict[str, Any] = GENERATE["_commands"]()


def names(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.fixture(params=PAGES, ids=names)
def page(request: pytest.FixtureRequest) -> Path:
    return request.param


def anchors(text: str) -> set[str]:
    """The anchors of a page's headings, as GitHub and others make them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.S), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_generated_parts(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == GENERATE["filled"](text), "out of date: run `python docs/generate.py`"


def test_an_extra_is_installed_from_the_sources(page: Path) -> None:
    """The package is on no index: whoever reads of an extra finds the line that works in a checkout, or the page that has it."""
    text = re.sub(r"<!-- generated:.*?<!-- end -->", "", page.read_text(encoding="utf-8"), flags=re.S)
    if page.parent.name == "docs" or re.search(r"extra\b[^.\n]{0,40} `\w+`", text) is None:
        return
    assert "install -c constraints.txt" in text or "extras.md" in text


def test_the_environments_page_names_every_argument() -> None:
    pages = (DOCS / name for name in ("reference/environment.md", "howto/your_own_task.md"))
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    arguments = [*inspect.signature(HydraulicSyncVectorEnv.__init__).parameters][1:]
    for name in (*arguments, *OPTIONS, "final_obs", "base", "meant_for"):
        assert re.search(rf"\b{name}\b", text), name


def test_nothing_says_to_install_from_an_index() -> None:
    files = [path for folder in ("hydro_env", "agents", "docs") for path in (ROOT / folder).rglob("*.*")]
    for path in [*files, ROOT / "README.md", ROOT / "CONTRIBUTING.md"]:
        if path.suffix in (".py", ".md", ".ipynb", ".html", ".js", ".yml", ".yaml"):
            assert not re.search(r"install ['\"]?hydro_env\b", path.read_text(encoding="utf-8")), path


#: Texts that are about the paper's rig, whatever rig is driven.
ABOUT_THE_PAPER = (
    "reproduce",
    "demo",
    "parameters",
    "paper",
    "paper_dead_zone",
    "valve_1",
)


def test_no_text_presupposes_the_papers_valves() -> None:
    """What is shown for any rig does not state the rated voltage, current or flow of one."""
    numbers = re.compile(
        r"\b73(&nbsp;| )?V\b|\b730 ?mA|rated flow (of both valves|is 49 l/min)|V on the paper's valves"
    )
    for path in (
        path for path in (ROOT / "hydro_env").rglob("*") if path.suffix in (".py", ".html", ".js", ".yaml")
    ):
        if path.stem not in ABOUT_THE_PAPER:
            text = re.sub(r"^\s*#.*$", "", path.read_text(encoding="utf-8"), flags=re.M)
            assert not numbers.search(text), path
    for name in (
        "howto/score_a_controller.md",
        "howto/write_a_controller.md",
        "howto/use_the_lab.md",
        "howto/measure_valves.md",
        "reference/environment.md",
    ):
        assert not numbers.search((DOCS / name).read_text(encoding="utf-8")), name


def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file.read_text(encoding="utf-8")), target


def test_the_index_lists_every_page() -> None:
    """The site takes its order from there."""
    listed = set(re.findall(r"\]\(([^)#]+)\)", (DOCS / "index.md").read_text(encoding="utf-8")))
    pages = [path for path in (*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")) if path.parent.name != "evidence"]
    assert not {path.relative_to(DOCS).as_posix() for path in pages} - {*listed, "index.md"}


def test_named_files_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:hydro_env|agents|configs|tests|docs)/(?!\w+/\d+`)[\w./-]*)`", text):
        assert (ROOT / path).exists(), path


def test_named_modules_exist(page: Path) -> None:
    """`hydro_env.x.y` is a module or a name in one; so is what stands behind `python -m`."""
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m ((?:hydro_env|agents|docs)[\w.]*)", text):
        assert importlib.util.find_spec(module), module
    for name in re.findall(r"`(hydro_env(?:\.\w+)+)", text):
        module, rest = name, []
        while True:
            try:
                found: Any = importlib.import_module(module)
                break
            except ModuleNotFoundError:
                module, _, last = module.rpartition(".")
                rest.insert(0, last)
        for each in rest:
            assert hasattr(found, each), name
            found = getattr(found, each)


def test_named_commands_and_options_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    for command, rest in re.findall(
        r"hydro-env ((?:export|naming-benchmark) [a-z]+|[a-z][a-z-]+)([^\n`|#]*)", text
    ):
        assert command in COMMANDS, command
        known = {opt for p in COMMANDS[command].params for opt in (*p.opts, *p.secondary_opts)} | {"--help"}
        assert set(re.findall(r"(?<=\s)--[a-z-]+", rest)) <= known, f"hydro-env {command}{rest}"


def test_sentences_are_short(page: Path) -> None:
    """No sentence has more than 40 words; tables and code aside."""
    text = re.sub(
        r"```.*?```|^\|.*$|^#.*$|^<!--.*$", "\n\n", page.read_text(encoding="utf-8"), flags=re.S | re.M
    )
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    for sentence in re.split(r"(?<=[.:!?])\s+|\n\n|\n\s*[*\d]", text):
        assert len(sentence.split()) <= 40, sentence


def test_pages_named_in_the_code_exist() -> None:
    for folder in ("hydro_env", "agents", "configs", "tests"):
        for file in (path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".yml", ".yaml")):
            for name in re.findall(r"docs/[\w/]+\.(?:md|json|png|py)\b", file.read_text(encoding="utf-8")):
                assert (ROOT / name).exists(), f"{file.relative_to(ROOT)}: {name}"


@pytest.mark.parametrize("tutorial", sorted((DOCS / "tutorials").glob("*.md")), ids=names)
def test_python_of_the_tutorials(tutorial: Path) -> None:
    scope: dict[str, Any] = {"__name__": "tutorial"}
    for block in re.findall(r"```python\n(.*?)```", tutorial.read_text(encoding="utf-8"), flags=re.S):
        exec(compile(block, tutorial.name, "exec"), scope)


@pytest.mark.parametrize(
    "name",
    [
        "howto/describe_your_rig.md",
        "howto/write_a_controller.md",
        "howto/your_own_task.md",
        "reference/environment.md",
    ],
)
def test_python_of_the_guides(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (DOCS / name).read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.S):
        exec(compile(block, name, "exec"), {"__name__": "guide"})


def test_the_model_file_of_the_guide(tmp_path: Path) -> None:
    text = (DOCS / "howto" / "describe_your_rig.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(schema: hydro_env/model/1.*?)```", text, flags=re.S)
    (tmp_path / "model.yaml").write_text(example, encoding="utf-8")
    assert load_model(tmp_path / "model.yaml").value("dead_zone.overlap_negative", 0) == 6e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "paper_dead_zone"])
def test_the_volume_hardly_matters(name: str) -> None:
    volumes = {"V": [[1e-4, 1e-4], [1e-3, 1e-3]]}
    peaks = run_paper(load_model(name), SETPOINT_STEPS, values=volumes, num_rigs=2).peak
    text = (DOCS / "explanation" / "paper.md").read_text(encoding="utf-8")
    said = re.search(rf"from ([\d.]+) to ([\d.]+) rpm on `{name}`", text)
    assert said is not None
    assert [round(peak, 1) for peak in peaks] == [float(number) for number in said.groups()]


def test_the_printed_readings_of_kq_agree() -> None:
    """At 730 mA the spool stands at 0.86 mm, which gives 24.5 l/min on V1."""
    model = load_model("paper")
    spool = model.value("alpha", 0) * 0.73 / model.value("k", 0)
    assert round(spool * 1e3, 2) == 0.86
    assert round(model.value("Kq", 0) * spool * 60e3, 1) == 24.5
