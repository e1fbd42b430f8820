"""The one error that users' input can cause."""

from __future__ import annotations

__all__ = ["InputError"]


class InputError(ValueError):
    """Input that cannot be used: one line that names the file, row or key and says what would be right.

    The command line prints it as `error: ...` and exits with status 2.
    """
