"""The picture of docs/howto/use_the_lab.md: `python -m tests.lab.picture FILE.png`, the page of a lab that has run for 20 s.

Needs Playwright (extra `dev`) and Chromium or Chrome.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from tests.browser import BROWSER
from tests.lab.server import served

SIZE = {"width": 1280, "height": 1080}
MILLISECONDS = 20_000


def main(file: str) -> None:
    if BROWSER is None:
        raise SystemExit("no Chromium or Chrome on the path")
    with (
        tempfile.TemporaryDirectory() as name,
        sync_playwright() as driver,
        served(Path(name) / "out", Path(name) / "temporary") as (_, port, key),
    ):
        browser = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
        page.goto(f"http://127.0.0.1:{port}/?key={key}")
        page.wait_for_selector(".lab-motors")
        page.wait_for_timeout(MILLISECONDS)
        page.screenshot(path=file)
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1])
