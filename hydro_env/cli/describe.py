"""The command `describe`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hydro_env.cli.options import writing
from hydro_env.errors import InputError


def describe(
    sheet: Annotated[
        Path | None,
        Argument(metavar="[SHEET.yaml]", help="Data sheet of the rig. Without one, questions are asked."),
    ] = None,
    out: Annotated[Path | None, Option("--out", help="Folder to write to; created if needed.")] = None,
    empty: Annotated[
        bool, Option("--template", help="Print an empty data sheet with all keys, and end.")
    ] = False,
) -> None:
    """Make a model from data sheets.

    Valve, motor, supply, lines and oil as their data sheets print them. Shows the given data sheet beside the simulated one and
    what had to be assumed; writes model.yaml, describe.json and describe.txt, and after questions data_sheet.yaml.
    """
    from hydro_env import data_sheet
    from hydro_env.files import write_text

    if empty:
        print(data_sheet.template(), end="")
        return
    if out is None:
        raise InputError("Missing option '--out': the folder to write the model to")
    if sheet is None and not sys.stdin.isatty():
        raise InputError(
            "name a data sheet (`hydro-env describe --template` prints an empty one); questions need a terminal"
        )
    given, answers = (data_sheet.read_sheet(sheet), "") if sheet else data_sheet.ask(out / "data_sheet.yaml")
    with writing(out) as folder:
        if answers:
            write_text(folder / "data_sheet.yaml", answers)
        print(data_sheet.write(data_sheet.describe(given), folder))
