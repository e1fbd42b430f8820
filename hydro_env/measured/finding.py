"""One thing the data gate noticed about a log."""

from dataclasses import dataclass
from typing import Any

#: Codes of findings about how a file is written, not about what it holds.
SPELLING = frozenset({
    "delimiter", "decimal_comma", "encoding", "no_names", "preamble", "si_suffixes", "units_row", "time_stamps", "epoch_time",
    "unknown_column", "coarse", "from_position",
})  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """A warning about a log, for the report; what cannot be read at all is an `InputError` instead.

    `code` is a stable name; `message` says what was seen, `suggestion` what would be right; `signal` and `channel`
    (1 or 2) say where in the rig, `column` and `row` (line of the file) where in the file, as far as known. `sure`: no
    rig records such a thing rightly, so a diagnosis of the log would be one of the mistake. `fix` says what a mapping
    would have to say instead, by channel and signal, where that is known: {"channel_2": {"speed": {"sign": -1}}}.
    """

    code: str
    message: str
    suggestion: str = ""
    signal: str | None = None
    channel: int | None = None
    column: str | None = None
    row: int | None = None
    sure: bool = False
    fix: dict[str, Any] | None = None

    @property
    def text(self) -> str:
        """Message and suggestion in one line."""
        if not self.suggestion:
            return self.message
        mark = "" if self.message.endswith("?") else ";"  # after a question comes a new sentence
        return f"{self.message}{mark} {self.suggestion}"
