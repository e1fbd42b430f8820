"""The commands in the order in which `--help` lists them."""

from __future__ import annotations

from typing import Annotated

import typer

from hydro_env import __version__
from hydro_env.cli.components import describe, valve_test
from hydro_env.cli.controllers import benchmark, tune
from hydro_env.cli.diagnosis import diagnose, hide
from hydro_env.cli.experiments import close_loop, demo, pdf, reproduce, speed
from hydro_env.cli.export import export
from hydro_env.cli.help import HelpfulCommand, HelpfulGroup
from hydro_env.cli.learning import dataset, train
from hydro_env.cli.listing import list_names
from hydro_env.cli.live import lab, live
from hydro_env.cli.naming_benchmark import naming_benchmark

app = typer.Typer(
    cls=HelpfulGroup,
    add_completion=False,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Synchronise two hydraulic motors, each driven by its own proportional valve.",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"hydro_env {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


for _command in (
    demo, describe, reproduce, valve_test, speed, tune, train, benchmark, dataset, hide, diagnose, lab, live, close_loop,
    pdf,
):  # fmt: skip
    app.command(_command.__name__.replace("_", "-"), cls=HelpfulCommand)(_command)
app.add_typer(export, name="export")
app.add_typer(naming_benchmark, name="naming-benchmark")
app.command("list", cls=HelpfulCommand)(list_names)
