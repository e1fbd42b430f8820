"""An HTML page as PDF, printed by a browser of this machine: it runs the page's script, and needs no library."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from hydro_env.errors import InputError
from hydro_env.files import write_bytes

_NAMES = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge", "microsoft-edge",
)  # fmt: skip
#: Where browsers lie that are on no path: macOS and Windows.
_PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)
#: What a page may take, s; its script is given this much of its own time, ms.
_LIMIT, _SCRIPT = 120.0, 10_000


def to_pdf(page: Path, folder: Path) -> Path:
    """Prints a page to a PDF of its name in a folder, and returns that. InputError if there is no such page or no browser
    ($CHROME, else Chromium, Chrome or Edge), and if the browser fails."""
    if page.suffix.lower() not in (".html", ".htm") or not page.is_file():
        raise InputError(f"{page}: is no file of a page; one that ends with .html is right")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as room:
        made = Path(room) / "page.pdf"
        command = [
            _browser(), "--headless", "--disable-gpu", "--no-pdf-header-footer", f"--virtual-time-budget={_SCRIPT}",
            f"--user-data-dir={room}/profile", f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        if sys.platform != "win32" and os.geteuid() == 0:  # Chromium has no sandbox for root
            command.insert(1, "--no-sandbox")
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT, check=False)
        except subprocess.TimeoutExpired:
            raise InputError(f"{page}: {command[0]} has not printed it after {_LIMIT:g} s") from None
        except OSError as problem:
            why = f"{problem.strerror}; a Chromium, Chrome or Edge is right"
            raise InputError(f"CHROME is {command[0]!r}: {why}") from None
        if not made.is_file():
            said = done.stderr.strip().splitlines() or [f"exit status {done.returncode}"]
            raise InputError(f"{page}: {command[0]} does not print it: {said[-1]}")
        target = folder / f"{page.stem}.pdf"
        write_bytes(target, made.read_bytes())
    return target


def _browser() -> str:
    found = [os.environ.get("CHROME"), *map(shutil.which, _NAMES), *filter(os.path.isfile, _PLACES)]
    browser = next(filter(None, found), None)
    if browser is None:
        raise InputError("no browser prints the page: install Chromium, Chrome or Edge, or set CHROME to one")
    return browser
