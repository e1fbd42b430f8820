"""Keeps the columns of a docstring on the site: names and what they mean, one to a line, would run together as Markdown."""

from __future__ import annotations

import re
from typing import Any

import griffe

#: A name, at least two spaces, and its meaning.
ROW = re.compile(r"^\S[^\n]*?\S {2,}\S", flags=re.M)


class DocstringColumns(griffe.Extension):
    """A paragraph of a docstring that begins with such a row becomes a block of text."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Called for each module, class, function and attribute."""
        if obj.docstring:
            paragraphs = obj.docstring.value.split("\n\n")
            obj.docstring.value = "\n\n".join(
                f"```text\n{each}\n```" if ROW.match(each) else each for each in paragraphs
            )
