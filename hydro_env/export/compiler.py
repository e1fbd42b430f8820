"""The C compiler of this machine, where there is one."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

from hydro_env.errors import InputError

#: No floating-point operation is fused or reordered: Clang fuses in C99 too, where the processor can.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")


def find_compiler() -> list[str] | None:
    """The command of a C compiler: `$CC`, else cc, gcc or clang; None if there is none. InputError for a `$CC` that is no
    program here."""
    named = shlex.split(os.environ.get("CC", ""))
    if named:
        if shutil.which(named[0]) is None:
            raise InputError(f"CC is {named[0]!r}, which is no program here; unset it, or name a C compiler")
        return named
    return next(([found] for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)


def build_library(
    compiler: list[str], sources: Iterable[Path], library: Path, flags: Iterable[str] = FLAGS
) -> None:
    """Makes a shared library. InputError with the compiler's first complaint if it does not compile."""
    library.parent.mkdir(parents=True, exist_ok=True)
    names = [str(path) for path in sources]
    shared = ["-shared"] if library.suffix == ".dll" else ["-shared", "-fPIC"]
    command = [*compiler, *flags, *shared, "-fvisibility=hidden", *names, "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = done.stderr.splitlines()
        lines = [line for line in said if "error" in line] or said or ["no message"]
        raise InputError(f"{compiler[0]} does not compile the exported C source: {lines[0]}")
