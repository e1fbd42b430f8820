"""What is the same in all exported sources, with places for the rest."""

from pathlib import Path
from string import Template


def template(file: str) -> Template:
    """The file of this name in this folder; its places are like `${name}`."""
    return Template((Path(__file__).parent / file).read_text(encoding="utf-8"))
