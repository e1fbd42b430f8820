"""An FMU of a rig: its description, its C source, and binaries for this machine and others where there is a C compiler.

The files are made of the model alone: the same model gives the same bytes, but for the binaries, which are the compilers'.
"""

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hydro_env import __version__
from hydro_env.errors import InputError, check_known, to_install
from hydro_env.export.c_printer import identifier
from hydro_env.export.plant_source import PlantSource, plant_source
from hydro_env.export.templates import template
from hydro_env.files import write_json
from hydro_env.plant import PlantModel
from hydro_env.units import RPM

from .description import COMMAND_REFERENCE, FIRST_REFERENCE, LOAD_REFERENCE, TIME_REFERENCE, model_description

HERE = Path(__file__).parent
#: No floating-point operation is fused or reordered: Clang fuses in C99 too, where the processor can.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
#: By the name of a platform: its `sys.platform` and machine, the folder of the binary in FMI 2.0 (which has none for some) and in
#: FMI 3.0, its ending, and what Zig calls it.
PLATFORMS = {
    "linux64": (("linux", "x86_64"), "linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),
    "linux-arm64": (("linux", "aarch64"), "", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
    "win64": (("win32", "AMD64"), "win64", "x86_64-windows", ".dll", "x86_64-windows-gnu"),
    "darwin64": (("darwin", "x86_64"), "darwin64", "x86_64-darwin", ".dylib", "x86_64-macos"),
    "darwin-arm64": (("darwin", "arm64"), "", "aarch64-darwin", ".dylib", "aarch64-macos"),
}


@dataclass(frozen=True)
class Made:
    """What was written: the files, and a note where something is missing."""

    files: tuple[Path, ...]
    note: str


def export_fmu(
    model: PlantModel, folder: Path, versions: tuple[int, ...] = (2, 3), platforms: tuple[str, ...] = ()
) -> Made:
    """Writes NAME_fmi2.fmu and NAME_fmi3.fmu, and export.json, to a folder, with binaries for `platforms` (of `PLATFORMS`; none:
    for this machine).

    Where there is no C compiler for this machine, the files hold the source only, and the note says so. InputError if the source
    does not compile, for an unknown platform, and for another one than this machine's without Zig (extra `windows`).
    """
    source = plant_source(model, __version__)
    name = identifier(f"hydro_env_{model.name}"[:64])
    compilers = _compilers(platforms)
    files, about, missing = [], [], []
    for version in versions:
        path = folder / f"{name}_fmi{version}.fmu"
        binaries = _write(path, source, version, name, compilers)
        wanted = platforms or (() if binaries else (f"{sys.platform} on {platform.machine()}",))
        missing += [f"{each} in FMI {version}.0" for each in wanted if each not in binaries]
        files.append(path)
        written = {"file": path.name, "fmi": f"{version}.0", "bytes": path.stat().st_size}
        about.append({**written, "binaries": binaries})
    without = "" if compilers or find_compiler() else "no C compiler was found (cc, gcc, clang or $CC)"
    why = without or f"no binary for {', '.join(missing)}"
    note = f"{why}: what has no binary holds the C source only, for tools that compile it" if missing else ""
    data = {
        "schema": "hydro_env/export/1", "kind": "fmu", "model": model.to_dict(),
        "tolerance_rpm": source.model.tolerance / RPM, "files": about,
    }  # fmt: skip
    write_json(folder / "export.json", data)
    return Made(tuple(files), note)


def _compilers(platforms: tuple[str, ...]) -> dict[str, list[str]]:
    """The command of a compiler for each platform; for this machine, if there is one, where none is named."""
    here = sys.platform, platform.machine()
    own = {name: find_compiler() for name, each in PLATFORMS.items() if each[0] == here}
    found = {name: command for name, command in own.items() if command and name in (platforms or own)}
    for name in platforms:
        check_known("--platform is", [name], PLATFORMS)
        if name not in found and importlib.util.find_spec("ziglang") is None:
            raise InputError(f"--platform {name} needs the compiler Zig: {to_install('windows')}")
        found.setdefault(name, [sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[name][4]])
    return found


def _write(
    path: Path, source: PlantSource, version: int, identifier: str, compilers: dict[str, list[str]]
) -> list[str]:
    """Writes one FMU; the platforms for which there is a binary in it."""
    wrapper = (HERE / f"fmi{version}.c").read_text(encoding="utf-8")
    most = f", and at most {source.max_sent} changes of command under way" if source.max_sent else ""
    digest = hashlib.sha256("\n".join([source.header, source.body, wrapper, identifier]).encode()).digest()
    token = f"{{{uuid.UUID(bytes=digest[:16])}}}"
    model_header = template("model.h").substitute(
        token=token, time=TIME_REFERENCE, command=COMMAND_REFERENCE, load=LOAD_REFERENCE, first=FIRST_REFERENCE, most=most,
    )  # fmt: skip
    description = model_description(source, version, identifier, token, f"hydro_env {__version__}")
    content: dict[str, bytes] = {
        "modelDescription.xml": description,
        "sources/plant.h": source.header.encode(),
        "sources/plant.c": source.body.encode(),
        "sources/model.h": model_header.encode(),
        f"sources/fmi{version}.c": wrapper.encode(),
    }
    if version == 3:
        build = template("buildDescription.xml").substitute(identifier=identifier)
        content["sources/buildDescription.xml"] = build.encode()
    binaries = [name for name in compilers if PLATFORMS[name][version - 1]]
    with tempfile.TemporaryDirectory() as room:
        for name, text in content.items():
            if name.startswith("sources/"):
                (Path(room) / name.removeprefix("sources/")).write_bytes(text)
        for name in binaries:
            where, ending = PLATFORMS[name][version - 1], PLATFORMS[name][3]
            library = Path(room) / f"{identifier}{ending}"
            build_library(compilers[name], [Path(room) / "plant.c", Path(room) / f"fmi{version}.c"], library)
            content[f"binaries/{where}/{library.name}"] = library.read_bytes()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return binaries


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
