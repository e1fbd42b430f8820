"""Controllers as C, Structured Text or ONNX: from the name that a user gives to files in a folder."""

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.controllers.base import Controller
from hydro_env.controllers.input_guard import HOLD, MAX_VALUE, held_samples
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.registry import CONTROLLERS, make_controller, split_gains
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.errors import InputError, described
from hydro_env.files import write_json, write_text
from hydro_env.ir.nodes import without_unread
from hydro_env.ir.reader import Reader, TranslationError
from hydro_env.plant import Plant, PlantModel, load_model, scales_of

from .c_printer import RESERVED, TYPES, identifier, source, statements, variables
from .schedule import Schedule
from .structured_text import structured_text
from .symbols import TraceError
from .templates import template
from .tracing import MEASURED, Program, trace


def program_of(
    spec: str, period: float, plant: str | None = None, single: bool = False, trust: bool = False, readable: bool = False
) -> Program:  # fmt: skip
    """What a controller does with its samples. `plant`: the rig it drives, whose valves are put on the bench where needed, by
    default that on which its gains were tuned, or the paper's; `single`: a network in single precision, as it runs in Python
    unless asked otherwise; `trust`: as for `make_controller`; `readable`: with names, and with gains as inputs but for a law that
    decides by them in plain Python.

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
        raise _refusal(spec, described(problem)) from problem


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


def c_code(program: Program, about: str) -> dict[str, str]:
    """A program as C99: the texts of NAME.h and NAME.c, by file; a state of fixed size, nothing allocated. `about`: a sentence on
    the controller."""
    name = identifier(program.name)
    reader = Reader(reserved=RESERVED)
    bodies = []
    for which, assignments in (("first", program.first), ("next", program.next)):
        schedule = Schedule(assignments, reader, "s->")
        changing = {made.name for made in reader.functions.values() if made.written}
        body, declared = without_unread(schedule.body, schedule.variables, changing)
        lines = [*variables(declared), "(void)measured;", *statements(body)]
        head = f"static void {which}_sample({name}_state *s, const double *measured, double *command) {{"
        bodies.append("\n".join([head, *("    " + line for line in lines), "}", ""]))
    state = "".join(f"    {TYPES[kind]} {each}[{size}];\n" for each, (kind, size) in program.state.items())
    header, step = (
        template(file).substitute(
            name=name, guard=name.upper(), period=repr(program.period), about=about, version=__version__, measured=len(MEASURED),
            hold=f"{HOLD:g}", samples=held_samples(program.period), state=state, most=MAX_VALUE,
        )
        for file in ("controller.h", "controller.c")
    )  # fmt: skip
    return {f"{name}.h": header, f"{name}.c": f'#include "{name}.h"\n' + source(reader, *bodies, step)}


#: How a program is written, by the name of the language.
_LANGUAGES = {"c": c_code, "st": structured_text}


def texts_of(
    language: str, spec: str, period: float, plant: str | None = None, single: bool = False, trust: bool = False, name: str = ""
) -> tuple[Program, dict[str, str]]:  # fmt: skip
    """A controller's program, under its own name or this one, and the texts of its files, as for `export_controller`."""
    program = program_of(spec, period, plant, single, trust, readable=language == "st")
    program.name = name or program.name
    entry = CONTROLLERS.get(split_gains(spec)[0])
    about = f"In short: {entry.summary}." if entry is not None else "From a file of its user."
    try:
        return program, _LANGUAGES[language](program, about)
    except TraceError as problem:
        raise _refusal(spec, problem) from None


def export_controller(
    language: str, spec: str, folder: Path, period: float, plant: str | None = None, single: bool = False,
    trust: bool = False,
) -> None:  # fmt: skip
    """Writes a controller in C ("c": NAME.h and NAME.c) or Structured Text ("st": NAME.st), and export.json. The rest as for
    `program_of`. InputError as there, and for Structured Text of one that calls compiled functions."""
    write_program(folder, language, spec, *texts_of(language, spec, period, plant, single, trust))


def write_program(folder: Path, kind: str, spec: str, program: Program, texts: dict[str, str]) -> None:
    """Writes the files of a program, by name, and export.json."""
    for name, text in texts.items():
        write_text(folder / name, text)
    about = {
        "control_period_s": program.period,
        "state_numbers": sum(size for _, size in program.state.values()),
    }
    _note(folder, kind, spec, [*texts], about)


def export_network(spec: str, folder: Path) -> None:
    """Writes the network of a learned agent in ONNX (NAME.onnx), and export.json. InputError for a controller without one."""
    from .onnx import export_onnx

    controller = make_controller(spec)
    if not isinstance(controller, NumpyPolicy):
        raise InputError(
            f"controller {spec!r} has no network: learned agents and policies (.npz) can be exported as ONNX"
        )
    name = f"{controller.name}.onnx"
    export_onnx(_policy_file(spec), folder / name)
    _note(folder, "onnx", spec, [name], {"interface": controller.interface.table()})


def _policy_file(spec: str) -> Path:
    entry = CONTROLLERS.get(split_gains(spec)[0])
    return entry.file if entry is not None and entry.file is not None else Path(spec)


def _note(folder: Path, kind: str, spec: str, files: list[str], about: dict[str, Any]) -> None:
    """Writes export.json."""
    sizes = [{"file": name, "bytes": (folder / name).stat().st_size} for name in files]
    note = {"schema": "hydro_env/export/1", "kind": kind, "controller": spec, **about, "files": sizes}
    write_json(folder / "export.json", note)
