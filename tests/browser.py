"""What a page shows once its script has run, in a headless browser where the machine has one."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None
)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="needs Chromium or Chrome")


def shown(page: Path, profile: Path, *options: str) -> str:
    """The document after its script, without the scripts themselves. AssertionError if a script failed."""
    assert BROWSER is not None
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--log-level=0",
        "--virtual-time-budget=2000", f"--user-data-dir={profile}", *options, "--dump-dom", page.resolve().as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "Uncaught" not in done.stderr, done.stderr
    before, _, rest = done.stdout.partition("<script")
    return before + rest.partition("</script>")[2]
