"""An FMU of a rig: its description, its C source, and a binary for this machine where there is a C compiler.

The files are made of the model alone: the same model gives the same bytes, but for the binary, which is the compiler's.
"""

from __future__ import annotations

import hashlib
import platform
import sys
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path

from hydro_env import __version__
from hydro_env.export.c_printer import identifier
from hydro_env.export.compiler import build_library, find_compiler
from hydro_env.export.plant_source import PlantSource, plant_source
from hydro_env.files import write_json
from hydro_env.plant import PlantModel
from hydro_env.units import RPM

from .description import COMMAND_REFERENCE, FIRST_REFERENCE, LOAD_REFERENCE, TIME_REFERENCE, model_description

__all__ = ["Made", "export_fmu"]

HERE = Path(__file__).parent
_MODEL_HEADER = """\
#ifndef HYDRO_MODEL_H
#define HYDRO_MODEL_H
#define TOKEN "{token}"
#define TIME_REFERENCE {time}u
#define COMMAND_REFERENCE {command}u
#define LOAD_REFERENCE {load}u
#define FIRST_REFERENCE {first}u
#define STEP_REFUSED "the communication step must be positive{most}"
#endif
"""
_BUILD = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{identifier}">
    <SourceFileSet language="C99" compilerOptions="-std=c99">
      <SourceFile name="plant.c"/>
      <SourceFile name="fmi3.c"/>
    </SourceFileSet>
    <Library name="m" external="true"/>
  </BuildConfiguration>
</fmiBuildDescription>
"""
#: Folder of the binary and its ending, by `sys.platform` and machine: of FMI 2.0, of FMI 3.0.
_PLATFORMS = {
    ("linux", "x86_64"): ("linux64", "x86_64-linux", ".so"),
    ("linux", "aarch64"): ("", "aarch64-linux", ".so"),
    ("darwin", "x86_64"): ("darwin64", "x86_64-darwin", ".dylib"),
    ("darwin", "arm64"): ("", "aarch64-darwin", ".dylib"),
}


@dataclass(frozen=True)
class Made:
    """What was written: the files, and a note where something is missing."""

    files: tuple[Path, ...]
    note: str


def export_fmu(model: PlantModel, folder: Path, versions: tuple[int, ...] = (2, 3)) -> Made:
    """Writes NAME_fmi2.fmu and NAME_fmi3.fmu, and export.json, to a folder.

    Where there is no C compiler, the files hold the source only, and the note says so. InputError if the source does not
    compile.
    """
    source = plant_source(model, __version__)
    name = identifier(f"hydro_env_{model.name}"[:64])
    compiler = find_compiler()
    files, about = [], []
    built = compiler is not None
    for version in versions:
        path = folder / f"{name}_fmi{version}.fmu"
        binary = _write(path, source, version, name, compiler)
        built = built and binary
        files.append(path)
        about.append(
            {"file": path.name, "fmi": f"{version}.0", "bytes": path.stat().st_size, "binary": binary}
        )
    note = "" if built else (
        "no C compiler was found (cc, gcc, clang or $CC)" if compiler is None
        else f"FMI has no name for binaries of {sys.platform} on {platform.machine()} in one of these versions"
    )  # fmt: skip
    if note:
        note = f"{note}: what has no binary holds the C source only, for tools that compile it"
    data = {
        "schema": "hydro_env/export/1", "kind": "fmu", "model": model.to_dict(),
        "tolerance_rpm": source.model.tolerance / RPM, "files": about,
    }  # fmt: skip
    write_json(folder / "export.json", data)
    return Made(tuple(files), note)


def _write(
    path: Path, source: PlantSource, version: int, identifier: str, compiler: list[str] | None
) -> bool:
    """Writes one FMU; whether there is a binary in it."""
    wrapper = (HERE / f"fmi{version}.c").read_text(encoding="utf-8")
    most = f", and at most {source.most_sent} changes of command under way" if source.most_sent else ""
    digest = hashlib.sha256("\n".join([source.header, source.body, wrapper, identifier]).encode()).digest()
    token = f"{{{uuid.UUID(bytes=digest[:16])}}}"
    model_header = _MODEL_HEADER.format(
        token=token, time=TIME_REFERENCE, command=COMMAND_REFERENCE, load=LOAD_REFERENCE, first=FIRST_REFERENCE, most=most,
    )  # fmt: skip
    content: dict[str, bytes] = {
        "modelDescription.xml": model_description(
            source, version, identifier, token, f"hydro_env {__version__}"
        ),
        "sources/plant.h": source.header.encode(),
        "sources/plant.c": source.body.encode(),
        "sources/model.h": model_header.encode(),
        f"sources/fmi{version}.c": wrapper.encode(),
    }
    if version == 3:
        content["sources/buildDescription.xml"] = _BUILD.format(identifier=identifier).encode()
    place = _PLATFORMS.get((sys.platform, platform.machine()))
    where = place[version - 2] if place else ""
    if compiler is not None and place and where:
        with tempfile.TemporaryDirectory() as room:
            for name, text in content.items():
                if name.startswith("sources/"):
                    (Path(room) / name.removeprefix("sources/")).write_bytes(text)
            library = Path(room) / f"{identifier}{place[2]}"
            build_library(compiler, [Path(room) / "plant.c", Path(room) / f"fmi{version}.c"], library)
            content[f"binaries/{where}/{library.name}"] = library.read_bytes()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    return any(name.startswith("binaries/") for name in content)
