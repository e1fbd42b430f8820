"""The command `lab`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from hydro_env.cli.options import EffectFiles, Plant, number
from hydro_env.limits import Limits


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
