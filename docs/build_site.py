"""Builds the documentation site with Zensical: `python docs/build_site.py [OUT]`, by default into site/ (extra `docs`).

The pages are read from where they lie, and what is built is a copy of them in which

* the order is that of docs/index.md, which lists them all;
* the changelog and its like, which lie beside docs/ where GitHub looks for them, are pages, too;
* a notebook is a page like the others, with the outputs that `docs/run_notebooks.py` left in it, and can be downloaded;
* each public module has a page of its docstrings;
* of docs/evidence, which is for a checkout, only the results are there;
* links to source files lead to the repository (`repo_url` in docs/site.yml), or are plain text as long as there is none.

A warning, such as one of a link that leads nowhere, is an error.
"""

from __future__ import annotations

import posixpath
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import griffe
import yaml
from nbconvert import MarkdownExporter

DOCS = Path(__file__).parent
ROOT = DOCS.parent
#: Pages beside docs/.
OUTER = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
#: Modules whose public names are documented.
API = (
    "envs",
    "sb3",
    "multi_agent",
    "datasets",
    "tasks",
    "plant",
    "controllers",
    "controllers.base",
    "controllers.rollout",
    "benchmark.statistics",
    "measured",
    "diagnosis",
    "practice.generate",
    "valve_bench",
    "errors",
)
LINK = re.compile(r"(!?)\[((?:[^\]\\]|\\.)*)\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)")


def build(out: Path) -> None:
    """Builds the site into the folder `out`. CalledProcessError if Zensical warns."""
    settings = yaml.safe_load((DOCS / "site.yml").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pages = _pages(settings.get("repo_url"))
        for path, content in pages.items():
            (folder / "docs" / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / "docs" / path).write_bytes(content.encode() if isinstance(content, str) else content)
        settings["nav"] = _order(pages)
        (folder / "mkdocs.yml").write_text(
            yaml.safe_dump(settings).replace("$ROOT", ROOT.as_posix()), encoding="utf-8"
        )
        command = [sys.executable, "-m", "zensical", "build", "--strict", "-f", str(folder / "mkdocs.yml")]
        subprocess.run(command, cwd=folder, check=True)
        shutil.copytree(folder / "site", out, dirs_exist_ok=True)


def _pages(repository: str | None) -> dict[str, str | bytes]:
    """Everything that the site is built from, by its path there."""
    found: dict[str, str | bytes] = {}
    for path in sorted(DOCS.rglob("*")):
        place = path.relative_to(DOCS).as_posix()
        if place == "evidence/README.md":
            continue
        if path.suffix == ".ipynb":
            found |= {f"notebooks/{name}": content for name, content in _notebook(path).items()}
        if path.is_file() and path.suffix in (".md", ".ipynb", ".png", ".json", ".js"):
            found[place] = path.read_text(encoding="utf-8") if path.suffix == ".md" else path.read_bytes()
    found |= {name: (ROOT / name).read_text(encoding="utf-8") for name in OUTER}
    for place, content in found.items():
        if isinstance(content, str):
            found[place] = _linked(content, place, set(found), repository)
    package = griffe.load("hydro_env", search_paths=[ROOT], resolve_aliases=True)
    return found | {f"api/{module}.md": _api(package[module]) for module in API}


def _order(pages: dict[str, Any]) -> list[Any]:
    """The navigation: a section for each heading of the index with the pages that it lists first, then the API."""
    nav: list[Any] = [{"Home": "index.md"}]
    seen: set[str] = set()
    for section in re.split(r"^## ", pages["index.md"], flags=re.M)[1:]:
        heading, _, text = section.partition("\n")
        targets = dict.fromkeys(target for _, _, target, _ in LINK.findall(text))
        if listed := [target for target in targets if target.endswith(".md") and target not in seen]:
            nav.append({heading: listed})
            seen |= set(listed)
    nav.append({"API": [name for name in pages if name.startswith("api/")]})
    missing = {name for name in pages if name.endswith(".md")} - set(re.findall(r"[\w./]+\.md", str(nav)))
    if missing:
        raise SystemExit(f"docs/index.md does not list {', '.join(sorted(missing))}")
    return nav


def _notebook(path: Path) -> dict[str, str | bytes]:
    """A notebook as Markdown, and its pictures, by name."""
    text, resources = MarkdownExporter().from_filename(
        path, resources={"output_files_dir": f"{path.stem}_files", "unique_key": path.stem}
    )
    heading, _, rest = text.partition("\n")
    download = f'<a href="{path.name}" download>Download this notebook</a>'
    return {f"{path.stem}.md": f"{heading}\n\n{download}\n{rest}", **resources["outputs"]}


def _api(module: griffe.Module) -> str:
    """The functions and classes that a module's `__all__` lists, or else those of its own without an underscore. Sources are
    read, not imported: no other extra is needed."""
    lines = [
        f"# {module.path}",
        "",
        f"::: {module.path}",
        "    options: {members: false, show_root_heading: false}",
        "",
    ]
    own = [
        name for name, member in module.members.items() if not member.is_alias and not name.startswith("_")
    ]
    for name in map(str, module.exports or own):
        with suppress(griffe.AliasResolutionError):
            if module[name].is_class or module[name].is_function:
                lines += [f"::: {module.path}.{name}", ""]
    return "\n".join(lines)


def _linked(text: str, place: str, known: set[str], repository: str | None) -> str:
    """A page whose links lead to what their targets are on the site."""
    folder = posixpath.dirname(place)

    def link(found: re.Match[str]) -> str:
        picture, label, target, anchor = found[1], found[2], found[3], found[4] or ""
        # From the root of the repository, which lies above docs/.
        path = posixpath.normpath(posixpath.join("" if place in OUTER else "docs", folder, target))
        on_site = re.sub(r"\.ipynb$", ".md", path.removeprefix("docs/"))
        if on_site in known and (path in OUTER or path.startswith("docs/")):
            return f"{picture}[{label}]({posixpath.relpath(on_site, folder or '.')}{anchor})"
        if not (ROOT / path).exists():
            return found[0]  # which is a dead link, and a warning
        return f"[{label}]({repository}/blob/main/{path}{anchor})" if repository else label

    parts = re.split(r"(^```.*?^```)", text, flags=re.S | re.M)
    return "".join(part if part.startswith("```") else LINK.sub(link, part) for part in parts)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if sys.argv[1:] else ROOT / "site"
    try:
        build(target)
    except subprocess.CalledProcessError as problem:
        sys.exit(problem.returncode)
    print(f"Open {target / 'index.html'}")
