"""The documentation site (extra `docs`) is built without a warning, has no dead link and needs no network."""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.slow


class _Page(HTMLParser):
    """What a page refers to, what it fetches, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {key: value or "" for key, value in attrs}
        self.anchors |= {found[key] for key in ("id", "name") if key in found}
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        if "src" in found or (tag == "link" and "href" in found):
            self.fetched.append(found.get("src") or found["href"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("zensical")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "docs/build_site.py", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "No issues found" in done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, _Page]:
    found = {
        path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if path.stem != "404"
    }
    assert len(found) > 40
    return found


def test_no_link_is_dead(site: Path, pages: dict[Path, _Page]) -> None:
    for path, page in pages.items():
        for link in [*page.links, *page.fetched]:
            if re.match(r"(https?|mailto|data):", link):
                continue
            target, anchor = urldefrag(unquote(link))
            file = (path.parent / target).resolve() if target else path
            file = file / "index.html" if file.is_dir() else file
            assert file.is_relative_to(site) and file.is_file(), f"{path.relative_to(site)}: {link}"
            if anchor and file in pages:
                assert anchor in pages[file].anchors, f"{path.relative_to(site)}: {link}"


def test_nothing_comes_from_the_network(pages: dict[Path, _Page]) -> None:
    assert not {each for page in pages.values() for each in page.fetched if re.match(r"(https?:)?//", each)}


def test_it_can_be_searched_from_the_disk(site: Path) -> None:
    index = (site / "search.js").read_text(encoding="utf-8")
    for words in ("HydraulicSyncParallelEnv", "narrowing_edge", "learn_from_recorded_data.html"):
        assert words in index
    assert any("iframe-worker" in path.name for path in (site / "assets").iterdir())
