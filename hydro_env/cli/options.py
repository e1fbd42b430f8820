"""Options that several commands share, and the folder that every command writes to."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from hydro_env.errors import InputError
from hydro_env.files import output_folder

__all__ = [
    "Cells",
    "ControlPeriod",
    "EffectFiles",
    "Engine",
    "Jobs",
    "Model",
    "Out",
    "Pictures",
    "Plant",
    "Seed",
    "numbers",
    "writing",
]

Out = Annotated[Path, typer.Option("--out", help="Folder to write to; created if needed.")]
Plant = Annotated[str, typer.Option("--plant", help="Preset or YAML file of the rig.")]
Model = Annotated[str, typer.Option("--model", help="Preset or YAML file of the model.")]
ControlPeriod = Annotated[float, typer.Option("--control-period", help="Control period, s.")]
Seed = Annotated[int, typer.Option("--seed", help="Random seed; the same seed gives the same result.")]
EffectFiles = Annotated[
    list[str] | None,
    typer.Option(
        "--effects", metavar="FILE.py", help="Python file that registers your own effects; it is run."
    ),
]
Jobs = Annotated[int, typer.Option("--jobs", min=1, help="Number of processes.")]
Engine = Annotated[
    str, typer.Option(help="local: --jobs processes; ray: the Ray cluster at RAY_ADDRESS or on this machine.")
]
Cells = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder of finished parts; a stopped run continues from there."),
]
Pictures = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Whether to draw pictures.")]


@contextmanager
def writing(out: Path) -> Iterator[Path]:
    """The folder to work in; names what was written and how long it took once it is in its place."""
    start = time.perf_counter()
    with output_folder(out) as folder:
        yield folder
        written = sorted(path.name + "/" * path.is_dir() for path in folder.iterdir())
    print(f"{time.perf_counter() - start:.1f} s. Written to {out}: {', '.join(written)}")


def numbers(option: str, text: str) -> list[float]:
    """`5,20,80` as numbers."""
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InputError(f"{option} is {text!r}: numbers with commas, such as 5,20,80") from None
