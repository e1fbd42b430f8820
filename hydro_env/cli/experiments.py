"""The commands `demo`, `reproduce`, `speed`, `close-loop` and `pdf`, and `naming-benchmark` with make, run, play and score."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hydro_env.cli.help import HelpfulCommand, group_of_commands
from hydro_env.cli.options import Cells, Engine, Jobs, Out, Pictures, Seed, number, writing
from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text
from hydro_env.limits import Limits


def demo(out: Out, seed: Seed = 0, jobs: Jobs = 1) -> None:
    """Show what the package does, on one page.

    The paper's experiment, a leaderboard and one diagnosis; writes index.html and a folder for each part.
    """
    with writing(out) as folder:
        from hydro_env.experiments import demo as work

        work.run(folder, seed=seed, jobs=jobs)
    print(f"Open {out / 'index.html'} in a browser.")


def reproduce(out: Out, pictures: Pictures = True) -> None:
    """Run the paper's experiments.

    Fig. 2, 7 and 8; writes reproduce.json, traces.csv and figures.
    """
    with writing(out) as folder:
        from hydro_env.experiments import reproduce as work

        print(work.summary(work.run(folder, pictures=pictures).numbers))


def speed(
    out: Out,
    num_envs: Annotated[
        list[int] | None, number("Size of a batch; may be repeated. Default: 1 to 1024.", Limits(1, 2**20, whole=True))
    ] = None,
    seconds: Annotated[float, number("Measuring time for each figure.", Limits(0.05, 3600.0, unit="s"))] = 1.0,
) -> None:  # fmt: skip
    """Measure the speed and accuracy of the simulator.

    Writes speed.json.
    """
    with writing(out) as folder:
        from hydro_env.experiments import speed as work

        print(work.summary(work.run(folder, num_envs=num_envs or work.NUM_ENVS, seconds=seconds)))


def close_loop(
    out: Out,
    case: Annotated[list[str] | None, Option(help="Only this case; may be repeated.")] = None,
    seeds: Annotated[int, number("Hidden rigs per case.", Limits(1, 1000, whole=True))] = 2,
    engine: Engine = "local",
    jobs: Jobs = 1,
    cells: Cells = None,
    seed: Seed = 0,
) -> None:
    """Measure what a repaired model is worth to a controller.

    Hides effects, diagnoses, tunes controllers on the model as given, the repaired and the true model, and scores them on
    the hidden rigs; writes close_loop.json, close_loop.md, traces.json and the rigs' models.
    """
    with writing(out) as folder:
        from hydro_env.experiments import close_loop as work

        settings = work.Settings(tuple(case or work.CASES), seeds, seed)
        print(work.summary(work.run(folder, settings, cells=cells, jobs=jobs, engine=engine)))


def pdf(
    out: Out, pages: Annotated[list[Path], Argument(metavar="PAGE.html...", help="Pages that other commands have written.")]
) -> None:  # fmt: skip
    """Print pages of results as PDF.

    PAGE.pdf for each, printed by Chromium, Chrome or Edge, whichever is found, or by $CHROME.
    """
    with writing(out) as folder:
        from hydro_env.pages.pdf import to_pdf

        for page in pages:
            to_pdf(page, folder)


naming_benchmark = group_of_commands("Compare methods that name missing physics from logs.")

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
