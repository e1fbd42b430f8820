"""The command `dataset`."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from hydro_env.cli.options import ControlPeriod, Out, Plant, Seed, number, writing
from hydro_env.limits import Limits


def dataset(
    out: Out,
    controller: Annotated[list[str] | None, Option(
        help="Who drives: random, or what `benchmark` takes; may be repeated. Default: random, pid_tuned, probing_flow, gru, "
        "oracle."
    )] = None,
    split: Annotated[
        list[str] | None, Option(help="Split of valve pairs; may be repeated. Default: train and test_interp.")
    ] = None,
    scenario: Annotated[str, Option(help="Scenario.")] = "random_steps",
    episodes: Annotated[int, number("Episodes of each data set.", Limits(1, 1_000_000, whole=True))] = 100,
    plant: Plant = "paper_dead_zone",
    control_period: ControlPeriod = 0.01,
    seed: Seed = 0,
    trust: Annotated[bool, Option("--trust", help="Use files that can run code, as for `benchmark`.")] = False,
) -> None:  # fmt: skip
    """Record data sets for offline learning (needs the extra `dataset`).

    Writes one Minari data set per controller and split; --out is a folder for MINARI_DATASETS_PATH. Nothing is overwritten.
    """
    with writing(out) as folder:
        from tqdm import tqdm

        from hydro_env import datasets

        tasks = [
            datasets.Task(who, which, scenario, episodes, plant, control_period, seed, trust)
            for who in controller or datasets.CONTROLLERS
            for which in split or datasets.SPLITS_RECORDED
        ]
        datasets.check(tasks, out)
        with tqdm(total=len(tasks) * episodes, unit="episode", leave=False, delay=0.5) as bar:
            for before, task in enumerate(tasks):
                bar.set_description(task.id, refresh=False)
                for done in datasets.write(folder, task):
                    bar.update(before * episodes + done - bar.n)
    for task in tasks:
        print(f"{task.id}: {task.episodes} episodes")
