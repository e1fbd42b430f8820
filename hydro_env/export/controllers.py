"""Controllers as C, Structured Text or ONNX: from the name that a user gives to files in a folder."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.controllers.base import Controller
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.registry import CONTROLLERS, make_controller, split_gains
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.errors import InputError, place_of
from hydro_env.files import write_json, write_text
from hydro_env.ir.reader import TranslationError
from hydro_env.plant import Plant, PlantModel, load_model, scales_of

from .c_code import c_code
from .c_printer import identifier
from .structured_text import structured_text
from .symbols import TraceError
from .tracing import Program, trace

__all__ = ["block_of", "c_files", "onnx_file", "program_of", "st_file", "tuned_on", "written"]


def program_of(
    spec: str, period: float, plant: str | None = None, single: bool = False, trust: bool = False, readable: bool = False
) -> Program:  # fmt: skip
    """What a controller does with its samples. `plant`: the rig it drives, whose valves are put on the bench where needed, by
    default that on which its gains were tuned, or the paper's; `single`: a network in single precision, as it runs in Python
    unless asked otherwise; `trust`: as for `make_controller`; `readable`: as for `trace`, but for a law
    that decides by its gains in plain Python, which has them built in.

    InputError for a name that nobody knows, a controller that needs the true plant, and one that cannot be followed.
    """
    model = load_model(plant or tuned_on(spec))
    controller = _controller(spec, model, single, trust)
    make = partial(trace, controller, period, controller.name.partition(":")[0], scales_of(model), readable)
    try:
        if readable:
            with suppress(Exception):
                return make(gains=True)
        return make()
    except (TraceError, TranslationError) as problem:
        raise _refusal(spec, problem) from None
    except Exception as problem:  # of a user's own law, which may do with symbols what only numbers can do
        place = f" ({place_of(problem)})" if place_of(problem) else ""
        raise _refusal(spec, f"{type(problem).__name__}: {problem}{place}") from problem


def _refusal(spec: str, why: object) -> InputError:
    return InputError(f"controller {spec!r} cannot be exported: {why}")


def tuned_on(spec: str) -> str:
    """The plant that a gains file names, or else the paper's."""
    path = split_gains(spec)[0]
    return str((read_gains(path).tuning if path.endswith(".json") else {}).get("plant", "paper_dead_zone"))


def _controller(spec: str, model: PlantModel, single: bool, trust: bool) -> Any:
    controller = make_controller(spec, trust=trust)
    if isinstance(controller, NumpyPolicy):
        return NumpyPolicy(_policy_file(spec), controller.name, np.float32 if single else np.float64)
    if not isinstance(controller, Controller):
        can = "shipped controllers, gains files (.json), policies (.npz) and subclasses of Controller can be"
        raise _refusal(spec, can)
    if controller.needs in ("parameters", "everything"):
        why = "it needs the true plant, which no rig can tell it; one that goes by measurements is right"
        raise _refusal(spec, why)
    controller.drives(model)
    if controller.needs == "bench":
        controller.prepare(Plant(model))
    return controller


def _about(spec: str) -> str:
    entry = CONTROLLERS.get(split_gains(spec)[0])
    return f"In short: {entry.summary}." if entry is not None else "From a file of its user."


def c_files(
    spec: str, folder: Path, period: float, plant: str | None, single: bool, trust: bool = False
) -> dict[str, Any]:
    """Writes NAME.h, NAME.c and export.json; what the latter holds."""
    program = program_of(spec, period, plant, single, trust)
    code = c_code(program, __version__, _about(spec))
    texts = {f"{code.name}.h": code.header, f"{code.name}.c": code.source}
    return written(folder, "c", spec, texts, program)


def st_file(
    spec: str, folder: Path, period: float, plant: str | None, single: bool, trust: bool = False
) -> dict[str, Any]:
    """Writes NAME.st and export.json; what the latter holds. InputError for one that calls compiled functions."""
    program, text = block_of(spec, period, plant, single, trust)
    return written(folder, "st", spec, {f"{identifier(program.name)}.st": text}, program)


def block_of(
    spec: str, period: float, plant: str | None, single: bool, trust: bool = False, name: str = ""
) -> tuple[Program, str]:
    """A readable program and its function block, under its own name or this one. InputError for a controller that calls compiled
    functions."""
    program = program_of(spec, period, plant, single, trust, readable=True)
    program.name = name or program.name
    try:
        return program, structured_text(program, __version__, _about(spec))
    except TraceError as problem:
        raise _refusal(spec, problem) from None


def onnx_file(spec: str, folder: Path) -> dict[str, Any]:
    """Writes NAME.onnx and export.json; what the latter holds. InputError for a controller without a network."""
    from .onnx import export_onnx

    controller = make_controller(spec)
    if not isinstance(controller, NumpyPolicy):
        raise InputError(
            f"controller {spec!r} has no network: learned agents and policies (.npz) can be exported as ONNX"
        )
    name = f"{controller.name}.onnx"
    export_onnx(_policy_file(spec), folder / name)
    return _noted(folder, "onnx", spec, [name], {"interface": controller.interface.table()})


def _policy_file(spec: str) -> Path:
    entry = CONTROLLERS.get(split_gains(spec)[0])
    return entry.file if entry is not None and entry.file is not None else Path(spec)


def written(folder: Path, kind: str, spec: str, texts: dict[str, str], program: Program) -> dict[str, Any]:
    """Writes the files of a program, by name, and export.json."""
    for name, text in texts.items():
        write_text(folder / name, text)
    size = sum(each.size for each in program.state)
    return _noted(folder, kind, spec, [*texts], {"control_period_s": program.period, "state_numbers": size})


def _noted(folder: Path, kind: str, spec: str, files: list[str], about: dict[str, Any]) -> dict[str, Any]:
    """Writes export.json."""
    sizes = [{"file": name, "bytes": (folder / name).stat().st_size} for name in files]
    about = {"schema": "hydro_env/export/1", "kind": kind, "controller": spec, **about, "files": sizes}
    write_json(folder / "export.json", about)
    return about
