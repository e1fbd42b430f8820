"""The command `hydro-env`: reads options, calls the function that does the work, reports errors in one line.

Every command writes to a hidden folder first, which becomes `--out` when the work is done, so that nothing
half-written is left behind. What a command needs is imported when it runs, after a look at `--out`: `--help` and
a wrong folder are answered at once.
"""

from hydro_env.cli.main import app, main, run

__all__ = ["app", "main", "run"]
