"""The commands `demo`, `reproduce`, `speed`, `close-loop` and `pdf`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hydro_env.cli.options import Cells, Engine, Jobs, Out, Pictures, Seed, number, writing
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
        from hydro_env.experiments.close_loop_summary import summary

        settings = work.Settings(tuple(case or work.CASES), seeds, seed)
        print(summary(work.run(folder, settings, cells=cells, jobs=jobs, engine=engine)))


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
