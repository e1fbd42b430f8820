"""How a command of `python -m` ends by bad input, a full disk or an interruption."""

from __future__ import annotations

import sys
from collections.abc import Callable

from hydro_env.errors import InputError, stopped_by_signals


def run_command(work: Callable[[], None]) -> None:
    """Runs what a command of `python -m` does: bad input or a full disk end it with one line and status 2, Ctrl-C with 130,
    SIGTERM with 143."""
    signals: list[int] = []
    try:
        with stopped_by_signals() as signals:
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
        raise SystemExit(128 + signals[0] if signals else 130) from None
