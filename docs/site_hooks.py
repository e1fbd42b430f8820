"""What MkDocs does not know by itself about these pages (`hooks` in mkdocs.yml).

* The order of the pages is that of docs/index.md, which lists them all.
* The changelog and its like lie beside docs/, where GitHub looks for them; the site has them too.
* A notebook becomes a page like the others, with the outputs that `docs/run_notebooks.py` left in it, and can be downloaded.
* The API reference is one page for each public module, made from docstrings.
* Links to source files lead to the repository (`repo_url`), or are plain text as long as there is none.
"""

from __future__ import annotations

import posixpath
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[1]
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


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that lie outside docs/ and those of the API, and puts all in the order of docs/index.md."""
    for name in OUTER:
        files.append(File.generated(config, name, content=(ROOT / name).read_text(encoding="utf-8")))
    package = griffe.load("hydro_env", search_paths=[ROOT], resolve_aliases=True)
    pages = {f"api/{module}.md": _api_page(package[module]) for module in API}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for notebook in sorted(Path(config.docs_dir, "notebooks").glob("*.ipynb")):
        for name, content in _notebook_page(notebook).items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    index = Path(config.docs_dir, "index.md").read_text(encoding="utf-8")
    nav: list[Any] = [{"Home": "index.md"}]
    for section in re.split(r"^## ", index, flags=re.M)[1:]:
        heading, _, text = section.partition("\n")
        linked = [_on_site(target.removeprefix("../")) for _, _, target, _ in LINK.findall(text)]
        if listed := [target for target in dict.fromkeys(linked) if target.endswith(".md")]:
            nav.append({heading: listed})
    nav.append({"API": list(pages)})
    config.nav = nav
    return files


def _api_page(module: griffe.Module) -> str:
    """The functions and classes that a module's `__all__` lists. Sources are read, not imported: no other extra is needed."""
    lines = [
        f"# {module.path}",
        "",
        f"::: {module.path}",
        "    options: {members: false, show_root_heading: false}",
        "",
    ]
    for name in map(str, module.exports or ()):
        with suppress(griffe.AliasResolutionError):
            if module[name].is_class or module[name].is_function:
                lines += [f"::: {module.path}.{name}", ""]
    return "\n".join(lines)


def _notebook_page(path: Path) -> dict[str, str | bytes]:
    """A notebook as Markdown, and its pictures, by name."""
    text, resources = MarkdownExporter().from_filename(
        path, resources={"output_files_dir": f"{path.stem}_files", "unique_key": path.stem}
    )
    heading, _, rest = text.partition("\n")
    download = f'<a href="{path.name}" download>Download this notebook</a>'
    return {f"{path.stem}.md": f"{heading}\n\n{download}\n{rest}", **resources["outputs"]}


def _on_site(path: str) -> str:
    return path.removesuffix(".ipynb") + ".md" if path.endswith(".ipynb") else path


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links that leave docs/ into what they are on the site."""
    folder = posixpath.dirname(page.file.src_uri)
    inner = page.file.src_uri not in OUTER

    def link(found: re.Match[str]) -> str:
        picture, text, target, anchor = found[1], found[2], found[3], found[4] or ""
        # From the root of the repository, which lies above docs/.
        path = posixpath.normpath(posixpath.join("docs" if inner else "", folder, target))
        on_site = _on_site(path.removeprefix("docs/"))
        if path in OUTER or (path.startswith("docs/") and files.get_file_from_path(on_site)):
            return f"{picture}[{text}]({posixpath.relpath(on_site, folder or '.')}{anchor})"
        if not (ROOT / path).exists():
            return found[0]  # MkDocs says that it leads nowhere
        return f"[{text}]({config.repo_url}/blob/main/{path}{anchor})" if config.repo_url else text

    parts = re.split(r"(^```.*?^```)", markdown, flags=re.S | re.M)
    return "".join(part if part.startswith("```") else LINK.sub(link, part) for part in parts)
