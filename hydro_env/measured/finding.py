"""One thing the data gate noticed about a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Finding"]


@dataclass(frozen=True)
class Finding:
    """A warning about a log, for the report; what cannot be used at all is an `InputError` instead.

    `code` is a stable name; `message` says what was seen, `suggestion` what would be right; `signal` and `channel`
    (1 or 2) say where in the rig, `column` and `row` (line of the file) where in the file, as far as known.
    """

    code: str
    message: str
    suggestion: str = ""
    signal: str | None = None
    channel: int | None = None
    column: str | None = None
    row: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)
