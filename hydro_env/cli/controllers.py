"""The commands `tune`, `benchmark`, `train` and `dataset`."""

import sys
import threading
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from hydro_env.cli.options import Cells, ControlPeriod, Engine, Jobs, Out, Plant, Seed, number, writing
from hydro_env.errors import InputError
from hydro_env.limits import SEEDS, Limits

PAIRS = Limits(1, 10_000, whole=True)
# fmt: off
Limit = Annotated[
    float, number("Time limit of a controller for one split and scenario.", Limits(1e-3, 1e6, unit="s"))
]
Check = Annotated[Path | None, Option(
    metavar="FILE.json", help="Drive a random tenth of this result file again: it must be the same bit for bit."
)]
Declare = Annotated[Path | None, Option(
    metavar="FILE.yaml", help="How the agent was trained, for the result files of --suite paper."
)]
ScoreSeed = Annotated[int | None, number(
    "Random seed; the same seed gives the same result. Default: 0, with --check another one each time.", SEEDS, "--seed"
)]
# fmt: on


def tune(
    out: Out,
    controller: Annotated[str, Option(
        help="Control law whose gains are tuned, or file.py:Class with gains declared in the class."
    )] = "pid",
    plant: Plant = "paper_dead_zone",
    mismatch: Annotated[str, Option(
        help="train, or own: the plant's own pair of valves. auto: train, but own for a plant file that sets what train draws."
    )] = "auto",
    scenario: Annotated[str, Option(help="Scenarios, separated by commas.")] = "setpoint_steps,random_steps",
    cases: Annotated[int, number("Pairs of valves for each candidate.", PAIRS)] = 12,
    episodes: Annotated[int, number("Budget: number of simulated episodes.", Limits(1, 10_000_000, whole=True))] = 11520,
    weight: Annotated[
        float, number("Weight of the synchronisation error against the tracking error.", Limits(0.0, 1000.0))
    ] = 2.0,
    control_period: ControlPeriod = 0.01,
    seed: Seed = 0,
    name: Annotated[str | None, Option(help="Name of the controller on the leaderboard.")] = None,
    linear: Annotated[
        bool, Option(help="PID gains from the linearised plant, compared with Table III of the paper.")
    ] = False,
    max_sensitivity: Annotated[float, number("With `--linear`: maximum sensitivity Ms.", Limits(1.05, 4.0))] = 1.3,
) -> None:  # fmt: skip
    """Tune the gains of a controller.

    Writes gains.json, which `benchmark` takes. `--linear` takes --plant and --max-sensitivity.
    """
    with writing(out) as folder:
        if linear:
            from hydro_env.controllers.tuning import linearised as tuner

            # The linearised plant has no dead zone: the paper's own is the one to be asked unless another one is named.
            chosen = "paper" if plant == "paper_dead_zone" else plant
            print(tuner.summary(tuner.run(folder, plant=chosen, max_sensitivity=max_sensitivity, name=name)))
            return
        from hydro_env.controllers.tuning.search import Search, Task
        from hydro_env.controllers.tuning.tune import run, summary

        task = Task(controller, weight, plant, mismatch, scenarios=tuple(scenario.split(",")))
        print(summary(run(folder, Search(task, seed, control_period, cases, episodes), name)))


def benchmark(
    controllers: Annotated[list[str] | None, Argument(
        metavar="[CONTROLLER]...",
        help="Names, gains files (.json), policies (.npz), agents of Stable-Baselines3 (.zip, with --trust), file.py:Class "
        "(file.py: all in it) or module:Class, each with gains if wanted (NAME:Kp=0.2,Ki=1); all (default): every shipped "
        "controller.",
    )] = None,
    more: Annotated[
        list[str] | None, Option("--controllers", metavar="CONTROLLER...", help="The same, as an option.")
    ] = None,
    suite: Annotated[str, Option(help="quick, full, paper (the protocol: all that can be cited) or a YAML file.")] = "full",
    split: Annotated[list[str] | None, Option(
        help="Only this split; may be repeated. own: the plant's own pair of valves, the default for a plant file that sets what "
        "the suite's splits draw."
    )] = None,
    scenario: Annotated[list[str] | None, Option(help="Only this scenario; may be repeated.")] = None,
    cases: Annotated[int | None, number("Pairs of valves per split. Default: the suite's.", PAIRS)] = None,
    plant: Plant = "paper_dead_zone",
    control_period: ControlPeriod = 0.01,
    seed: ScoreSeed = None,
    mapping: Annotated[Path | None, Option(
        metavar="FILE.yaml", help="Which variables of an FMU (--plant FILE.fmu, with --trust) are meant."
    )] = None,
    limit: Limit = 600.0,
    as_shipped: Annotated[bool, Option(
        "--as-shipped", help="On a plant file: score shipped gains, carried over by similarity, instead of tuning them for this "
        "plant first (once; kept in the folder gains of --cells, else of --out)."
    )] = False,
    out: Annotated[Path | None, Option(help="Folder to write to; created if needed. Needed but with --check.")] = None,
    check: Check = None,
    declare: Declare = None,
    trust: Annotated[bool, Option(
        "--trust", help="Use files that can run code: agents (.zip, a pickle), gains of a law in a Python file, FMUs."
    )] = False,
    engine: Engine = "local",
    jobs: Jobs = 1,
    cells: Cells = None,
) -> None:  # fmt: skip
    """Score controllers on the fixed suite.

    Writes scores.json and scores.html; with --suite paper also result_NAME.json of each controller.
    """
    from hydro_env.benchmark import command, result
    from hydro_env.benchmark.cells import Conditions

    given = [*(controllers or []), *(more or [])]
    if check is not None:
        print(result.check(check, given, seed=seed, trust=trust, engine=engine, jobs=jobs))
        return
    if out is None:
        raise InputError("Missing option '--out': the folder to write to")
    with writing(out) as folder:
        rig, split = _rig(plant, mapping, split, trust)
        selection = command.Selection(suite, split, scenario, cases, declare)
        conditions = Conditions(rig, control_period, seed or 0, limit)
        scores = command.run(
            folder, controllers=given, selection=selection, conditions=conditions, engine=engine, jobs=jobs, cells_folder=cells,
            trust=trust, gains=None if as_shipped else (cells or out) / "gains",
        )  # fmt: skip
        print(command.report(scores))


def _rig(
    plant: str, mapping: Path | None, split: list[str] | None, trust: bool
) -> tuple[Any, list[str] | None]:
    """The plant that is driven, and the splits: an FMU has its own pair of valves."""
    from hydro_env.fmu_plant import is_fmu, load_fmu

    if not is_fmu(plant):
        if mapping is not None:
            raise InputError("--mapping goes with an FMU, as in --plant FILE.fmu")
        return plant, split
    if split not in (None, ["own"]):
        raise InputError("--split: an FMU has its own valves, so only own is right")
    return load_fmu(plant, mapping, trust=trust), ["own"]


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
