"""`hydro-env lab` as a process, for tests of the server and of the page in a browser."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def served(out: Path, temporary: Path) -> Iterator[tuple[subprocess.Popen[str], int, str]]:
    """The process, its port and its key; `temporary` is made, for its temporary files."""
    temporary.mkdir()
    command = [sys.executable, "-m", "hydro_env", "lab", "--no-browser", "--port", "0", "--out", str(out)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(temporary)},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        address = re.search(r"http://127\.0\.0\.1:(\d+)/\?key=(\S+)", process.stdout.readline())
        assert address is not None
        yield process, int(address[1]), address[2]
    finally:
        process.kill()
        process.communicate()
