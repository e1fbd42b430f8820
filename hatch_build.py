"""The README as the package index shows it: links into the repository become addresses, if `project.urls` has its `Source`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface


class ReadmeWithAddresses(MetadataHookInterface):
    """Called by hatchling (`tool.hatch.metadata.hooks.custom`) when a wheel or source archive is built."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Sets the readme in the metadata of the package."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        if source := metadata.get("urls", {}).get("Source"):
            text = with_addresses(text, source)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def with_addresses(text: str, source: str) -> str:
    """A page whose links to files are addresses in the repository at `source`, pictures in their raw form."""
    text = re.sub(r"!\[([^]]*)\]\((?!https?:|#)([^)]+)\)", rf"![\1]({source}/raw/main/\2)", text)
    return re.sub(r"(?<!!)\[([^]]*)\]\((?!https?:|#)([^)]+)\)", rf"[\1]({source}/blob/main/\2)", text)
