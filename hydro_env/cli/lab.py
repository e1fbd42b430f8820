"""The command `lab`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hydro_env.cli.options import EffectFiles, Plant, number
from hydro_env.limits import Limits

Port = Annotated[
    int,
    number("--port", within=Limits(0, 65535, whole=True), help="Port on this machine; 0: any that is free."),
]


Controller = Annotated[
    str, typer.Option(help="Controller that begins: a name, gains.json, policy.npz or file.py:Class.")
]


def lab(
    out: Annotated[
        Path, typer.Option("--out", help="Folder for logs and reports; created when needed.")
    ] = Path("lab"),
    plant: Plant = "paper_dead_zone",
    controller: Controller = "pid_tuned",
    port: Port = 8137,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Whether to open the page.")] = True,
    effect_files: EffectFiles = None,
) -> None:
    """Run a rig on a page of this machine.

    Change controller, valves and effects while it runs, record logs and diagnose them. Ctrl-C ends it.
    """
    from hydro_env.lab import server
    from hydro_env.lab.session import Settings
    from hydro_env.plant import load_effects
    from hydro_env.tasks import default_mismatch

    load_effects(effect_files or [])
    split = default_mismatch(plant, "test_interp")
    server.run(out, Settings(preset=plant, split=split, controller=controller), port=port, browser=browser)
