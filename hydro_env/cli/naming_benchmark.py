"""The command `naming-benchmark`: make, run, play, score."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hydro_env.cli.help import HelpfulCommand, HelpfulGroup
from hydro_env.cli.options import Out, Seed, number, writing
from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text
from hydro_env.limits import Limits

naming_benchmark = typer.Typer(
    cls=HelpfulGroup,
    rich_markup_mode=None,
    no_args_is_help=True,
    help="Compare methods that name missing physics from logs.",
)

Set = Annotated[Path, Option("--set", metavar="DIR", help="Folder of the set.")]


@naming_benchmark.command(cls=HelpfulCommand)
def make(
    out: Out,
    rigs: Annotated[int, number("Rigs of the set.", Limits(1, 10_000, whole=True))] = 40,
    seed: Seed = 0,
    ask: Annotated[bool, Option("--ask", help="Rigs that may be asked, within a budget.")] = False,
) -> None:
    """Make a set of rigs with hidden effects.

    Writes logs and models of the rigs, and their truth in a folder of its own, whose digest is in set.json; a stopped run
    continues.
    """
    from hydro_env.experiments.naming_benchmark.sets import make_set

    make_set(out, rigs, seed, ask)
    print(f"Written to {out}: rigs/ for the methods, truth/ for scoring alone")


@naming_benchmark.command(cls=HelpfulCommand)
def run(
    method: Annotated[list[str], Argument(metavar="METHOD...", help="diagnose, calibrate, ask, or all.")],
    set_folder: Set,
    out: Out,
) -> None:
    """Run methods that ship on a set.

    Writes a folder of answers for each method; a stopped run continues. Where the set comes without its truth, `ask` writes
    questions: run it again when they are answered.
    """
    from hydro_env.experiments.naming_benchmark.methods import METHODS, chosen, run_methods

    methods = chosen(method, METHODS)
    run_methods(methods, set_folder, out)
    print(f"Written to {out}: {', '.join(f'{name}/' for name in methods)}")


@naming_benchmark.command(cls=HelpfulCommand)
def play(
    answers: Annotated[Path, Argument(metavar="ANSWERS", help="Folder of a method, with questions.")],
    set_folder: Set,
) -> None:
    """Answer the questions of a method with logs.

    Writes them beside the questions, as far as the budget of each rig goes.
    """
    from hydro_env.experiments.naming_benchmark import dialogue

    print(f"{answers}: {dialogue.play(set_folder, answers)} questions answered")


@naming_benchmark.command(cls=HelpfulCommand)
def score(
    answers: Annotated[list[Path], Argument(metavar="ANSWERS...", help="Folders of answers, one a method.")],
    set_folder: Set,
    out: Out,
    first: Annotated[int | None, number("Only the first N rigs.", Limits(1, 10_000, whole=True))] = None,
) -> None:  # fmt: skip
    """Score answers against the truth.

    Writes naming.json and naming.md; the first method is compared with the others.
    """
    from hydro_env.experiments.naming_benchmark import scoring

    methods = {path.resolve().name: path for path in answers}
    if len(methods) < len(answers):
        raise InputError("two folders of answers have the same name; a folder's name is that of its method")
    with writing(out) as folder:
        scores = scoring.score(set_folder, methods, first)
        write_json(folder / "naming.json", scores)
        text = scoring.table(scores)
        write_text(folder / "naming.md", text + "\n")
        print(text)
