"""The commands `live` and `lab`."""

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hydro_env.cli.options import EffectFiles, Plant, number
from hydro_env.errors import InputError
from hydro_env.limits import Limits

#: Exit status of a run that ended in a fault.
FAULT = 3


def live(
    link: Annotated[Path, Argument(metavar="LINK.yaml", help="How the rig is reached, and its limits.")],
    out: Annotated[Path, Option("--out", help="Folder for the logs; created if needed. Each run begins a new one.")],
    controller: Annotated[str | None, Argument(
        metavar="[CONTROLLER]", help="A name, gains.json, policy.npz, agent.zip (with --trust) or file.py:Class."
    )] = None,
    scenario: Annotated[str | None, Option(
        metavar="NAME|FILE.yaml", help="Set-points to follow: a scenario, or step tables. Default: the set-point of the rig."
    )] = None,
    experiment: Annotated[Path | None, Option(
        metavar="CSV", help="Play these commands instead of a controller: next_experiment.csv of `diagnose`."
    )] = None,
    plant: Plant = "paper_dead_zone",
    command_limit: Annotated[float | None, number(
        "Largest command, per cent of the rated one. Default: that of the link file, which is at most 20.",
        Limits(1.0, 100.0, unit="%"),
    )] = None,
    duration: Annotated[float | None, number("End of the run.", Limits(0.1, 1e6, unit="s"))] = None,
    trust: Annotated[bool, Option("--trust", help="Use controllers whose files can run code, as for `benchmark`.")] = False,
    effect_files: EffectFiles = None,
) -> None:  # fmt: skip
    """Drive a real rig over OPC UA or UDP (needs the extra `live`).

    No safety function. Ctrl-C, every fault and the end of the run write zero commands. After a fault zero is written until
    Ctrl-C, and the exit status is 3. Writes log_1.csv, a rig log, and log_1.jsonl, what else happened.
    """
    if (controller is None) == (experiment is None):
        raise InputError("name a controller, or an --experiment to play; one of them")
    if experiment is not None and scenario is not None:
        raise InputError("--scenario goes with a controller; an --experiment has commands of its own")
    from hydro_env.live.driver import controlled, played
    from hydro_env.live.link import load_link
    from hydro_env.live.run import Run
    from hydro_env.plant import load_effects, load_model

    load_effects(effect_files or [])
    rig, model = load_link(link), load_model(plant)
    limit = (rig.command_limit_percent if command_limit is None else command_limit) / 100.0
    if experiment is not None:
        driver = played(experiment, rig, model)
    else:
        driver = controlled(str(controller), rig, model, scenario, (limit, rig.rate_limit), trust)
    told = partial(print, file=sys.stderr, flush=True)
    for line in rig.warnings(limit):
        told(line)
    if Run(rig, driver, out, model.pair("u_rated"), limit=limit, duration=duration, told=told)():
        raise typer.Exit(FAULT)


def lab(
    out: Annotated[Path, Option("--out", help="Folder for logs and reports; created when needed.")] = Path("lab"),
    plant: Plant = "paper_dead_zone",
    controller: Annotated[
        str, Option(help="Controller that begins: a name, gains.json, policy.npz or file.py:Class.")
    ] = "pid_tuned",
    port: Annotated[int, number("Port on this machine; 0: any that is free.", Limits(0, 65535, whole=True))] = 8137,
    browser: Annotated[bool, Option("--browser/--no-browser", help="Whether to open the page.")] = True,
    live: Annotated[
        Path | None, Option(metavar="DIR", help="Only show a run of `hydro-env live`: the newest log in its --out.")
    ] = None,
    effect_files: EffectFiles = None,
) -> None:  # fmt: skip
    """Run a rig on a page of this machine.

    Change controller, valves and effects while it runs, record logs and diagnose them. Ctrl-C ends it.
    """
    from hydro_env.lab import server
    from hydro_env.lab.session import Settings
    from hydro_env.plant import load_effects
    from hydro_env.tasks import default_mismatch

    load_effects(effect_files or [])
    split = default_mismatch(plant, "test_interp")
    server.run(
        out, Settings(preset=plant, split=split, controller=controller), live=live, port=port, browser=browser
    )
