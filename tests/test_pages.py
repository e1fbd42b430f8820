"""The shared look of the pages: offline, escaped, and pictures that take the page's colours."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from hydro_env.cli import main
from hydro_env.errors import InputWarning
from hydro_env.pages import beside_results, figure, fill, png, render, svg
from tests.browser import needs_browser


@pytest.fixture
def template(tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    path.write_text('{% extends "page.html" %}{% block body %}<p>{{ word }}</p>{{ picture }}{% endblock %}')
    return path


def test_page_escapes_and_loads_nothing(template: Path) -> None:
    drawing, (axis,) = figure()
    axis.plot([0, 1], [0, 1])
    axis.set_title("a < b")
    page = render(template, title="<b>", word="<script>", picture=svg(drawing, 'say "yes"'))
    assert "<title>&lt;b&gt;</title>" in page and "<p>&lt;script&gt;</p>" in page
    assert 'aria-label="say &#34;yes&#34;"' in page and page.count("<svg") == 1 and "a &lt; b" in page
    # Names of XML namespaces are no addresses that are loaded.
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", page.replace("xlink:href", ""))
    assert "@import" not in page and "url(http" not in page


def test_only_a_full_disk_is_more_than_a_missing_page(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    told = "page.html could not be made: KeyError: 'a <b>'"
    with pytest.warns(InputWarning, match=told), beside_results(page):
        raise KeyError("a <b>")
    assert "a &lt;b&gt;" in page.read_text()
    with pytest.raises(OSError, match="full"), beside_results(page):
        raise OSError("full")


def test_a_value_that_is_missing_is_an_error(template: Path) -> None:
    with pytest.raises(UndefinedError):
        render(template, title="t", word="w")


def test_pictures_take_the_ink_of_the_page() -> None:
    first, second = (figure(2) for _ in range(2))
    assert len(first[1]) == 2
    text = str(svg(first[0], "empty"))
    assert "#123456" not in text and "currentColor" in text
    assert text == str(svg(second[0], "empty")), "the same drawing must give the same page"


def test_png(tmp_path: Path) -> None:
    drawing, _ = figure()
    png(drawing, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "name", ["/*A*/null", "/*STYLE*/", "</script>", '"\\', "{{ 7*7 }}", "\\1", "\ud800", "\u2028"]
)
def test_a_text_stands_for_no_place_of_the_page(tmp_path: Path, name: str) -> None:
    template = tmp_path / "page.html"
    template.write_text("<style>/*STYLE*/</style><script>const A = /*A*/null, B = /*B*/null;</script>")
    page = fill(template, A={"name": name}, B=[name])
    script = page.partition("<script>")[2]
    first, end = json.JSONDecoder().raw_decode(script, len("const A = "))
    second, _ = json.JSONDecoder().raw_decode(script, end + len(", B = "))
    assert (first, second) == ({"name": name}, [name]) and page.count("</script>") == 1
    page.encode()


def test_a_name_with_dollars_is_no_formula(tmp_path: Path) -> None:
    drawing, (axis,) = figure()
    axis.plot([1, 10], [1, 10], label="$x_{$")
    axis.set(title="$\\frac$", xscale="log")
    axis.legend()
    text = str(svg(drawing, r"\1 \g<x>"))
    assert "$x_{$" in text and r'aria-label="\1 \g&lt;x&gt;"' in text
    assert (
        "$" not in text.replace("$x_{$", "").replace("$\\frac$", "").partition("<style")[0]
        or "mathdefault" not in text
    )
    png(drawing, tmp_path / "a.png")


# --- PDF -----------------------------------------------------------------------------------------------------------------
def print_pages(*pages: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["pdf", *map(str, pages), "--out", str(Path(str(pages[0])).parent / "out")])
    return int(ended.value.code or 0)


@needs_browser
def test_a_page_as_pdf_with_what_its_script_draws(tmp_path: Path) -> None:
    """On A4, with the picture as lines, not as an image of them."""
    page = tmp_path / "a page.html"
    drawn = "document.body.insertAdjacentHTML('beforeend', '<h2>' + ['drawn', 'later'].join('-') + '</h2>')"
    (tmp_path / "template.html").write_text(
        f'{{% extends "page.html" %}}{{% block body %}}{{{{ picture }}}}<script>{drawn}</script>{{% endblock %}}'
    )
    drawing, (axis,) = figure()
    axis.plot(range(100), range(100))
    page.write_text(render(tmp_path / "template.html", title="Report", picture=svg(drawing, "a line")))
    assert print_pages(page) == 0
    made = tmp_path / "out" / "a page.pdf"
    printed = made.read_bytes()
    assert printed.startswith(b"%PDF") and b"/Subtype /Image" not in printed
    width, height = map(float, re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed).groups())  # type: ignore[union-attr]
    assert (round(width), round(height)) == (595, 842)
    reader = shutil.which("pdftotext")
    if reader is not None:
        text = subprocess.run([reader, str(made), "-"], capture_output=True, text=True).stdout
        assert "Report" in text and "drawn-later" in text and "1/1" in text


@pytest.mark.parametrize(
    ("name", "browser", "says"),
    [
        ("page.json", None, "ends with .html"),
        ("nothing.html", None, "is no file"),
        ("page.html", "no-such-browser", "CHROME is 'no-such-browser'"),
        ("page.html", "false", "does not print it"),
        ("page.html", "", "install Chromium"),
    ],
)
def test_what_cannot_be_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, browser: str | None, says: str
) -> None:  # fmt: skip
    for each in ("page.html", "page.json"):
        (tmp_path / each).write_text("<p>text</p>")
    if browser is not None:
        monkeypatch.setenv("CHROME", browser)
    if browser == "":
        monkeypatch.setenv("PATH", str(tmp_path))
    assert print_pages(tmp_path / name) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and says in said and not (tmp_path / "out").exists()
