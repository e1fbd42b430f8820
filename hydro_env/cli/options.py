"""Options that several commands share, and the folder that every command writes to."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from hydro_env.errors import InputError
from hydro_env.files import output_folder
from hydro_env.limits import CORES, SEEDS, Limits

# fmt: off

def number(help: str, within: Limits, *names: str) -> Any:
    """An option that takes a number within limits, which its help and every refusal name."""

    def parsed(text: str) -> Any:
        try:
            return within.read(str(text), "the value")
        except InputError as problem:
            raise typer.BadParameter(str(problem)) from None

    help = f"{help} {str(within)[0].upper()}{str(within)[1:]}."
    return Option(*names, parser=parsed, metavar="INTEGER" if within.whole else "FLOAT", help=help)


Out = Annotated[Path, Option("--out", help="Folder to write to; created if needed.")]
Plant = Annotated[str, Option("--plant", help="Preset or YAML file of the rig.")]
Model = Annotated[str, Option("--model", help="Preset or YAML file of the model.")]
ControlPeriod = Annotated[float, number("Control period.", Limits(1e-4, 1.0, unit="s"), "--control-period")]
Seed = Annotated[int, number("Random seed; the same seed gives the same result.", SEEDS, "--seed")]
EffectFiles = Annotated[
    list[str] | None,
    Option("--effects", metavar="FILE.py", help="Python file that registers your own effects; it is run."),
]
Jobs = Annotated[int, number("Number of processes.", CORES, "--jobs")]
Engine = Annotated[str, Option(help="local: --jobs processes; ray: the Ray cluster at RAY_ADDRESS or on this machine.")]
Cells = Annotated[Path | None, Option(metavar="DIR", help="Folder of finished parts; a stopped run continues from there.")]
Pictures = Annotated[bool, Option("--pictures/--no-pictures", help="Whether to draw pictures.")]
# fmt: on


@contextmanager
def writing(out: Path) -> Iterator[Path]:
    """The folder to work in; names what was written and how long it took once it is in its place."""
    start = time.perf_counter()
    with output_folder(out) as folder:
        yield folder
        written = sorted(path.name + "/" * path.is_dir() for path in folder.iterdir())
    told = f" Written to {out}: {', '.join(written)}" if written else ""
    print(f"{time.perf_counter() - start:.1f} s.{told}")


def numbers(option: str, text: str, within: Limits) -> tuple[float, ...]:
    """`5,20,80` as numbers within limits, none for an empty text."""
    return tuple(within.read(part, option) for part in text.split(",") if part.strip())
