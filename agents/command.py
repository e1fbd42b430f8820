"""How every command of this folder ends: bad input or a full disk in one line and status 2, Ctrl-C with status 130."""

from __future__ import annotations

import sys
from collections.abc import Callable

from hydro_env.errors import InputError

__all__ = ["run_command"]


def run_command(work: Callable[[], None]) -> None:
    """Runs the work of a command line."""
    try:
        work()
    except InputError as problem:
        print(f"error: {problem}", file=sys.stderr)
        raise SystemExit(2) from None
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename else ""
        print(f"error: {where}{problem.strerror or problem}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("stopped; the same command goes on with what is not finished", file=sys.stderr)
        raise SystemExit(130) from None
