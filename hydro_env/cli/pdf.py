"""The command `pdf`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from hydro_env.cli.options import Out, writing


def pdf(
    out: Out, pages: Annotated[list[Path], Argument(metavar="PAGE.html...", help="Pages that other commands have written.")]
) -> None:  # fmt: skip
    """Print pages of results as PDF.

    PAGE.pdf for each, printed by Chromium, Chrome or Edge, whichever is found, or by $CHROME.
    """
    with writing(out) as folder:
        from hydro_env.pages.pdf import to_pdf

        for page in pages:
            to_pdf(page, folder)
