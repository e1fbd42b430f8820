"""The command `pdf`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

__all__ = ["pdf"]


def pdf(
    pages: Annotated[
        list[Path], Argument(metavar="PAGE.html...", help="Pages that other commands have written.")
    ],
) -> None:
    """Print pages of results as PDF.

    PAGE.pdf is written beside each page, by Chromium, Chrome or Edge, whichever is found, or by $CHROME.
    """
    from hydro_env.pages.pdf import to_pdf

    for page in pages:
        print(f"Written: {to_pdf(page)}")
