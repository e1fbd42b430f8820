"""`python -m docs.evidence.naming_methods`, see the package."""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

from agents.command import run_command
from hydro_env.errors import InputError, to_install
from hydro_env.experiments.naming_benchmark.methods import chosen, run_methods

from .methods import METHODS, SPARSE


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="naming_methods", description="Simple methods on a set of the naming benchmark."
    )
    add = parser.add_argument
    add("method", nargs="+", metavar="METHOD", help=f"{', '.join(METHODS)}, or all")
    add("--set", type=Path, required=True, metavar="DIR", dest="folder", help="folder of the set")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the answers")
    given = parser.parse_args()
    methods = chosen(given.method, METHODS)
    if any(name in methods for name in SPARSE) and find_spec("pysindy") is None:
        raise InputError(f"{' and '.join(SPARSE)} need pysindy: {to_install('naming')}")
    run_methods(methods, given.folder, given.out)
    print(f"Written to {given.out}: {', '.join(f'{name}/' for name in methods)}")


if __name__ == "__main__":
    run_command(main)
