"""The commands `train` and `dataset`."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Annotated

from typer import Option

from hydro_env.cli.options import ControlPeriod, Out, Plant, Seed, number, writing
from hydro_env.errors import InputError
from hydro_env.limits import SEEDS, Limits


def train(
    out: Out,
    algo: Annotated[
        str | None, Option(help="Recipe: ppo, ppo_short or sac; ppo_quick and sac_quick take seconds. Default: ppo.")
    ] = None,
    config: Annotated[Path | None, Option(metavar="FILE.yml", help="A training file of your own instead.")] = None,
    steps: Annotated[int | None, number(
        "Control periods of single rigs. Default: the recipe's.", Limits(1, 10**12, whole=True)
    )] = None,
    seed: Annotated[int | None, number("Seed of networks, exploration and environment.", SEEDS)] = None,
    resume: Annotated[
        bool, Option("--resume", help="Go on from the last checkpoint in --out, with the same options.")
    ] = False,
    quiet: Annotated[bool, Option("--quiet", help="No progress bar.")] = False,
) -> None:  # fmt: skip
    """Train a learned agent (needs the extra `agents`).

    Writes policy.npz, which `benchmark` takes, curve.json and checkpoints. A stopped run goes on with --resume.
    """
    if algo is not None and config is not None:
        raise InputError("--algo and --config both name a training file; give one of them")
    begun = out / "config.yml"
    from hydro_env.training.config import read_config, with_changes
    from hydro_env.training.recipes import recipe
    from hydro_env.training.train import train as run

    if config is None:
        config = begun if resume and algo is None and begun.is_file() else recipe(algo or "ppo")
    chosen = with_changes(read_config(config), steps=steps, seed=seed)
    threading.excepthook = _once
    progress = run(chosen, out, resume=resume, command=" ".join(["hydro-env", *sys.argv[1:]]), bar=not quiet)
    last = min(progress["curve"], key=lambda row: row["score"])
    print(
        f"best on val after {last['steps']} steps: "
        f"largest speed difference {last['max_speed_difference_rpm']:.1f} rpm, "
        f"tracking error {last['tracking_mae_rpm']:.1f} rpm; {out / 'policy.npz'}"
    )


def _once(problem: threading.ExceptHookArgs) -> None:
    """TensorBoard's thread ends by what its next call raises in this command: a full disk is to be said once."""
    if not issubclass(problem.exc_type, OSError):
        threading.__excepthook__(problem)


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
