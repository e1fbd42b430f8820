"""Options that several commands share, and the folder that every command writes to."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from hydro_env.errors import InputError, shown
from hydro_env.files import output_folder
from hydro_env.limits import CORES, SEEDS, Limits

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
    "number",
    "numbers",
    "writing",
]


def number(*names: str, within: Limits, **more: Any) -> Any:
    """An option that takes a number within limits, which its help and every refusal name."""

    def parsed(text: str) -> Any:
        try:
            return within.read(str(text), "the value")
        except InputError as problem:
            raise typer.BadParameter(str(problem)) from None

    more["help"] = f"{more['help']} {str(within)[0].upper()}{str(within)[1:]}."
    return typer.Option(*names, parser=parsed, metavar="INTEGER" if within.whole else "FLOAT", **more)


Out = Annotated[Path, typer.Option("--out", help="Folder to write to; created if needed.")]
Plant = Annotated[str, typer.Option("--plant", help="Preset or YAML file of the rig.")]
Model = Annotated[str, typer.Option("--model", help="Preset or YAML file of the model.")]
ControlPeriod = Annotated[
    float, number("--control-period", within=Limits(1e-4, 1.0, unit="s"), help="Control period.")
]
Seed = Annotated[
    int, number("--seed", within=SEEDS, help="Random seed; the same seed gives the same result.")
]
EffectFiles = Annotated[
    list[str] | None,
    typer.Option(
        "--effects", metavar="FILE.py", help="Python file that registers your own effects; it is run."
    ),
]
Jobs = Annotated[int, number("--jobs", within=CORES, help="Number of processes.")]
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


MAX_NUMBERS = 100


def numbers(option: str, text: str, within: Limits) -> tuple[float, ...]:
    """`5,20,80` as numbers within limits, none for an empty text."""
    parts = [part for part in text.split(",", MAX_NUMBERS) if part.strip()]
    if len(parts) > MAX_NUMBERS:
        raise InputError(f"{option} is {shown(text)}: at most {MAX_NUMBERS} numbers with commas between them")
    return tuple(within.read(part, option) for part in parts)
